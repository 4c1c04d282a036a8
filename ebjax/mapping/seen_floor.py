"""The floor that a run looks at, by options: where it lies, which rectangle of it, and what is in its way."""

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool

from ebjax.evaluation.run import spread_rows
from ebjax.geometry.camera import Camera, FloorView, camera_from
from ebjax.io.frames import Frames
from ebjax.io.mask import alpha_mask, read_mask
from ebjax.io.sequence import Sequence
from ebjax.slam.world import planar
from ebjax.views.depth_floor import camera_from_depth
from ebjax.views.run_view import RunView, choose_floor, from_camera, from_quad, without
from ebjax.views.static_pixels import spread, static_pixels

Quad = tuple[float, float, float, float, float, float, float, float]
DEPTHS = 9
"""Depth images that the floor's plane is fitted to."""


@dataclasses.dataclass(frozen=True)
class FloorOptions:
    """Which floor is looked at."""

    floor: Literal["camera", "depth"] = "camera"
    """Where the floor lies: as the camera's mount says, or as a plane fitted to the depth images."""
    quad: Quad | None = None
    """Four image points of a rectangle on the floor, px: far left, far right, near right, near left (x y each)."""
    quad_margin: float = 0.5
    """How far the floor view reaches beyond the quad, as a share of its sides."""
    view: tuple[float, float, float, float] | None = None
    """Rectangle of floor that is looked at, m in base: x_min x_max y_min y_max. None: chosen from the camera."""
    metres_per_px: float = 0.01
    """Of the floor view, m."""
    mask: Literal["auto", "none"] | Path = "auto"
    """Pixels that are no floor: an image, black or transparent there; auto: found over the run, where the picture never
    changes (the robot's own body, dirt), or transparent in the images themselves."""


def run_view(options: FloorOptions, ignored: Bool[np.ndarray, "H W"] | None, camera: Camera) -> RunView:
    """The floor that a camera looks at, as the options say, without ignored pixels.

    Raises:
      ValueError: the camera sees too little of it, or the quad or the rectangle is none.
    """
    if options.quad is not None:
        view = from_quad(camera, np.array(options.quad, np.float64).reshape(4, 2), options.quad_margin)
    elif options.view is not None:
        view = from_camera(camera, FloorView(*options.view, options.metres_per_px))
    else:
        view = from_camera(camera, choose_floor(camera, options.metres_per_px))
    return view if ignored is None else without(view, camera, ignored)


def ignored_pixels(
    mask: Literal["auto", "none"] | Path, sequence: Sequence
) -> tuple[Bool[np.ndarray, "H W"] | None, tuple[str, ...]]:
    """Pixels of the image that are no world, by a file or found over the run (auto), and notes; None: all are."""
    size = sequence.camera.width, sequence.camera.height
    if mask == "none":
        return None, ()
    if mask != "auto":
        return read_mask(mask, size)
    if sequence.files and (clear := alpha_mask(sequence.files, size)) is not None:
        return clear, (f"mask: {clear.mean():.0%} of the image is transparent and ignored",)
    way = np.arange(len(sequence), dtype=np.float64)
    if sequence.odom_from_base is not None:
        step = np.diff(planar(sequence.odom_from_base), axis=0)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + np.abs(step[:, 2]))])
    images = [image for image in map(Frames(sequence).rgb, spread(way).tolist()) if image is not None]
    found = static_pixels(images) if images else None
    if found is None or not found.any():
        return None, ()
    share = f"{found.mean():.0%} of the image never changes and is ignored"
    return found, (f"mask: {share}, as the robot's own body (--mask none)",)


def camera_over_floor(options: FloorOptions, sequence: Sequence) -> tuple[Camera, tuple[str, ...]]:
    """The camera over the floor that its mount or the depth images say, and notes.

    Raises:
      ValueError: the depth images are asked for and there are none, or they show no floor.
    """
    camera = camera_from(sequence.camera)
    if options.floor == "camera":
        return camera, ()
    if not sequence.has_depth:
        raise ValueError(f"{sequence.path}: --floor depth needs a log with depth, and --depth sequence")
    chosen = spread_rows(np.arange(len(sequence)), DEPTHS)
    depths = [depth for depth in map(Frames(sequence).depth, chosen.tolist()) if depth is not None]
    try:
        camera, height_m, pitch_deg, roll_deg = camera_from_depth(depths, camera)
    except ValueError as fault:
        raise ValueError(f"{sequence.log.depth_source}: {fault}") from None
    lies = f"camera {height_m:.3f} m above it, pitch {pitch_deg:.2f} deg, roll {roll_deg:.2f} deg"
    return camera, (f"floor from depth: {lies}",)


def view_chooser(
    options: FloorOptions, ignored: Bool[np.ndarray, "H W"] | None, camera: Camera, source: str
) -> Callable[[Camera], RunView]:
    """What chooses the floor view for a camera, tried once.

    Raises:
      ValueError: the camera sees too little floor; begins with `source`.
    """
    choose = partial(run_view, options, ignored)
    try:
        choose(camera)
    except ValueError as fault:
        raise ValueError(f"{source}: {fault}") from None
    return choose
