import numpy as np
import pytest

from ebjax.geometry.planar import between
from ebjax.slam.believe import CONTRADICTED, KEPT, THINNED, Belief, BeliefConfig
from ebjax.slam.measured import Measured
from ebjax.slam.walked import Walked
from ebjax.slam.why import REMEDIES, why_nothing

WAY = np.stack([np.linspace(0, 20, 101), np.zeros(101), np.zeros(101)], 1)
STEPS = np.tile(np.diag([1e-4, 1e-4, 1e-6]), (100, 1, 1))


def reasons_of(count=5, config=None, **changed):
    """Why closures are not believed that are changed so."""
    i, j = np.linspace(60, 100, count).astype(int), np.linspace(5, 30, count).astype(int)
    measured = {
        "i": i,
        "j": j,
        "opposing": np.zeros(count, bool),
        "distance": np.zeros(count),
        "inliers": np.full(count, 80),
        "total": np.full(count, 100),
        "i_from_j": between(WAY[i], WAY[j]),
        "covariance": np.tile(np.diag([1e-5, 1e-5, 1e-6]), (count, 1, 1)),
    }
    for name, change in changed.items():
        measured[name] = change(measured[name])
    belief = Belief(config or BeliefConfig())
    belief.update(Measured(**measured), Walked(WAY, STEPS, np.zeros(len(WAY), int)))
    return belief.reasons.tolist()


CHANGES = {
    "few inliers": ({"inliers": lambda a: a - 70}, "too few matches agree", "--extractor rootsift"),
    "low ratio": ({"total": lambda a: a * 5}, "too few matches agree", "--extractor rootsift"),
    "uncertain": ({"covariance": lambda a: 1e3 * a}, "uncertain", "--view"),
    "no depth": ({"i_from_j": lambda a: np.nan * a}, "no measurement", "--depth none"),
    "odometry": ({"i_from_j": lambda a: a + np.array([8.0, 8.0, 0])}, "contradicts odometry", "T_base_camera"),
}


@pytest.mark.parametrize("change,most,remedy", CHANGES.values(), ids=CHANGES)
def test_what_belief_says_has_its_remedy(change, most, remedy):
    reasons = reasons_of(**change)
    assert KEPT not in reasons
    said = why_nothing(reasons, len(reasons))
    assert said.startswith(f"no loop closure: of 5 candidates 5: {most}")
    assert remedy in said and "\n" not in said


def test_one_closure_alone_is_not_believed():
    reasons = reasons_of(count=1)
    assert reasons == ["no other closure supports it"]
    said = why_nothing(reasons, 1)
    assert "of 1 candidates 1: no other closure" in said and "--min-agreeing 1" in said


def test_closures_that_contradict_each_other_say_so():
    around = 2 * np.pi * np.array([0, 2, 4, 1, 3]) / 5
    reasons = reasons_of(i_from_j=lambda a: a + 0.4 * np.stack([np.cos(around), np.sin(around), 0 * around], 1))
    assert reasons.count("contradicts the other closures") == 4 and KEPT not in reasons
    said = why_nothing(reasons, 5)
    assert "contradicts the others" in said and "loop_closures.csv" in said
    assert "contradicts the others" in why_nothing([CONTRADICTED] * 3, 3)


@pytest.mark.parametrize("key,remedy", REMEDIES)
def test_the_commonest_reason_counts(key, remedy):
    others = [other for other, _ in REMEDIES if other != key]
    said = why_nothing([*others, THINNED, f"{key} 1", f"{key} 2", f"{key} 3"], 9)
    assert said.endswith(remedy)
    assert "of 9 candidates 3: " in said


def test_no_candidates_at_all():
    said = why_nothing([], 0)
    assert "no view was compared" in said and "--min-gap-s" in said


def test_reasons_without_a_remedy_are_shown():
    said = why_nothing([THINNED, "not among the best 5 spread along the path"], 2)
    assert "of 2 candidates none was kept" in said and "(not among the best 5" in said
    assert "loop_closures.csv" in why_nothing([THINNED], 1) and "(" not in why_nothing([THINNED], 1)
