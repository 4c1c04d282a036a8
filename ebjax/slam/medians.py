"""A run looked at through medians: floor views without what a polished floor mirrors.

What lies on the floor stays where it is, what is mirrored moves against it. Every neighbour's view is brought onto the
floor under a keyframe; the median of how much each stands out from its surroundings there is what they agree on.
Medians are faint and keep streaks, so few of their matches agree even where they are right: a closure is believed for
how many others agree with it, not for the share of its matches.
"""

import dataclasses
import math

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.geometry.planar import between, matrix
from ebjax.slam.believe import BeliefConfig
from ebjax.slam.engine import Engine
from ebjax.slam.latest import Latest
from ebjax.slam.look_again import described_again
from ebjax.slam.mirrored import detail
from ebjax.slam.packed import packed_pictures
from ebjax.slam.run import Run

REACH = 0.4
"""Neighbours lie within this share of the way after which a keyframe may be compared in the same direction, so that no
two medians that are compared have a view in common."""
NEIGHBOURS = 6
"""On either side, at most."""
LEAST = 3
"""Views that have to see a pixel."""
MIDDLE, GAIN = 128.0, 30.0
"""Of the picture: the grey of what stands out by nothing, and grey levels a standard deviation."""
VERIFY = 8
"""Candidates a direction: a ranking of medians is rough."""
LEAST_INLIERS, MORE_THAN_ORDINARY = 12, 2.0
"""A closure has so many agreeing matches, and so many times as many as half of the run's candidates: most of these are
of other places, and on a floor that repeats they have many."""
AGREEING = 4
"""Closures that agree with each other, at least."""


def median_view(
    details: list[Float[np.ndarray, "h w"]],
    floors: list[Bool[np.ndarray, "h w"]],
    here_from_each: list[Float[np.ndarray, "3 3"]],
) -> tuple[UInt8[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """A grey picture of what views agree on, and where enough of them see the floor.

    Args:
      details: how much each stands out from its surroundings, in their standard deviations.
      floors: what of each is floor.
      here_from_each: a pixel of each in the picture.
    """
    height, width = floors[0].shape
    layers = []
    for one, floor, warp in zip(details, floors, here_from_each, strict=True):
        moved = cv2.warpPerspective(one, warp, (width, height))
        seen = cv2.warpPerspective(floor.astype(np.float32), warp, (width, height)) > 0.99
        layers.append(np.where(seen, moved, np.nan))
    stack = np.stack(layers)
    count = np.isfinite(stack).sum(0)
    # Sorted, NaN comes last: the middle of those that see a pixel.
    ordered = np.sort(stack, 0)
    low, high = (np.maximum(count - 1, 0) // 2)[None], (count // 2).clip(0, len(stack) - 1)[None]
    middle = (np.take_along_axis(ordered, low, 0) + np.take_along_axis(ordered, high, 0))[0] / 2
    floor = count >= min(LEAST, len(stack))
    grey = np.where(floor, MIDDLE + GAIN * np.nan_to_num(middle), 0)
    return np.rint(grey).clip(0, 255).astype(np.uint8), floor


def looked_through(engine: Engine, run: Run) -> Engine:
    """An engine that went through the same keyframes, in memory, and saw of each the median of its neighbourhood.

    Args:
      engine: of a run of its own, without a map.
      run: what it gave.
    """
    config = dataclasses.replace(engine.config, verify=max(VERIFY, engine.config.verify))
    another = Engine(engine.camera, config, view=engine.view_of, recording=engine.recording, lean=engine.lean)
    another.names, another.frames, another.follower = engine.names, engine.frames, engine.follower
    another.seconds = engine.seconds
    floor_from_view = np.asarray(run.view.floor_from_view, np.float64)
    view_from_floor = np.linalg.inv(floor_from_view)
    poses, travelled = run.poses[run.keyframes], engine.keyframes.travelled
    known: Latest[int, tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]] = Latest(2 * NEIGHBOURS + 2)

    def seen(k: int) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
        if k not in known:
            floor = run.floor(k)
            known[k] = detail(run.seen(k), floor), floor
        return known[k]

    for k in range(len(poses)):
        near = neighbours(k, travelled, REACH * config.min_gap_m)
        details, floors = zip(*(seen(j) for j in near), strict=True)
        warps = [view_from_floor @ matrix(between(poses[k], poses[j])) @ floor_from_view for j in near]
        grey, floor = median_view(list(details), list(floors), warps)
        shown, kept = np.repeat(grey[..., None], 3, 2), engine.store.arrays(k)
        way = {name: array for name, array in kept.items() if name.startswith("at.")}
        seen_now = packed_pictures(shown, grey, floor)
        another.recognise(way | seen_now | described_again(shown, floor, kept, another.eyes, another.place), "")
    another.config = dataclasses.replace(config, believe=believing(config.believe, another.candidates.inliers))
    return another


def neighbours(k: int, travelled: Float[np.ndarray, " N"], reach_m: float) -> range:
    """The keyframes whose views a median is of.

    Args:
      k: which is in their middle.
      travelled: the way to each, m.
      reach_m: on either side.
    """
    first, last = np.searchsorted(travelled, [travelled[k] - reach_m, travelled[k] + reach_m])
    return range(max(int(first), k - NEIGHBOURS), min(int(last), k + NEIGHBOURS + 1))


def believing(config: BeliefConfig, inliers: Int[np.ndarray, " K"]) -> BeliefConfig:
    """When a closure of medians is believed.

    Args:
      config: when one of views is.
      inliers: of all candidates of the run.
    """
    ordinary = float(np.median(inliers)) if len(inliers) else 0.0
    return dataclasses.replace(
        config,
        min_inliers=max(LEAST_INLIERS, math.ceil(MORE_THAN_ORDINARY * ordinary)),
        min_inlier_ratio=0.0,
        min_agreeing=max(AGREEING, config.min_agreeing),
    )
