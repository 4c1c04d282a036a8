"""Times matching and verification of many pairs against a loop over OpenCV, in one process and turn by turn.

The pairs are made up: half of the keypoints of a view are seen again, moved rigidly and described with noise; the rest
are other keypoints. Both sides look for mutual nearest neighbours and for the motion most of them agree on.
"""

import time
from dataclasses import dataclass
from functools import partial
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.features.matching import Features
from ebjax.features.pair import KEEP
from ebjax.features.verify import Verified, verify

SIDE_PX, TOLERANCE_PX, SHARE = 400.0, 3.0, 0.5


@dataclass(frozen=True)
class Timing:
    """Seconds for all pairs, the median over the turns, and the share of pairs whose motion came out right."""

    ours_s: float
    opencv_s: float
    ours_right: float
    opencv_right: float

    def lines(self) -> list[str]:
        """One line for each side."""
        ratio = self.opencv_s / self.ours_s
        return [
            f"ebjax  {self.ours_s:7.2f} s, {self.ours_right:.0%} of the motions right",
            f"OpenCV {self.opencv_s:7.2f} s, {self.opencv_right:.0%}; {ratio:.1f} times as long",
        ]


def make_pairs(pairs: int, keypoints: int, length: int, seed: int) -> tuple[Features, Features, np.ndarray]:
    """Queries, references (leading axis: pairs) and query_from_reference, 3x3."""
    random = np.random.default_rng(seed)
    seen = int(SHARE * keypoints)
    places = random.uniform(0, SIDE_PX, (2, pairs, keypoints, 2))
    words = random.standard_normal((2, pairs, keypoints, length)).astype(np.float32)
    angle, shift = random.uniform(-0.3, 0.3, pairs), random.uniform(-40, 40, (pairs, 2))
    motion = np.tile(np.eye(3), (pairs, 1, 1))
    motion[:, :2, :2] = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
    motion[:, :2, 2] = shift
    moved = places[1, :, :seen] @ motion[:, :2, :2].transpose(0, 2, 1) + shift[:, None]
    order = random.permuted(np.tile(np.arange(keypoints), (pairs, 1)), axis=1)[:, :seen]
    rows = np.arange(pairs)[:, None]
    places[0, rows, order] = moved + random.normal(0, 0.5, moved.shape)
    words[0, rows, order] = words[1, :, :seen] + random.standard_normal((pairs, seen, length))
    words /= np.linalg.norm(words, axis=-1, keepdims=True)
    valid = jnp.ones((pairs, keypoints), bool)
    query, reference = (Features(jnp.asarray(places[k], jnp.float32), jnp.asarray(words[k]), valid) for k in (0, 1))
    return query, reference, motion


@partial(jax.jit, static_argnames="keep")
def _ours(query: Features, reference: Features, keys: Array, keep: int) -> Verified:
    def one(pair):
        a, b, key = pair
        return verify(a, b, a.keypoints, b.keypoints, key=key, tolerance=TOLERANCE_PX, model="rigid", keep=keep)

    return jax.lax.map(one, (query, reference, keys))


def _opencv(query: Features, reference: Features) -> list[np.ndarray | None]:
    import cv2

    matcher, found = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True), []
    arrays = (
        np.asarray(leaf) for leaf in (query.keypoints, query.descriptors, reference.keypoints, reference.descriptors)
    )
    for a, words_a, b, words_b in zip(*arrays, strict=True):
        matches = matcher.match(words_a, words_b)
        here, there = (np.array([getattr(m, k) for m in matches]) for k in ("queryIdx", "trainIdx"))
        motion, _ = cv2.estimateAffinePartial2D(b[there], a[here], ransacReprojThreshold=TOLERANCE_PX)
        found.append(motion)
    return found


def _right(motions: list[np.ndarray | None], truth: Float[np.ndarray, "N 3 3"]) -> float:
    corners = np.array([[0, 0, 1], [SIDE_PX, 0, 1], [SIDE_PX, SIDE_PX, 1], [0, SIDE_PX, 1]])
    errors = [
        np.inf if motion is None else np.abs(corners @ (motion[:2] - true[:2]).T).max()
        for motion, true in zip(motions, truth, strict=True)
    ]
    return float(np.mean(np.array(errors) < TOLERANCE_PX))


def bench(pairs: int, keypoints: int, length: int, turns: int, seed: int = 0) -> Timing:
    """Times both.

    Args:
      pairs: of views.
      keypoints: of each view.
      length: of a descriptor.
      turns: how often; compilation is left out.
      seed: of the pairs and of RANSAC.
    """
    query, reference, truth = make_pairs(pairs, keypoints, length, seed)
    keep = min(KEEP, keypoints)
    keys = jax.random.split(jax.random.key(seed), pairs)
    ours = jax.block_until_ready(_ours(query, reference, keys, keep))
    seconds: dict[str, list[float]] = {"ours": [], "opencv": []}
    theirs: list[np.ndarray | None] = []
    for _ in range(turns):
        start = time.perf_counter()
        ours = jax.block_until_ready(_ours(query, reference, keys, keep))
        seconds["ours"].append(time.perf_counter() - start)
        start = time.perf_counter()
        theirs = _opencv(query, reference)
        seconds["opencv"].append(time.perf_counter() - start)
    right = _right(list(np.asarray(ours.query_from_reference)), truth), _right(theirs, truth)
    return Timing(median(seconds["ours"]), median(seconds["opencv"]), *right)
