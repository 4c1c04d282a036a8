"""Finds images of the same floor among others, from either side."""

import csv
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from ebjax.command import dump_config, progress, run
from ebjax.geometry.camera import camera_from
from ebjax.geometry.warp import Taps
from ebjax.io.atomic import whole_file
from ebjax.io.cache import Cache, content_key, digest, open_cache
from ebjax.io.image_folder import list_images, read_truth
from ebjax.io.image_sizes import orientation_notes, sizes_of
from ebjax.io.images import BrokenFrame, read_fitting
from ebjax.io.logs.camera import camera_in
from ebjax.io.logs.mount_options import MountOptions
from ebjax.models.fast import Arithmetic
from ebjax.places.descriptor import Descriptor, descriptor
from ebjax.places.recall import recall_at
from ebjax.places.search import SHORTLIST, check_ranking, search
from ebjax.views.floor_view import floor_view
from ebjax.views.look import camera_view, quad_view, whole_image

Quad = tuple[float, float, float, float, float, float, float, float]
COLUMNS = ("query", "rank", "name", "direction", "distance")


@dataclass(frozen=True)
class PlacesConfig:
    """Ranks the images of one folder for every image of another, seen from the same or the opposite side.

    Say how to look at the floor: --camera, --quad or --raw. Components and vocabulary are learned from all the images.
    """

    database: tyro.conf.Positional[Path]
    """Folder of reference images."""
    queries: tyro.conf.Positional[Path]
    """Folder of query images; the same folder again compares every image with all others."""
    out: Path = Path("runs/places")
    """Folder for ranked.csv."""
    camera: Path | None = None
    """camera.json or any other calibration that is read; the floor view follows from it."""
    mount: MountOptions = field(default_factory=MountOptions)
    quad: Quad | None = None
    """Four image points of a rectangle on the floor, px: far left, far right, near right, near left (x y each)."""
    quad_margin: float = 0.5
    """How far the floor view reaches beyond the quad, as a share of its sides."""
    raw: bool = False
    """Compare whole images, resized, not floor views."""
    metres_per_px: float = 0.01
    """Of the floor view of --camera, m."""
    opposing: Literal["both", "only", "none"] = "both"
    """Look for places seen from the same and the opposite side, from the opposite side only, or from the same only."""
    descriptor: str = "floornet"
    """Global descriptor: floornet, rootsift-vlad, hog, joint (floor and whole image), or of a network whose weights are
    not ours netvlad, superpoint, resnet50 or vgg19 (flattened map), resnet50-pooled, vgg19-pooled; or your own,
    package.module:NAME, whose code is then run."""
    weights: Path | None = None
    """Of a network: its .safetensors file, or a folder of them; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    arithmetic: Arithmetic = "exact"
    """Of a network: float32 convolutions, the same by Winograd's algorithm (equal to rounding), or in part bfloat16."""
    ranking: Literal["auto", "correlation", "cosine"] = "auto"
    """The paper's cosine of global descriptors, or shift-maximised correlation of maps (the default of floornet and
    rootsift-vlad; the others have none)."""
    top: int = 20
    """Candidates written for each query."""
    truth: Path | None = None
    """JSON object: number of a query -> list of the numbers of accepted references, counted from 0 in natural order."""
    seed: int = 0
    """Of the vocabulary."""
    cache: Path | None = None
    """Folder where what is kept of every image stays for the next run; None: nowhere."""


class Looker:
    """Turns images into what a descriptor keeps of their floor views; fixed by the first readable image's size."""

    def __init__(self, config: PlacesConfig, chosen: Descriptor):
        """Raises ValueError unless exactly one way to look at the floor is given."""
        ways = (config.camera is not None) + (config.quad is not None) + config.raw
        if ways != 1:
            raise ValueError(f"{ways} of --camera, --quad and --raw are given; give one")
        self.config, self.descriptor = config, chosen
        self._look = jax.jit(chosen.look) if chosen.jitted else chosen.look
        self.size: tuple[int, int] | None = None
        self.cache: Cache | None = None
        self.samples: Taps | None = None
        self.seen = jnp.zeros((0, 0), bool)

    def look(self, path: Path) -> dict[str, np.ndarray]:
        """What is kept of an image's view.

        Raises:
          BrokenFrame: the image cannot be read.
          ValueError: it has another size than the camera or the first image.
        """
        if self.samples is None:
            self._prepare(sizes_of(path))
            assert self.size is not None
            for note in orientation_notes(path, self.size):
                print(note)
        if self.cache is None:
            return self._describe(path)
        return dict(self.cache.recall(content_key(path), lambda: self._describe(path)))

    def _describe(self, path: Path) -> dict[str, np.ndarray]:
        image = read_fitting(path, self.size)
        size = image.shape[1], image.shape[0]
        if size != self.size and not self.config.raw:
            assert self.size is not None
            raise ValueError(
                f"{path}: {size[0]}x{size[1]} pixels, but the first image has {self.size[0]}x{self.size[1]}; "
                "give images of one camera at its full size"
            )
        samples = self.samples if size == self.size else whole_image(size, self.seen.shape)
        view = _view(image, samples)
        return jax.tree.map(np.asarray, dict(self._look(view, self.seen, image)))

    def _prepare(self, sizes: tuple[tuple[int, int], ...]) -> None:
        self._choose_view(sizes)
        if self.config.cache is not None:
            assert self.samples is not None
            arrays = (np.asarray(leaf) for leaf in (*jax.tree.leaves(self.samples), self.seen))
            self.cache = open_cache(
                self.config.cache,
                self.config.descriptor,
                self.descriptor.weights,
                arithmetic=self.config.arithmetic,
                view=digest(*arrays),
                side_px=self.descriptor.side_px,
            )

    def _choose_view(self, sizes: tuple[tuple[int, int], ...]) -> None:
        side, size = self.descriptor.side_px, sizes[0]
        if self.config.raw:
            scale = side / max(size)
            self.seen = jnp.ones((round(size[1] * scale), round(size[0] * scale)), bool)
            self.size, self.samples = size, whole_image(size, self.seen.shape)
        elif self.config.camera is not None:
            file = camera_in(self.config.camera, sizes, self.config.mount)
            self.size = file.width, file.height
            try:
                self.samples, self.seen = camera_view(camera_from(file), self.config.metres_per_px)
            except ValueError as fault:
                raise ValueError(f"{self.config.camera}: {fault}") from None
        else:
            quad = np.array(self.config.quad, np.float64).reshape(4, 2)
            self.size, (self.samples, self.seen) = size, quad_view(size, quad, self.config.quad_margin, side)


