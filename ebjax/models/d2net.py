"""D2-Net (Dusmanu et al., CVPR 2019): one map of VGG-16 is both detector and descriptor.

A cell of the map is a keypoint of its strongest channel k where that channel is also a local maximum. At test time
pool3 is an average of stride 1 and conv4 is dilated, for a map of 4 px cells; in training the cells have 8 px.

    dense = network(rgb)                                  N h w 512
    found = detect(network, rgb[0], scales=(0.5, 1, 2))   keypoints, scores, descriptors

The published code puts cell i at 4 i + 1.5 px and forgets that the average moves it by half a cell; the centre of what
it sees is 4 i + 3.5 px. On views that face each other the error doubles to 4 px: `offset="exact"` is the default.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from ebjax.geometry.warp import sample_bilinear
from ebjax.models.detect import Detections
from ebjax.models.layers import Precision, Stack, normalise, relu
from ebjax.models.resize import resize
from ebjax.models.vgg import convert_stack, torchvision_indices

Form = Literal["test", "training"]
Offset = Literal["exact", "official"]
OFFSETS: tuple[Offset, ...] = ("exact", "official")
MEAN_BGR = (103.939, 116.779, 123.68)
EDGE = 5.0
"""Largest ratio of a keypoint's principal curvatures."""
SCALES = (0.5, 1.0, 2.0)
PREFIX = "dense_feature_extraction.model."
STAGES = (2, 2, 3, 3)


class D2Net(Stack):
    """VGG-16 up to conv4_3: RGB in [0, 1] to a map of 512 channels.

    Args:
      form: "test" (cells of 4 px; H // 4 - 1 rows of them) or "training" (cells of 8 px, as in VGG).
      final_relu: the published test code rectifies the map by default; training and its --no-relu do not.
      precision: of the products.
    """

    def __init__(
        self, *, form: Form = "test", final_relu: bool = True, precision: Precision = "highest", rngs: nnx.Rngs
    ):
        test = form == "test"
        super().__init__(
            STAGES,
            pools=("max", "max", "avg" if test else "max", ""),
            dilations=(1, 1, 1, 2 if test else 1),
            precision=precision,
            rngs=rngs,
        )
        self.final_relu = final_relu

    def __call__(self, images: Float[Array, "N H W 3"]) -> Float[Array, "N h w 512"]:
        """The dense map."""
        layer = "relu4_3" if self.final_relu else "conv4_3"
        return self.taps(preprocess(images), (layer,))[layer]


def preprocess(rgb: Float[Array, "N H W 3"]) -> Float[Array, "N H W 3"]:
    """RGB in [0, 1] to BGR, 0 to 255, minus the mean."""
    return rgb[..., ::-1] * 255 - jnp.asarray(MEAN_BGR, rgb.dtype)[None, None, None, :]


def soft_scores(dense: Float[Array, "h w C"]) -> Float[Array, "h w"]:
    """Soft detection (eq. 4-7): local soft-max times the ratio to the strongest channel, its maximum over the channels.

    The scores of an image sum to one; differentiable, also where the map is zero.
    """
    dense = relu(dense)
    exponential = jnp.exp(dense / jnp.maximum(dense.max(), 1e-6))
    padded = jnp.pad(exponential, ((1, 1), (1, 1), (0, 0)), constant_values=1)
    height, width = dense.shape[:2]
    around = sum(padded[i : i + height, j : j + width] for i in range(3) for j in range(3))
    ratio = dense / (dense.max(-1, keepdims=True) + 1e-6)
    score = (exponential / around * ratio).max(-1)
    return score / (score.sum() + 1e-6)


@jax.jit
def hard_detection(
    dense: Float[Array, "h w C"],
) -> tuple[Bool[Array, "h w"], Int[Array, "h w"], Float[Array, "h w 2"]]:
    """Hard detection (eq. 3) and Newton's step to the sub-pixel maximum.

    Returns:
      Cells whose strongest channel is a local maximum of their 3x3 neighbourhood and no edge; that channel; the step
      (x, y) in cells, which the published code believes where both parts are below 0.5.
    """
    height, width, _ = dense.shape
    channel = jnp.argmax(dense, -1)
    # Only the strongest channel of a cell matters: nine reads a cell instead of filters over all channels.
    i, j = (steps.reshape(9, 1, 1) for steps in np.mgrid[:3, :3])
    rows, columns = i + np.arange(height)[None, :, None], j + np.arange(width)[None, None, :]
    patch = jnp.pad(dense, ((1, 1), (1, 1), (0, 0)))[rows, columns, channel[None]]
    nw, north, ne, west, centre, east, sw, south, se = patch
    outside = (rows == 0) | (rows > height) | (columns == 0) | (columns > width)
    local = ((centre[None] >= patch) | outside).all(0)
    dyy, dxx = north - 2 * centre + south, west - 2 * centre + east
    dxy = (nw - ne - sw + se) / 4
    dx, dy = (east - west) / 2, (south - north) / 2
    det, trace = dxx * dyy - dxy**2, dxx + dyy
    peak = (det > 0) & (trace**2 <= (EDGE + 1) ** 2 / EDGE * det)
    safe = jnp.where(det > 0, det, 1)
    step = jnp.stack([(dxy * dy - dyy * dx) / safe, (dxy * dx - dxx * dy) / safe], -1)
    return local & peak, channel, step


