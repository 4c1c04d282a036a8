import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.evaluation.association import associate
from ebjax.evaluation.trajectory import (
    ALIGNMENTS,
    align,
    arc_length,
    arc_length_association,
    ate,
    rpe,
    statistics,
)
from ebjax.io.trajectory import read


@pytest.fixture
def path():
    rng = np.random.default_rng(0)
    return np.cumsum(rng.normal(size=(80, 3)), axis=0)


def moved(points, group, scale=1.0):
    turn = Rotation.from_rotvec([0.3, -1.1, 2.0] if group != "se2" else [0, 0, 2.0]).as_matrix()
    return scale * points @ turn.T + np.array([4.0, -7.0, 1.5 if group != "se2" else 0.0])[None]


@pytest.mark.parametrize("group, scale", [("se2", 1.0), ("se3", 1.0), ("sim3", 2.5)])
def test_alignment_undoes_a_motion_of_its_group(path, group, scale):
    estimate = moved(path, group, scale)
    assert ate(path, estimate, group)["max"] < 1e-12
    assert ate(path, estimate, group, first=10)["max"] < 1e-10
    assert ate(path, estimate, "none")["rmse"] > 1
    matrix = align(estimate, path, group)
    np.testing.assert_allclose(np.linalg.det(matrix[:3, :3]), scale**-3, rtol=1e-12)


def test_alignment_never_mirrors_and_is_optimal(path):
    rng = np.random.default_rng(1)
    estimate = moved(path * np.array([1, 1, -1.0])[None], "se3") + rng.normal(size=path.shape)
    for group in ALIGNMENTS[1:]:
        matrix = align(estimate, path, group)
        assert np.linalg.det(matrix[:3, :3]) > 0
    best = ate(path, estimate, "se3")["rmse"]
    rotation, _ = Rotation.align_vectors(path - path.mean(axis=0), estimate - estimate.mean(axis=0))
    np.testing.assert_allclose(align(estimate, path, "se3")[:3, :3], rotation.as_matrix(), atol=1e-9)
    assert ate(path, estimate, "sim3")["rmse"] <= best <= ate(path, estimate, "se2")["rmse"] + 10


def test_se2_leaves_height_and_se3_may_turn_a_plane_over(path):
    flat = path * np.array([1, 1, 0.0])[None]
    mirrored = flat * np.array([1, -1, 1.0])[None]
    assert ate(flat, mirrored, "se3")["max"] < 1e-10
    assert ate(flat, mirrored, "se2")["rmse"] > 0.5
    np.testing.assert_allclose(ate(flat, flat + np.array([[0, 0, 2.0]]), "se2")["min"], 2.0)


def test_statistics_of_known_errors():
    values = statistics(np.array([3.0, 4.0, 5.0, 0.0]))
    assert values["mean"] == 3 and values["median"] == 3.5 and values["max"] == 5 and values["min"] == 0
    assert values["rmse"] == pytest.approx(np.sqrt(12.5)) and values["std"] == pytest.approx(np.sqrt(3.5))


def test_arc_length_compares_places_not_instants():
    angle = np.linspace(0, 2 * np.pi, 4000)
    circle = 5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    slow_then_fast = circle[np.unique((np.linspace(0, 1, 900) ** 3 * 3999).astype(int))]
    np.testing.assert_allclose(arc_length(circle)[-1], 10 * np.pi, rtol=1e-5)
    reference, estimate = arc_length_association(circle, slow_then_fast, 700)
    assert reference.shape == (700, 3)
    assert ate(reference, estimate)["max"] < 0.02


def test_rpe_sees_only_the_steps():
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, :3] = Rotation.random(40, rng=3).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(40, 3))
    elsewhere = np.eye(4)
    elsewhere[:3, :3], elsewhere[:3, 3] = Rotation.from_rotvec([1, 2, 3]).as_matrix(), [9, 9, 9]
    errors = rpe(poses, elsewhere[None] @ poses, delta=3)
    assert errors["translation_m"]["max"] < 1e-12 and errors["rotation_deg"]["max"] < 1e-12
    slip = np.eye(4)
    slip[:3, :3], slip[:3, 3] = Rotation.from_rotvec([0, 0, np.deg2rad(2.0)]).as_matrix(), [0.03, 0.04, 0]
    estimate = poses.copy()
    for k in range(1, 40):
        estimate[k] = estimate[k - 1] @ np.linalg.inv(poses[k - 1]) @ poses[k] @ slip
    errors = rpe(poses, estimate)
    np.testing.assert_allclose([errors["translation_m"][k] for k in ("min", "max")], 0.05, atol=1e-12)
    np.testing.assert_allclose([errors["rotation_deg"][k] for k in ("min", "max")], 2.0, atol=1e-9)


def test_undefined_errors_are_refused(path):
    still = np.zeros((5, 3))
    with pytest.raises(ValueError, match="never move"):
        ate(path[:5], still, "se3")
    with pytest.raises(ValueError, match="never move"):
        arc_length_association(path, still)
    with pytest.raises(ValueError, match="two or more"):
        arc_length_association(path, path, 1)
    with pytest.raises(ValueError, match="no associated"):
        ate(path[:0], path[:0])
    with pytest.raises(ValueError, match="no pair 5 rows apart"):
        rpe(np.tile(np.eye(4), (5, 1, 1)), np.tile(np.eye(4), (5, 1, 1)), delta=5)


def evo_reference(file):
    """Pairs of command words and the statistics that evo printed for them."""
    command: list[str] = []
    for line in file.read_text().splitlines():
        if line.startswith("$"):
            command = line.split()[1:]
        else:
            yield command, {name: float(value) for name, value in re.findall(r"(\w+)\t([\d.]+)", line)}


@pytest.mark.slow
@pytest.mark.parametrize("folder, suffix, least", [("trajectories", ".gz", 9), ("d5_pose_graph", ".gz", 5)])
def test_every_number_of_evo(data, folder, suffix, least):
    checked = 0
    for command, expected in evo_reference(data(folder) / "evo_reference.txt"):
        files = [data(folder) / (name + suffix) for name in command[2:4]]
        if not all(file.exists() for file in files):
            continue
        reference, estimate = (read(file) for file in files)
        i = j = np.arange(len(reference.poses))
        if command[1] == "tum":
            i, j = associate(reference.timestamps, estimate.timestamps)
        if command[0] == "evo_rpe":
            errors = rpe(reference.poses[i], estimate.poses[j])
            found = errors["rotation_deg" if "angle_deg" in command else "translation_m"]
        else:
            group = "sim3" if "-as" in command else "se3" if "-a" in command else "none"
            first = int(command[-1]) if "--n_to_align" in command else None
            found = ate(reference.poses[i, :3, 3], estimate.poses[j, :3, 3], group, first)
        for name in found:
            assert found[name] == pytest.approx(expected[name], abs=2e-6), (command, name)
        checked += 1
    assert checked >= least
