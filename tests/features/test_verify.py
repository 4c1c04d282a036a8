import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

from ebjax.features.matching import Features
from ebjax.features.refine import refine
from ebjax.features.verify import log10_false_alarms, verify
from ebjax.geometry.homography import apply

MOTIONS = {
    "rigid": np.array([[-0.9, -0.43589, 2.0], [0.43589, -0.9, 1.0], [0, 0, 1]]),
    "similarity": np.array([[-1.1, -0.3, 2.0], [0.3, -1.1, 1.0], [0, 0, 1]]),
    "homography": np.array([[-0.9, -0.4, 2.0], [0.5, -1.1, 1.0], [0.03, -0.02, 1]]),
}


def make(model, seed=0, count=120, noise=0.002, ambiguous=0):
    """Two feature sets that share 70 of 120 keypoints; `ambiguous` of the shared look alike."""
    random = np.random.default_rng(seed)
    points_r = random.uniform(-1, 1, (count, 2))
    points_q = np.array(apply(MOTIONS[model], points_r)) + noise * random.standard_normal((count, 2))
    points_q[70:] = random.uniform(0, 3, (count - 70, 2))
    descriptors = random.random((count, 32))
    descriptors[:ambiguous] = descriptors[0] + 0.02 * random.standard_normal((ambiguous, 32))
    other = descriptors + 0.05 * random.standard_normal((count, 32))
    unit = lambda d: d / np.linalg.norm(d, axis=1, keepdims=True)  # noqa: E731
    order = random.permutation(count)
    valid = jnp.ones(count, bool)
    query = Features(jnp.asarray(points_q), jnp.asarray(unit(descriptors)), valid)
    reference = Features(jnp.asarray(points_r[order]), jnp.asarray(unit(other[order])), valid)
    return query, reference


@pytest.mark.parametrize("model", MOTIONS)
def test_finds_the_motion_and_its_inliers(model):
    query, reference = make(model)
    found = verify(
        query, reference, query.keypoints, reference.keypoints, key=jax.random.key(0), tolerance=0.02, model=model
    )
    assert int(found.total) >= int(found.count) >= 65
    assert np.mean(np.asarray(found.query)[np.asarray(found.inliers)] < 70) > 0.95
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    np.testing.assert_allclose(
        apply(found.query_from_reference, corners), np.asarray(apply(MOTIONS[model], corners)), atol=0.02
    )


@pytest.mark.parametrize("model", MOTIONS)
def test_guided_matches_resolve_what_looks_alike(model):
    query, reference = make(model, ambiguous=40)
    off = jnp.array([[1, 0, 0.03], [0, 1, -0.03], [0, 0, 1]]) @ MOTIONS[model]
    plain = verify(
        query, reference, query.keypoints, reference.keypoints, key=jax.random.key(0), tolerance=0.02, model=model
    )
    found = refine(query, reference, query.keypoints, reference.keypoints, off, tolerance=0.02, model=model)
    assert int(found.count) >= 68 > int(plain.count)
    at = np.array(reference.keypoints)
    error = lambda h: np.linalg.norm(np.asarray(apply(h, at) - apply(MOTIONS[model], at)), axis=1).mean()  # noqa: E731
    assert error(found.query_from_reference) < min(0.002, error(off) / 10)


def test_nothing_to_match_gives_identity():
    query, reference = make("rigid")
    none = Features(query.keypoints, query.descriptors, jnp.zeros(120, bool))
    found = verify(none, reference, none.keypoints, reference.keypoints, key=jax.random.key(0), tolerance=0.02)
    assert int(found.count) == int(found.total) == 0
    np.testing.assert_array_equal(found.query_from_reference, np.eye(3))


def test_false_alarms_count_what_chance_would_show():
    # With the C(n, m) minimal sets fixed, the rest is a binomial tail; the formula bounds it from above.
    for n, k in ((50, 12), (200, 20), (200, 60)):
        tail = np.log10(binom.sf(k - 5, n - 4, 3e-4))
        sets = np.log10(float(np.prod(np.arange(n - 3, n + 1)) / 24))
        assert log10_false_alarms(k, n, 3e-4, "homography") >= tail + sets - 1e-9
    assert log10_false_alarms(6, 120, 3e-4, "homography") > 0 > log10_false_alarms(20, 120, 3e-4, "homography")
    assert log10_false_alarms(4, 9, 3e-4, "homography") == np.inf
    assert log10_false_alarms(30, 100, 3e-4, "rigid") < log10_false_alarms(20, 100, 3e-4, "rigid")
