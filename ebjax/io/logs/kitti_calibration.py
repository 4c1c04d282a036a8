"""KITTI odometry's calib.txt: projections P0 .. P3 of the rectified cameras, 3 x 4, row-major."""

from pathlib import Path

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.text import data_lines, floats


def read_kitti_calibration(path: Path, size: tuple[int, int]) -> Calibration:
    """Reads the intrinsics, which all four cameras share.

    Args:
      path: of calib.txt.
      size: (width, height) of the images, px, which the file does not say.

    Raises:
      ValueError: no line of P0 to P3, or not twelve numbers in it; names file and line.
    """
    for number, line in data_lines(path):
        name, _, rest = line.partition(":")
        if name not in ("P0", "P1", "P2", "P3"):
            continue
        values = floats(path, number, rest.split())
        if len(values) != 12 or min(values[0], values[5]) <= 0:
            raise ValueError(f"{path} line {number}: not twelve numbers of a projection, 3 x 4; correct the line")
        return Calibration(
            source=str(path),
            kind="KITTI calib.txt",
            width=size[0],
            height=size[1],
            intrinsics=np.array(values).reshape(3, 4)[:, :3],
            notes=(f"{path}: no image size; taken as that of the images, {size[0]} x {size[1]} px",),
        )
    raise ValueError(f"{path}: no line P0 to P3; give KITTI odometry's calib.txt, or --camera FILE")
