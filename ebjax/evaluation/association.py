"""Pairs of two lists of times: one to one, in order, and in words which poses found no partner."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ebjax.io.clocks import seconds_text
from ebjax.io.timed_poses import nearest


def associate(
    reference_times: Float[np.ndarray, " N"], estimate_times: Float[np.ndarray, " M"], max_difference_s: float = 0.01
) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]]:
    """Pairs each instant of the shorter trajectory with the nearest of the longer, at most max_difference_s away.

    Pairs are one to one: of several instants with the same nearest one the closest keeps it, of rows with one
    timestamp the first counts. Where evo's pairs are one to one, these are the same.

    Args:
      reference_times: s, sorted.
      estimate_times: s, sorted.
      max_difference_s: how far apart two times may be.

    Returns:
      Row numbers of the pairs in the reference and in the estimate, both increasing; empty when nothing matches.
    """
    if len(reference_times) < len(estimate_times):
        estimate, reference = associate(estimate_times, reference_times, max_difference_s)
        return reference, estimate
    long, long_rows = np.unique(reference_times, return_index=True)
    short, short_rows = np.unique(estimate_times, return_index=True)
    after = np.clip(np.searchsorted(long, short), 0, len(long) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(short - long[before] <= np.abs(long[after] - short), before, after)
    difference = np.abs(long[nearest] - short)
    closest_first = np.lexsort((difference, nearest))
    kept = closest_first[np.unique(nearest[closest_first], return_index=True)[1]]
    kept = kept[difference[kept] <= max_difference_s]
    return long_rows[nearest[kept]], short_rows[kept]


@dataclass(frozen=True)
class Pairing:
    """Pairs of an estimate and a reference by time.

    Attributes:
      reference_times: s, of all its poses.
      estimate_times: s, of all its poses, on the reference's clock.
      max_difference_s: how far apart the times of a pair may be.
      i: rows of the pairs in the reference.
      j: rows of the pairs in the estimate.
    """

    reference_times: Float[np.ndarray, " N"]
    estimate_times: Float[np.ndarray, " M"]
    max_difference_s: float
    i: Int[np.ndarray, " K"]
    j: Int[np.ndarray, " K"]

    def __len__(self) -> int:
        """Returns the number of pairs."""
        return len(self.i)

    @property
    def possible(self) -> int:
        """Poses of the file that has fewer."""
        return min(len(self.reference_times), len(self.estimate_times))

    @property
    def few(self) -> bool:
        """Whether less than half of the poses of the file that has fewer found a partner."""
        return 2 * len(self) < self.possible

    @property
    def differences(self) -> Float[np.ndarray, " K"]:
        """How far apart the times of each pair are, s."""
        return np.abs(self.reference_times[self.i] - self.estimate_times[self.j])


def pair(
    reference_times: Float[np.ndarray, " N"], estimate_times: Float[np.ndarray, " M"], max_difference_s: float
) -> Pairing:
    """As `associate`, with the times kept beside the pairs."""
    i, j = associate(reference_times, estimate_times, max_difference_s)
    return Pairing(reference_times, estimate_times, max_difference_s, i, j)


def pairing_lines(pairing: Pairing) -> list[str]:
    """Says how many poses were paired, how far apart, and how many of the file that has fewer were left out and why."""
    apart, own, other = pairing.differences, len(pairing.estimate_times), len(pairing.reference_times)
    line = f"matched {len(pairing)} of {own} poses to the reference's {other} within {pairing.max_difference_s:g} s"
    lines = [f"{line}; the times of a pair differ by {np.median(apart):.2g} s (median), {apart.max():.2g} s at most"]
    if left_out := _left_out(pairing):
        lines.append(left_out)
    return lines


def _left_out(pairing: Pairing) -> str:
    times, others, paired, name = pairing.estimate_times, pairing.reference_times, pairing.j, "trajectory"
    if len(others) < len(times):
        times, others, paired, name = others, times, pairing.i, "reference"
    other = "reference" if name == "trajectory" else "trajectory"
    alone = np.delete(times, paired)
    if not len(alone):
        return ""
    before = int((alone < others[0] - pairing.max_difference_s).sum())
    after = int((alone > others[-1] + pairing.max_difference_s).sum())
    near = np.abs(others[nearest(others, alone)] - alone) <= pairing.max_difference_s
    far, taken = len(alone) - before - after - int(near.sum()), int(near.sum())
    reasons = [f"{before} before the {other}'s first pose"] if before else []
    reasons += [f"{after} after the {other}'s last pose"] if after else []
    reasons += [f"{far} with no pose of the {other} within {seconds_text(pairing.max_difference_s)} s"] if far else []
    reasons += [f"{taken} whose nearest is paired with a nearer one"] if taken else []
    return f"{len(alone)} of the {name}'s {len(times)} poses are left out: {', '.join(reasons)}"
