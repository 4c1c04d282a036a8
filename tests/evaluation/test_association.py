import numpy as np
import pytest

from ebjax.evaluation.association import associate, pair, pairing_lines


def test_takes_the_nearest_and_only_near_ones():
    reference = np.array([0.0, 0.1, 0.2, 0.3, 0.3, 0.4])
    estimate = np.array([-1.0, 0.006, 0.096, 0.15, 0.3, 0.42])
    i, j = associate(reference, estimate, 0.01)
    np.testing.assert_array_equal(i, [0, 1, 3])
    np.testing.assert_array_equal(j, [1, 2, 4])
    # The shorter one asks, whichever side it stands on.
    j, i = associate(estimate, np.append(reference, 9.0), 0.01)
    np.testing.assert_array_equal(np.append(reference, 9.0)[i], [0, 0.1, 0.3])
    assert [len(part) for part in associate(reference, estimate + 100, 0.01)] == [0, 0]


@pytest.mark.parametrize("counts", [(300, 200), (200, 300), (200, 200), (40, 900), (1, 7)])
@pytest.mark.parametrize("most", [0.02, 0.5, 1e10])
def test_pairs_are_one_to_one_in_order_and_near(counts, most):
    rng = np.random.default_rng(2)
    reference, estimate = (np.sort(rng.uniform(0, 10, count).round(2)) for count in counts)
    i, j = associate(reference, estimate, most)
    assert len(i) or min(counts) == 1
    assert (np.diff(i) > 0).all() and (np.diff(j) > 0).all()
    short, long = (estimate, reference) if len(estimate) <= len(reference) else (reference, estimate)
    gap = np.abs(long[None, :] - short[:, None])
    apart = np.abs(reference[i] - estimate[j])
    assert (apart <= most).all()
    # Every pair is nearest for the shorter; what is left out had no near one, or its nearest is taken by a nearer one.
    asked = j if len(estimate) <= len(reference) else i
    np.testing.assert_allclose(apart, gap.min(axis=1)[asked], atol=1e-12)
    for k in np.setdiff1d(np.arange(len(short)), asked):
        taken = np.abs(short[asked] - long[gap[k].argmin()])
        assert gap[k].min() > most or taken.min() <= gap[k].min() + 1e-12


@pytest.mark.parametrize("offset", [20.0, -50.0, 1.4e9])
def test_clocks_that_do_not_overlap_pair_once_at_most(offset):
    times = np.arange(41) * 0.5
    assert len(associate(times + offset, times, 1e10)[0]) == 1


def test_lines_say_what_was_left_out_and_why():
    reference = 100 + np.arange(50) * 0.1
    estimate = np.concatenate([[99.0, 99.5], 101.003 + np.arange(10) * 0.1, [101.908, 101.46, 104.0, 200.0]])
    lines = pairing_lines(pair(reference, estimate, 0.01))
    assert lines[0].startswith(
        "matched 11 of 16 poses to the reference's 50 within 0.01 s; the times of a pair differ by"
    )
    assert "0.003 s (median), 0.003 s at most" in lines[0]
    assert lines[1] == (
        "5 of the trajectory's 16 poses are left out: 2 before the reference's first pose, 1 after the reference's "
        "last pose, 1 with no pose of the reference within 0.01 s, 1 whose nearest is paired with a nearer one"
    )
    assert len(lines) == 2 and len(pairing_lines(pair(reference, reference, 0.01))) == 1
    swapped = pairing_lines(pair(estimate, reference, 0.01))
    assert swapped[1].startswith("5 of the reference's 16 poses are left out: 2 before the trajectory's first pose")


def test_a_large_difference_pairs_no_pose_twice_in_a_gap():
    reference = np.concatenate([np.arange(20) * 0.1, 10 + np.arange(20) * 0.1])
    found = pair(reference, np.arange(0, 12, 0.5), 1e10)
    assert len(found) == 9 and found.differences.max() < 0.11 and found.few
    assert pairing_lines(found)[0].endswith("the times of a pair differ by 0 s (median), 0.1 s at most")
