"""The part of D2-Net, SuperPoint and ALIKE in `ebjax.models.check`: every array of their reference files.

A keypoint counts as found where one of ours lies within 0.02 px, one to one; ties at a threshold may cost a few.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.models import alike as alike_module
from ebjax.models import d2net as d2net_module
from ebjax.models.catalogue import restore
from ebjax.models.compare import Comparison, Deviation, Image, match_points
from ebjax.models.detect import Detections, read_descriptors
from ebjax.models.layers import relu
from ebjax.models.resize import resize
from ebjax.models.superpoint import CONVENTIONS, Convention, cell_from_pixel, detect_maps, keypoint_mask, score_map

UNIT = 1e-4  # for entries of unit vectors and probabilities
POSITION_PX = 0.02
UNMATCHED, UNMATCHED_RANKED = 0.005, 0.01
"""Share of keypoints without a partner; where only the strongest are kept, the last ranks differ by rounding."""
EVERY = 10**7


def _valid(found: Detections) -> Any:
    rows = np.asarray(found.valid)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], found)


class _Points:
    """Keypoints of a reference file and ours, one to one."""

    def __init__(self, comparison: Comparison, key: str, expected: np.ndarray, got: np.ndarray, unmatched: float):
        self.comparison = comparison
        self.query, self.row = match_points(expected, got, POSITION_PX).T
        lonely = 1 - len(self.row) / max(len(expected), len(got), 1)
        error = float(np.abs(expected[self.query] - got[self.row]).max(initial=0))
        comparison.record(key, error if lonely <= unmatched else np.inf, POSITION_PX)

    def scores(self, key: str, expected: np.ndarray, got: np.ndarray, tolerance: float) -> None:
        """Compares one number a keypoint."""
        error = np.abs(expected[self.query] - got[self.row]).max(initial=0)
        self.comparison.record(key, error, tolerance)

    def descriptors(self, key: str, index_key: str, *got: np.ndarray) -> None:
        """Compares the rows the file keeps; each may agree with any one of `got`."""
        partner = dict(zip(self.query.tolist(), self.row.tolist(), strict=True))
        index = self.comparison.reference[index_key].tolist()
        kept = [row for row, point in enumerate(index) if point in partner]
        self.comparison.record(index_key, 1 - len(kept) / max(len(index), 1), 0.1)
        expected = self.comparison.reference[key][kept]
        rows = [partner[index[row]] for row in kept]
        errors = [np.abs(expected - ours[rows]).max(1, initial=0) for ours in got]
        self.comparison.record(key, float(np.min(errors, 0).max(initial=0)), UNIT)


def _set(comparison: Comparison, key: str, got: np.ndarray) -> None:
    """Compares a set of integer rows."""
    expected, ours = (set(map(tuple, rows.tolist())) for rows in (comparison.reference[key], got))
    comparison.record(key, len(expected ^ ours) / max(len(expected), len(ours), 1), UNMATCHED)


def d2net(arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]) -> dict[str, Deviation]:
    """D2-Net's test form: the maps, the hard detections, and the keypoints at one and three scales."""
    model: Any = restore("d2net", arrays)
    comparison, rgb = Comparison(reference), jnp.asarray(image.rgb, jnp.float32) / 255
    x = d2net_module.preprocess(rgb[None])
    comparison.array("input_crop", np.moveaxis(np.asarray(x[0, :16, :16]), -1, 0))
    comparison.array("input_mean", x.mean((0, 1, 2), dtype=jnp.float32), 1e-3)
    layers = {"avgpool3": "pool3", "dense_relu": "relu4_3", "dense_norelu": "conv4_3"}
    maps = model.taps(x, [layers.get(name, name) for name in comparison.maps()])
    for name in comparison.maps():
        comparison.map(name, maps[layers.get(name, name)][0])
    model.final_relu, pyramid = False, {1.0: maps["conv4_3"][0]}
    for scale in set(d2net_module.SCALES) - {1.0}:
        level = d2net_module.level_size(image.grey.shape, scale)
        pyramid[scale] = model(resize(rgb, level)[None])[0]
    for kind, layer in (("relu", "relu4_3"), ("norelu", "conv4_3")):
        found, channel, _ = map(np.asarray, d2net_module.hard_detection(maps[layer][0]))
        rows, columns = np.nonzero(found)
        _set(comparison, f"detections_{kind}_cij", np.stack([channel[rows, columns], rows, columns], 1))
        for levels, scales in (("ss", (1.0,)), ("ms", d2net_module.SCALES)):
            dense = [relu(pyramid[scale]) if kind == "relu" else pyramid[scale] for scale in scales]
            ours = _valid(d2net_module.detect_maps(dense, image.grey.shape, scales, count=EVERY, offset="official"))
            key = f"{levels}_{kind}"
            both = reference[f"{key}_keypoints_ijs"], np.column_stack([ours.keypoints[:, ::-1], ours.scale])
            # Keypoints of different scales are no partners: set far apart.
            expected, got = (rows[:, :2].astype(np.float64) + 1e5 * rows[:, 2:] for rows in both)
            points = _Points(comparison, f"{key}_keypoints_ijs", expected, got, UNMATCHED)
            scores = reference[f"{key}_scores"]
            points.scores(f"{key}_scores", scores, ours.scores, 1e-4 * float(scores.max(initial=0)))
            points.descriptors(f"{key}_descriptors", f"{key}_desc_idx", ours.descriptors)
    return comparison.deviations


