"""How a robot nods, by its floor views alone: roll and pitch of every keyframe, solved together with the steps.

A nod bends the floor views: between two of them lies a homography and no rigid motion. Each pair of views tells how the
camera leans in the one against the other, and, by the perspective over the view, in both; all pairs together tell each
frame's lean, with a prior around upright.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse.linalg import splu, spsolve

from ebjax.features.landmarks import Landmarks
from ebjax.features.measure import measure_floor
from ebjax.features.settle import EXCESS, FREEDOM, MEDIAN, PairMatches, pair_matches, white
from ebjax.features.verify import verify
from ebjax.geometry.camera import Camera, image_from_floor
from ebjax.geometry.homography import Scalar, apply, slopes
from ebjax.odometry.steps import MIN_INLIERS
from ebjax.views.run_view import RunView

PRIOR_DEG = 1.5
"""Standard deviation of a nod that is believed beforehand."""
AVERAGE_S, AVERAGE_DEG = 2.5, 0.1
"""Over so long to either side a nod averages out to about that: what leans longer is the mount."""
REST_DEG = 0.3
"""... of what is left of it once the views were looked at accordingly."""
PAIRS_A_CALL, COLUMNS = 64, 256
ROUNDS = 8
MEDIAN_4 = 3.3567
"""Of chi-square with four degrees of freedom."""
LEAST_FACTOR = 0.02
TOLERANCE_M = 0.02


@partial(jax.jit, static_argnames="tolerance_m")
def _matched(query: Landmarks, reference: Landmarks, keys, view: RunView, camera: Camera, tolerance_m: float):
    def one(args):
        ours, theirs, key = args
        points = ours.floor_points, theirs.floor_points
        found = verify(ours.features, theirs.features, *points, key=key, tolerance=tolerance_m, model="homography")
        matches = pair_matches(ours, theirs, found, view, camera)
        rigid = measure_floor(points[0][found.query], points[1][found.reference], found.inliers)
        return dataclasses.replace(matches, matched=found.inliers, start=rigid.i_from_j)

    return jax.lax.map(one, (query, reference, keys))


def bent_pairs(
    landmarks: Callable[[Int[np.ndarray, " n"]], Landmarks],
    view: RunView,
    camera: Camera,
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    seed: int,
) -> PairMatches:
    """Matches of pairs of floor views that agree on a homography between them; `landmarks` gives those of some rows."""
    keys = jax.random.split(jax.random.key(seed), len(i))

    def block(rows):
        ends = landmarks(i[rows]), landmarks(j[rows])
        return _matched(*ends, keys[rows], view, camera, TOLERANCE_M)

    return _in_blocks(block, len(i))


def _in_blocks(call: Callable[[Int[np.ndarray, " B"]], Any], count: int) -> Any:
    """What `call` makes of all rows, a block at a time; the last block is filled up, so that all have one shape."""
    starts = range(0, count, PAIRS_A_CALL)
    found = [jax.tree.map(np.asarray, call(np.arange(s, s + PAIRS_A_CALL) % count)) for s in starts]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *found)


def leant(camera: Camera, lean: Float[Array, "2"]) -> Camera:
    """The camera of a robot that leans: pitch down and roll to the right about base's origin on the floor, rad."""
    (s, sr), (c, cr) = jnp.sin(lean), jnp.cos(lean)
    zero, one = jnp.zeros_like(s), jnp.ones_like(s)
    nod = jnp.stack([jnp.stack([c, zero, s]), jnp.stack([zero, one, zero]), jnp.stack([-s, zero, c])])
    roll = jnp.stack([jnp.stack([one, zero, zero]), jnp.stack([zero, cr, -sr]), jnp.stack([zero, sr, cr])])
    pose = jnp.asarray(camera.base_from_camera)
    return dataclasses.replace(camera, base_from_camera=pose.at[:3].set(nod @ roll @ pose[:3]))


def _on_floor(pixels: Float[Array, "M 2"], camera: Camera) -> Float[Array, "M 2"]:
    """As `settle.on_floor`, by the ray: no matrix is inverted under the derivative."""
    pose, k = jnp.asarray(camera.base_from_camera), jnp.asarray(camera.intrinsics)
    rays = jnp.concatenate([pixels, jnp.ones_like(pixels[:, :1])], 1) @ (pose[:3, :3] @ jnp.linalg.inv(k)).T
    return pose[None, :2, 3] - rays[:, :2] * (pose[2, 3] / rays[:, 2:])


