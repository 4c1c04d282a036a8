"""Every reader with its seeds: what is called with a path, as the commands call it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from .mutate import Input

Step = Callable[[], Any]


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
      seeds: makes its seeds, as "module:function" with arguments.
      steps: gives the calls to make with a path, one after the other; each may raise ValueError or OSError.
      needs_jax: whether its process has JAX.
    """

    seeds: tuple[str, ...]
    steps: Callable[[Path], Sequence[Step]]
    needs_jax: bool = False

    def inputs(self) -> list[Input]:
        """Makes the seeds."""
        module, _, name = self.seeds[0].partition(":")
        return getattr(import_module(f".{module}", __package__), name)(*self.seeds[1:])


@dataclass(frozen=True)
class Inner:
    """A part of a config."""

    low: float = 0.0
    high: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True)
class Config:
    """Fields of every kind that configs have."""

    steps: int = 1
    rate: float | None = None
    name: str = ""
    sizes: list[int] = field(default_factory=list)
    inner: Inner = field(default_factory=Inner)
    way: Literal["fast", "slow"] = "fast"
    path: Path | None = None
    flag: bool = False


def _trajectory(path: Path) -> list[Step]:
    from ebjax.io.trajectory import read

    return [lambda: read(path)]


def _graph(path: Path) -> list[Step]:
    from ebjax.posegraph.g2o import read_g2o

    return [lambda: read_g2o(path)]


def _calibration(path: Path) -> list[Step]:
    from ebjax.io.calibration.depth_scale import depth_scale_in
    from ebjax.io.calibration.duckietown import read_duckietown, read_floor_homography
    from ebjax.io.calibration.mount_file import read_mount
    from ebjax.io.calibration.read import read_calibration
    from ebjax.io.camera_file import read_camera

    return [
        lambda: read_calibration(path),
        lambda: read_calibration(path, camera="1", size=(640, 480)).scaled(320, 240),
        lambda: read_camera(path),
        lambda: depth_scale_in(path),
        lambda: read_floor_homography(path),
        lambda: read_duckietown(path, path),
        lambda: read_mount(path, None),
        lambda: read_mount(path, path),
    ]


def _image(path: Path) -> list[Step]:
    from ebjax.io.depth_images import read_depth
    from ebjax.io.image_header import read_header
    from ebjax.io.images import read_image
    from ebjax.io.mask import alpha_mask, read_mask

    return [
        lambda: read_image(path),
        lambda: read_depth(path, 1000.0),
        lambda: read_mask(path, (32, 24)),
        lambda: alpha_mask([path], (32, 24)),
        lambda: read_header(path),
    ]


def _payload(path: Path) -> list[Step]:
    from ebjax.io.logs.ros_depth import depth_from
    from ebjax.io.logs.ros_message import COMPRESSED, Header, Image
    from ebjax.io.logs.rtabmap_depth import depth_from_bytes

    layout = f"{path.stem[4:]}; compressedDepth {path.suffix[1:]}"

    def of_message() -> None:
        try:
            depth_from(Image(Header(0, ""), 0, 0, layout, False, 0, memoryview(path.read_bytes())), COMPRESSED)
        except ValueError as error:  # the caller knows which message
            raise ValueError(f"{path}: {error}") from error

    return [lambda: depth_from_bytes(str(path), path.read_bytes()), of_message]


def _checkpoint(path: Path) -> list[Step]:
    from ebjax.models.checkpoint import read_checkpoint
    from ebjax.models.weights import load_weights

    return [lambda: read_checkpoint(path), lambda: load_weights(path)]


def _config(path: Path) -> list[Step]:
    from ebjax.config import load_config

    return [lambda: load_config(path, Config)]


def _truth(path: Path) -> list[Step]:
    from ebjax.io.image_folder import read_truth

    return [lambda: read_truth(path, 5, 5)]


