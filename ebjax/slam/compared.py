"""Which closures of a group agree with each other: every two are compared once as the group grows."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.planar import inverse, inverse_covariance
from ebjax.posegraph.consistency import Loops, cycle
from ebjax.posegraph.robust import CHI2_99
from ebjax.slam.measured import Measured
from ebjax.slam.walked import Walked

ROOM = 128
"""Closures of the largest group; all are compared by one program."""


class Compared:
    """The closures of the last groups and which two of them agree."""

    def __init__(self):
        self._known: dict[int, tuple[Int[np.ndarray, " n"], Bool[np.ndarray, "n n"]]] = {}

    def agree(
        self, number: int, group: Int[np.ndarray, " n"], candidates: Measured, path: Walked
    ) -> Bool[np.ndarray, "n n"]:
        """Which of a group agree.

        Args:
          number: of the group; groups long past are not asked again.
          group: rows of the candidates, ascending along the path, ROOM at most.
          candidates: that the rows are of.
          path: walked between their ends.
        """
        known, agree = (np.eye(len(group), dtype=bool) for _ in range(2))
        for rows, theirs in self._known.values():
            _, here, there = np.intersect1d(group, rows, assume_unique=True, return_indices=True)
            known[np.ix_(here, here)], agree[np.ix_(here, here)] = True, theirs[np.ix_(there, there)]
        if not known.all():
            loops = loops_of(candidates.rows(group), path)
        # One closure that is new lacks all others, and each of these only the new one.
        while not known.all():
            a = int(np.argmin(known.sum(1)))
            both = np.asarray(_row_of_cycles(loops, a)).max(0)[: len(group)]
            lacking = np.flatnonzero(~known[a])
            agree[a, lacking] = agree[lacking, a] = both[lacking] <= CHI2_99[3]
            known[a] = known[:, a] = True
        self._known = {n: one for n, one in self._known.items() if n >= number - 1} | {number: (group, agree)}
        return agree


def loops_of(group: Measured, path: Walked) -> Loops:
    """Closures and the path at their ends, as `posegraph.consistency` compares them, in arrays of one size."""
    count = len(group.i)
    # Rows in the order of the path: which of two comes first says whether the way between adds or is taken away.
    ends = np.unique(np.concatenate([group.j, group.i]))
    poses, spread = np.zeros((2 * ROOM, 3)), np.zeros((2 * ROOM, 3, 3))
    poses[: len(ends)], spread[: len(ends)] = path.poses[ends], path.spread[ends]
    earlier, later = np.zeros(ROOM, int), np.zeros(ROOM, int)
    earlier[:count], later[:count] = np.searchsorted(ends, group.j), np.searchsorted(ends, group.i)
    measured, covariance = np.zeros((ROOM, 3)), np.tile(np.eye(3), (ROOM, 1, 1))
    measured[:count] = inverse(group.i_from_j)
    covariance[:count] = inverse_covariance(group.i_from_j, group.covariance)
    return Loops(poses, spread, earlier, later, measured, covariance)


def compile_comparing() -> None:
    """Makes the program before there are two closures; may run in a thread."""
    none = np.zeros(1, int)
    one = Measured(none, none, none > 0, np.zeros(1), none, none, np.zeros((1, 3)), np.eye(3)[None])
    nowhere = Walked(np.zeros((2, 3)), np.eye(3)[None], np.zeros(2, int))
    _row_of_cycles(loops_of(one, nowhere), 0)


@jax.jit
def _row_of_cycles(loops: Loops, a: Int[Array, ""]) -> Float[Array, "2 K"]:
    """Distances of the cycles through closure a and every other, and through every other and a."""
    every = jnp.arange(len(loops.i))
    one = jnp.broadcast_to(a, every.shape)
    return jnp.stack([cycle(loops, one, every)[0], cycle(loops, every, one)[0]])