_view = jax.jit(floor_view)


def _stack(kept: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Views as rows of one array a name."""
    return {name: np.stack([one[name] for one in kept]) for name in kept[0]}


def look_at_all(
    paths: list[Path], looker: Looker, label: str
) -> tuple[list[dict[str, np.ndarray]], list[int], list[str]]:
    """What is kept of the readable images, their numbers, and what is wrong with the others.

    Raises:
      ValueError: none is readable.
    """
    kept, numbers, broken = [], [], []
    try:
        for number, path in enumerate(progress(paths, len(paths), label)):
            try:
                kept.append(looker.look(path))
            except BrokenFrame as fault:
                broken.append(" ".join(str(fault).split()))
                continue
            numbers.append(number)
    finally:
        if looker.cache is not None:
            looker.cache.flush()
    if not kept:
        raise ValueError(f"{paths[0].parent}: none of {len(paths)} images can be read ({broken[0]})")
    return kept, numbers, broken


def main(config: PlacesConfig) -> None:
    """Reads, ranks, writes ranked.csv and prints R@1 and R@5 if the truth is given."""
    if config.top < 1:
        raise ValueError(f"--top is {config.top}; give a number of candidates, 1 or more")
    if config.raw and config.descriptor == "joint":
        raise ValueError("--descriptor joint needs a floor beside the whole image: give --camera or --quad, not --raw")
    chosen = descriptor(config.descriptor, config.weights, config.arithmetic)
    check_ranking(config.ranking, chosen.has_maps)
    looker = Looker(config, chosen)
    names = [list_images(config.database)]
    same_folder = config.database.resolve() == config.queries.resolve()
    names.append(names[0] if same_folder else list_images(config.queries))
    truth = read_truth(config.truth, len(names[1]), len(names[0])) if config.truth is not None else None
    kept, numbers, broken = look_at_all(names[0], looker, "database")
    asked = numbers
    if not same_folder:
        ours, asked, more = look_at_all(names[1], looker, "queries")
        kept, broken = kept + ours, broken + more
    for fault in broken:
        print(f"skipped: {fault}", file=sys.stderr)

    rows = np.arange(len(kept) - len(asked), len(kept))
    allowed = np.zeros((len(rows), len(kept), 2), bool)
    allowed[:, : len(numbers)] = np.array([config.opposing != "only", config.opposing != "none"])[None, None, :]
    if same_folder:
        allowed[np.arange(len(rows)), rows] = False
    places = chosen.unite(_stack(kept), seed=config.seed)
    top = max(SHORTLIST, config.top)
    found = search(places, jnp.asarray(allowed), ranking=config.ranking, queries=rows, top=top)
    found = jax.tree.map(np.asarray, found)
    ranked: list[list[int]] = [[] for _ in names[1]]
    with whole_file(config.out / "ranked.csv") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for row, query in enumerate(asked):
            for rank in range(min(config.top, int(found.valid[row].sum()))):
                reference = numbers[found.j[row, rank]]
                ranked[query].append(reference)
                direction = "opposing" if found.opposing[row, rank] else "same"
                name, distance = names[0][reference].name, float(found.distance[row, rank])
                table.writerow((names[1][query].name, rank + 1, name, direction, f"{distance:.6f}"))
    dump_config(config, config.out / "config.yaml")
    written = config.out / "ranked.csv"
    print(f"{len(asked)} queries, {len(numbers)} references, {len(broken)} images skipped: {written}")
    if truth is not None:
        recalls = [(k, *recall_at(ranked, truth, k)) for k in (1, 5)]
        shown = "  ".join(f"R@{k} {math.nan if share is None else 100 * share:.1f} %" for k, share, _ in recalls)
        print(f"{shown}  of {recalls[0][2]} queries with an accepted reference (skipped ones count as not found)")


if __name__ == "__main__":
    run(main, PlacesConfig)
