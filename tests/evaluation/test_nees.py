import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from ebjax.evaluation.nees import (
    between,
    log,
    mean_interval,
    nees,
    pairs_along,
    summaries,
    summary,
    tangent_errors,
    with_scale,
)
from ebjax.geometry import se2


def test_log_and_between_are_those_of_se2():
    rng = np.random.default_rng(0)
    a, b = (rng.normal(size=(200, 3)) * [2, 2, 1.5] for _ in range(2))
    a[:3, 2], b[:3, 2] = 0, [0, 1e-9, 3.1]
    a_from_b = se2.compose(se2.inverse(jnp.asarray(a)), jnp.asarray(b))
    np.testing.assert_allclose(between(a, b), a_from_b, atol=1e-12)
    error = tangent_errors(a, b)
    np.testing.assert_allclose(error, se2.log(a_from_b), atol=1e-11)
    np.testing.assert_allclose(log(np.asarray(a_from_b)), error, atol=1e-11)


def test_interval_is_that_of_chi_squared():
    for n in (1, 7, 500):
        np.testing.assert_allclose(mean_interval(n), chi2.ppf([0.025, 0.975], 3 * n) / n, rtol=1e-9)


def test_nees_of_errors_drawn_from_their_covariance():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(2000, 3, 3)) * np.array([0.02, 0.01, 0.005])[None, :, None]
    covariance = root @ root.swapaxes(1, 2) + 1e-8 * np.eye(3)[None]
    error = np.einsum("kij,kj->ki", np.linalg.cholesky(covariance), rng.normal(size=(2000, 3)))
    found = summary(error, covariance)
    low, high = found["nees_mean_interval"]
    assert low < found["nees_mean"] < high and found["n"] == 2000
    assert found["nees_median"] == pytest.approx(chi2.median(3), abs=0.15)
    assert found["rms_error_m"] == pytest.approx(found["rms_sigma_m"], rel=0.05)
    assert found["rms_error_deg"] == pytest.approx(found["rms_sigma_deg"], rel=0.05)
    np.testing.assert_allclose(nees(error, 4 * covariance), nees(error, covariance) / 4)


def test_groups_are_those_of_rows_with_truth_in_order():
    error, covariance = np.ones((5, 3)), np.tile(np.eye(3), (5, 1, 1))
    error[4] = np.nan
    found = summaries(error, covariance, {"gap": ["10", "2", "2", "1", "3"], "kind": list("baaba")})
    assert list(found) == ["all", "gap 1", "gap 2", "gap 10", "kind a", "kind b"]
    assert [values["n"] for values in found.values()] == [4, 1, 2, 1, 2, 2]
    assert summaries(error[4:], covariance[4:]) == {}


def test_pairs_spread_along_the_path_and_keep_their_distance():
    path = np.cumsum(np.full(400, 0.1))
    known = np.ones(400, bool)
    known[200:230] = False
    a, b = pairs_along(path, known, 5.0, 40)
    assert 30 <= len(a) <= 40 and known[a].all() and known[b].all()
    assert np.abs(path[b] - path[a] - 5.0).max() <= 1.0
    assert a[0] == 0 and b[-1] == 399 and np.diff(a).max() < 60
    assert len(pairs_along(path, known, 60.0, 40)[0]) == 0
    assert len(pairs_along(path, np.zeros(400, bool), 5.0, 40)[0]) == 0
    standing = np.zeros(30)
    assert len(pairs_along(standing, np.ones(30, bool), 1.0, 40)[0]) == 0
    # Frames too sparse for a metre are no pair of a metre.
    assert len(pairs_along(np.arange(10) * 3.0, np.ones(10, bool), 1.0, 40)[0]) == 0


def test_a_common_scale_stretches_along_the_way_alone():
    a_from_b = np.array([[20.0, 0.0, 0.0], [0.0, 5.0, np.pi / 2], [0.0, 0.0, 1.0]])
    covariance = np.tile(1e-6 * np.eye(3), (3, 1, 1))
    wider = with_scale(covariance, a_from_b, 1e-3)
    # Right tangent: along b's own axes. b of the second looks along the way as well.
    np.testing.assert_allclose(np.sqrt(wider[0].diagonal()), [np.hypot(0.02, 1e-3), 1e-3, 1e-3])
    np.testing.assert_allclose(np.sqrt(wider[1].diagonal()), [np.hypot(0.005, 1e-3), 1e-3, 1e-3])
    np.testing.assert_array_equal(wider[2], covariance[2])
    scaled = a_from_b * [1.001, 1.001, 1.0]
    assert nees(tangent_errors(a_from_b, scaled)[:1], wider[:1] - covariance[:1] + 1e-12 * np.eye(3)) < 1.01
