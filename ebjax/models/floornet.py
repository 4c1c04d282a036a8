"""floornet, our own network of floor views: a place map, local descriptors and their reliability in one pass.

    maps = network(grey, seen)
    maps.places     stride 8, for correlation and VLAD
    maps.local      stride 4, unit length, read at keypoints
    maps.score      stride 4, the logit of how reliably a descriptor there finds its like; for training alone

It is equivariant under R_pi by construction (Cohen and Welling, "Group equivariant convolutional networks", ICML 2016,
for the group of two): every filter comes with itself turned by pi, and the responses of the two change places when the
view is turned. The heads read sums and differences of the two, so that the descriptors of the turned view are those of
the view, in reversed order, the odd half of the channels with the other sign (`parity`): it is never looked at twice.
Strides keep the grid symmetric about the centre: kernels of even size over maps of even size.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax import lax
from jaxtyping import Array, Float

from ebjax.geometry.pytree import pytree
from ebjax.models.layers import Buffer, normalise, relu
from ebjax.models.trainable import convolve
from ebjax.models.weights import load_into, load_weights

NAME = "floornet"
SHIPPED = Path(__file__).with_name("floornet.safetensors")
CELL = 8
CONTRAST_PX = 10.0
CONTRAST_FLOOR = 0.02
"""Grey levels of [0, 1]: contrast below it is noise and stays small."""
MOMENTUM = 0.95
EPSILON = 1e-4
STEM = ((24, 6, 2), (32, 3, 1), (64, 4, 2), (64, 3, 1))
TOP = ((96, 4, 2), (128, 3, 1), (128, 3, 1))
"""Channels, kernel size and stride of the layers up to stride 4, and on to stride 8."""


@pytree
class FloorMaps:
    """What the network says of views."""

    places: Float[Array, "B h w D"]
    local: Float[Array, "B k l D"]
    score: Float[Array, "B k l"]


def parity(dimension: int) -> Float[np.ndarray, " D"]:
    """1 for each even channel of a descriptor, -1 for each odd one."""
    return np.repeat(np.array([1.0, -1.0], np.float32), dimension // 2)


def turn_maps(maps: FloorMaps) -> FloorMaps:
    """The maps of the views turned by pi."""

    def turned(values: Float[Array, "B h w D"]) -> Float[Array, "B h w D"]:
        return values[:, ::-1, ::-1] * jnp.asarray(parity(values.shape[-1]), values.dtype)[None, None, None, :]

    return FloorMaps(turned(maps.places), turned(maps.local), maps.score[:, ::-1, ::-1])


def fitted(grey: Float[Array, "H W"], seen: Float[Array, "H W"]) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """A view and its field, stretched to the nearest sides that the network takes."""
    size = tuple(max(CELL, CELL * round(side / CELL)) for side in grey.shape)
    if size == grey.shape:
        return grey, seen
    shown = jax.image.resize(seen, size, "linear")
    return jax.image.resize(grey, size, "linear"), (shown > 0.999).astype(seen.dtype)


def local_contrast(grey: Float[Array, "B H W"], seen: Float[Array, "B H W"]) -> Float[Array, "B H W"]:
    """Difference from the mean of the seen surroundings over their deviation; 0 where nothing is seen.

    Surroundings are a Gaussian window of CONTRAST_PX. Light that changes slowly, exposure and gamma hardly matter then.
    """
    height, width = grey.shape[1:]

    def blur(values):
        rows, columns = (jnp.asarray(gaussian(n), values.dtype) for n in (height, width))
        return jnp.einsum("yi,bij,xj->byx", rows, values, columns, precision="highest")

    weight = jnp.maximum(blur(seen), 1e-3)
    centred = (grey - blur(grey * seen) / weight) * seen
    deviation = jnp.sqrt(jnp.maximum(blur(centred**2) / weight, 0) + CONTRAST_FLOOR**2)
    return jnp.clip(centred / deviation, -4, 4)


def gaussian(size: int) -> Float[np.ndarray, "n n"]:
    """The window of the contrast as a matrix; its rows sum to 1."""
    offset = np.arange(size)
    kernel = np.exp(-0.5 * ((offset[:, None] - offset[None, :]) / CONTRAST_PX) ** 2)
    return (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)


class PairConv(nnx.Module):
    """A convolution whose outputs come in pairs, by a filter and by the same filter turned by pi; norm and ReLU.

        y_0 = A x_0 + B x_1,    y_1 = (R_pi B) x_0 + (R_pi A) x_1

    The first half of the channels is y_0, the second y_1. Batch statistics are those of both together.

    Args:
      channels_in: 1 is an image, more are pairs.
      channels_out: even.
      size: of the kernel; even for stride 2.
      stride: 1 or 2.
      rngs: of the kernel.
    """

    def __init__(self, channels_in: int, channels_out: int, size: int, stride: int = 1, *, rngs: nnx.Rngs):
        pairs = channels_out // 2
        initial = nnx.initializers.he_normal()
        self.kernel = nnx.Param(initial(rngs.params(), (size, size, channels_in, pairs), jnp.float32))
        self.scale = nnx.Param(jnp.ones(pairs, jnp.float32))
        self.shift = nnx.Param(jnp.zeros(pairs, jnp.float32))
        self.mean = Buffer(jnp.zeros(pairs, jnp.float32))
        self.variance = Buffer(jnp.ones(pairs, jnp.float32))
        self.stride, self.padding = stride, (size - stride) // 2 if size % 2 == 0 else size // 2

    def __call__(self, x: Float[Array, "B H W I"], *, training: bool = False) -> Float[Array, "B h w O"]:
        """The layer; in training by the statistics of the batch, which are remembered."""
        kernel = self.kernel[...].astype(x.dtype)
        gain = self.scale[...] * lax.rsqrt(self.variance[...] + EPSILON)
        if not training:
            kernel = kernel * gain.astype(x.dtype)[None, None, None, :]
        halves = jnp.split(kernel, 2, axis=2) if x.shape[-1] > 1 else [kernel]
        turned = jnp.concatenate(halves[::-1], axis=2)[::-1, ::-1]
        y = convolve(x, jnp.concatenate([kernel, turned], axis=3), self.stride, self.padding)
        if training:
            pairs = y.reshape(-1, 2, y.shape[-1] // 2)
            mean = jnp.mean(pairs, axis=(0, 1))
            variance = jnp.maximum(jnp.mean(pairs**2, axis=(0, 1)) - mean**2, 0)
            for remembered, now in ((self.mean, mean), (self.variance, variance)):
                remembered[...] = MOMENTUM * remembered[...] + (1 - MOMENTUM) * lax.stop_gradient(now)
            gain = self.scale[...] * lax.rsqrt(variance + EPSILON)
            y = y * jnp.tile(gain, 2)[None, None, None, :]
            shift = self.shift[...] - mean * gain
        else:
            shift = self.shift[...] - self.mean[...] * gain
        return relu(y + jnp.tile(shift, 2).astype(x.dtype)[None, None, None, :])


class ParityHead(nnx.Module):
    """Sums and differences of pairs, each read by a matrix of its own: the first half of the outputs is even.

    Args:
      channels_in: pairs.
      dimension: of the descriptor.
      rngs: of the matrices.
    """

    def __init__(self, channels_in: int, dimension: int, *, rngs: nnx.Rngs):
        initial = nnx.initializers.orthogonal()
        shape = (channels_in // 2, dimension // 2)
        self.even = nnx.Param(initial(rngs.params(), shape, jnp.float32))
        self.odd = nnx.Param(initial(rngs.params(), shape, jnp.float32))

    def __call__(self, x: Float[Array, "B h w I"]) -> Float[Array, "B h w O"]:
        """The descriptors."""
        first, second = jnp.split(x, 2, axis=-1)
        even = (first + second) @ self.even[...].astype(x.dtype)
        odd = (first - second) @ self.odd[...].astype(x.dtype)
        return jnp.concatenate([even, odd], -1)


class FloorNet(nnx.Module):
    """Grey floor views to their maps.

    Args:
      dimension: of a descriptor, even.
      rngs: of the weights.
    """

    def __init__(self, dimension: int = 64, *, rngs: nnx.Rngs):
        self.depth = len(STEM), len(TOP)
        channels = 1
        for name, layers in (("stem", STEM), ("top", TOP)):
            for n, (width, size, stride) in enumerate(layers, 1):
                setattr(self, f"{name}{n}", PairConv(channels, width, size, stride, rngs=rngs))
                channels = width
        self.place_head = ParityHead(channels, dimension, rngs=rngs)
        self.merge = PairConv(STEM[-1][0] + TOP[-1][0], 96, 1, rngs=rngs)
        self.local_head = ParityHead(96, dimension, rngs=rngs)
        self.score_head = nnx.Param(jnp.zeros(96 // 2, jnp.float32))

    def __call__(
        self, grey: Float[Array, "B H W"], seen: Float[Array, "B H W"], *, training: bool = False
    ) -> FloorMaps:
        """The maps of a batch.

        Args:
          grey: in [0, 1].
          seen: 1 where the view shows the floor.
          training: normalise by the batch and remember its statistics.

        Raises:
          ValueError: a side is no multiple of 8 px.
        """
        if any(side % CELL for side in grey.shape[1:]):
            raise ValueError(f"views of {grey.shape[1:]} px: floornet needs sides that are multiples of {CELL}")
        fine = local_contrast(grey, seen)[..., None]
        for n in range(1, self.depth[0] + 1):
            fine = getattr(self, f"stem{n}")(fine, training=training)
        coarse = fine
        for n in range(1, self.depth[1] + 1):
            coarse = getattr(self, f"top{n}")(coarse, training=training)
        places = self.place_head(coarse)
        places = places * lax.rsqrt(1 + jnp.sum(places**2, -1, keepdims=True))
        raised = _upsampled(coarse)
        # Pairs stay pairs: first halves of both, then second halves.
        parts = [half for halves in zip(*(jnp.split(m, 2, -1) for m in (fine, raised)), strict=True) for half in halves]
        both = self.merge(jnp.concatenate(parts, -1), training=training)
        first, second = jnp.split(both, 2, axis=-1)
        score = (first + second) @ self.score_head[...].astype(both.dtype)
        return FloorMaps(places, normalise(self.local_head(both)), score)


def _upsampled(x: Float[Array, "B h w C"]) -> Float[Array, "B k l C"]:
    """Twice the size, linear, symmetric under R_pi: weights 3/4 and 1/4."""
    for axis in (1, 2):
        low = jnp.concatenate([lax.slice_in_dim(x, 0, 1, axis=axis), x[(slice(None),) * axis + (slice(-1),)]], axis)
        high = jnp.concatenate(
            [x[(slice(None),) * axis + (slice(1, None),)], lax.slice_in_dim(x, -1, None, axis=axis)], axis
        )
        pair = jnp.stack([0.75 * x + 0.25 * low, 0.75 * x + 0.25 * high], axis + 1)
        x = pair.reshape(*x.shape[:axis], 2 * x.shape[axis], *x.shape[axis + 1 :])
    return x


def open_floornet(given: Path | None = None) -> tuple[Path, FloorNet]:
    """The network with its weights, and the file that they were read from.

    Args:
      given: a file of them, or a folder that holds floornet.safetensors; of anything else, of another network's file
        and of None the weights that come with the package are taken.

    Raises:
      ValueError: not a weights file, or not of this network; the file is named.
      OSError: it cannot be read.
    """
    path = SHIPPED if given is None else given
    if path.is_dir():
        path = path / SHIPPED.name if (path / SHIPPED.name).is_file() else SHIPPED
    name, arrays = load_weights(path)
    if name != NAME:
        path = SHIPPED
        name, arrays = load_weights(path)
    dimension = 2 * arrays["place_head.even"].shape[1] if "place_head.even" in arrays else 2
    network = nnx.eval_shape(lambda: FloorNet(dimension, rngs=nnx.Rngs(0)))
    try:
        load_into(network, {key: np.asarray(array, np.float32) for key, array in arrays.items()})
    except ValueError as fault:
        raise ValueError(f"{path}: {fault}") from None
    return path, network
