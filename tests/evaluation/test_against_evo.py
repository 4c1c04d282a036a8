import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.evaluation.association import associate
from ebjax.evaluation.trajectory import ate, rpe
from ebjax.io.poses import poses_from

core = pytest.importorskip("evo.core")
sync, metrics, paths = (pytest.importorskip(f"evo.core.{name}") for name in ("sync", "metrics", "trajectory"))


def random_pair(seed, counts, jitter, noise, scale=1.0):
    """A walk in space at two samplings, the estimate moved, scaled and noisy."""
    rng = np.random.default_rng(seed)
    dense = np.cumsum(rng.normal(0, 0.05, (4000, 3)), axis=0)
    clock = np.linspace(0, 40, 4000)
    sides = []
    for count in counts:
        times = np.sort(np.linspace(0.2, 39.8, count) + rng.uniform(-jitter, jitter, count))
        place = np.stack([np.interp(times, clock, dense[:, k]) for k in range(3)], axis=1)
        turn = np.stack([0.1 * times, 0.3 * np.sin(times), 0.2 * np.cos(times)], axis=1)
        sides.append((times, place, Rotation.from_rotvec(turn).as_matrix()))
    (reference_times, place, rotation), (times, other, other_rotation) = sides
    motion = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    other = scale * other @ motion.T + rng.normal(size=(1, 3)) + rng.normal(0, noise, other.shape)
    other_rotation = motion @ other_rotation @ Rotation.from_rotvec(rng.normal(0, 0.02, other.shape)).as_matrix()
    return (reference_times, poses_from(rotation, place)), (times, poses_from(other_rotation, other))


def evo_of(times, poses):
    return paths.PoseTrajectory3D(poses_se3=list(poses), timestamps=times)


def evo_statistics(metric):
    found = metric.get_all_statistics()
    return [found[name] for name in ("rmse", "mean", "median", "max", "min", "std")]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "counts, jitter, noise, scale, offset",
    [((400, 400), 0.004, 0.02, 1.0, 0.0), ((400, 133), 0.01, 0.2, 3.0, 1e3), ((97, 800), 0.02, 0.05, 0.01, -7.25)],
)
def test_pairs_and_errors(seed, counts, jitter, noise, scale, offset):
    (reference_times, reference), (times, estimate) = random_pair(seed, counts, jitter, noise, scale)
    times = times - offset
    theirs = sync.associate_trajectories(
        evo_of(reference_times, reference), evo_of(times, estimate), max_diff=0.03, offset_2=offset
    )
    i, j = associate(reference_times, times + offset, 0.03)
    np.testing.assert_array_equal(reference_times[i], theirs[0].timestamps)
    np.testing.assert_array_equal(times[j], theirs[1].timestamps)
    assert len(i) > 0.5 * min(counts)
    for name, options in (("none", None), ("se3", {}), ("sim3", {"correct_scale": True})):
        aligned = paths.PoseTrajectory3D(poses_se3=[p.copy() for p in theirs[1].poses_se3], timestamps=times[j])
        if options is not None:
            aligned.align(theirs[0], **options)
        metric = metrics.APE(metrics.PoseRelation.translation_part)
        metric.process_data((theirs[0], aligned))
        found = ate(reference[i, :3, 3], estimate[j, :3, 3], name)
        np.testing.assert_allclose(list(found.values()), evo_statistics(metric), rtol=1e-9, atol=1e-9)
    steps = rpe(reference[i], estimate[j], 1)
    for part, relation in (
        ("translation_m", metrics.PoseRelation.translation_part),
        ("rotation_deg", metrics.PoseRelation.rotation_angle_deg),
    ):
        metric = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames, all_pairs=True)
        metric.process_data(theirs)
        np.testing.assert_allclose(list(steps[part].values()), evo_statistics(metric), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_se2_is_the_fit_in_the_plane(seed):
    rng = np.random.default_rng(seed)
    place = np.cumsum(rng.normal(size=(80, 3)) * np.array([[1, 1, 0.0]]), axis=0)
    turn = Rotation.from_rotvec([0, 0, 2.0]).as_matrix()
    estimate = place @ turn.T + np.array([[4, -7, 0.0]]) + rng.normal(0, 0.1, place.shape) * np.array([[1, 1, 0.0]])
    still = np.tile(np.eye(3), (80, 1, 1))
    sides = [paths.PosePath3D(poses_se3=list(poses_from(still, points))) for points in (place, estimate)]
    sides[1].align(sides[0])
    metric = metrics.APE(metrics.PoseRelation.translation_part)
    metric.process_data(tuple(sides))
    np.testing.assert_allclose(list(ate(place, estimate, "se2").values()), evo_statistics(metric), atol=1e-9)
