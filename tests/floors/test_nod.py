from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.cameras import CameraConfig
from ebjax.floors.nod import make_nod, nodded, with_tilt_of
from ebjax.floors.plan import PlanConfig
from ebjax.floors.ramp import make_ramp, stand
from ebjax.floors.rays import bent_rays
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.sequence import CorridorConfig, check, record
from ebjax.floors.surface import FloorConfig

LEVEL = CorridorConfig(
    floor=FloorConfig(texel_m=0.02),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0),
    camera=CameraConfig("gopro-wide", width=96),
    # A readout of almost nothing: one program with what is read row by row.
    sensor=SensorConfig(depth_noise=0.0, depth_holes=0.0, readout_s=1e-6),
)
NODDING = replace(LEVEL, robot=replace(LEVEL.robot, nod_deg=3.0))
pytestmark = pytest.mark.usefixtures("any_floor")
RAMP = PlanConfig(ramp="0.3 0, 0.8 0", ramp_deg=10.0)


@pytest.fixture(scope="module")
def level(any_floor):
    return record(LEVEL)


@pytest.fixture(scope="module")
def nodding(any_floor):
    return record(NODDING)


@pytest.fixture
def seen_from(monkeypatch):
    """Renders nothing; collects the poses that frames are seen from."""
    seen = []

    def note(scene, camera, world_from_base, *rest):
        seen.append(np.asarray(world_from_base))
        return jnp.zeros((*camera.size, 3)), jnp.zeros(camera.size)

    monkeypatch.setattr("ebjax.floors.sequence._see", note)
    return seen


def roll_pitch_yaw(poses):
    r = poses[..., :3, :3]
    return np.arctan2(r[..., 2, 1], r[..., 2, 2]), -np.arcsin(r[..., 2, 0]), np.arctan2(r[..., 1, 0], r[..., 0, 0])


def test_pitch_and_roll_have_the_rms_and_the_bound_that_are_promised():
    times = np.arange(0, 4000, 0.05)
    for seed in range(4):
        angles = np.degrees(make_nod(2.0, seed).angles(times))
        np.testing.assert_allclose(np.sqrt(np.mean(angles**2, axis=0)), np.sqrt(2), rtol=0.01)
        assert 2.7 < np.abs(angles).max() <= 2.8
    spectrum = np.abs(np.fft.rfft(angles[:, 0]))
    peaks = np.fft.rfftfreq(len(times), 0.05)[np.sort(np.argsort(spectrum)[-2:])]
    np.testing.assert_allclose(peaks, [0.37, 0.73], atol=1e-3)


def test_the_phases_follow_from_the_seed():
    assert np.all(make_nod(2.0, 5).phases == make_nod(1.0, 5).phases) and make_nod(0.0, 5) is None
    assert len({make_nod(1.0, seed).phases[0, 0] for seed in (-1, 0, 1, 2)}) == 4


def test_the_body_turns_about_the_base():
    times, nod = np.array([0.0, 1.3, 2.1]), make_nod(4.0, 0)
    bases = stand(np.array([[0, 0, 0], [1, 2, 0.5], [2, 2, -2.0]], np.float64), None)
    roll, pitch, yaw = roll_pitch_yaw(nodded(bases, nod, times))
    np.testing.assert_allclose(np.stack([pitch, roll], axis=1), nod.angles(times), atol=1e-12)
    np.testing.assert_allclose(yaw, [0, 0.5, -2.0], atol=1e-12)
    np.testing.assert_allclose(nodded(bases, nod, times)[:, :, 3], bases[:, :, 3])
    ahead = nodded(bases, nod._replace(phases=np.full((2, 2), np.pi / 2)), np.zeros(3)) @ [1.0, 0, 0, 1]
    assert np.all(ahead[:, 2] < 0), "a positive pitch looks down"


def test_images_nod_while_truth_and_odometry_stay_planar(level, nodding):
    assert np.all(nodding.world_from_base == level.world_from_base)
    assert np.all(nodding.odom_from_base == level.odom_from_base)
    assert np.all(level.world_from_body == level.world_from_base)
    roll, pitch, _ = roll_pitch_yaw(nodding.world_from_body)
    assert 0.5 < np.degrees(np.abs(np.stack([roll, pitch])).max()) < 4.3
    assert np.abs(nodding.frame(3)[0].astype(int) - level.frame(3)[0]).mean() > 2


