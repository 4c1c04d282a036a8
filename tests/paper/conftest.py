"""A run over a floor of blotches, drawn in a second: what the experiments measure, without the worlds' renderer."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.io.camera_file import CameraFile
from ebjax.io.write_sequence import write_sequence
from ebjax.paper import worlds
from ebjax.slam.world import matrices

WAY_M, SHIFT_M, STEP_M = 5.0, 0.15, 0.4
PX_PER_M, ORIGIN_M = 150, np.array([-5.0, -4.0])


def floor():
    """Blotches and specks, 15 x 8 m."""
    noise = np.random.default_rng(0).standard_normal((8 * PX_PER_M, 15 * PX_PER_M))
    blotches = sum(s * gaussian_filter(noise, s, mode="wrap") for s in (1.5, 4.0, 12.0))
    return np.repeat(np.clip(128 + 30 * blotches / blotches.std(), 0, 255).astype(np.uint8)[..., None], 3, 2)


def way():
    """Poses there and back, and odometry that turns a degree a metre too much."""
    x = np.arange(0, WAY_M + 0.01, STEP_M)
    out = np.stack([x, np.zeros_like(x), np.zeros_like(x)], 1)
    turn = np.stack([np.full(9, x[-1]), np.zeros(9), np.linspace(0, np.pi, 11)[1:-1]], 1)
    back = np.stack([x[::-1], np.full_like(x, SHIFT_M), np.full_like(x, np.pi)], 1)
    truth = np.concatenate([out, turn, back])
    step = np.diff(truth, axis=0)
    heading = np.concatenate([[0], np.cumsum(step[:, 2] + np.radians(1.0) * np.hypot(*step[:, :2].T))])
    wrong = heading[:-1] - truth[:-1, 2]
    c, s = np.cos(wrong), np.sin(wrong)
    moved = np.stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]], 1)
    return truth, np.concatenate([np.concatenate([[[0, 0]], np.cumsum(moved, 0)]), heading[:, None]], 1)


def render(config, out):
    """Stands in for the worlds' renderer."""
    texture, (truth, odometry) = floor(), way()
    camera = camera_over_floor(310.0, 310.0, 160.0, 120.0, 320, 240, 0.54, np.radians(19.0), x_m=0.27)
    image_from_base = np.asarray(image_from_floor(camera))
    texture_from_world = np.array(
        [[PX_PER_M, 0, -ORIGIN_M[0] * PX_PER_M], [0, PX_PER_M, -ORIGIN_M[1] * PX_PER_M], [0, 0, 1]]
    )
    world_from_base = matrices(truth)[:, [0, 1, 3]][:, :, [0, 1, 3]]

    def frame(i):
        homography = texture_from_world @ world_from_base[i] @ np.linalg.inv(image_from_base)
        image = cv2.warpPerspective(texture, homography, (320, 240), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP)
        shade = 1.0 if i < len(truth) / 2 else 0.8
        return (image * shade).astype(np.uint8), np.zeros((240, 320), np.uint16)

    file = CameraFile(
        intrinsics=np.asarray(camera.intrinsics, np.float64),
        base_from_camera=np.asarray(camera.base_from_camera, np.float64),
        width=320,
        height=240,
        depth_scale=1000.0,
    )
    write_sequence(out, 0.5 * np.arange(len(truth)), matrices(odometry), matrices(truth), file, frame)


@pytest.fixture(scope="session")
def small_worlds(tmp_path_factory):
    """A folder with one world, W, 5 m there and back."""
    folder = tmp_path_factory.mktemp("worlds")
    (folder / "W.yaml").write_text("seed: 3\n")
    return folder


@pytest.fixture(scope="session")
def drawn():
    """The worlds are drawn by `render` for the session; gives how many were."""
    calls = []

    def counted(config, out):
        calls.append(out)
        render(config, out)

    patch = pytest.MonkeyPatch()
    patch.setattr(worlds, "render_sequence", counted)
    yield calls
    patch.undo()


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The run that `render` draws."""
    folder = tmp_path_factory.mktemp("run") / "blotches"
    render(None, folder)
    return folder
