"""What a frame must be for the engine to take it."""

import numpy as np

from ebjax.geometry.camera import Camera
from ebjax.slam.frame import Frame


def check_frame(
    frame: Frame, number: int, camera: Camera, motion: str | None, before: tuple[float, bool] | None
) -> None:
    """Refuses a frame that cannot follow on the one before.

    Args:
      frame: to be added.
      number: of it.
      camera: of the run.
      motion: see `PipelineConfig.motion`.
      before: time of the last frame, s, and whether it had odometry; None where this is the first.

    Raises:
      ValueError: it is not later than the one before; its images are of another size or type than the camera's; its
        time or odometry is not finite; it has odometry where the ones before had none, or the other way round, or has
        none where the wheels are asked for.
    """
    name, size = f"frame {frame.name or number}", (camera.height, camera.width)
    if before is not None and frame.stamp_s <= before[0]:
        raise ValueError(
            f"{name} at {frame.stamp_s:.6f} s is not later than the one before, at {before[0]:.6f} s; give the frames "
            "in the order of their times"
        )
    if frame.rgb is not None and frame.rgb.shape != (*size, 3):
        raise ValueError(
            f"{name} is an image of shape {frame.rgb.shape}, the camera's are {(*size, 3)}; give the image as "
            "the camera gave it, or the camera of this size"
        )
    if frame.rgb is not None and frame.rgb.dtype != np.uint8:
        raise ValueError(f"{name} is of {frame.rgb.dtype}; give uint8, RGB")
    if frame.depth_m is not None and frame.depth_m.shape != size:
        raise ValueError(
            f"{name} has depth of shape {frame.depth_m.shape}, the camera's images are {size}; bring the depth into "
            "the camera's image, or leave it out"
        )
    wheels = frame.odom_from_base
    if not np.isfinite([frame.stamp_s, *([] if wheels is None else wheels)]).all():
        raise ValueError(f"{name} has a time or odometry that is not finite")
    if before is None and wheels is None and motion not in (None, "floor"):
        raise ValueError(f"--motion {motion} needs odometry; run with --motion floor")
    if before is not None and (wheels is not None) != before[1]:
        raise ValueError(f"{name}: some frames have odometry and some have none; give it to all of them, or to none")
