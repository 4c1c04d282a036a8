"""The images of a run's frames, decoded when asked for; those that cannot be read are noted and left out."""

from ebjax.io.sequence import BrokenFrame, Sequence


class Frames:
    """Loads frames by their number and keeps what is wrong with broken ones."""

    def __init__(self, sequence: Sequence):
        self.sequence = sequence
        self._faults: dict[int, str] = {}

    def load_rgb(self, k: int):
        """RGB of frame k alone, in a tuple, or None; what is wrong with it is noted when it is loaded in full."""
        try:
            return (self.sequence.rgb(k),)
        except BrokenFrame:
            return None

    def load(self, k: int):
        """RGB and depth of frame k, or None."""
        try:
            return self.sequence.rgb(k), self.sequence.depth(k) if self.sequence.has_depth else None
        except BrokenFrame as fault:
            self._faults[k] = " ".join(str(fault).split())
            return None

    @property
    def broken(self) -> dict[str, str]:
        """What is wrong with the frames that could not be read, by name, in the order of the run."""
        return {self.sequence.names[k]: self._faults[k] for k in sorted(self._faults)}
