"""Steps from the whole image, for keyframes whose floor view tells nothing of how they follow on the one before."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.camera import Camera
from ebjax.geometry.planar import between, chained, inverse, inverse_covariance
from ebjax.odometry.chain import carried_on
from ebjax.odometry.image_corners import image_corners
from ebjax.odometry.image_matches import ImageFeatures
from ebjax.odometry.steps import USED, Steps, joined, no_steps
from ebjax.odometry.wheels import WheelErrors
from ebjax.odometry.whole_image import measure_motion

Load = Callable[[int], tuple[np.ndarray, np.ndarray | None] | None]
NO_COMMON = "no motion explains the whole images"


def bridge(
    steps: Steps,
    count: int,
    frames: Int[np.ndarray, " N"],
    times: Float[np.ndarray, " N"],
    wheels: Float[np.ndarray, "N 3"] | None,
    camera: Camera,
    load: Load,
    errors: WheelErrors,
    ignored: Bool[np.ndarray, "H W"] | None = None,
    level_from_base: Float[np.ndarray, "N 4 4"] | None = None,
) -> Steps:
    """Measures the steps between successive keyframes that `steps` lacks; without wheels, else over the next one.

    Args:
      steps: what the floor measured.
      count: of keyframes.
      frames: frame number of every keyframe.
      times: s.
      wheels: odometry of the keyframes, or None: then speed is carried on.
      camera: with its mount put right.
      load: frame number -> (RGB, depth).
      errors: of the wheels.
      ignored: pixels of the image that are no world.
      level_from_base: how the robot leans at every keyframe; None: it does not.
    """
    known = np.zeros(count, bool)
    first = steps.used & (steps.i - steps.j == 1)
    known[steps.i[first]] = True
    moved = np.zeros((count - 1, 3))
    moved[steps.j[first]] = inverse(steps.i_from_j[first])
    moved = carried_on(moved, known[1:], times)
    looked: dict[int, ImageFeatures | None] = {}
    rows: list[Steps] = []
    seen = None if ignored is None else ~ignored

    def look(k: int):
        if k not in looked:
            images = load(int(frames[k]))
            leant = None if level_from_base is None else level_from_base[k]
            looked[k] = None if images is None else image_corners(*images, camera, seen, leant)
            for old in [n for n in looked if n < k - 3]:
                del looked[old]
        return looked[k]

    def measure(k: int, j: int) -> bool:
        a, b = look(k), look(j)
        if a is None or b is None:
            return False
        counted = None if wheels is None else wheels[[j, k]]
        rows.append(step_of(k, j, a, b, camera, counted, chained(moved[j:k])[-1], errors))
        return bool(rows[-1].used[0])

    for k in np.flatnonzero(~known[1:]) + 1:
        if not measure(int(k), int(k) - 1) and wheels is None:
            for i, j in ((k, k - 2), (k + 1, k - 1)):
                if j >= 0 and i < count:
                    measure(int(i), int(j))
    return joined(rows) if rows else no_steps()


def step_of(
    k: int,
    j: int,
    later: ImageFeatures,
    earlier: ImageFeatures,
    camera: Camera,
    wheels: Float[np.ndarray, "2 3"] | None,
    guess: Float[np.ndarray, "3"],
    errors: WheelErrors,
) -> Steps:
    """One step, a row, from the corners of two images.

    Args:
      k: row of the later keyframe.
      j: row of the earlier one.
      later: corners of its image.
      earlier: likewise.
      camera: of both.
      wheels: odometry of the earlier and the later one; None without.
      guess: earlier_from_later as it is expected without wheels.
      errors: of the wheels.
    """
    if wheels is not None:
        prior = between(wheels[1], wheels[0])
        wide = inverse_covariance(inverse(prior), np.diag(errors.step_sigmas(wheels)[0] ** 2))
    else:
        prior = inverse(guess)
        wide = np.diag([(0.3 * float(np.hypot(*prior[:2])) + 0.03) ** 2] * 2 + [0.3**2])
    found = measure_motion(later, earlier, camera, (prior, wide))
    kind = "rotation" if found.kind == "rotation" else "image"
    reason = USED if found.ok else NO_COMMON
    row = (k, j, kind, found.inliers, found.matches, found.i_from_j, found.covariance, reason)
    types = (int, int, object, int, int, float, float, object)
    return Steps(*(np.array([value], dtype) for value, dtype in zip(row, types, strict=True)))
