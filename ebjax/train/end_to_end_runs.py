"""The runs of the task `end_to_end`: corridors driven out and back, seen by a camera that is not what it is believed.

Rendered once into a folder; what is there is used again as long as the world is the same.
"""

import dataclasses
import zipfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.command import progress
from ebjax.floors.cameras import CameraConfig, ModelName
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.surface import FamilyName, FloorConfig
from ebjax.geometry.camera import Camera
from ebjax.geometry.lens import lens
from ebjax.geometry.mount import Mounting, remounted
from ebjax.geometry.optics import unchanged, with_optics
from ebjax.io.atomic import whole_file
from ebjax.models.luma import luma
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.soft import SoftRun
from ebjax.slam.soft_pairs import chain_of
from ebjax.slam.world import planar


@dataclasses.dataclass(frozen=True)
class WorldConfig:
    """What all runs have in common."""

    distance_m: float = 8.0
    """Length of the corridor, m."""
    step_m: float = 0.25
    """Between two frames, m."""
    turn_step_deg: float = 30.0
    """Between two frames of the turn, degrees."""
    drift: float = 2.0
    """Factor of the odometry's errors (`floors.robot`, drifting)."""
    camera: ModelName = "p3dx-d435"
    """On the robot; phone-raw and gopro-wide look through lenses that bend."""
    width_px: int = 320
    """Width of the images, px."""
    texel_m: float = 0.005
    """Of the floor's picture, m."""


def corridor(world: WorldConfig, family: FamilyName, seed: int) -> CorridorConfig:
    """The world of one run."""
    return CorridorConfig(
        seed=seed,
        floor=FloorConfig(family=family, texel_m=world.texel_m),
        robot=RobotConfig(
            distance_m=world.distance_m, step_m=world.step_m, turn_step_deg=world.turn_step_deg, drift=world.drift
        ),
        camera=CameraConfig(model=world.camera, width=world.width_px),
    )


def _frames(config: CorridorConfig, file: Path) -> dict[str, np.ndarray]:
    """Times, truth, odometry, camera and grey images, from `file` or rendered into it."""
    if file.is_file():
        try:
            with open(file, "rb") as stored, np.load(stored) as kept:
                if str(kept["world"]) == repr(config) and "distortion" in kept.files:
                    return {name: kept[name] for name in kept.files}
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            pass  # damaged: rendered anew
    recorded = record(config)
    frames = [recorded.frame(k)[0] for k in progress(range(len(recorded)), label=f"rendering {config.floor.family}")]
    grey = np.asarray(jnp.round(jax.vmap(luma)(jnp.asarray(np.stack(frames), jnp.float32)))).astype(np.uint8)
    found = {
        "world": np.asarray(repr(config)),
        "images": grey,
        "times_s": recorded.timestamps - recorded.timestamps[0],
        "world_from_base": planar(recorded.world_from_base),
        "odom_from_base": planar(recorded.odom_from_base),
        "intrinsics": np.asarray(recorded.camera.intrinsics, np.float64),
        "base_from_camera": np.asarray(recorded.camera.base_from_camera, np.float64),
        "distortion_model": np.asarray(recorded.camera.lens.model),
        "distortion": np.asarray(recorded.camera.lens.coefficients, np.float64),
    }
    with whole_file(file, "wb") as opened:
        np.savez(opened, **found)  # type: ignore[arg-type]
    return found


def load_run(config: CorridorConfig, wrong: Mounting, folder: Path, distortion_off: float = 0.0) -> SoftRun:
    """A run whose camera is believed to be off.

    Args:
      config: from `corridor`.
      wrong: what is added to the true camera's mounting.
      folder: where rendered runs are kept.
      distortion_off: added to the first coefficient of its lens, as a share of it.

    Raises:
      ValueError: a world that cannot be; names the key.
      OSError: the folder cannot be written.
    """
    found = _frames(config, folder / f"{config.floor.family}_{config.seed}.npz")
    height, width = found["images"].shape[1:]
    bent = lens(str(found["distortion_model"]), found["distortion"].tolist())
    true = Camera(jnp.asarray(found["intrinsics"]), jnp.asarray(found["base_from_camera"]), width, height, bent)
    off = unchanged(true)
    if len(bent.coefficients):
        off = dataclasses.replace(off, coefficients=off.coefficients.at[0].set(distortion_off * bent.coefficients[0]))
    return SoftRun(
        jnp.asarray(found["images"][..., None], jnp.float32) / 255,
        jnp.asarray(found["times_s"]),
        chain_of(found["odom_from_base"], WheelErrors()),
        with_optics(remounted(true, wrong), off),
        jnp.asarray(found["world_from_base"][:, :2]),
    )
