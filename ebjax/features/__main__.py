"""Matches two images of one floor and finds the motion between them."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import tyro

from ebjax.command import progress, run
from ebjax.features.contradict import contradictions
from ebjax.features.equivariance import middle, stand_in, through_turn
from ebjax.features.extractor import EXTRACTORS, Extractor, extractor, usable
from ebjax.features.fewer import strongest_only
from ebjax.features.pair import Comparison, PlaneView, checked_quad, metric_view, quad_view, raw_view
from ebjax.features.record import FLOOR, RAW, TURNED, conventions, describe, matched_points, measure, summary
from ebjax.features.remember import remembered
from ebjax.features.table import Pair, as_json, compare_inputs, compare_pairs, markdown
from ebjax.geometry.camera import Camera, FloorView, camera_from
from ebjax.io.atomic import whole_file, whole_folder
from ebjax.io.cache import open_cache
from ebjax.io.depth_images import read_depths
from ebjax.io.image_sizes import orientation_notes, sizes_of
from ebjax.io.images import read_both, read_image
from ebjax.io.logs.camera import camera_in
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.pairs import read_pairs
from ebjax.models.d2net import OFFSETS
from ebjax.models.fast import Arithmetic
from ebjax.parts import OWN, is_own
from ebjax.views.run_view import choose_floor
from ebjax.viz import figures


@dataclass(frozen=True)
class Config:
    """Matches two images of one floor, raw, seen from above, and seen from above with the second turned by pi."""

    a: tyro.conf.Positional[Path]
    """The first image, JPEG or PNG."""
    b: tyro.conf.Positional[Path]
    """The second, by the same camera."""
    out: Path
    """Folder for matches.png, matches.csv and transform.json."""
    camera: Path | None = None
    """camera.json or any other calibration that is read: makes the floor view metric."""
    mount: MountOptions = field(default_factory=MountOptions)
    quad: tuple[float, float, float, float, float, float, float, float] | None = None
    """Four points of the floor, x y px each: far left, far right, near right, near left."""
    extractor: Literal[
        "floornet", "rootsift", "sift", "orb", "surf", "superpoint", "d2net", "alike", "aliked", "xfeat", "all"
    ] = "floornet"
    """Local feature; all compares those that can be used here and keeps what most matches agree on."""
    weights: Path | None = None
    """Of a network: its .safetensors file, or a folder of them; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    arithmetic: Arithmetic = "exact"
    """Of a network: float32 convolutions, the same by Winograd's algorithm (equal to rounding), or in part bfloat16."""
    model: Literal["auto", "rigid", "similarity", "homography"] = "auto"
    """Motion on the floor; auto: rigid with --camera, else homography, for a hand-picked quad is no exact rectangle."""
    size: int = 400
    """Side of the floor view, px."""
    margin: float = 0.5
    """How far the view reaches beyond the quad on every side, as a share of its side."""
    tolerance: float = 0.01
    """Largest error of an inlier, as a share of the view's side."""
    depth_a: Path | None = None
    """Depth of A, 16-bit PNG: a_from_b is measured from 3D points too."""
    depth_b: Path | None = None
    """Depth of B."""
    seed: int = 0
    """Of RANSAC."""
    cache: Path | None = None
    """Folder where the features of every view stay for the next run; None: nowhere."""


@dataclass(frozen=True)
class TableConfig:
    """Compares the local features on pairs of known motion, as table 3 of the paper does; prints Markdown tables."""

    pairs: tyro.conf.Positional[Path]
    """Folder of folders, one a pair: a.png, b.png and gt.json with "quad" (as --quad, four points) and "H_a_to_b". With
    "rms_px" too, px of a 400 px view that the truth fits its points to, a motion is right within twice that, else 3 px.
    """
    out: Path
    """Folder for table.md and table.json."""
    extractors: tuple[str, ...] = tuple(EXTRACTORS)
    """Which local features, your own too (package.module:NAME, whose code is then run); one that cannot be used here is
    left out, and why is said."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    arithmetic: Arithmetic = "exact"
    """Of a network: float32 convolutions, the same by Winograd's algorithm (equal to rounding), or in part bfloat16."""
    keypoints: int | None = None
    """Hold every local feature to its so many strongest keypoints a view; None: each as many as it gives."""
    seed: int = 0
    """Of RANSAC."""
    cache: Path | None = None
    """Folder where the features of every view stay for the next run (the times are then of reading); None: nowhere."""


@dataclass(frozen=True)
class TurnConfig:
    """Draws how far D2-Net's keypoints move when the image is turned by pi, with the exact and the official offset."""

    image: tyro.conf.Positional[Path]
    """JPEG or PNG; its middle is looked at, at most 480 px a side."""
    out: Path
    """The figure, PNG."""
    seed: int = 0
    """Of the stand-in weights: which they are does not matter, see ebjax/features/equivariance.py."""


