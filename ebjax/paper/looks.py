"""How a descriptor sees a run: whole images, whole images flipped left to right (the paper's baselines), floor views.

What a descriptor keeps of frames does not depend on how they are ranked later, so it is computed once a kind.
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from ebjax.command import progress
from ebjax.geometry.camera import Camera
from ebjax.geometry.warp import Taps
from ebjax.paper.run import Run
from ebjax.places.descriptor import Descriptor
from ebjax.slam.describe import clear_floor, floor_view, view_taps
from ebjax.slam.look import whole_image
from ebjax.slam.view import RunView

Kind = Literal["whole", "flipped", "floor"]


@jax.jit
def _floor(
    rgb: UInt8[Array, "H W 3"], depth_m: Float[Array, "H W"], samples: Taps, view: RunView, camera: Camera
) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    return floor_view(rgb, samples), clear_floor(depth_m.astype(view.image_from_view.dtype), view, camera)


_whole = jax.jit(floor_view)


def keep(run: Run, chosen: Descriptor, frames: Int[np.ndarray, " N"], kind: Kind) -> dict[str, np.ndarray]:
    """What the descriptor keeps of some frames, stacked.

    Args:
      run: the run.
      chosen: the descriptor.
      frames: numbers.
      kind: whole images, resized to the descriptor's size; those, mirrored; or floor views, without what depth shows to
        stand on the floor.

    Raises:
      BrokenFrame: an image cannot be read.
    """
    look = jax.jit(chosen.look) if chosen.jitted else chosen.look
    width, height = run.camera.width, run.camera.height
    scale = chosen.side_px / max(width, height)
    small = round(height * scale), round(width * scale)
    samples = view_taps(run.view, run.camera) if kind == "floor" else whole_image((width, height), small)
    kept = []
    for frame in progress(frames.tolist(), len(frames), f"{run.sequence.path.name}, {kind}"):
        image = run.sequence.rgb(frame)
        if kind == "flipped":
            image = np.ascontiguousarray(image[:, ::-1])
        if kind == "floor":
            depth = run.sequence.depth(frame) if run.sequence.has_depth else np.zeros((height, width), np.float32)
            view, seen = _floor(jnp.asarray(image), jnp.asarray(depth), samples, run.view, run.camera)
        else:
            view, seen = _whole(jnp.asarray(image), samples), jnp.ones(small, bool)
        kept.append(jax.tree.map(np.asarray, dict(look(view, seen, image))))
    return {name: np.stack([one[name] for one in kept]) for name in kept[0]}