def _pairs(path: Path) -> list[Step]:
    from ebjax.io.images import read_both
    from ebjax.io.pairs import read_pairs

    return [lambda: [read_both(pair.a, pair.b) for pair in read_pairs(path)]]


def _cache(path: Path) -> list[Step]:
    from ebjax.io.cache import Cache

    def recalled() -> None:
        cache = Cache(path, "model", {"size": 3})
        for key in ("one", "two"):
            cache.recall(key, dict)
        cache.flush()

    return [recalled]


def _run_folder(path: Path) -> list[Step]:
    from ebjax.evaluation.nees_tables import read_measurements
    from ebjax.viz.run_errors import frames_and_truth, scale_sigma

    def tables() -> None:
        times = frames_and_truth(path, str(path / "groundtruth.txt"), 0.02)[0]
        read_measurements(path / "steps.csv", "used", times, ("gap", "kind"))
        read_measurements(path / "loop_closures.csv", "kept", times)

    return [tables, lambda: scale_sigma(path)]


def _log(path: Path) -> list[Step]:
    """Opens, says what is in it as `python -m ebjax.logs` does, and decodes a few images."""
    from ebjax.io.logs.open import open_log
    from ebjax.logs.describe import lines
    from ebjax.logs.facts import log_facts

    found: list[Any] = []

    def opened() -> None:
        found.append(open_log(path))

    def said() -> None:
        for log in found:
            lines(log_facts(log) | {"run": ""})

    def decoded(kind: str, index: int) -> Step:
        def one() -> None:
            images = getattr(found[0], kind) if found else None
            if images is not None and len(images):
                images.decode(min(index, len(images) - 1))
                if images.stored is not None:
                    images.stored(0)

        return one

    return [opened, said, *(decoded(kind, index) for kind in ("colour", "depth") for index in (0, 1, 9))]


def _contents(path: Path) -> list[Step]:
    from ebjax.logs.facts import bag_facts

    return [*_log(path), lambda: bag_facts(path)]


def _database(path: Path) -> list[Step]:
    import numpy as np

    from ebjax.io.logs.rtabmap import open_rtabmap
    from ebjax.io.logs.rtabmap_links import Closure, write_closures

    closure = Closure(3, 1, 0.1, 0.0, 0.0, 1e-4 * np.eye(3))
    return [
        *_log(path),
        lambda: open_rtabmap(path, images="raw", session=1),
        lambda: write_closures(path, path.with_name("copy.db"), [closure]),
    ]


READERS: dict[str, Reader] = {
    "trajectory": Reader(("seed_texts:trajectories",), _trajectory),
    "calibration": Reader(("seed_calibrations:calibrations",), _calibration),
    "image": Reader(("seed_images:images",), _image),
    "depth": Reader(("seed_images:depths",), _image),
    "mask": Reader(("seed_images:masks",), _image),
    "payload": Reader(("seed_images:payloads",), _payload),
    "truth": Reader(("seed_texts:truths",), _truth),
    "pairs": Reader(("seed_texts:pair_folders",), _pairs),
    "config": Reader(("seed_texts:configs",), _config),
    "cache": Reader(("seed_weights:caches",), _cache),
    "tum": Reader(("seed_logs:tum_folders",), _log),
    "images": Reader(("seed_logs:image_folders",), _log),
    "video": Reader(("seed_logs:videos",), _log),
    "bag": Reader(("seed_logs:bags", "ros1"), _contents),
    "db3": Reader(("seed_logs:bags", "sqlite3"), _contents),
    "mcap": Reader(("seed_logs:bags", "mcap"), _contents),
    "rtabmap": Reader(("seed_logs:databases",), _database),
    "g2o": Reader(("seed_texts:graphs",), _graph, needs_jax=True),
    "checkpoint": Reader(("seed_weights:checkpoints",), _checkpoint, needs_jax=True),
    "run": Reader(("seed_texts:run_folders",), _run_folder, needs_jax=True),
}
