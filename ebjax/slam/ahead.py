"""Work on frames before their turn, on a thread of its own; what depends on nothing but the frame stays the same."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from ebjax.slam.frame import Frame


class Ahead:
    """What was begun, by frame and by what is made of it."""

    def __init__(self):
        self._pool = ThreadPoolExecutor(1)
        self._begun: dict[tuple[str, int], tuple[Frame, Future]] = {}
        self._spare: list[Future] = []

    def begin(self, what: str, number: int, frame: Frame, make: Callable[[int, Frame], Any]) -> None:
        """Makes something of a frame beside what else is done."""
        if (what, number) not in self._begun:
            self._begun[what, number] = frame, self._pool.submit(make, number, frame)

    def spare(self, work: Callable[[], Any]) -> None:
        """Does what nobody waits for; what it raises, a later `forget` does."""
        self._spare.append(self._pool.submit(work))

    def take(self, what: str, number: int, frame: Frame, make: Callable[[int, Frame], Any]) -> Any:
        """The same, waited for where it was begun with this frame, else made now."""
        begun, waited = self._begun.pop((what, number), (None, None))
        return waited.result() if waited is not None and begun is frame else make(number, frame)

    def forget(self, number: int) -> None:
        """Lets go of all frames up to that one."""
        for what, old in [key for key in self._begun if key[1] <= number]:
            self._begun.pop((what, old))[1].cancel()
        while self._spare and self._spare[0].done():
            self._spare.pop(0).result()