@jax.jit
def _systems(
    matches: PairMatches, unknowns: Float[Array, "K 7"], camera: Camera
) -> tuple[Float[Array, "K 7 7"], Float[Array, "K 7"]]:
    """Normal equations of pairs in (lean_i, lean_j, motion): information and gradient, reweighted."""

    def one(args):
        pair, at = args
        along = slopes(jnp.linalg.inv(image_from_floor(camera)), pair.pixels_i)
        spread = along @ pair.spread @ jnp.swapaxes(along, 1, 2)

        def residual(x):
            ends = (pair.pixels_i, x[:2]), (pair.pixels_j, x[2:4])
            here, there = (_on_floor(pixels, leant(camera, lean)) for pixels, lean in ends)
            c, s = jnp.cos(x[6]), jnp.sin(x[6])
            turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
            return white(here - (there @ turn.T + x[None, 4:6]), spread)

        value, jacobian = residual(at), jax.jacfwd(residual)(at)
        squared = jnp.sum(value**2, 1)
        ranked = jnp.sort(jnp.where(pair.matched, squared, jnp.inf))
        middle = jnp.where(pair.matched.any(), ranked[pair.matched.sum() // 2], 1.0)
        factor = jnp.maximum(middle / MEDIAN, LEAST_FACTOR)
        weight = jnp.where(pair.matched, (FREEDOM + 2) / ((FREEDOM + squared / factor) * factor * EXCESS), 0)
        return (
            jnp.einsum("m,mka,mkb->ab", weight, jacobian, jacobian),
            jnp.einsum("m,mka,mk->a", weight, jacobian, value),
        )

    return jax.lax.map(one, (matches, unknowns))


def _some_systems(matches: PairMatches, unknowns: Float[np.ndarray, "K 7"], camera: Camera, rows: np.ndarray):
    return _systems(jax.tree.map(lambda leaf: leaf[rows], matches), unknowns[rows], camera)


@dataclasses.dataclass(frozen=True)
class Nods:
    """Pitch and roll of every keyframe against upright, rad, and their standard deviations."""

    lean: Float[np.ndarray, "N 2"]
    sigma: Float[np.ndarray, "N 2"]

    def level_from_base(self, frames: Int[np.ndarray, " N"], count: int) -> Float[np.ndarray, "F 4 4"]:
        """How the robot leans at every frame of a run: at the keyframes as found, elsewhere not at all."""
        (s, sr), (c, cr) = np.sin(self.lean.T), np.cos(self.lean.T)
        found = np.tile(np.eye(4), (count, 1, 1))
        found[frames, 0, 0], found[frames, 0, 1], found[frames, 0, 2] = c, s * sr, s * cr
        found[frames, 1, 1], found[frames, 1, 2] = cr, -sr
        found[frames, 2, 0], found[frames, 2, 1], found[frames, 2, 2] = -s, c * sr, c * cr
        return found


def nods(
    matches: PairMatches,
    i: Int[np.ndarray, " K"],
    j: Int[np.ndarray, " K"],
    count: int,
    camera: Camera,
    *,
    times: Float[np.ndarray, " N"] | None = None,
    wheels: tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]] | None = None,
    prior_deg: float = PRIOR_DEG,
) -> Nods:
    """Solves for every keyframe's lean.

    Args:
      matches: of pairs, by `bent_pairs`.
      i: rows of the later keyframes.
      j: rows of the earlier ones.
      count: of keyframes.
      camera: as it is mounted.
      times: of the keyframes, s; None: nods need not average out.
      wheels: i_from_j as they count it, and its standard deviations. A slow lean of all views is a scale of all steps:
        floor views hardly tell the one from the other.
      prior_deg: standard deviation of a lean that is believed beforehand.
    """
    good = np.asarray(matches.matched).sum(1) >= MIN_INLIERS
    matches = jax.tree.map(lambda leaf: leaf[good], matches)
    i, j = i[good], j[good]
    counted, trust = (np.zeros((len(i), 3)),) * 2
    if wheels is not None:
        counted, trust = wheels[0][good], wheels[1][good] ** -2.0
    lean = np.zeros((count, 2))
    motion = np.array(matches.start, np.float64)
    prior = np.radians(prior_deg) ** -2
    believed = sparse.eye(2 * count, format="csc") * prior
    if times is not None:
        average = _averages(times)
        believed = believed + average.T @ average * np.radians(AVERAGE_DEG) ** -2
    total = believed
    columns = np.stack([2 * i, 2 * i + 1, 2 * j, 2 * j + 1], 1) if len(i) else np.zeros((0, 4), int)
    for _ in range(ROUNDS if len(i) else 0):
        unknowns = np.concatenate([lean[i], lean[j], motion], 1)
        information, gradient = _in_blocks(partial(_some_systems, matches, unknowns, camera), len(i))
        information[:, [4, 5, 6], [4, 5, 6]] += trust
        off = motion - counted
        off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
        gradient = gradient + np.concatenate([np.zeros((len(i), 4)), trust * off], 1)
        inner = np.linalg.inv(information[:, 4:, 4:] + 1e-6 * np.eye(3))
        gain = inner @ information[:, 4:, :4]
        reduced = information[:, :4, :4] - information[:, :4, 4:] @ gain
        pull = gradient[:, :4] - np.einsum("kab,kb->ka", np.swapaxes(gain, 1, 2), gradient[:, 4:])
        # A pair that the others contradict is a wrong match, in a turn say.
        own = reduced + prior * np.eye(4)
        misfit = np.einsum("ka,kab,kb->k", pull, np.linalg.inv(own), pull)
        weight = 1 / (1 + misfit / (4 * max(1.0, float(np.median(misfit)) / MEDIAN_4)))
        reduced, pull = weight[:, None, None] * reduced, weight[:, None] * pull
        rows = np.repeat(columns, 4, axis=1).ravel(), np.tile(columns, (1, 4)).ravel()
        size = (2 * count, 2 * count)
        total = sparse.coo_matrix((reduced.ravel(), rows), size).tocsc() + believed
        right = np.zeros(2 * count)
        np.add.at(right, columns.ravel(), pull.ravel())
        step = -spsolve(total, right + believed @ lean.ravel()).reshape(count, 2)
        lean = lean + step
        change = np.concatenate([step[i], step[j]], 1)
        motion = motion - np.einsum("kab,kb->ka", inner, gradient[:, 4:]) - np.einsum("kab,kb->ka", gain, change)
    variance = _inverse_diagonal(total)
    # Where rounding leaves no variance, nothing is known but what was believed beforehand.
    return Nods(lean, np.sqrt(np.where(variance > 0, variance, 1 / prior)).reshape(count, 2))


