"""transforms.json of nerfstudio: one camera, and for each image where it was taken.

Its cameras look along -z with y up (OpenGL), its world has z up, and its pixels have their corner, not their centre, at
whole numbers: the centre of the top-left pixel is (0.5, 0.5).
"""

import json
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.io.atomic import whole_file
from ebjax.io.camera_file import CameraFile

BROWN = ("k1", "k2", "p1", "p2", "k3")
FURTHER = ("k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
CV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])
REMEDY = "undistort the images, and export a run on those"


def write_transforms(
    path: str | Path,
    camera: CameraFile,
    world_from_base: Float[np.ndarray, "N 4 4"],
    images: Sequence[str | PurePath],
) -> None:
    """Writes a data set that `ns-train --data PATH` reads.

    The world stays as it is, z up: `orientation_override` keeps nerfstudio from turning it. It still centres and scales
    the poses.

    Args:
      path: the file, transforms.json by custom.
      camera: that took the images.
      world_from_base: where the robot was at each image, m.
      images: files, absolute or relative to the folder of `path`.

    Raises:
      ValueError: a lens that nerfstudio has no model of, not as many images as poses, or none.
      OSError: the file cannot be written.
    """
    if len(images) != len(world_from_base) or not len(images):
        raise ValueError(
            f"{path}: {len(images)} images for {len(world_from_base)} poses; give one for each, at least one"
        )
    model, distortion = lens_of(path, camera)
    world_from_camera = world_from_base @ camera.base_from_camera @ CV_FROM_GL
    values: dict[str, Any] = {
        "camera_model": model,
        "fl_x": float(camera.intrinsics[0, 0]),
        "fl_y": float(camera.intrinsics[1, 1]),
        "cx": float(camera.intrinsics[0, 2]) + 0.5,
        "cy": float(camera.intrinsics[1, 2]) + 0.5,
        "w": camera.width,
        "h": camera.height,
        **distortion,
        "orientation_override": "none",
        "frames": [
            {"file_path": PurePath(image).as_posix(), "transform_matrix": pose.tolist()}
            for image, pose in zip(images, world_from_camera, strict=True)
        ],
    }
    with whole_file(path) as file:
        file.write(json.dumps(values, indent=1, allow_nan=False) + "\n")


def lens_of(path: str | Path, camera: CameraFile) -> tuple[str, dict[str, float]]:
    """The lens by nerfstudio's name, and its coefficients.

    nerfstudio's perspective camera has k1 k2 k3 p1 p2 of OpenCV's model; what it calls k4 there is another term.
    """
    model, distortion = camera.distortion_model, camera.distortion
    if model == "equidistant":
        return "OPENCV_FISHEYE", dict(zip(("k1", "k2", "k3", "k4"), distortion, strict=True))
    if model == "omnidirectional":
        raise ValueError(f"{path}: nerfstudio has no omnidirectional lens (Mei's); {REMEDY}")
    named = dict(zip((*BROWN, *FURTHER), distortion, strict=False))
    if beyond := [name for name in FURTHER if named.get(name)]:
        raise ValueError(f"{path}: nerfstudio's lens has no {', '.join(beyond)}, which this {model} has; {REMEDY}")
    return "OPENCV", {name: named.get(name, 0.0) for name in BROWN}
