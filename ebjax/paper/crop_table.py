"""`python -m ebjax.paper crops`: the ranking of descriptors on real floors beside that on synthetic ones."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from scipy.stats import kendalltau

import ebjax
from ebjax.features.extractor import EXTRACTORS, usable
from ebjax.features.pair import look, quad_view
from ebjax.io.atomic import whole_file
from ebjax.io.image_folder import list_images
from ebjax.io.images import read_image
from ebjax.io.pairs import read_pairs
from ebjax.paper import crops, page
from ebjax.paper.cells import Cells, weighed
from ebjax.paper.crop_source import Source
from ebjax.paper.retrieval import FLOOR, TURNED
from ebjax.places.descriptor import DESCRIPTORS, Descriptor, descriptor
from ebjax.places.search import rankings

Photographs = Mapping[str, UInt8[np.ndarray, "_ _ 3"]]

TOP_VIEW_PX = 400
REAL, SYNTHETIC = "real", "synthetic"


def read_photographs(folders: Sequence[Path], only: str) -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """Images of floors by name; of a folder of facing pairs (`gt.json`) the first image of each, from above.

    Raises:
      ValueError: a folder without images, or without any that matches.
      OSError: a folder or an image cannot be read.
    """
    found: dict[str, UInt8[np.ndarray, "_ _ 3"]] = {}
    for folder in folders:
        if any(folder.glob("*/gt.json")):
            for pair in read_pairs(folder):
                view, _ = look(read_image(pair.a), quad_view(pair.quad, TOP_VIEW_PX, 0.0))
                found[f"{folder.name}/{pair.name}"] = np.asarray(np.rint(255 * np.asarray(view)), np.uint8)
            continue
        paths = [path for path in list_images(folder) if path.match(only)]
        if not paths:
            raise ValueError(f"{folder}: no image matches {only!r}; change --only")
        found |= {f"{folder.name}/{path.stem}": read_image(path) for path in paths}
    return found


def methods(weights: Path | None) -> tuple[dict[str, tuple[Descriptor, str]], dict[str, str]]:
    """Label -> descriptor and ranking of what can be used, and why the others cannot. `joint` needs a whole image."""
    found = {name: (chosen, "cosine") for name, chosen in crops.BASELINES.items()}
    absent = {}
    for name in DESCRIPTORS:
        if name == "joint":
            continue
        try:
            chosen = descriptor(name, weights)
        except ValueError as fault:
            absent[name] = page.reason(fault)
            continue
        ways = rankings(chosen.has_maps)
        found |= {f"{name}, {way}" if len(ways) > 1 else name: (chosen, way) for way in ways}
    return found, absent


def make(
    folders: Sequence[Path],
    out: Path,
    only: str,
    most: int,
    weights: Path | None,
    seed: int,
    *,
    pairs: int,
    side_by_side: bool,
) -> list[str]:
    """Measures both, writes crops.md, crops.json and pictures; see `ebjax.paper.__main__.CropsConfig`.

    Returns:
      the lines of the table, Kendall's tau among them.
    """
    if most < 2:
        raise ValueError(f"--crops is {most}; give at least 2")
    if pairs < 1:
        raise ValueError(f"--pairs is {pairs}; give at least 1")
    used, absent = methods(weights)
    extractors, without = usable(list(EXTRACTORS), weights)
    cells = Cells(out / "cells")
    floors = {REAL: read_photographs(folders, only)}
    if side_by_side:
        from ebjax.paper.strips import strips

        floors[SYNTHETIC] = strips(seed)
    tables: dict[str, dict[str, dict[str, float]]] = {}
    features: dict[str, dict[str, dict[str, Any]]] = {}
    lines, pictures = [], []
    for name, photographs in floors.items():
        source = Source(photographs, most, seed=seed)
        settings = {"ebjax": ebjax.__version__, **source.settings}
        tables[name], features[name] = {}, {}
        for label, (described, ranking) in used.items():
            tables[name][label] = cells.values(
                f"crops {name} {label}",
                settings | weighed(described.weights),
                partial(source.recall, described, ranking),
            )
        for which, chosen in extractors.items():
            features[name][which] = cells.values(
                f"pairs {name} {which}",
                settings | weighed(chosen.weights) | {"pairs": pairs},
                partial(source.match, chosen, pairs),
            )
        pictures.append(cells.picture(out / f"crops_{name}.png", settings, source.examples))
        lines.append(f"{name}: {len(source.cut)} crops of {len(photographs)} floors.")
    head = ["R@1, %", *(f"{source}, {seen_as}" for source in tables for seen_as in (FLOOR, TURNED))]
    rows = {
        label: [page.percent(tables[source][label][seen_as]) for source in tables for seen_as in (FLOOR, TURNED)]
        for label in used
    }
    lines += ["", *page.markdown_table(head, rows)]
    result: dict[str, Any] = {"tables": tables, "features": features, "left_out": absent}
    result["settings"] = _settings(seed, most, only)
    if side_by_side:
        tau = kendalltau(*(crops.spread(tables[source], TURNED) for source in (REAL, SYNTHETIC)))
        result["kendall_tau"] = {"tau": float(tau.statistic), "p": float(tau.pvalue), "methods": len(used)}
        lines.append(f"Kendall tau of the two rankings, {TURNED}, {len(used)} methods: {tau.statistic:.3f}")
        lines.append(f"(p {tau.pvalue:.3f} for rankings that have nothing to do with each other).")
    head = ["local features: inliers / matches, right motions", *features]
    matched = {which: [_matched(features[source][which]) for source in features] for which in extractors}
    lines += ["", *page.markdown_table(head, matched)]
    left_out = dict.fromkeys([*absent.values(), *map(page.reason, without.values())])
    lines += ["", *(f"Left out: {why}" for why in left_out)]
    shown = [f"![{path.stem}]({path.name})" for path in pictures]
    with whole_file(out / "crops.md") as file:
        file.write("\n".join(["# Retrieval among crops of floors", "", *lines, "", *shown, ""]))
    with whole_file(out / "crops.json") as file:
        json.dump(result, file, indent=1, allow_nan=False)
    return lines


def _matched(row: Mapping[str, Any]) -> str:
    return f"{row['inliers']:.0f} / {row['total']:.0f}, {row['right']} of {row['pairs']}"


def _settings(seed: int, most: int, only: str) -> dict[str, Any]:
    names = ("SIDE_PX", "STRIDE_PX", "SHORTLIST", "ROTATION_DEG", "SCALE", "SHIFT", "PERSPECTIVE")
    light = ("GAMMA", "GAIN", "SHADOW", "GLARE", "NOISE")
    return {"seed": seed, "crops": most, "only": only, **{n.lower(): getattr(crops, n) for n in (*names, *light)}}
