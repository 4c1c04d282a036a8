from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from ebjax.config import load_config
from ebjax.floors.__main__ import Config
from ebjax.floors.cameras import CameraConfig
from ebjax.floors.passers import PassersConfig
from ebjax.floors.plan import PlanConfig
from ebjax.floors.robot import RobotConfig, drive
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.sequence import CorridorConfig, check, check_inside, moments, plan_of, record
from ebjax.floors.surface import FloorConfig

WORLDS = Path(__file__).parents[2] / "configs" / "worlds"
SMALL = CorridorConfig(
    floor=FloorConfig(texel_m=0.02),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0),
    camera=CameraConfig(width=80),
)


@pytest.fixture(scope="module")
def recording():
    return record(SMALL)


@pytest.mark.slow
def test_a_rolling_shutter_skews_what_the_robot_turns_past(recording):
    rolling = record(replace(SMALL, sensor=SensorConfig(readout_s=0.1)))
    turns = int(np.argmax(np.abs(np.diff(recording.world_from_base[:, 0, 0])))) + 1
    (still, _), (skewed, _) = (run.frame(turns) for run in (recording, rolling))
    differs = np.abs(still.astype(int) - skewed).mean(axis=(1, 2))
    assert differs[[0, -1]].min() > 3 * differs[len(differs) // 2] and differs.max() > 3
    assert np.all(rolling.world_from_base == recording.world_from_base)


def test_moments_lie_around_the_frame_and_reach_over_the_readout():
    config = replace(SMALL, sensor=SensorConfig(readout_s=0.05, shutter_s=0.02))
    poses = np.stack([np.arange(5.0), np.zeros(5), 0.2 * np.arange(5)], axis=1)
    at = moments(poses, 2, 61, config)
    assert at.shape == (3, 61, 3)
    np.testing.assert_allclose(at[1, 30], poses[2])
    np.testing.assert_allclose(at[1, -1] - at[1, 0], [0.1, 0, 0.02])
    np.testing.assert_allclose(at[2, 5] - at[0, 5], [0.04, 0, 0.008])
    assert np.all(moments(poses, 2, 61, SMALL) == poses[2])


@pytest.mark.slow
def test_on_a_ramp_the_truth_climbs_and_pitches(tmp_path):
    config = replace(SMALL, plan=PlanConfig(ramp="0.3 0, 0.8 0", ramp_deg=10.0))
    run, level = record(config), record(SMALL)
    top = 0.5 * np.tan(np.radians(10))
    np.testing.assert_allclose(run.world_from_base[[0, 2], 2, 3], [0, top], atol=1e-9)
    assert run.world_from_base[1, 2, 0] > 0.1 and np.all(run.odom_from_base[:, 2, 3] == 0)
    np.testing.assert_allclose(run.world_from_base[:, :2, 3], level.world_from_base[:, :2, 3])
    assert np.hypot(*run.odom_from_base[2, :2, 3]) > np.hypot(*level.odom_from_base[2, :2, 3]) + 0.004
    assert np.abs(run.frame(0)[0].astype(int) - level.frame(0)[0]).mean() > 3


@pytest.mark.slow
def test_another_seed_is_another_run(recording):
    other = record(replace(SMALL, seed=1))
    assert np.abs(other.frame(0)[0].astype(int) - recording.frame(0)[0]).mean() > 3
    assert np.abs(other.odom_from_base - recording.odom_from_base).max() > 0.001


def test_frames_are_float32_whatever_the_default(recording):
    assert {leaf.dtype for leaf in jax.tree.leaves(recording.camera)} == {np.dtype(np.float32)}


@pytest.mark.slow
def test_everything_at_once_is_a_function_of_the_seed():
    config = replace(
        SMALL,
        sun=1.0,
        landmarks_per_m=0.5,
        plan=PlanConfig(corridors=("0 0, 3 0, 3 3", "3 1.5, 6 1.5")),
        robot=replace(SMALL.robot, route="0 0, 3 0, 3 3", stops=1),
        passers=PassersConfig(share=0.9),
        sensor=SensorConfig(shutter_s=0.02),
    )
    one, two = record(config), record(config)
    for i in range(0, len(one), 5):
        for a, b in zip(one.frame(i), two.frame(i), strict=True):
            assert np.all(a == b)
    bare = record(replace(config, passers=PassersConfig(), landmarks_per_m=0.0))
    nearer = [np.mean(one.frame(i)[1].astype(int) < bare.frame(i)[1].astype(int) - 300) for i in range(0, len(one), 3)]
    assert max(nearer) > 0.05, "somebody stands in the way"


@pytest.mark.parametrize(
    "config, key",
    [
        (replace(SMALL, plan=PlanConfig(width_m=-1.0)), "plan.width_m"),
        (replace(SMALL, plan=PlanConfig(width_m=0.5)), "plan.width_m"),
        (replace(SMALL, plan=PlanConfig(margin_m=0.1)), "plan.margin_m"),
        (replace(SMALL, plan=PlanConfig(corridors=("0 0",))), r"plan.corridors\[0\]"),
        (replace(SMALL, plan=PlanConfig(corridors=("0 5, 1 5",))), "robot.route"),
        (replace(SMALL, gloss=2.0), "gloss"),
        (replace(SMALL, exposure_change=-0.1), "exposure_change"),
        (replace(SMALL, floor=replace(SMALL.floor, ageing_per_m2=-1.0)), "floor.ageing_per_m2"),
        (replace(SMALL, robot=replace(SMALL.robot, lateral_spread_m=-0.1)), "robot.lateral_spread_m"),
        (replace(SMALL, robot=replace(SMALL.robot, lateral_spread_m=0.9)), "plan.width_m"),
        (replace(SMALL, camera=replace(SMALL.camera, width=0)), "camera.width"),
        (replace(SMALL, camera=replace(SMALL.camera, height_m=3.0)), "camera.height_m"),
        (replace(SMALL, robot=replace(SMALL.robot, step_m=float("nan"))), "robot.step_m"),
        (replace(SMALL, passers=PassersConfig(share=1.5)), "passers.share"),
        (replace(SMALL, sensor=SensorConfig(shutter_s=-1.0)), "sensor.shutter_s"),
        (replace(SMALL, sensor=SensorConfig(readout_s=-1.0)), "sensor.readout_s"),
        (replace(SMALL, sensor=SensorConfig(readout_s=0.6)), "sensor.readout_s"),
        (replace(SMALL, plan=PlanConfig(ramp="1 0", ramp_deg=5.0)), "plan.ramp"),
        (replace(SMALL, plan=PlanConfig(ramp="0 0, 1 0", ramp_deg=25.0)), "plan.ramp_deg"),
        (
            replace(
                SMALL, plan=PlanConfig(ramp="0.1 0, 0.8 0", ramp_deg=9.0), camera=replace(SMALL.camera, height_m=0.02)
            ),
            "plan.ramp_deg",
        ),
    ],
)
def test_bad_values_name_their_key(config, key):
    with pytest.raises(ValueError, match=f"^{key} is"):
        record(config)


@pytest.mark.parametrize("path", sorted(WORLDS.glob("*.yaml")), ids=lambda path: path.stem)
def test_worlds_keep_the_robot_inside(path):
    config = load_config(path, Config)
    check(config)
    poses, passes = drive(config.robot, np.random.default_rng(config.seed))
    check_inside(config, plan_of(config), poses)
    assert 100 <= len(poses) <= 500 or path.stem == "laps"
    assert set(passes) == set(range(config.robot.passes))


def test_laps_are_ten_thousand_frames_each_pass_in_its_own_lane():
    config = load_config(WORLDS / "laps.yaml", Config)
    poses, passes = drive(config.robot, np.random.default_rng(config.seed))
    assert 10_000 <= len(poses) <= 10_200
    middle = [poses[(passes == p) & (np.abs(poses[:, 0]) < 10), 1].mean() for p in range(config.robot.passes)]
    there, back = np.array(middle[::2]), np.array(middle[1::2])
    assert max(np.abs(there).max(), np.abs(back + 0.25).max()) < config.robot.lateral_spread_m + 0.01
    assert min(np.ptp(there), np.ptp(back)) > config.robot.lateral_spread_m


def test_every_pass_is_exposed_anew():
    config = replace(SMALL, light_change=0.0, robot=replace(SMALL.robot, passes=4))
    plain, exposed = (record(replace(config, exposure_change=change)) for change in (0.0, 0.5))
    passes = drive(config.robot, np.random.default_rng(config.seed))[1]
    ratio = np.array([exposed.frame(i)[0].mean() / plain.frame(i)[0].mean() for i in range(len(plain))])
    of_pass = [ratio[passes == p] for p in range(4)]
    assert max(np.ptp(each) for each in of_pass) < 0.12 < np.ptp([np.median(each) for each in of_pass])
    assert np.all(plain.odom_from_base == exposed.odom_from_base)
