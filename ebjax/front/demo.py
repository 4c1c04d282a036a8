"""The synthetic corridor that comes without a robot."""

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ebjax.floors import robot
from ebjax.floors.cameras import make_camera
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import camera_from
from ebjax.slam.config import PipelineConfig
from ebjax.slam.drive import drive
from ebjax.slam.mapper import Mapper
from ebjax.slam.recording import Recording
from ebjax.worlds.render import camera_file, render_sequence

FRAMES = 6


def demo(folder: str | Path = "runs/demo/sequence", beside: Callable[[], None] = lambda: None) -> Path:
    """Renders a corridor out and back, 91 frames, into a folder, and returns the folder; one that is there is kept.

    Args:
      folder: of the sequence.
      beside: is done while it is rendered.

    Raises:
      ValueError: the folder holds something else.
      OSError: it cannot be written.
    """
    folder = Path(folder)
    if (folder / "rgb.txt").is_file():
        return folder
    begun_s = time.perf_counter()
    said = "half a minute or more the first time, as JAX compiles its programs"
    print(f"rendering a synthetic corridor into {folder}; {said}", file=sys.stderr, flush=True)
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(beside)
        render_sequence(CorridorConfig(), folder)
        other.result()
    print(f"rendered in {time.perf_counter() - begun_s:.1f} s", file=sys.stderr, flush=True)
    return folder


def compile_engine(config: PipelineConfig) -> None:
    """Compiles the programs of a drive: the engine looks at a few frames of noise by the corridor's camera.

    Args:
      config: of the engine.

    Raises:
      ValueError: as of `Mapper`.
    """
    world = CorridorConfig()
    camera = camera_from(camera_file(make_camera(world.camera, None)))
    image = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width, 3), np.uint8)
    both = image, np.zeros(image.shape[:2], np.float32)
    poses, _ = robot.drive(world.robot, np.random.default_rng(0))
    whole, some = (Recording(lambda k: both, np.arange(len(p), dtype=float), p) for p in (poses, poses[:FRAMES]))
    engine = Mapper(camera, config, recording=whole)  # its length decides shapes
    drive(engine, some)
    engine.corrector.close()
