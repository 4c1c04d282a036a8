"""Order and count of calls; the interval of a median, on samples with tails as heavy as those of a loaded machine."""

import itertools

import numpy as np
import pytest
from scipy.stats import binom

from ebjax.bench.gate import FEWEST_TURNS, Verdict, verdict
from ebjax.bench.turns import FEWEST, SHARE, in_turn, median_interval


def test_everyone_is_called_once_a_turn_in_random_order():
    called = []
    calls = {name: lambda name=name: called.append(name) for name in "abc"}
    ticks = itertools.count()
    seconds = in_turn(calls, 40, clock=lambda: float(next(ticks)))
    assert called[:3] == ["a", "b", "c"]
    turns = [tuple(called[k : k + 3]) for k in range(3, len(called), 3)]
    assert len(turns) == 40 and all(sorted(turn) == ["a", "b", "c"] for turn in turns) and len(set(turns)) == 6
    assert all((taken == 1).all() and len(taken) == 40 for taken in seconds.values())


@pytest.mark.parametrize("count", [FEWEST, 15, 16, 51])
def test_the_interval_is_the_narrowest_that_order_statistics_allow(count):
    values = np.random.default_rng(count).permutation(count) + 1.0
    low, median, high = median_interval(values)
    k = int(low)
    assert median == (count + 1) / 2 and high == count + 1 - k
    assert 2 * binom.cdf(k - 1, count, 0.5) <= 1 - SHARE < 2 * binom.cdf(k, count, 0.5)


def test_too_few_values_have_no_interval():
    with pytest.raises(ValueError, match="5 values say too little"):
        median_interval(np.ones(FEWEST - 1))


def ratios(rng, centre, runs):
    """Of turns: a tenth of spread with the tails of Student's t at 3 degrees of freedom, and one in ten doubled."""
    shape = runs, FEWEST_TURNS
    wild = np.where(rng.uniform(size=shape) < 0.05, 2.0, 1.0) / np.where(rng.uniform(size=shape) < 0.05, 2.0, 1.0)
    return centre * np.exp(0.06 * rng.standard_t(3, shape)) * wild


def test_the_interval_holds_the_median_as_often_as_it_says():
    found = [median_interval(values) for values in ratios(np.random.default_rng(0), 0.3, 2000)]
    held = np.mean([low <= 0.3 <= high for low, _, high in found])
    assert SHARE <= held < 0.98


@pytest.mark.parametrize(
    ("times", "expected", "least"),
    [
        (1.0, Verdict.AS_BEFORE, 1.0),
        (1.1, Verdict.AS_BEFORE, 0.99),
        (1.3, Verdict.SLOWER, 0.9),
        (0.75, Verdict.FASTER, 0.9),
    ],
)
def test_a_verdict_is_right_under_load(times, expected, least):
    found = [verdict(median_interval(values), 0.3) for values in ratios(np.random.default_rng(1), 0.3 * times, 1000)]
    assert np.mean([one is expected for one in found]) >= least
