"""VGG-19 as a global descriptor: its last pooled map, flattened or averaged (see `flattened`)."""

from pathlib import Path

from ebjax.places.descriptor import Descriptor
from ebjax.places.flattened import SIDE_PX, flat, pooled, unite
from ebjax.places.network import network_descriptor


def _flat(network, images, shown):
    return flat(network(images, "pool5"), shown)


def _pooled(network, images, shown):
    return pooled(network(images, "pool5"), shown)


def vgg19(weights: Path | None) -> Descriptor:
    """The flattened map, reduced by PCA."""
    return network_descriptor("vgg19", weights, _flat, unite, side_px=SIDE_PX)


def vgg19_pooled(weights: Path | None) -> Descriptor:
    """The mean over the map."""
    return network_descriptor("vgg19", weights, _pooled, unite, side_px=SIDE_PX)