def test_depth_lies_on_the_floor_below_the_nodding_body(nodding):
    cam = nodding.camera
    rays = np.asarray(bent_rays(cam).directions).reshape(3, -1)
    lower = np.arange(rays.shape[1]) >= rays.shape[1] * 19 // 20
    for i in (2, 5):
        depth = nodding.frame(i)[1].ravel() / 1000
        points, low = np.concatenate([rays * depth, np.ones_like(rays[:1])]), lower & (depth > 0)
        heights = [
            (w[i] @ cam.base_from_camera @ points)[2, low] for w in (nodding.world_from_body, nodding.world_from_base)
        ]
        assert np.abs(heights[0]).max() < 2e-3 < np.abs(heights[1]).max()


@pytest.mark.parametrize("plan", [PlanConfig(), RAMP])
def test_rows_of_a_rolling_shutter_nod_on(seen_from, plan):
    run = record(replace(NODDING, plan=plan, sensor=replace(NODDING.sensor, readout_s=0.4)))
    run.frame(3)
    rows, nod = seen_from[-1], make_nod(3.0, 0)
    assert rows.shape == (run.camera.height, 4, 4)
    times = run.timestamps[3] - 1000.0 + np.linspace(-0.2, 0.2, len(rows))
    expected = nodded(np.tile(np.eye(4), (len(rows), 1, 1)), nod, times)
    standing = rows @ np.linalg.inv(expected)
    middle = (standing[35] + standing[36]) / 2
    np.testing.assert_allclose(middle[:3], run.world_from_base[3, :3], atol=2e-3)
    roll, pitch, _ = roll_pitch_yaw(standing)
    assert plan is RAMP or max(np.abs(roll).max(), np.abs(pitch).max()) < 1e-6


@pytest.mark.parametrize("plan", [PlanConfig(), RAMP])
def test_an_odometry_with_tilt_has_the_true_pitch_and_roll(seen_from, plan):
    config = replace(NODDING, plan=plan, robot=replace(NODDING.robot, odometry_tilt=True))
    run, planar = record(config), record(replace(config, robot=replace(config.robot, odometry_tilt=False)))
    (roll, pitch, _), (true_roll, true_pitch, _) = map(roll_pitch_yaw, (run.odom_from_base, run.world_from_body))
    np.testing.assert_allclose(roll, true_roll, atol=1e-12)
    np.testing.assert_allclose(pitch, true_pitch, atol=1e-12)
    yaw, planar_yaw = (roll_pitch_yaw(r.odom_from_base)[2] for r in (run, planar))
    np.testing.assert_allclose(yaw, planar_yaw, atol=1e-12)
    assert np.all(run.odom_from_base[:, :3, 3] == planar.odom_from_base[:, :3, 3])
    assert np.all(planar.odom_from_base[:, 2, 2] == 1) and np.abs(pitch).max() > 0.01


def test_on_a_ramp_the_body_nods_on_the_slope():
    poses = np.stack([np.linspace(0, 2, 9), np.zeros(9), np.zeros(9)], axis=1)
    standing, times = stand(poses, make_ramp(RAMP)), 0.5 * np.arange(9)
    body = nodded(standing, make_nod(3.0, 0), times)
    level_body = nodded(stand(poses, None), make_nod(3.0, 0), times)
    np.testing.assert_allclose(
        np.linalg.inv(standing) @ body, np.linalg.inv(stand(poses, None)) @ level_body, atol=1e-12
    )
    np.testing.assert_allclose(with_tilt_of(stand(poses, None), standing)[:, :3, :3], standing[:, :3, :3], atol=1e-12)


@pytest.mark.parametrize("nod_deg", [-1.0, 20.0, float("nan")])
def test_bad_values_name_their_key(nod_deg):
    with pytest.raises(ValueError, match=r"^robot\.nod_deg is"):
        check(replace(LEVEL, robot=replace(LEVEL.robot, nod_deg=nod_deg)))


@pytest.mark.parametrize("camera", [CameraConfig(width=80, height_m=0.02), CameraConfig(width=80, height_m=2.4)])
def test_a_camera_that_nods_into_something_names_the_key(camera):
    plan = replace(LEVEL.plan, width_m=1.3) if camera.height_m > 1 else LEVEL.plan
    robot = replace(LEVEL.robot, nod_deg=15.0)
    with pytest.raises(ValueError, match=r"^robot\.nod_deg is 15\.0: the camera"):
        record(replace(LEVEL, camera=camera, robot=robot, plan=plan))
