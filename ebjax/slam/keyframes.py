"""The frames of a run that are looked at, decoded a few ahead and described one by one."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ebjax.features.extractor import Extractor
from ebjax.geometry.camera import Camera
from ebjax.places.descriptor import Descriptor
from ebjax.slam.describe import Described, describe
from ebjax.views.floor_view import view_taps
from ebjax.views.run_view import RunView
from ebjax.views.tilted import tilted

Load = Callable[[int], tuple[np.ndarray, np.ndarray | None] | None]
Progress = Callable[[Iterable, int, str], Iterator]
PREFETCH = 4
_taps = jax.jit(view_taps)


def describe_keyframes(
    load: Load,
    due: list[int],
    camera: Camera,
    view: RunView,
    extractor: Extractor,
    descriptor: Descriptor,
    progress: Progress,
    level_from_base: Float[np.ndarray, "F 4 4"] | None = None,
) -> tuple[Int[np.ndarray, " N"], Described]:
    """Describes the frames that can be read: their numbers, and everything about them stacked.

    Args:
      load: frame number -> (RGB, depth in metres or None), or None.
      due: the frames.
      camera: of the run.
      view: of the run.
      extractor: of local features.
      descriptor: of places.
      progress: wraps the loop.
      level_from_base: how the robot leans at every frame of the run; None: it does not.

    Raises:
      ValueError: fewer than two of them could be read.
    """
    samples = view_taps(view, camera)
    blank = jnp.zeros((camera.height, camera.width), jnp.float32)
    keyframes: list[int] = []
    rows: list[Any] = []
    with ThreadPoolExecutor(2) as pool:
        for frame, images in progress(_prefetched(pool, load, due), len(due), "describing"):
            if images is None:
                continue
            rgb, depth = images
            depth = blank if depth is None else depth
            leans = level_from_base is not None
            seen_by = tilted(view, camera, level_from_base[frame]) if level_from_base is not None else (view, camera)
            looked = _taps(*seen_by) if leans else samples
            one = describe(rgb, depth, looked, *seen_by, extractor=extractor, descriptor=descriptor)
            one = one.levelled(view, camera) if leans else one
            rows.append(jax.tree.map(np.asarray, one))
            keyframes.append(frame)
    if len(rows) < 2:
        raise ValueError(f"{len(rows)} of {len(due)} frames could be read; at least two are needed")
    return np.array(keyframes), jax.tree.map(lambda *leaves: np.stack(leaves), *rows)


def moved_enough(odom_from_base: Float[np.ndarray, "F 3"], distance_m: float, turn_deg: float) -> list[int]:
    """Frames at which the robot has moved or turned enough since the last one, the first included."""
    chosen = [0]
    for k in range(1, len(odom_from_base)):
        step = odom_from_base[k] - odom_from_base[chosen[-1]]
        turn = abs(np.arctan2(np.sin(step[2]), np.cos(step[2])))
        if np.hypot(step[0], step[1]) >= distance_m or turn >= np.radians(turn_deg):
            chosen.append(k)
    return chosen


def _prefetched(pool: ThreadPoolExecutor, load: Load, frames: list[int]) -> Iterator[tuple[int, Any]]:
    """Decodes a few frames ahead of the one being described."""
    waiting = [pool.submit(load, frame) for frame in frames[:PREFETCH]]
    for k, frame in enumerate(frames):
        images = waiting.pop(0).result()
        if k + PREFETCH < len(frames):
            waiting.append(pool.submit(load, frames[k + PREFETCH]))
        yield frame, images
