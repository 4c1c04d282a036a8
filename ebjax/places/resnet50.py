"""ResNet-50 as a global descriptor: its last map, flattened or averaged (see `flattened`)."""

from pathlib import Path

from ebjax.places.descriptor import Descriptor
from ebjax.places.flattened import SIDE_PX, flat, pooled, unite
from ebjax.places.network import network_descriptor


def _flat(network, images, shown):
    return flat(network(images, "layer4"), shown)


def _pooled(network, images, shown):
    return pooled(network(images, "layer4"), shown)


def resnet50(weights: Path | None) -> Descriptor:
    """The flattened map, reduced by PCA."""
    return network_descriptor("resnet50", weights, _flat, unite, side_px=SIDE_PX)


def resnet50_pooled(weights: Path | None) -> Descriptor:
    """The mean over the map."""
    return network_descriptor("resnet50", weights, _pooled, unite, side_px=SIDE_PX)
