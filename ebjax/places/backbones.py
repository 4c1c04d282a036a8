"""VGG-19 and ResNet-50 as global descriptors: their last map, flattened or averaged (see `flattened`)."""

from pathlib import Path

from ebjax.models.fast import Arithmetic
from ebjax.places.descriptor import Descriptor
from ebjax.places.flattened import SIDE_PX, flat, pooled, unite
from ebjax.places.network import network_descriptor

LAYERS = {"vgg19": "pool5", "resnet50": "layer4"}


def _reader(name, keep):
    return lambda network, images, shown: keep(network(images, LAYERS[name]), shown)


_FLAT, _POOLED = ({name: _reader(name, keep) for name in LAYERS} for keep in (flat, pooled))


def vgg19(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """VGG-19's flattened map, reduced by PCA."""
    return network_descriptor("vgg19", weights, arithmetic, _FLAT["vgg19"], unite, side_px=SIDE_PX)


def vgg19_pooled(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """The mean over VGG-19's map."""
    return network_descriptor("vgg19", weights, arithmetic, _POOLED["vgg19"], unite, side_px=SIDE_PX)


def resnet50(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """ResNet-50's flattened map, reduced by PCA."""
    return network_descriptor("resnet50", weights, arithmetic, _FLAT["resnet50"], unite, side_px=SIDE_PX)


def resnet50_pooled(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """The mean over ResNet-50's map."""
    return network_descriptor("resnet50", weights, arithmetic, _POOLED["resnet50"], unite, side_px=SIDE_PX)
