"""What the floor's steps say beside the motion: of the wheels, of the images' clock, of the camera's height and x."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.features.landmarks import Landmarks
from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, inverse
from ebjax.odometry.clock import TimeOffset, estimate_offset
from ebjax.odometry.height import ALARM, PRIOR_M, Reach, height_from_depth, height_from_wheels, x_from_turns
from ebjax.odometry.steps import Steps
from ebjax.odometry.wheels import Systematic, WheelErrors, systematic


def offset_of(steps: Steps, wheels_at: Callable[[float], Float[np.ndarray, "N 3"]], errors: WheelErrors) -> TimeOffset:
    """The clock of the images, from the turns of successive steps."""
    rows = steps.consecutive()
    ends = np.stack([steps.i[rows], steps.j[rows]], 1)
    wheels = wheels_at(0.0)
    noise = errors.step_sigmas(wheels)[steps.j[rows], 2] / 4
    sigma = np.sqrt(steps.covariance[rows, 2, 2] + noise**2)
    return estimate_offset(steps.i_from_j[rows, 2], sigma, lambda offset: wheels_at(offset)[ends, 2])


def systematic_of(
    steps: Steps, wheels: Float[np.ndarray, "N 3"], times: Float[np.ndarray, " N"], errors: WheelErrors
) -> Systematic:
    """What is wrong with all of the wheels' steps."""
    rows = steps.consecutive()
    rows = rows[steps.kind[rows] != "rotation"]
    i, j = steps.i[rows], steps.j[rows]
    sigmas = errors.step_sigmas(wheels)[j]
    return systematic(
        between(wheels[j], wheels[i]),
        inverse(steps.i_from_j[rows]),
        steps.covariance[rows],
        sigmas,
        times[i] - times[j],
        errors,
    )


def height_off(landmarks: Landmarks, camera: Camera) -> float:
    """By which share of the camera's height depth sees the floor elsewhere; 0 without depth."""
    z = np.asarray(landmarks.points)[..., 2][np.asarray(landmarks.range_m) > 0]
    return float(abs(np.median(z)) / np.asarray(camera.base_from_camera)[2, 3]) if z.size else 0.0


def measured_scale(wrong: Systematic, errors: WheelErrors) -> tuple[float, float]:
    """The floor's metres per metre of the wheels without what was expected of it, and its standard deviation."""
    expected, both = errors.scale_sigma**-2, wrong.sigma[0] ** -2
    own = both - expected
    if own < 1e-3 * expected:
        return 1.0, float("inf")
    return 1 + (wrong.scale - 1) * both / own, own**-0.5


def reach_of(
    steps: Steps,
    landmarks: Landmarks,
    camera: Camera,
    wheels: Float[np.ndarray, "N 3"] | None,
    wrong: Systematic | None,
    errors: WheelErrors,
) -> Reach:
    """Height by depth, else by the wheels; x by the wheels."""
    height = float(np.asarray(camera.base_from_camera)[2, 3])
    found, x = (0.0, PRIOR_M), (0.0, PRIOR_M)
    z = np.asarray(landmarks.points)[..., 2][np.asarray(landmarks.range_m) > 0]
    if z.size:
        found = height_from_depth(height, z)
    elif wrong is not None and wrong.steps:
        found = height_from_wheels(height, *measured_scale(wrong, errors), errors.scale_sigma)
    if wheels is not None and wrong is not None:
        rows = steps.consecutive()
        rows = rows[steps.kind[rows] != "rotation"]
        i, j = steps.i[rows], steps.j[rows]
        back = inverse(steps.i_from_j[rows])
        counted = between(wheels[j], wheels[i])
        counted[:, :2] *= wrong.scale
        sigmas = errors.step_sigmas(wheels)[j]
        x = x_from_turns(back, counted, np.hypot(sigmas, np.sqrt(steps.covariance[rows][:, [0, 1, 2], [0, 1, 2]])))
    return Reach(found[0], x[0], found[1], x[1]).significant()


def moved_camera(camera: Camera, reach: Reach) -> Camera:
    """The camera with its height and x put right."""
    pose = np.array(camera.base_from_camera)
    pose[0, 3] += reach.x_m
    pose[2, 3] += reach.height_m
    return dataclasses.replace(camera, base_from_camera=jnp.asarray(pose))


def mount_warnings(
    wrong: Systematic | None, trust_depth: bool, landmarks: Landmarks, camera: Camera, errors: WheelErrors
) -> tuple[str, ...]:
    """What the user should correct of the mount, a line each."""
    height = float(np.asarray(camera.base_from_camera)[2, 3])
    said = []
    scale, sigma = (1.0, 0.0) if wrong is None or not wrong.steps else measured_scale(wrong, errors)
    if abs(scale - 1) > max(ALARM, 3 * sigma):
        said.append(
            f"the floor moves {scale:.3f} m for every metre of the wheels: the camera's height of {height:.3f} m "
            f"in T_base_camera is about {100 * (scale - 1):+.0f} % off, or the wheels' scale is; measure the "
            "height of the lens above the floor"
        )
    if trust_depth and (off := height_off(landmarks, camera)) > ALARM:
        z = float(np.median(np.asarray(landmarks.points)[..., 2][np.asarray(landmarks.range_m) > 0]))
        said.append(
            f"depth sees the floor {z:+.3f} m from where the camera's height of {height:.3f} m in T_base_camera puts "
            f"it, {100 * off:.0f} % of it: depth is trusted; correct the height, or try --floor depth"
        )
    return tuple(said)
