"""A run of one's own that a task learns from, and the flags that read it again."""

import dataclasses
import shlex

from ebjax.io.logs.open import LogOptions
from ebjax.mapping.open_run import RunOptions, flags_of


@dataclasses.dataclass(frozen=True)
class OwnRun(RunOptions):
    """Where a run is, and how it is read."""

    time_offset_s: float = 0.0
    """Added to the images' stamps, s; `python -m ebjax.slam` tells which."""


def log_flags(options: OwnRun) -> str:
    """The flags that read the same log again, as they are typed; empty where none was given."""
    usual = flags_of(LogOptions())
    given = {name: value for name, value in flags_of(options.log).items() if value != usual[name]}
    return "".join(f" {name} {shlex.quote(str(value))}" for name, value in given.items())
