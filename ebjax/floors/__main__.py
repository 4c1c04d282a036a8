"""Renders a synthetic corridor run in TUM layout."""

import dataclasses
import os
from pathlib import Path

import numpy as np

from ebjax.command import progress, run
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.io.camera_file import CameraFile
from ebjax.io.write_sequence import write_sequence


@dataclasses.dataclass(frozen=True)
class Config(CorridorConfig):
    """Renders a robot's way out and back along a tiled corridor: colour, depth, drifting odometry, truth."""

    out: Path = Path("runs/corridor_world")
    """Folder of the sequence."""


def render_sequence(config: CorridorConfig, out: str | Path) -> None:
    """Writes the run that `config` describes in TUM layout, whole or not at all; the same seed gives the same files.

    Raises:
      ValueError: a value that no corridor can have; names the key.
      OSError: the folder cannot be written.
    """
    recording = record(config)
    camera = CameraFile(
        intrinsics=np.asarray(recording.camera.intrinsics, np.float64).round(6),
        base_from_camera=np.asarray(recording.camera.base_from_camera, np.float64).round(7),
        width=recording.camera.width,
        height=recording.camera.height,
        depth_scale=1000.0,
    )
    write_sequence(
        out,
        recording.timestamps,
        recording.odom_from_base,
        recording.world_from_base,
        camera,
        recording.frame,
        threads=min(8, os.cpu_count() or 1),
        progress=lambda frames, total: progress(frames, total, "rendering"),
    )


def main(config: Config) -> None:
    """Renders and says what was written."""
    render_sequence(config, config.out)
    print(f"{config.out}: rgb.txt, depth.txt, odometry.txt, groundtruth.txt, camera.json")


if __name__ == "__main__":
    run(main, Config)
