"""D2-Net, SuperPoint, ALIKE, ALIKED and XFeat as local features, each of its weights file and its arithmetic.

Networks are not invariant to rotation: of a view that is turned by pi they have to look at the turned view.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

import ebjax.models.alike
import ebjax.models.aliked
import ebjax.models.d2net
import ebjax.models.superpoint
import ebjax.models.xfeat
from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.features.upright import halved
from ebjax.models.detect import Detections, window_max
from ebjax.models.fast import Arithmetic
from ebjax.models.locate import open_network
from ebjax.models.luma import luma

COUNT = 2000
SIDE_PX = 400
"""A view is looked at at half its size, and so on, as long as that leaves so many px: a floor view holds no finer
detail than the image, and joints between tiles would fill up with keypoints that can slide along them."""
MARGIN_PX = 8
"""Keypoints so close to what is not seen describe the border of the field of view."""
ALIKE_THRESHOLD = 0.01
"""Floors are faint: the published 0.2 leaves a dozen keypoints on polished stone; the strongest COUNT are kept."""
ALIKED_THRESHOLD = 0.0
"""Its scores on stone and ceramic are lower still: the strongest COUNT are kept, whatever they are."""
XFEAT_THRESHOLD = 0.005
"""Likewise, below the published 0.05."""
CONVENTIONS = {"superpoint": "superglue", "superpoint-v6": "v6"}


def d2net(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """D2-Net at one scale, 512 numbers a keypoint."""
    path, _, network = open_network("d2net", weights, arithmetic)
    return _extractor(path, network, partial(ebjax.models.d2net.detect, count=COUNT))


def superpoint(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """SuperPoint v1 as hloc reads it, or v6; 256 numbers a keypoint."""
    path, kind, network = open_network("superpoint", weights, arithmetic, accepted=tuple(CONVENTIONS))
    convention = ebjax.models.superpoint.CONVENTIONS[CONVENTIONS[kind]]

    def detect(network: Any, view: Float[Array, "H W 3"]) -> Detections:
        return ebjax.models.superpoint.detect(network, luma(view)[..., None], convention, count=COUNT)

    return _extractor(path, network, detect)


def alike(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """ALIKE, whichever variant the file holds; 64 to 128 numbers a keypoint."""
    path, _, network = open_network("alike", weights, arithmetic)
    return _extractor(path, network, partial(ebjax.models.alike.detect, count=COUNT, threshold=ALIKE_THRESHOLD))


def aliked(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """ALIKED, whichever variant the file holds; 64 to 128 numbers a keypoint."""
    path, _, network = open_network("aliked", weights, arithmetic)
    return _extractor(path, network, partial(ebjax.models.aliked.detect, count=COUNT, threshold=ALIKED_THRESHOLD))


def xfeat(weights: Path | None, arithmetic: Arithmetic) -> Extractor:
    """XFeat's sparse feature, 64 numbers a keypoint."""
    path, _, network = open_network("xfeat", weights, arithmetic)
    return _extractor(path, network, partial(ebjax.models.xfeat.detect, count=COUNT, threshold=XFEAT_THRESHOLD))


def _extractor(path: Path, network: nnx.Module, detect: Callable[..., Detections]) -> Extractor:
    graph, state = nnx.split(network)
    # The weights are arguments of one program: as constants in it they would be compiled.
    return Extractor(
        extract=lambda view, seen: _extract(graph, state, jnp.asarray(view), jnp.asarray(seen), detect),
        jitted=False,
        turn=None,
        weights=path,
    )


@partial(jax.jit, static_argnames=("graph", "detect"))
def _extract(
    graph: Any,
    state: Any,
    view: Float[Array, "H W 3"],
    seen: Bool[Array, "H W"],
    detect: Callable[..., Detections],
) -> Features:
    scale = 1
    while min(view.shape[:2]) >= 2 * SIDE_PX:
        view, seen, scale = halved(view).mean((1, 3)), halved(seen).all((1, 3)), 2 * scale
    weight = seen.astype(view.dtype)[..., None]
    mean = (view * weight).sum((0, 1), keepdims=True) / jnp.maximum(weight.sum(), 1)
    # Two views have the edge of the field of view in common, whatever they show: no black beyond it.
    found = detect(nnx.merge(graph, state), jnp.where(seen[..., None], view, mean))
    hidden = jnp.pad(1 - seen.astype(jnp.float32), MARGIN_PX, constant_values=1)
    near_border = window_max(hidden, MARGIN_PX)[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] > 0
    column, row = (jnp.round(found.keypoints[:, k]).astype(jnp.int32) for k in (0, 1))
    keypoints = (found.keypoints + 0.5) * scale - 0.5
    return Features(keypoints, found.descriptors, found.valid & ~near_border[row, column])
