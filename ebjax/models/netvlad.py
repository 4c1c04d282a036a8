"""NetVLAD (Arandjelovic et al., CVPR 2016) on VGG-16's conv5_3, with whitening, and the two published conventions.

    a_k(x) = softmax_k(w_k . x + b_k),  V(k) = sum_x a_k(x) (x - c_k)      (equations 3 and 4)

over descriptors x of unit length; each V(k), then the whole, is brought to unit length; whitening is one more linear
layer and unit length. "matlab" is the authors' own (mean image of the file, flattened channel by channel), "nanne"
pytorch-NetVlad and Patch-NetVLAD (ImageNet's mean and deviation, flattened cluster by cluster).
RGB in [0, 1], NHWC.
"""

import math
from collections.abc import Mapping
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.models.layers import Buffer, Precision, Stack, imagenet, normalise
from ebjax.models.vgg import STAGES, convert_stack, torchvision_indices
from ebjax.models.weights import kernel_from_torch

Convention = Literal["matlab", "nanne"]
CHANNELS = 512
AVERAGE_RGB = (123.68, 116.779, 103.939)


class Aggregation(nnx.Module):
    """The NetVLAD layer.

    Attributes:
      assignment: w, channels x clusters.
      bias: b, or None.
      centroids: c, clusters x channels.
    """

    def __init__(
        self,
        clusters: int = 64,
        channels: int = CHANNELS,
        *,
        convention: Convention = "matlab",
        bias: bool = False,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        initial = nnx.initializers.orthogonal()
        self.assignment = nnx.Param(10 * initial(rngs.params(), (channels, clusters), jnp.float32))
        self.bias = nnx.Param(jnp.zeros(clusters, jnp.float32)) if bias else None
        self.centroids = nnx.Param(initial(rngs.params(), (clusters, channels), jnp.float32))
        self.convention, self.precision = convention, precision

    def soft_assignment(self, x: Float[Array, "B N D"]) -> Float[Array, "B N K"]:
        """a_k(x) of descriptors of unit length."""
        logits = jnp.einsum("bnd,dk->bnk", x, self.assignment[...], precision=self.precision)
        return jax.nn.softmax(logits if self.bias is None else logits + self.bias[...][None, None, :])

    def residuals(self, x: Float[Array, "B N D"], share: Float[Array, "B N K"]) -> Float[Array, "B K D"]:
        """V(k) = sum_x a_k(x) x - (sum_x a_k(x)) c_k."""
        total = jnp.einsum("bnk,bnd->bkd", share, x, precision=self.precision)
        return total - share.sum(1)[:, :, None] * self.centroids[...][None]

    def flatten(self, v: Float[Array, "B K D"]) -> Float[Array, "B KD"]:
        """Each V(k), then all of them together, of unit length, in the order of the convention."""
        v = normalise(v)
        return normalise((v.mT if self.convention == "matlab" else v).reshape(len(v), -1))

    def __call__(self, descriptors: Float[Array, "B H W D"]) -> Float[Array, "B KD"]:
        """Aggregates a map of descriptors of any length into one of unit length."""
        x = normalise(descriptors.reshape(len(descriptors), -1, descriptors.shape[-1]))
        return self.flatten(self.residuals(x, self.soft_assignment(x)))


class Whitening(nnx.Module):
    """y = v P + b, brought to unit length."""

    def __init__(self, inputs: int, components: int, *, precision: Precision = "highest", rngs: nnx.Rngs):
        initial = nnx.initializers.orthogonal()
        self.kernel = nnx.Param(initial(rngs.params(), (inputs, components), jnp.float32))
        self.bias = nnx.Param(jnp.zeros(components, jnp.float32))
        self.precision = precision

    def project(self, v: Float[Array, "B F"]) -> Float[Array, "B P"]:
        """The vector y before it is brought to unit length."""
        return jnp.matmul(v, self.kernel[...], precision=self.precision) + self.bias[...][None, :]

    def __call__(self, v: Float[Array, "B F"]) -> Float[Array, "B P"]:
        """Whitens."""
        return normalise(self.project(v))


class NetVLAD(nnx.Module):
    """One unit vector an image: 32,768 numbers, or as many as the whitening keeps.

    Args:
      convention: "matlab" or "nanne": preprocessing and order of the vector.
      clusters: of the vocabulary.
      bias: whether the soft assignment has one (pytorch-NetVlad's vladv2).
      components: of the whitening; None leaves it out.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(
        self,
        *,
        convention: Convention = "matlab",
        clusters: int = 64,
        bias: bool = False,
        components: int | None = None,
        precision: Precision = "highest",
        rngs: nnx.Rngs,
    ):
        self.convention = convention
        self.backbone = Stack(STAGES["vgg16"], pools=("max",) * 4 + ("",), precision=precision, rngs=rngs)
        self.aggregation = Aggregation(clusters, convention=convention, bias=bias, precision=precision, rngs=rngs)
        inputs = clusters * CHANNELS
        whitening = None if components is None else Whitening(inputs, components, precision=precision, rngs=rngs)
        self.whitening = whitening
        if convention == "matlab":
            self.mean_rgb = Buffer(jnp.array(AVERAGE_RGB, jnp.float32))

    def preprocess(self, images: Float[Array, "B H W 3"]) -> Float[Array, "B H W 3"]:
        """What the backbone sees."""
        if self.convention == "nanne":
            return imagenet(images)
        return jnp.clip(255 * images, 0, 255) - self.mean_rgb[...].astype(images.dtype)[None, None, None, :]

    def __call__(self, images: Float[Array, "B H W 3"]) -> Float[Array, "B F"]:
        """Describes RGB images in [0, 1]."""
        layer = "conv5_3"  # without its ReLU, as published
        v = self.aggregation(self.backbone.taps(self.preprocess(images), (layer,))[layer])
        return v if self.whitening is None else self.whitening(v)


def initial_vocabulary(
    centroids: Float[Array, "K D"], descriptors: Float[Array, "N D"], *, bias: bool = False
) -> dict[str, Float[Array, "..."]]:
    """Soft assignment from k-means centres, for `load_into(aggregation, ...)`.

    alpha is such that on average the second cluster gets a hundredth of the first's share.
    Without a bias: w = alpha c / |c|, alpha = -ln(0.01) / mean(first - second of c . x / |c|), the authors' way.
    With: w = 2 alpha c, b = -alpha |c|^2, alpha = -ln(0.01) / mean(second - first of |x - c|^2), for descriptors of
    unit length; that is softmax(-alpha |x - c|^2).

    Args:
      centroids: from k-means.
      descriptors: of unit length; some of those k-means saw.
      bias: whether the layer has one.
    """
    directions = centroids if bias else normalise(centroids)
    squared = jnp.sum(centroids**2, 1)
    score = jnp.matmul(descriptors, directions.T, precision="highest")
    if bias:
        score = 2 * score - squared[None, :]
    best = jax.lax.top_k(score, 2)[0]
    alpha = -math.log(0.01) / jnp.mean(best[:, 0] - best[:, 1])
    vocabulary = {"assignment": (2 * alpha if bias else alpha) * directions.T, "centroids": centroids}
    return vocabulary | ({"bias": -alpha * squared} if bias else {})


def learn_whitening(vectors: Float[Array, "N F"], components: int) -> dict[str, Float[Array, "..."]]:
    """PCA whitening, y = diag(lambda)^-1/2 U^T (v - mean), for `load_into(whitening, ...)`.

    Args:
      vectors: unwhitened, of unit length; their number bounds the components.
      components: the directions of largest variance to keep.

    Raises:
      ValueError: there are not enough vectors.
    """
    count, inputs = vectors.shape
    if not 0 < components <= min(count - 1, inputs):
        raise ValueError(f"{count} vectors of {inputs} give at most {min(count - 1, inputs)} components")
    mean = vectors.mean(0)
    _, spread, directions = jnp.linalg.svd(vectors - mean[None, :], full_matrices=False)
    deviation = spread[:components] / math.sqrt(count - 1)
    # Directions without variance would be divided by zero; they stay small instead.
    kernel = directions[:components].T / jnp.maximum(deviation, 1e-6 * deviation[0])[None, :]
    return {"kernel": kernel, "bias": -jnp.matmul(mean, kernel, precision="highest")}


def _build(convention: Convention, arrays: Mapping[str, np.ndarray] | None, rngs: nnx.Rngs) -> NetVLAD:
    if arrays is None:
        return NetVLAD(convention=convention, components=4096 if convention == "matlab" else None, rngs=rngs)
    try:
        kernel = arrays.get("whitening.kernel")
        return NetVLAD(
            convention=convention,
            clusters=arrays["aggregation.centroids"].shape[0],
            bias="aggregation.bias" in arrays,
            components=None if kernel is None else kernel.shape[1],
            rngs=rngs,
        )
    except (KeyError, IndexError):
        raise ValueError("aggregation.centroids or whitening.kernel is missing or has a wrong shape") from None


def netvlad_matlab(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> NetVLAD:
    """NetVLAD as its authors published it."""
    return _build("matlab", arrays, rngs)


def netvlad_nanne(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> NetVLAD:
    """NetVLAD of pytorch-NetVlad and Patch-NetVLAD."""
    return _build("nanne", arrays, rngs)


def recognise_matlab(state: Mapping[str, np.ndarray]) -> bool:
    """Whether the struct has the vlad layer where the authors' files have it."""
    return "layers.30.weights.1" in state


def recognise_nanne(state: Mapping[str, np.ndarray]) -> bool:
    """Whether there is an encoder and a pool with centroids, from one GPU or several."""
    keys = {key.replace("module.", "") for key in state}
    return "pool.centroids" in keys and "encoder.28.weight" in keys


def convert_matlab(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The authors' .mat: kernels already height, width, in, out; centroids negated; the mean of the file's image.

    Raises:
      ValueError: a layer is missing.
    """
    try:
        arrays = {"mean_rgb": state["meta.normalization.averageImage"].reshape(-1, 3)[0]}
        for index, name in torchvision_indices(STAGES["vgg16"]).items():
            kernel, bias = (state[f"layers.{index}.weights.{n}"] for n in (0, 1))
            arrays |= {f"backbone.{name}.kernel": kernel, f"backbone.{name}.bias": bias.reshape(-1)}
        assignment, negated = (state[f"layers.30.weights.{n}"] for n in (0, 1))
        arrays["aggregation.assignment"] = assignment.reshape(CHANNELS, -1)
        arrays["aggregation.centroids"] = -negated.reshape(CHANNELS, -1).T
        if "layers.33.weights.0" in state:
            bias = state["layers.33.weights.1"].reshape(-1)
            arrays |= {"whitening.kernel": state["layers.33.weights.0"].reshape(-1, len(bias)), "whitening.bias": bias}
    except KeyError as error:
        raise ValueError(f"{error.args[0]} is missing from the struct") from None
    return arrays


def convert_nanne(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """pytorch-NetVlad or Patch-NetVLAD, from one GPU or several, with or without bias and WPCA.

    Raises:
      ValueError: a key that is none of these.
    """
    state = {key.replace("module.", ""): array for key, array in state.items()}
    encoder = {key: array for key, array in state.items() if key.startswith("encoder.")}
    stack = convert_stack(encoder, "encoder.", torchvision_indices(STAGES["vgg16"]))
    arrays = {f"backbone.{key}": array for key, array in stack.items()}
    names = {
        "pool.conv.weight": "aggregation.assignment",
        "pool.conv.bias": "aggregation.bias",
        "pool.centroids": "aggregation.centroids",
        "WPCA.0.weight": "whitening.kernel",
        "WPCA.0.bias": "whitening.bias",
    }
    for key in state.keys() - encoder.keys():
        if key not in names:
            raise ValueError(f"unexpected key {key!r} in the checkpoint")
        array = state[key]
        arrays[names[key]] = kernel_from_torch(array)[0, 0] if array.ndim == 4 else array
    return arrays
