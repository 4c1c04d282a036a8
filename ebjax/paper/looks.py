"""How a descriptor sees a run: whole images, whole images flipped left to right (the paper's baselines), floor views.

What a descriptor keeps of frames does not depend on how they are ranked later, so it is computed once a kind.
"""

from collections.abc import Iterable, Iterator
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from ebjax.command import progress
from ebjax.geometry.camera import Camera
from ebjax.geometry.warp import Taps
from ebjax.paper.run import Run
from ebjax.places.descriptor import Descriptor
from ebjax.views.floor_view import clear_floor, floor_view, view_taps
from ebjax.views.look import whole_image
from ebjax.views.run_view import RunView

Kind = Literal["whole", "flipped", "floor"]


@jax.jit
def _floor(
    rgb: UInt8[Array, "H W 3"], depth_m: Float[Array, "H W"], samples: Taps, view: RunView, camera: Camera
) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    return floor_view(rgb, samples), clear_floor(depth_m.astype(view.image_from_view.dtype), view, camera)


_whole = jax.jit(floor_view)


def views(
    run: Run, frames: Int[np.ndarray, " N"], kind: Kind, side_px: int
) -> Iterator[tuple[Float[Array, "h w 3"], Bool[Array, "h w"], UInt8[np.ndarray, "H W 3"]]]:
    """What a descriptor looks at of some frames, one by one: the view, what of it is floor, the whole image.

    Args:
      run: the run.
      frames: numbers.
      kind: whole images, resized; those, mirrored; or floor views, without what depth shows to stand on the floor.
      side_px: the longer side of a whole image.

    Raises:
      BrokenFrame: an image cannot be read.
    """
    width, height = run.camera.width, run.camera.height
    scale = side_px / max(width, height)
    small = round(height * scale), round(width * scale)
    samples = view_taps(run.view, run.camera) if kind == "floor" else whole_image((width, height), small)
    for frame in progress(frames.tolist(), len(frames), f"{run.sequence.path.name}, {kind}"):
        image = run.sequence.rgb(frame)
        if kind == "flipped":
            image = np.ascontiguousarray(image[:, ::-1])
        if kind == "floor":
            depth = run.sequence.depth(frame) if run.sequence.has_depth else np.zeros((height, width), np.float32)
            view, seen = _floor(jnp.asarray(image), jnp.asarray(depth), samples, run.view, run.camera)
        else:
            view, seen = _whole(jnp.asarray(image), samples), jnp.ones(small, bool)
        yield view, seen, image


def keep(run: Run, chosen: Descriptor, frames: Int[np.ndarray, " N"], kind: Kind) -> dict[str, np.ndarray]:
    """What the descriptor keeps of some frames, stacked; see `views`."""
    return look_at(chosen, views(run, frames, kind, chosen.side_px))


def look_at(chosen: Descriptor, shown: Iterable[tuple[Any, Any, Any]]) -> dict[str, np.ndarray]:
    """What a descriptor keeps of (view, seen, image), stacked."""
    look = jax.jit(chosen.look) if chosen.jitted else chosen.look
    kept = [jax.tree.map(np.asarray, dict(look(*one))) for one in shown]
    return {name: np.stack([one[name] for one in kept]) for name in kept[0]}
