"""VGG-16 and VGG-19 (Simonyan and Zisserman 2015) without their classifiers, with torchvision's weights.

RGB in [0, 1], NHWC; the network subtracts ImageNet's mean and divides by its deviation. Any layer can be read.
"""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.models.layers import Precision, Stack, imagenet
from ebjax.models.weights import kernel_from_torch

STAGES = {"vgg16": (2, 2, 3, 3, 3), "vgg19": (2, 2, 4, 4, 4)}


class VGG(Stack):
    """The convolutions and pools of VGG: H x W x 3 -> H/32 x W/32 x 512.

    Args:
      stages: convolutions in each of the five stages.
      precision: of the products; "highest" is float32, also on a GPU.
    """

    def __init__(self, stages: Sequence[int] = STAGES["vgg16"], *, precision: Precision = "highest", rngs: nnx.Rngs):
        super().__init__(stages, precision=precision, rngs=rngs)

    def __call__(self, images: Float[Array, "B H W 3"], layer: str = "pool5") -> Float[Array, "B h w C"]:
        """The output of one layer.

        Args:
          images: RGB in [0, 1].
          layer: conv{stage}_{n} (before the ReLU), relu{stage}_{n} or pool{stage}.

        Raises:
          ValueError: there is no such layer.
        """
        return self.taps(imagenet(images), (layer,))[layer]


def adaptive_avg_pool(x: Float[Array, "B H W C"], size: int) -> Float[Array, "B s s C"]:
    """Means over size x size windows that cover the map, overlapping where it does not divide, also a smaller one.

    Window i reaches from floor(i n / size) to ceil((i + 1) n / size), as in torch.
    """
    rows, columns = (jnp.asarray(_windows(n, size), x.dtype) for n in x.shape[1:3])
    return jnp.einsum("bhwc,ph,qw->bpqc", x, rows, columns, precision="highest")


def _windows(n: int, size: int) -> np.ndarray:
    i, position = np.arange(size)[:, None], np.arange(n)[None, :]
    inside = (position >= i * n // size) & (position < -(-(i + 1) * n // size))
    return inside / inside.sum(1, keepdims=True)


def vgg16(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> VGG:
    """VGG-16."""
    return VGG(STAGES["vgg16"], rngs=rngs)


def vgg19(arrays: Mapping[str, np.ndarray] | None = None, *, rngs: nnx.Rngs) -> VGG:
    """VGG-19."""
    return VGG(STAGES["vgg19"], rngs=rngs)


def torchvision_indices(stages: Sequence[int]) -> dict[int, str]:
    """Where torchvision's `features` has each convolution: {0: "conv1_1", 2: "conv1_2", 5: "conv2_1", ...}."""
    found, index = {}, 0
    for stage, count in enumerate(stages, 1):
        for n in range(1, count + 1):
            found[index] = f"conv{stage}_{n}"
            index += 2
        index += 1
    return found


def recognise_vgg16(state: Mapping[str, np.ndarray]) -> bool:
    """Whether `features.*` has convolutions exactly where VGG-16 has them."""
    return _convolutions(state) == torchvision_indices(STAGES["vgg16"]).keys()


def recognise_vgg19(state: Mapping[str, np.ndarray]) -> bool:
    """Whether `features.*` has convolutions exactly where VGG-19 has them."""
    return _convolutions(state) == torchvision_indices(STAGES["vgg19"]).keys()


def _convolutions(state: Mapping[str, np.ndarray]) -> set[int]:
    parts = [key.split(".") for key in state if key.startswith("features.")]
    return {int(part[1]) for part in parts if len(part) == 3 and part[1].isdigit()}


def convert(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """From torchvision's VGG-16 or VGG-19; the classifier is left out.

    Raises:
      ValueError: a key that is neither.
    """
    stages = STAGES["vgg19" if recognise_vgg19(state) else "vgg16"]
    features = {key: array for key, array in state.items() if not key.startswith("classifier.")}
    return convert_stack(features, "features.", torchvision_indices(stages))


def convert_stack(state: Mapping[str, np.ndarray], prefix: str, indices: Mapping[int, str]) -> dict[str, np.ndarray]:
    """Renames `{prefix}{index}.weight` and `.bias` to `{name}.kernel` and `.bias`, kernels to height, width, in, out.

    Raises:
      ValueError: a key that is none of these.
    """
    names = {f"{prefix}{index}.weight": f"{name}.kernel" for index, name in indices.items()}
    names |= {f"{prefix}{index}.bias": f"{name}.bias" for index, name in indices.items()}
    if unknown := [key for key in state if key not in names]:
        raise ValueError(f"unexpected key {unknown[0]!r} in the checkpoint")
    return {names[key]: kernel_from_torch(array) for key, array in state.items()}
