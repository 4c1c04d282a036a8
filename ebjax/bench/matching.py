"""Matching and verification of many pairs beside a loop over OpenCV.

The pairs are made up: half of the keypoints of a view are seen again, moved rigidly and described with noise; the rest
are other keypoints. Both sides look for mutual nearest neighbours and for the motion most of them agree on.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.bench.turns import in_turn
from ebjax.features.matching import Features
from ebjax.features.pair import KEEP
from ebjax.features.verify import Verified, verify

SIDE_PX, TOLERANCE_PX, SHARE = 400.0, 3.0, 0.5


@dataclass(frozen=True)
class MatchingConfig:
    """Times matching and verification of many pairs beside OpenCV."""

    pairs: int = 20
    """Pairs of views."""
    keypoints: int = 2000
    """Of each view."""
    length: int = 512
    """Of a descriptor."""
    turns: int = 3
    """How often each side runs."""
    seed: int = 0
    """Of the pairs and of RANSAC."""


def bench_matching(config: MatchingConfig) -> None:
    """Prints both times, and the shares of pairs whose motion came out right."""
    if min(config.pairs, config.keypoints, config.length, config.turns) < 1:
        raise ValueError("--pairs, --keypoints, --length and --turns must be at least 1")
    query, reference, truth = make_pairs(config.pairs, config.keypoints, config.length, config.seed)
    ours, theirs = verifying(query, reference, config.seed), partial(opencv_motions, query, reference)
    taken = in_turn({"ebjax": ours, "OpenCV": theirs}, config.turns)
    seconds = {name: float(np.median(times)) for name, times in taken.items()}
    right = _right(list(np.asarray(ours().query_from_reference)), truth), _right(theirs(), truth)
    print(f"{config.pairs} pairs of {config.keypoints} keypoints of {config.length} numbers")
    print(f"ebjax  {seconds['ebjax']:7.2f} s, {right[0]:.0%} of the motions right")
    ratio = seconds["OpenCV"] / seconds["ebjax"]
    print(f"OpenCV {seconds['OpenCV']:7.2f} s, {right[1]:.0%}; {ratio:.1f} times as long")


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


def verifying(query: Features, reference: Features, seed: int) -> Callable[[], Verified]:
    """Our way: all pairs in one program."""
    pairs, keypoints = query.valid.shape
    keys = jax.random.split(jax.random.key(seed), pairs)
    return lambda: jax.block_until_ready(_ours(query, reference, keys, min(KEEP, keypoints)))


def opencv_motions(query: Features, reference: Features) -> list[np.ndarray | None]:
    """query_from_reference, 2x3, of every pair; None where none is found."""
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
