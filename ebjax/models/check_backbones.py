"""The part of VGG, ResNet and NetVLAD in `ebjax.models.check`: every array of their reference files."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ebjax.models.catalogue import restore
from ebjax.models.compare import Comparison, Deviation, Image
from ebjax.models.layers import imagenet, normalise
from ebjax.models.netvlad import CHANNELS
from ebjax.models.vgg import VGG, adaptive_avg_pool

UNIT = 1e-4  # for entries of unit vectors and shares of a softmax
VLAD = 1e-5  # the entries of 32,768 are about 0.005


def _floats(image: Image) -> jnp.ndarray:
    return jnp.asarray(image.rgb, jnp.float32)[None] / 255


def _input_crop(comparison: Comparison, x: jnp.ndarray) -> None:
    if "input_crop" in comparison.reference:
        comparison.array("input_crop", np.moveaxis(np.asarray(x[0, :16, :16]), -1, 0))


def vgg(arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]) -> dict[str, Deviation]:
    """VGG-16 or VGG-19."""
    model = restore("vgg19" if "conv3_4.kernel" in arrays else "vgg16", arrays)
    return _backbone(model, image, reference)


def resnet50(
    arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]
) -> dict[str, Deviation]:
    """ResNet-50."""
    return _backbone(restore("resnet50", arrays), image, reference)


def _backbone(model: Any, image: Image, reference: Mapping[str, np.ndarray]) -> dict[str, Deviation]:
    comparison, x = Comparison(reference), imagenet(_floats(image))
    _input_crop(comparison, x)
    vgg = isinstance(model, VGG)
    names = {"pool5", *comparison.maps()} - {"avgpool7"} if vgg else {"gap", "logits", *comparison.maps()}
    found = model.taps(x, tuple(sorted(names)))
    if vgg:
        last = found["pool5"]
        found |= {"avgpool7": adaptive_avg_pool(last, 7), "gap": last.mean((1, 2))}
    for name in comparison.maps():
        comparison.map(name, found[name][0])
    for name in {"gap", "logits"} & reference.keys() & found.keys():
        comparison.array(name, found[name][0])
    return comparison.deviations


def netvlad_matlab(
    arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]
) -> dict[str, Deviation]:
    """The authors' NetVLAD; D K stands for channels x clusters."""
    comparison, steps = _netvlad("netvlad", arrays, image, reference)
    raw = np.asarray(steps["raw"]).T
    comparison.array("vlad_raw_DK", raw)
    comparison.array("vlad_intra_DK_rows0_64", np.asarray(steps["intra"]).T[:64], UNIT)
    comparison.array("vlad_final_d_K_k", steps["final"], VLAD)
    comparison.array("whiten_before_l2", steps["projected"])
    comparison.array("whiten_final", steps["whitened"], UNIT)
    return comparison.deviations


def netvlad_nanne(
    arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]
) -> dict[str, Deviation]:
    """pytorch-NetVlad with Patch-NetVLAD's whitening."""
    comparison, steps = _netvlad("netvlad-nanne", arrays, image, reference)
    comparison.array("vlad_raw_KD", steps["raw"])
    comparison.array("vlad_raw_row_norms", jnp.linalg.norm(steps["raw"], axis=1))
    comparison.array("vlad_intra_KD_rows0_8", steps["intra"][:8], UNIT)
    comparison.array("vlad_final_kD_d", steps["final"], VLAD)
    comparison.array("wpca_final", steps["whitened"], UNIT)
    return comparison.deviations


def _netvlad(
    name: str, arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]
) -> tuple[Comparison, dict[str, jnp.ndarray]]:
    """Compares the maps and the soft assignment, and gives what follows, without the batch."""
    model: Any = restore(name, arrays)
    comparison, x = Comparison(reference), model.preprocess(_floats(image))
    _input_crop(comparison, x)
    maps = model.backbone.taps(x, ("conv5_3", *comparison.maps()))
    for key in comparison.maps():
        comparison.map(key, maps[key][0])
    head, local = model.aggregation, normalise(maps["conv5_3"].reshape(1, -1, CHANNELS))
    share = head.soft_assignment(local)
    comparison.array("soft_assign_KN", share[0].T, UNIT)
    raw = head.residuals(local, share)
    final = head.flatten(raw)
    steps = {"raw": raw, "intra": normalise(raw), "final": final}
    steps |= {"projected": model.whitening.project(final), "whitened": model.whitening(final)}
    return comparison, {key: value[0] for key, value in steps.items()}