def detect(
    network: D2Net,
    image: Float[Array, "H W 3"],
    *,
    scales: Sequence[float] = (1.0,),
    count: int = 2000,
    offset: Offset = "exact",
) -> Detections:
    """Detects and describes one image at one or more scales.

    Args:
      network: in test form.
      image: RGB in [0, 1]; at least 16 px a side at every scale. With sides that are multiples of 4 at every scale the
        exact positions have no preferred direction: see the top of this file.
      scales: of the levels, increasing; the published ones are SCALES.
      count: of rows, the keypoints of highest score; above the number of cells of all levels every one.
      offset: where the centre of a cell lies.
    """
    size = (image.shape[0], image.shape[1])
    maps = [network(resize(image, level_size(size, scale))[None])[0] for scale in scales]
    return detect_maps(maps, size, tuple(scales), count=count, offset=offset)


def level_size(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """(height, width) of an image at a scale."""
    return int(size[0] * scale), int(size[1] * scale)


@partial(jax.jit, static_argnames=("size", "scales", "count", "offset"))
def detect_maps(
    maps: Sequence[Float[Array, "_ _ C"]],
    size: tuple[int, int],
    scales: tuple[float, ...],
    *,
    count: int,
    offset: Offset,
) -> Detections:
    """Detects on the dense maps of one image, coarsest first.

    A level adds the map of the level before, resized to its own; places a level detected are banned in the following
    ones; scores are divided by the number of maps they sum.

    Args:
      maps: one a scale.
      size: (height, width) of the image, px.
      scales: as in `detect`.
      count: as in `detect`.
      offset: as in `detect`.
    """
    summed: list[Array] = []
    places, scores, valid, banned = [], [], [], None
    for number, dense in enumerate(maps, 1):
        height, width, _ = dense.shape
        if summed:
            dense = dense + resize(summed[-1], (height, width))
        found, _, step = hard_detection(dense)
        if banned is not None:
            # Nearest cell; the published code rounds down, which has a preferred direction.
            half = 0.0 if offset == "official" else 0.5
            rows, columns = (
                ((np.arange(n) + half) * m / n).astype(int) for n, m in zip((height, width), banned.shape, strict=True)
            )
            banned = banned[rows][:, columns]
            found &= ~banned
        banned = found if banned is None else found | banned
        x, y = jnp.meshgrid(jnp.arange(width), jnp.arange(height))
        at = jnp.stack([x, y], -1).astype(dense.dtype) + step
        limit = jnp.asarray([width - 1, height - 1], at.dtype)[None, None]
        found &= (jnp.abs(step) < 0.5).all(-1) & (at >= 0).all(-1) & (at <= limit).all(-1)
        summed.append(dense)
        places.append(at.reshape(-1, 2))
        scores.append((dense.max(-1) / number).reshape(-1))
        valid.append(found.reshape(-1))

    ends = np.cumsum([len(rows) for rows in scores])
    ranked = jnp.where(jnp.concatenate(valid), jnp.concatenate(scores), -jnp.inf)
    best, index = jax.lax.top_k(ranked, min(count, int(ends[-1])))
    level = jnp.searchsorted(jnp.asarray(ends), index, side="right")
    at = jnp.concatenate(places)[index]
    chosen = [(level == k)[:, None] for k in range(len(maps))]
    pixels = [_image_from_cell(at, size, level_size(size, scale), offset) for scale in scales]
    return Detections(
        keypoints=jnp.select(chosen, pixels),
        scores=best,
        descriptors=normalise(jnp.select(chosen, [sample_bilinear(dense, at) for dense in summed])),
        scale=1 / jnp.asarray(scales, best.dtype)[level],
        valid=best > -jnp.inf,
    )


def _image_from_cell(cells: Array, size: tuple[int, int], level: tuple[int, int], offset: Offset) -> Array:
    """(x, y) in cells of a level to px of the image; sizes are (height, width)."""
    if offset == "official":
        scale = [size[1] / level[1], size[0] / level[0]]
        return (4 * cells + 1.5) * jnp.asarray(scale, cells.dtype)[None, :]
    scale = [(size[1] - 1) / (level[1] - 1), (size[0] - 1) / (level[0] - 1)]
    return (4 * cells + 3.5) * jnp.asarray(scale, cells.dtype)[None, :]


def d2net(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> D2Net:
    """The network in test form."""
    return D2Net(rngs=rngs)


def recognise(state: Mapping[str, np.ndarray]) -> bool:
    """Whether these are the keys of d2_tf.pth and its like."""
    return f"{PREFIX}0.weight" in state and f"{PREFIX}21.weight" in state


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The published keys and layouts to ours.

    Raises:
      ValueError: a key that is not one of them.
    """
    return convert_stack(state, PREFIX, torchvision_indices(STAGES))
