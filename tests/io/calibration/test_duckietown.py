import numpy as np
import pytest

from ebjax.io.calibration.duckietown import read_duckietown, read_floor_homography

K = [[400, 0, 320], [0, 410, 240], [0, 0, 1]]
D = (-0.1, 0.02, 0.001, -0.002, 0.3)
INTRINSICS = f"""camera_matrix: {{rows: 3, cols: 3, data: {np.ravel(K).tolist()}}}
camera_name: duck
distortion_coefficients: {{rows: 1, cols: 5, data: {list(D)}}}
distortion_model: plumb_bob
image_height: 480
image_width: 640
projection_matrix: {{rows: 3, cols: 4, data: [300, 0, 310, 0, 0, 305, 230, 0, 0, 0, 1, 0]}}
"""


def test_duckietown(tmp_path):
    homography = np.array([[0.0, 0.001, -0.2], [0.001, 0.0, -0.3], [0.0, -0.008, 1.0]])
    intrinsics, extrinsics = tmp_path / "intrinsic.yaml", tmp_path / "extrinsic.yaml"
    intrinsics.write_text(INTRINSICS)
    extrinsics.write_text(f"homography: {homography.ravel().tolist()}\n")
    np.testing.assert_array_equal(read_floor_homography(extrinsics), homography)
    found = read_duckietown(intrinsics, extrinsics)
    ray = np.array([0.1, 0.4, 1.0])
    by_p = homography @ [[300, 0, 310], [0, 305, 230], [0, 0, 1]] @ ray
    np.testing.assert_allclose(found.floor_from_image @ found.intrinsics @ ray, by_p, rtol=1e-12)
    assert (found.distortion_model, found.width) == ("plumb_bob", 640)
    with pytest.raises(ValueError, match=r"extrinsic\.yaml: not the YAML of intrinsics"):
        read_duckietown(extrinsics, extrinsics)


@pytest.mark.parametrize(
    "text, words",
    [
        ("homography: [1, 0, 0, 0, 1, 0, 0, 0]", "'homography' has 8 numbers, not 9"),
        ("homography: [1, 0, 0, 0, 1, 0, 0, 0, 0]", "'homography' has no inverse"),
        ("other: 1", "no key 'homography'"),
    ],
)
def test_faults_of_homographies(tmp_path, text, words):
    (tmp_path / "extrinsic.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"extrinsic\.yaml: {words}"):
        read_floor_homography(tmp_path / "extrinsic.yaml")
