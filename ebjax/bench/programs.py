"""Programs that JAX compiles, or reads from its cache, while a block runs: by its own events."""

import contextlib
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import jax

COMPILED = "/jax/core/compile/backend_compile_duration"
HIT = "/jax/compilation_cache/cache_hits"


@dataclass
class Programs:
    """What was asked for so far.

    Attributes:
      asked: how often a program of a name was not there in this process.
      hits: how many of these were read from the cache.
      here: how many were asked for by the thread that counts; others work beside it.
    """

    asked: Counter[str] = field(default_factory=Counter)
    hits: int = 0
    here: int = 0

    @property
    def compiled(self) -> int:
        """Programs compiled anew."""
        return self.asked.total() - self.hits


@contextlib.contextmanager
def counted() -> Iterator[Programs]:
    """Counts the programs of a block."""
    found, me = Programs(), threading.get_ident()

    def compiled(event: str, duration_secs: float, **what: str | int) -> None:
        if event == COMPILED:
            found.asked[str(what.get("fun_name", "?"))] += 1
            found.here += threading.get_ident() == me

    def heard(event: str, **what: str | int) -> None:
        found.hits += event == HIT

    jax.monitoring.register_event_duration_secs_listener(compiled)
    jax.monitoring.register_event_listener(heard)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(compiled)
        jax.monitoring.unregister_event_listener(heard)