def superpoint(
    arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]
) -> dict[str, Deviation]:
    """SuperPoint v1 as Magic Leap's code (ml), SuperGlue's (sg) and hloc read it."""
    model: Any = restore("superpoint", arrays)
    comparison, grey = Comparison(reference), jnp.asarray(image.grey, jnp.float32)[..., None] / 255
    before = {"conv1a": grey[None]} | {f"conv{n}b": model.encode(grey[None], f"{n}a") for n in (3, 4)}
    maps = {name: getattr(model, f"layer{name[4:]}").conv(x) for name, x in before.items()}
    maps["convPa"] = model.layerPa.conv(model.encode(grey[None]))
    maps["semi"], maps["coarse_desc"] = model(grey[None])
    coarse = maps["coarse_desc"][0]
    for name in comparison.maps():
        comparison.map(name, maps[name][0], UNIT if name == "coarse_desc" else None)

    magic, glue = CONVENTIONS["magicleap"], CONVENTIONS["superglue"]
    heat, scores = (score_map(maps["semi"][0], way.epsilon) for way in (magic, glue))
    comparison.array("ml_heatmap_crop", heat[:64, :64], UNIT)
    comparison.array("ml_heatmap_rowmean", heat.mean(1), UNIT)
    comparison.array("ml_heatmap_colmean", heat.mean(0), UNIT)
    comparison.array("ml_heatmap_shape", np.array(heat.shape), 0.0)
    comparison.array("sg_scores_crop", scores[:64, :64], UNIT)
    comparison.array("sg_scores_shape", np.array(scores.shape), 0.0)
    everywhere = keypoint_mask(scores, dataclasses.replace(glue, border=0), image.grey.shape)
    _set(comparison, "sg_nms_nonzero_ij", np.argwhere(np.asarray(everywhere)))

    def detect(convention: Convention, count: int = EVERY) -> Any:
        return _valid(detect_maps(maps["semi"][0], coarse, image.grey.shape, convention, count=count))

    def read(keypoints: np.ndarray, sampling: str) -> np.ndarray:
        cells = cell_from_pixel(jnp.asarray(keypoints), sampling, coarse.shape[:2], image.grey.shape)
        return np.asarray(read_descriptors(coarse, cells))

    expected, ours = reference["ml_pts"].astype(np.float64), detect(magic)
    together = np.column_stack([ours.keypoints, ours.scores]).astype(np.float64)
    points = _Points(comparison, "ml_pts", expected[:, :2], together[:, :2], UNMATCHED)
    points.descriptors("ml_desc", "ml_desc_idx", ours.descriptors)
    points.descriptors("ml_desc_align_corners_true", "ml_desc_idx", read(ours.keypoints, "corners"))
    off = np.abs(expected[points.query, 2] - together[points.row, 2]).max(initial=0)
    if off > UNIT:  # positions and scores are one array
        comparison.record("ml_pts", np.inf, POSITION_PX)

    ours = detect(glue)
    points = _Points(comparison, "sg_keypoints", reference["sg_keypoints"], ours.keypoints, UNMATCHED)
    points.scores("sg_scores", reference["sg_scores"], ours.scores, UNIT)
    points.descriptors("sg_descriptors", "sg_desc_idx", ours.descriptors)
    points.descriptors("hloc_fix_sampling_descriptors", "sg_desc_idx", read(ours.keypoints, "exact"))
    ours = detect(dataclasses.replace(glue, radius=3), 200)
    key = "sg_r3_top200"
    points = _Points(comparison, f"{key}_keypoints", reference[f"{key}_keypoints"], ours.keypoints, UNMATCHED_RANKED)
    points.scores(f"{key}_scores", reference[f"{key}_scores"], ours.scores, UNIT)
    return comparison.deviations


def alike(arrays: Mapping[str, np.ndarray], image: Image, reference: Mapping[str, np.ndarray]) -> dict[str, Deviation]:
    """ALIKE: the maps, and keypoints by threshold and by rank."""
    model: Any = restore("alike", arrays)
    comparison, rgb = Comparison(reference), jnp.asarray(image.rgb, jnp.float32) / 255
    blocks = model.blocks(rgb[None])
    maps = {f"block{n}": x for n, x in enumerate(blocks, 1)} | {"head": model.head(blocks)}
    scores, maps["descriptor_map"] = model(rgb[None])
    for name in comparison.maps():
        comparison.map(name, maps[name][0], UNIT if name == "descriptor_map" else None)
    score = scores[0]
    comparison.array("score_map_sub2", score[::2, ::2], UNIT)
    comparison.array("score_map_rowmean", score.mean(1), UNIT)
    comparison.array("score_map_colmean", score.mean(0), UNIT)
    comparison.array("score_map_bottomright32", score[-32:, -32:], UNIT)
    settings: dict[str, dict[str, Any]] = {
        "thr0.2_sub": {"threshold": 0.2},
        "thr0.2_int": {"threshold": 0.2, "sub_pixel": False},
        "top300_sub": {"threshold": 0.0, "count": 300},
    }
    for key, setting in settings.items():
        ours = _valid(alike_module.detect(model, rgb, **setting))
        unmatched = UNMATCHED_RANKED if "count" in setting else UNMATCHED
        points = _Points(comparison, f"{key}_keypoints", reference[f"{key}_keypoints"], ours.keypoints, unmatched)
        points.scores(f"{key}_scores", reference[f"{key}_scores"], ours.scores, UNIT)
        steps = [(0, 0)] if setting.get("sub_pixel", True) else [(0, 0), (0, 1), (1, 0), (1, 1)]
        x, y = np.rint(ours.keypoints).astype(int).T
        dense = np.asarray(maps["descriptor_map"][0])
        # Which pixel the published code reads there is a matter of its rounding.
        read = [dense[y - dy, x - dx] for dx, dy in steps] if len(steps) > 1 else [ours.descriptors]
        points.descriptors(f"{key}_descriptors", f"{key}_desc_idx", *read)
    return comparison.deviations
