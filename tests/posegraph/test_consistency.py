from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.geometry import se2
from ebjax.posegraph.consistency import all_cycles, consistent_set, largest_clique, make_loops
from ebjax.posegraph.robust import CHI2_99

SIGMAS, CLOSURE = np.array([0.002, 0.001, 0.002]), np.array([0.01, 0.01, 0.003])


def corridor(n=600, closures=40, bad=0, seed=0):
    """There and back; loops between facing poses, of which the last `bad` are wrong."""
    rng = np.random.default_rng(seed)
    step = np.zeros((n - 1, 3))
    step[:, 0], step[n // 2 - 1, 2] = 0.05, np.pi
    walk = jax.jit(lambda s: jax.lax.scan(lambda p, d: (se2.compose(p, d),) * 2, jnp.zeros(3), s)[1])
    truth = jnp.concatenate([jnp.zeros((1, 3)), walk(jnp.asarray(step))])
    odometry = jnp.concatenate([jnp.zeros((1, 3)), walk(jnp.asarray(step + rng.normal(size=step.shape) * SIGMAS))])
    i = rng.integers(0, n // 2 - 30, closures)
    j = n - 1 - i - rng.integers(0, 20, closures)
    error = rng.normal(size=(closures, 3)) * CLOSURE
    error[closures - bad :] += rng.choice([-1, 1], (bad, 3)) * rng.uniform(0.3, 1.5, (bad, 3))
    measured = se2.compose(se2.compose(se2.inverse(truth[i]), truth[j]), se2.exp(jnp.asarray(error)))
    covariance = np.broadcast_to(np.diag(CLOSURE**2), (closures, 3, 3))
    return odometry, i, j, measured, covariance


def test_cycles_of_good_closures_are_chi_square_distributed():
    n, runs, rng = 600, 400, np.random.default_rng(0)
    step = np.zeros((n - 1, 3))
    step[:, 0], step[n // 2 - 1, 2] = 0.05, np.pi
    start = jnp.zeros((1, 3))
    walk = jax.jit(lambda s: jax.lax.scan(lambda p, d: (se2.compose(p, d),) * 2, start[0], s)[1])
    truth = jnp.concatenate([start, walk(jnp.asarray(step))])
    i, j = jnp.array([10, 250, 100]), jnp.array([580, 340, 480])
    measured = se2.compose(se2.inverse(truth[i]), truth[j])
    steps = jnp.broadcast_to(jnp.diag(jnp.asarray(SIGMAS**2)), (n - 1, 3, 3))
    covariance = jnp.broadcast_to(jnp.diag(jnp.asarray(CLOSURE**2)), (3, 3, 3))

    def once(step_error, error):
        odometry = jnp.concatenate([start, walk(step + step_error)])
        return all_cycles(make_loops(odometry, steps, i, j, se2.compose(measured, se2.exp(error)), covariance))

    errors = rng.normal(size=(runs, n - 1, 3)) * SIGMAS, rng.normal(size=(runs, 3, 3)) * CLOSURE
    distances = np.asarray(jax.jit(jax.vmap(once))(*map(jnp.asarray, errors)))
    assert abs(distances[:, range(3), range(3)]).max() < 1e-15
    np.testing.assert_allclose(distances, distances.swapaxes(1, 2), rtol=0.1, atol=1e-2)
    apart = distances[:, [0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(apart.mean(0), 3, atol=0.5)
    assert abs(np.mean(apart > CHI2_99[3]) - 0.01) < 0.012


def test_keeps_the_good_and_drops_the_bad():
    odometry, i, j, measured, covariance = corridor(bad=20)
    kept = consistent_set(odometry, SIGMAS, i, j, measured, covariance, np.ones(40))
    assert kept[:20].sum() >= 17
    assert not kept[20:].any()


def test_closures_that_agree_on_the_same_error_win_only_by_number():
    odometry, i, j, measured, covariance = corridor(closures=12)
    shifted = measured.at[:5].set(se2.compose(measured[:5], jnp.broadcast_to(jnp.array([3.0, 0, 0]), (5, 3))))
    kept = consistent_set(odometry, SIGMAS, i, j, shifted, covariance, np.ones(12))
    assert kept[5:].sum() >= 6
    assert not kept[:5].any()


def test_no_closure_and_one_closure():
    odometry, i, j, measured, covariance = corridor(closures=1)
    nothing = slice(0, 0)
    none = consistent_set(odometry, SIGMAS, i[nothing], j[nothing], measured[nothing], covariance[nothing], np.ones(0))
    assert none.shape == (0,)
    assert consistent_set(odometry, SIGMAS, i, j, measured, covariance, np.ones(1)).all()


def test_largest_clique_is_that_of_brute_force_with_ties_by_weight():
    rng = np.random.default_rng(0)
    for _ in range(60):
        k = int(rng.integers(1, 10))
        adjacent = np.triu(rng.random((k, k)) < rng.random(), 1)
        adjacent = adjacent | adjacent.T
        weights = rng.integers(1, 5, k).astype(float)
        cliques = (c for r in range(1, k + 1) for c in combinations(range(k), r))
        best = max(
            (len(c), weights[list(c)].sum()) for c in cliques if all(adjacent[p, q] for p, q in combinations(c, 2))
        )
        found = largest_clique(adjacent, weights)
        assert (found.sum(), weights[found].sum()) == best
        assert adjacent[np.ix_(found, found)].sum() == found.sum() * (found.sum() - 1)