def _averages(times: Float[np.ndarray, " N"]) -> sparse.csc_matrix:
    """Pitch and roll of every keyframe -> their means over the keyframes at most `AVERAGE_S` away."""
    first = np.searchsorted(times, times - AVERAGE_S)
    last = np.searchsorted(times, times + AVERAGE_S, side="right")
    size = last - first
    rows = np.repeat(np.arange(len(times)), size)
    columns = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size) + np.repeat(first, size)
    means = sparse.csc_matrix((1.0 / np.repeat(size, size), (rows, columns)), (len(times),) * 2)
    return sparse.kron(means, sparse.eye(2), format="csc")


def _inverse_diagonal(matrix: sparse.csc_matrix) -> Float[np.ndarray, " M"]:
    """Of a sparse matrix's inverse, some columns at a time."""
    solver, size = splu(matrix.tocsc()), matrix.shape[0]
    found = np.zeros(size)
    for start in range(0, size, COLUMNS):
        some = np.arange(start, min(start + COLUMNS, size))
        unit = np.zeros((size, len(some)))
        unit[some, some - start] = 1
        found[some] = solver.solve(unit)[some, some - start]
    return found


@jax.jit
def within(matches: PairMatches, camera: Camera, tolerance_m: Scalar) -> Bool[Array, "K M"]:
    """Matches whose points on the floor agree with where the pair starts from."""

    def one(pair):
        c, s = jnp.cos(pair.start[2]), jnp.sin(pair.start[2])
        turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
        here, there = (_on_floor(pixels, camera) for pixels in (pair.pixels_i, pair.pixels_j))
        off = here - (there @ turn.T + pair.start[None, :2])
        return pair.matched & (jnp.sum(off**2, 1) < jnp.asarray(tolerance_m) ** 2)

    return jax.lax.map(one, matches)


@jax.jit
def _leaned(matches: PairMatches, lean: Float[Array, "K 2 2"], camera: Camera) -> PairMatches:
    def end(pixels, points, lean):
        seen_by = leant(camera, lean)
        level = jnp.asarray(camera.base_from_camera)
        turned = level[:3, :3].T @ seen_by.base_from_camera[:3, :3]
        shift = level[:3, :3].T @ (seen_by.base_from_camera[:3, 3] - level[:3, 3])
        moved = jnp.where(points[:, 2:] > 0, points @ turned.T + shift[None], 0)
        return apply(image_from_floor(camera), _on_floor(pixels, seen_by)), moved

    def one(args):
        pair, lean = args
        pixels_i, points_i = end(pair.pixels_i, pair.points_i, lean[0])
        pixels_j, points_j = end(pair.pixels_j, pair.points_j, lean[1])
        return dataclasses.replace(pair, pixels_i=pixels_i, points_i=points_i, pixels_j=pixels_j, points_j=points_j)

    return jax.lax.map(one, (matches, lean))


def levelled_matches(
    matches: PairMatches, i: Int[np.ndarray, " K"], j: Int[np.ndarray, " K"], found: Nods, camera: Camera
) -> PairMatches:
    """The matches as a level camera would have seen them."""
    if not len(i):
        return matches
    lean = np.stack([found.lean[i], found.lean[j]], 1)
    return _in_blocks(lambda rows: _leaned(jax.tree.map(lambda leaf: leaf[rows], matches), lean[rows], camera), len(i))
