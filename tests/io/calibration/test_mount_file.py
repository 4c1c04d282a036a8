import numpy as np
import pytest

from ebjax.geometry.mount_numbers import mount_of, pose_of
from ebjax.io.calibration.mount_file import read_mount
from ebjax.io.camera_file import CameraFile, write_camera

K, P = [400.0, 0, 320, 0, 410, 240, 0, 0, 1], np.array([[300.0, 0, 310], [0, 305, 230], [0, 0, 1]])
ROWS = f"{{rows: 3, cols: 4, data: {np.column_stack([P, np.zeros(3)]).ravel().tolist()}}}"
INTRINSICS = f"""camera_matrix: {{rows: 3, cols: 3, data: {K}}}
distortion_coefficients: {{rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0.0]}}
distortion_model: plumb_bob
image_height: 480
image_width: 640
projection_matrix: {ROWS}
"""


@pytest.fixture
def files(tmp_path):
    """Intrinsics, and a function that writes the homography of a mount."""
    intrinsics, extrinsics = tmp_path / "intrinsic.yaml", tmp_path / "extrinsic.yaml"
    intrinsics.write_text(INTRINSICS)

    def write(base_from_camera, stretch=1.0):
        image_from_floor = P @ np.linalg.inv(base_from_camera)[:3, [0, 1, 3]] @ np.diag([stretch, 1, 1])
        homography = np.linalg.inv(image_from_floor)
        extrinsics.write_text(f"homography: {(homography / homography[2, 2]).ravel().tolist()}\n")
        return extrinsics

    return intrinsics, write


@pytest.mark.parametrize("height, pitch", [(0.115, 0.3), (1.2, 0.6)])
def test_a_homography_of_rectified_pixels(files, height, pitch):
    intrinsics, write = files
    mount = pose_of(np.array([pitch, 0.01, -0.02, height, 0.06, 0.0]))
    found, notes = read_mount(write(mount, 1.004), intrinsics)
    np.testing.assert_allclose(mount_of(found), mount_of(mount), atol=0.01)
    assert "lengths on the floor within 0." in notes[0]
    with pytest.raises(ValueError, match=r"extrinsic\.yaml: a homography .*; give their file too, as --camera FILE"):
        read_mount(write(mount), None)
    with pytest.raises(ValueError, match=r"extrinsic\.yaml: no rigid mount of the camera in .*intrinsic\.yaml"):
        read_mount(write(mount, 1.3), intrinsics)


def test_any_calibration_that_knows_its_mount(files, tmp_path):
    intrinsics, _ = files
    pose = pose_of(np.array([0.4, 0.0, 0.0, 0.5, 0.2, 0.0]))
    write_camera(tmp_path / "camera.json", CameraFile(np.array(K).reshape(3, 3), pose, 640, 480, 1000.0))
    np.testing.assert_allclose(read_mount(tmp_path / "camera.json", None)[0], pose, atol=1e-6)
    with pytest.raises(ValueError, match=r"intrinsic\.yaml: says nothing of how the camera is mounted"):
        read_mount(intrinsics, None)


def test_a_real_robot(data):
    folder = data("logs/calibrations")
    files = folder / "duckietown_ferrari_extrinsic.yaml", folder / "duckietown_ferrari_intrinsic.yaml"
    pitch, roll, yaw, height, x, y = mount_of(read_mount(*files)[0])
    np.testing.assert_allclose([height, x, y], [0.1157, 0.0629, -0.0004], atol=1e-4)
    np.testing.assert_allclose(np.degrees([pitch, roll, yaw]), [17.56, 2.70, 4.75], atol=0.05)