def check(config: Config) -> None:
    """Checks what needs no file.

    Raises:
      ValueError: names the option and the remedy.
    """
    if not 50 <= config.size <= 2000:
        raise ValueError(f"--size is {config.size}; give 50 to 2000 px")
    if not 0 <= config.margin <= 2:
        raise ValueError(f"--margin is {config.margin:g}; give 0 to 2")
    if not 0 < config.tolerance <= 0.1:
        raise ValueError(f"--tolerance is {config.tolerance:g}; give a share of the view's side, above 0, at most 0.1")
    if (config.depth_a is None) != (config.depth_b is None):
        raise ValueError("--depth-a and --depth-b go together; give both or neither")
    if config.depth_a is not None and config.camera is None:
        raise ValueError("--depth-a needs --camera: its intrinsics turn depth into points")
    if config.model == "rigid" and config.camera is None:
        raise ValueError("--model rigid needs --camera: without it the view has no scale; use similarity or homography")


def main(config: Config) -> None:
    """Reads, matches, prints the table, writes."""
    check(config)
    camera_file = None if config.camera is None else camera_in(config.camera, sizes_of(config.a), config.mount)
    size = None if camera_file is None else (camera_file.width, camera_file.height)
    image_a, image_b = read_both(config.a, config.b, size)
    height, width = image_a.shape[:2]
    print("".join(f"{note}\n" for note in orientation_notes(config.a, (width, height))), end="")
    quad = None if config.quad is None else checked_quad(config.quad, width, height)
    depths = None
    if config.depth_a is not None and config.depth_b is not None and camera_file is not None:
        depths = read_depths(config.depth_a, config.depth_b, camera_file)

    camera = None if camera_file is None else camera_from(camera_file)
    views = make_views(config, camera, quad, width, height)
    if config.extractor == "all":
        extractors, absent = usable(tuple(EXTRACTORS), config.weights, config.arithmetic)
    else:
        extractors, absent = {config.extractor: extractor(config.extractor, config.weights, config.arithmetic)}, {}
    records, comparisons = [], []
    print(f"{'':10}" + "".join(f"{name:>16}" for name in (RAW, FLOOR, TURNED) if name == RAW or FLOOR in views))
    for name, chosen in caching(config.cache, extractors, config.arithmetic).items():
        row = f"{name:10}"
        how: dict[str, Any] = {"model": config.model, "tolerance": config.tolerance, "seed": config.seed}
        found = list(compare_inputs(chosen, views, image_a, image_b, **how))
        denied = contradictions({kind: comparison for kind, comparison, _ in found}, views)
        for kind, comparison, model in found:
            view = views[RAW if kind == RAW else FLOOR]
            comparisons.append(comparison)
            records.append(describe(name, kind, model, comparison, view, config.size, denied.get(kind)))
            if camera is not None and kind != RAW and records[-1]["believed"]:
                records[-1] |= measure(comparison, camera, depths)
            mark = " !" if kind in denied else " *" if comparison.believed else "  "
            row += f"{f'{comparison.inliers} / {comparison.total}':>14}" + mark
        print(row.rstrip())
    print("inliers / matches; * more than chance would show")
    if any(record["contradicts"] for record in records):
        print("! more than chance too, but the floor view that most matches agree on puts the floor elsewhere")
    for reason in absent.values():
        print(f"left out: {reason}")
    if FLOOR not in views:
        print("floor views need --camera or --quad")
    best = max(range(len(records)), key=lambda k: rank(records[k]))
    print("\n".join(summary(records[best])))
    result = {
        "a": str(config.a),
        "b": str(config.b),
        "image_size": [width, height],
        "view": conventions(config.size, config.margin, views.get(FLOOR), quad),
        "best": best,
        "results": records,
    }
    write(config.out, result, comparisons[best], records[best], (image_a, image_b))


def rank(record: dict[str, Any]) -> tuple[bool, bool, int]:
    """The largest is the line that is kept: of those believed, one that sees the floor."""
    return record["believed"], record["input"] != RAW, record["inliers"]


def caching(folder: Path | None, found: dict[str, Extractor], arithmetic: Arithmetic) -> dict[str, Extractor]:
    """The extractors; with a folder, they look there first for a view that they know."""
    if folder is None:
        return found
    kept = {}
    for name, chosen in found.items():
        cache = open_cache(folder, name, chosen.weights, arithmetic=arithmetic, shard_s=0)
        kept[name] = remembered(chosen, cache.remember)
    return kept


