"""What the gate times: parts of ebjax, each beside something else that does the same work.

Inputs, compiled programs and the reference's own copies are made before the clock starts. A call takes some hundredths
of a second at least, so that what surrounds it does not count.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jax.numpy as jnp
import numpy as np

from ebjax.bench.corridor import corridor
from ebjax.bench.gtsam_solver import RTOL, STEPS, gtsam_solver
from ebjax.bench.lenses import FLOOR, LENSES, camera, picture
from ebjax.bench.matching import make_pairs, opencv_motions, verifying
from ebjax.bench.searching import searches_of
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.front.log import open_log
from ebjax.front.mapper import Mapper
from ebjax.geometry.warp import gather, grid_points, taps
from ebjax.posegraph.lm import compile_solve
from ebjax.views.run_view import from_camera
from ebjax.worlds.render import render_sequence


class Pair(NamedTuple):
    """Two ways to do the same work, or of the engine, which has no equal, a fixed amount of other work.

    Attributes:
      ours, reference: calls without arguments.
      calls: of each in a turn, whose times are added up.
    """

    ours: Callable[[], Any]
    reference: Callable[[], Any]
    calls: int


class Part(NamedTuple):
    """How a pair is made; what a unit is, and beside what; the package that only the reference needs."""

    make: Callable[[], Pair]
    what: str
    needs: str | None = None


def slam() -> Pair:
    """A turn is a run of 13 frames, out, round and back; a call takes the next frame."""
    robot = RobotConfig(distance_m=1.0, turn_step_deg=36.0, frame_s=1.0)
    with tempfile.TemporaryDirectory(prefix="ebjax_bench_") as folder:
        render_sequence(CorridorConfig(seed=3, robot=robot), Path(folder) / "sequence")
        log = open_log(Path(folder) / "sequence")
        frames = list(log)
    updates = (mapper.add(frame) for mapper in iter(lambda: Mapper(log.camera), None) for frame in frames)
    for _ in frames:  # fills the caches
        next(updates)
    random = np.random.default_rng(0)
    matrix, image = random.standard_normal((512, 512), np.float32), random.standard_normal((480, 640))
    order = random.permutation(image.size)

    def work() -> None:
        for _ in range(3):
            _ = matrix @ matrix
            _ = np.fft.rfft2(image)
            _ = image.ravel()[order]

    return Pair(lambda: next(updates), work, len(frames))


def solver() -> Pair:
    """A corridor of 1000 poses and 20 closures."""
    graph = corridor(1000, 20)
    return Pair(compile_solve(graph, kernel="cauchy", rtol=RTOL, max_steps=STEPS), gtsam_solver(graph, "cauchy"), 5)


def warp() -> Pair:
    """A floor view of 180 x 180, bilinear, taps and maps made before."""
    of = camera(*LENSES["pinhole"])
    view = from_camera(of, FLOOR)
    points = grid_points(jnp.asarray(view.image_from_view, jnp.float32), view.size)
    samples, rgb = taps(points, of.size), picture(np.random.default_rng(0))
    x, y = np.moveaxis(np.asarray(points), -1, 0)

    def reference() -> np.ndarray:
        return cv2.remap(rgb, x, y, cv2.INTER_LINEAR).astype(np.float32) * np.float32(1 / 255)

    return Pair(lambda: gather(rgb, samples), reference, 50)


def search() -> Pair:
    """The best 20 of 2000 references of 512 numbers, for 100 queries."""
    found = searches_of(2000, 100, 512, 20, seed=0)
    return Pair(found["ebjax"], found["faiss"], 15)


def matching() -> Pair:
    """Mutual nearest neighbours of 500 and 500 keypoints of 128 numbers, and the rigid motion most agree on."""
    query, reference, _ = make_pairs(2, 500, 128, seed=0)
    return Pair(verifying(query, reference, seed=0), lambda: opencv_motions(query, reference), 10)


PARTS = {
    "slam": Part(slam, "a frame of Mapper.add; NumPy: a product 512 x 512, a Fourier transform and a gather 480 x 640"),
    "solver": Part(solver, "a corridor of 1000 poses and 20 closures, Cauchy; gtsam", "gtsam"),
    "warp": Part(warp, "a bilinear floor view of a 640 x 480 image; OpenCV's remap"),
    "search": Part(search, "the best 20 of 2000 descriptors of 512 numbers for 100 others; faiss", "faiss"),
    "matching": Part(matching, "two pairs of 500 keypoints matched, and their motions; OpenCV"),
}
