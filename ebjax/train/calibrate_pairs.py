"""What calibration looks at: the same floor seen from two places, some decimetres of driving apart.

A match is two pixels of raw images, so that it depends neither on how the camera is mounted nor on its lens; the floor
views in which it was found do, and only have to be good enough to match.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ebjax.features.matching import Features, mutual_nearest
from ebjax.features.upright import extract
from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import Arrays
from ebjax.geometry.pytree import pytree
from ebjax.odometry.wheels import WheelErrors
from ebjax.train.calibrate_floor import raw_keypoints
from ebjax.views.floor_view import floor_view, view_taps
from ebjax.views.run_view import RunView

SHARES = (0.125, 0.25, 0.375)
"""How far the view's centre moves between the two frames of a pair, as a share of the view's length."""
MAX_TURN_DEG = 30.0
"""Upright descriptors do not stand more."""
KEYPOINT_PX = 0.25
"""Standard deviation of a keypoint, px of the floor view."""
MATCHES = 64
_PAIRS_A_CALL = 32
Load = Callable[[int], np.ndarray | None]


@pytree
class FloorPairs:
    """P pairs of frames with K matches each; the later frame of a pair comes second.

    Attributes:
      camera: that took the images, as it was believed before any was looked at.
      pixels: the matched keypoints in the raw images, px.
      slopes: how a pixel changes with one standard deviation of its keypoint along either axis of the view.
      valid: 1 where there is a match, 0 elsewhere.
      motion: first_from_second by odometry: x, y (m), heading (rad).
      noise: lower Cholesky factor of the covariance of that motion.
    """

    camera: Camera
    pixels: Float[Arrays, "P 2 K 2"]
    slopes: Float[Arrays, "P 2 K 2 2"]
    valid: Float[Arrays, "P K"]
    motion: Float[Arrays, "P 3"]
    noise: Float[Arrays, "P 3 3"]

    def some(self, rows: Int[np.ndarray, " R"]) -> "FloorPairs":
        """Only these pairs."""
        parts = (self.pixels, self.slopes, self.valid, self.motion, self.noise)
        return FloorPairs(self.camera, *(part[rows] for part in parts))


def relative_motion(
    odom_from_base: Float[np.ndarray, "F 3"], first: Int[np.ndarray, " P"], second: Int[np.ndarray, " P"]
) -> Float[np.ndarray, "P 3"]:
    """first_from_second: x, y (m), heading (rad)."""
    d = odom_from_base[second] - odom_from_base[first]
    c, s = np.cos(odom_from_base[first, 2]), np.sin(odom_from_base[first, 2])
    return np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]], 1)


def motion_noise(
    odom_from_base: Float[np.ndarray, "F 3"],
    first: Int[np.ndarray, " P"],
    second: Int[np.ndarray, " P"],
    odometry: WheelErrors,
) -> Float[np.ndarray, "P 3 3"]:
    """Lower Cholesky factor of the covariance of `relative_motion`, to first order.

    Every step's errors add up in its own frame, and its heading error swings what is driven after it.
    """
    sigmas = odometry.step_sigmas(odom_from_base)
    covariance = np.zeros((len(first), 3, 3))
    for k, (i, j) in enumerate(zip(first, second, strict=True)):
        turn = odom_from_base[i:j, 2] - odom_from_base[i, 2]
        ahead = relative_motion(odom_from_base, np.full(j - i, i), np.full(j - i, j))
        reached = relative_motion(odom_from_base, np.full(j - i, i), np.arange(i + 1, j + 1))
        swing = ahead[:, :2] - reached[:, :2]
        jacobian = np.zeros((j - i, 3, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = np.cos(turn)
        jacobian[:, 1, 0] = np.sin(turn)
        jacobian[:, 0, 1] = -jacobian[:, 1, 0]
        jacobian[:, 0, 2], jacobian[:, 1, 2], jacobian[:, 2, 2] = -swing[:, 1], swing[:, 0], 1
        scaled = jacobian * sigmas[i:j, None, :]
        covariance[k] = np.einsum("nab,ncb->ac", scaled, scaled)
    return np.linalg.cholesky(covariance)


def choose_pairs(
    odom_from_base: Float[np.ndarray, "F 3"], centre_m: Float[np.ndarray, "2"], length_m: float, count: int
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
    """Frames between which the centre of the floor view moves by an eighth, a quarter and three eighths of its length.

    Args:
      odom_from_base: x, y (m), heading (rad) of every frame.
      centre_m: of the view, in base.
      length_m: of the view.
      count: pairs wanted at most, spread evenly over the run.

    Returns:
      Rows of the first and the second frames; none where the robot does not move or turns too fast.
    """
    heading = odom_from_base[:, 2]
    c, s = np.cos(heading), np.sin(heading)
    centre = odom_from_base[:, :2] + np.stack([c * centre_m[0] - s * centre_m[1], s * centre_m[0] + c * centre_m[1]], 1)
    found = set()
    for i in range(len(centre)):
        moved = np.linalg.norm(centre[i:] - centre[i], axis=1)
        left = moved > length_m * (SHARES[-1] + SHARES[0])
        near = moved[: np.argmax(left)] if left.any() else moved
        turned = np.abs(heading[i : i + len(near)] - heading[i])
        for share in SHARES:
            enough = near >= share * length_m
            k = int(np.argmax(enough))
            if enough.any() and turned[k] <= np.radians(MAX_TURN_DEG):
                found.add((i, i + k))
    pairs = np.array(sorted(found), int).reshape(-1, 2)
    if len(pairs) > count:
        # By first frame, so that frames are shared and all three distances stay represented.
        starts = np.unique(pairs[:, 0])
        kept = starts[np.linspace(0, len(starts) - 1, max(1, count // len(SHARES))).round().astype(int)]
        pairs = pairs[np.isin(pairs[:, 0], kept)]
    return pairs[:, 0], pairs[:, 1]


@jax.jit
def _look(rgb, samples, seen):
    return extract(floor_view(rgb, samples), seen)


@jax.jit
def _match(first: Features, second: Features):
    return jax.lax.map(lambda two: mutual_nearest(*two, keep=MATCHES), (first, second))


def match_pairs(
    load: Load,
    first: Int[np.ndarray, " P"],
    second: Int[np.ndarray, " P"],
    odom_from_base: Float[np.ndarray, "F 3"],
    believed: Camera,
    camera: Camera,
    view: RunView,
    odometry: WheelErrors,
    progress: Callable = lambda items, total, label: iter(items),
) -> FloorPairs:
    """Finds the corners of the floor views and matches them, the most distinctive first.

    Args:
      load: frame number -> RGB uint8, or None for a frame that cannot be read.
      first: frame numbers.
      second: frame numbers.
      odom_from_base: x, y (m), heading (rad) of every frame.
      believed: the camera before any image was looked at.
      camera: as it is known by now; the floor is looked at through it.
      view: of this camera.
      odometry: how it errs.
      progress: wraps the long loop.

    Raises:
      ValueError: no frame could be read.
    """
    samples, seen = view_taps(view, camera), view.seen
    frames = np.unique(np.concatenate([first, second]))
    looked: dict[int, Features] = {}
    for k in progress(frames.tolist(), len(frames), "looking at the floor"):
        rgb = load(k)
        if rgb is not None:
            looked[k] = jax.tree.map(np.asarray, _look(jnp.asarray(rgb), samples, seen))
    if not looked:
        raise ValueError("none of the frames could be read")
    blank = jax.tree.map(np.zeros_like, next(iter(looked.values())))
    features = jax.tree.map(lambda *rows: np.stack(rows), *(looked.get(k, blank) for k in frames.tolist()))
    rows = np.searchsorted(frames, first), np.searchsorted(frames, second)

    found = []
    for start in range(0, len(first), _PAIRS_A_CALL):
        some = np.arange(start, start + _PAIRS_A_CALL) % len(first)  # the last block is filled up: one shape
        two = (jax.tree.map(lambda leaf, r=r[some]: leaf[r], features) for r in rows)
        found.append(jax.tree.map(np.asarray, _match(*two)))
    matches = jax.tree.map(lambda *blocks: np.concatenate(blocks)[: len(first)], *found)

    ends = zip(rows, (matches.query, matches.reference), strict=True)
    keypoints = np.stack([features.keypoints[r[:, None], chosen] for r, chosen in ends], 1)
    flat = keypoints.reshape(-1, 2).astype(view.image_from_view.dtype)
    pixels, slopes = map(np.asarray, raw_keypoints(view, camera, flat, KEYPOINT_PX))
    shape = keypoints.shape[:3]
    return FloorPairs(
        believed,
        pixels.reshape(*shape, 2),
        slopes.reshape(*shape, 2, 2),
        matches.valid.astype(pixels.dtype),
        relative_motion(odom_from_base, first, second).astype(pixels.dtype),
        motion_noise(odom_from_base, first, second, odometry).astype(pixels.dtype),
    )
