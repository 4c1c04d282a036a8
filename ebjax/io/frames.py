"""The images of a run's frames, decoded when asked for; those that cannot be read are noted and left out."""

from collections.abc import Callable

import numpy as np

from ebjax.io.sequence import BrokenFrame, Sequence


class Frames:
    """Loads frames by their number, None for those that cannot be read; what is wrong with these is kept, by frame."""

    def __init__(self, sequence: Sequence):
        self.sequence = sequence
        self.faults: dict[int, str] = {}

    def rgb(self, k: int) -> np.ndarray | None:
        """The image of frame k."""
        return self._readable(k, self.sequence.rgb)

    def depth(self, k: int) -> np.ndarray | None:
        """The depth of frame k."""
        return self._readable(k, self.sequence.depth)

    def both(self, k: int) -> tuple[np.ndarray, np.ndarray | None] | None:
        """The image and, where the run has depth, the depth of frame k, as `slam.pipeline` takes them."""
        rgb = self.rgb(k)
        if rgb is None or not self.sequence.has_depth:
            return None if rgb is None else (rgb, None)
        depth = self.depth(k)
        return None if depth is None else (rgb, depth)

    @property
    def broken(self) -> dict[str, str]:
        """What is wrong with the frames that could not be read, by name, in the order of the run."""
        return {self.sequence.names[k]: self.faults[k] for k in sorted(self.faults)}

    def told(self) -> str:
        """One line on the frames that could not be read; empty where all could."""
        if not self.faults:
            return ""
        first = next(iter(self.faults.values()))
        return f"{len(self.faults)} frames could not be read, first {first}"

    def _readable(self, k: int, read: Callable[[int], np.ndarray]) -> np.ndarray | None:
        try:
            return read(k)
        except BrokenFrame as fault:
            self.faults[k] = " ".join(str(fault).split())
            return None