def make_views(
    config: Config, camera: Camera | None, quad: np.ndarray | None, width: int, height: int
) -> dict[str, PlaneView]:
    """The raw view and, where the floor is known, the floor view: the quad's, or the floor ahead of the camera."""
    views = {RAW: raw_view(width, height)}
    if quad is not None:
        views[FLOOR] = quad_view(quad, config.size, config.margin, camera)
    elif camera is not None:
        try:
            floor = choose_floor(camera, 0.01)
        except ValueError as error:
            raise ValueError(f"{config.camera}: {error}") from None
        scale = (floor.x_max - floor.x_min) / config.size
        views[FLOOR] = metric_view(camera, FloorView(floor.x_min, floor.x_max, floor.y_min, floor.y_max, scale))
    return views


def write(
    out: Path, result: dict[str, Any], found: Comparison, record: dict[str, Any], images: tuple[np.ndarray, np.ndarray]
) -> None:
    """Writes the three files, all or none."""
    points_a, points_b, inliers = matched_points(found)
    turned = record["input"] == TURNED
    title = f"{record['extractor']}, {record['input']}: {record['inliers']} of {record['total']} matches agree"
    if turned:
        title += "; the second image is turned by pi"
    picture = figures.matches(*images, points_a, points_b, inliers, turn_second=turned, title=title)
    with whole_folder(out) as folder:
        (folder / "matches.png").write_bytes(picture)
        rows = np.column_stack([points_a, points_b, inliers])
        head = "x_a,y_a,x_b,y_b,inlier"
        np.savetxt(folder / "matches.csv", rows, ["%.3f"] * 4 + ["%d"], ",", header=head, comments="")
        text = json.dumps(result, indent=1, allow_nan=False)
        (folder / "transform.json").write_text(text + "\n", encoding="utf-8")
    print(f"wrote {out}")


def table(config: TableConfig) -> None:
    """Reads, compares, prints, writes."""
    if unknown := [name for name in config.extractors if name not in EXTRACTORS and not is_own(name)]:
        raise ValueError(f"extractor {unknown[0]!r} is unknown; choose of {', '.join(EXTRACTORS)}, or {OWN}")
    if config.keypoints is not None and config.keypoints < 4:
        raise ValueError(f"--keypoints is {config.keypoints}; give at least 4, or leave it out")
    pairs = [Pair(f.name, *read_both(f.a, f.b), f.quad, f.b_from_a, f.truth_px) for f in read_pairs(config.pairs)]
    found, absent = usable(config.extractors, config.weights, config.arithmetic)
    if not found:
        raise ValueError(next(iter(absent.values())))
    weights_mb = {name: one.weights.stat().st_size / 1e6 for name, one in found.items() if one.weights is not None}
    found = caching(config.cache, found, config.arithmetic)
    if config.keypoints is not None:
        found = {name: strongest_only(one, config.keypoints) for name, one in found.items()}
    shown = progress(found.items(), len(found), "Comparing")
    rows = {name: compare_pairs(chosen, pairs, seed=config.seed) for name, chosen in shown}
    lines = [*markdown(rows, weights_mb), "", *(f"Left out: {reason}" for reason in absent.values())]
    print("\n".join(lines))
    with whole_folder(config.out) as folder:
        (folder / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
        text = as_json(rows, left_out=absent, seed=config.seed, keypoints=config.keypoints)
        (folder / "table.json").write_text(text, encoding="utf-8")
    print(f"wrote {config.out}")


def turn(config: TurnConfig) -> None:
    """Reads, detects, draws."""
    image = middle(read_image(config.image))
    if min(image.shape[:2]) < 32:
        raise ValueError(f"{config.image}: {image.shape[1]}x{image.shape[0]} pixels; give at least 32 a side")
    network = stand_in(config.seed)
    # In float64: where a wall is all but white, float32 leaves nothing but its rounding to detect.
    rgb = jnp.asarray(image, jnp.float64) / 255
    read = {f"{offset} offset": through_turn(network, rgb, offset) for offset in OFFSETS}
    for name, (here, there) in read.items():
        apart = np.abs(there - here)
        print(f"{name:16} {len(here)} keypoints, moved {apart.mean():.3f} px an axis, at most {apart.max():.3f} px")
    title = "D2-Net keypoints, joined with the same read through a turn by pi"
    with whole_file(config.out, "wb") as file:
        file.write(figures.through_turn(image, read, title=title))
    print(f"wrote {config.out}")


COMMANDS: dict[str, tuple[Callable[[Any], None], type]] = {
    "table": (table, TableConfig),
    "turn": (turn, TurnConfig),
}


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in COMMANDS:
        run(*COMMANDS[sys.argv[1]], sys.argv[2:])
    else:
        run(main, Config)
