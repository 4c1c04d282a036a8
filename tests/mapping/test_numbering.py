import numpy as np
import pytest

from ebjax.mapping.numbering import with_ids, with_rows


def told(row, earlier):
    """What was measured of a keyframe against earlier ones."""
    j, count = np.array(earlier, np.int64), len(earlier)
    return {
        "view": np.arange(3, dtype=np.uint8),
        "first": np.array([earlier[-1], 1, 0.25]) if count else np.array([-1, 0, np.inf]),
        "candidates": np.stack([j, j % 2], 1),
        "candidates.distance": 0.5 * j,
        "pairs.j": j,
        "pairs.opposing": j % 2 == 0,
        "pairs.floor": np.tile(j[:, None], (1, 13)).astype(float),
        "steps.ends": np.stack([np.full(count, row), j], 1),
        "steps.words": j.astype("S4"),
    }


def assert_equal(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name])
        assert values.dtype == other[name].dtype and values.shape == other[name].shape


def some(rng, most):
    """Some of the whole numbers below `most`, in their order."""
    return np.flatnonzero(rng.random(most) < rng.random()).tolist()


@pytest.mark.parametrize("seed", range(50))
def test_there_and_back_and_without_what_is_gone(seed):
    rng = np.random.default_rng(seed)
    ids = np.array([*some(rng, 20), 20, *rng.choice(range(21, 40), rng.integers(0, 5), replace=False)])
    ids.sort()
    row = len(ids) - 1
    earlier, gone = some(rng, row), some(rng, row)
    kept = told(row, earlier)
    whole = with_ids(kept, ids)
    assert_equal(with_rows(whole, ids), kept)
    np.testing.assert_array_equal(whole["pairs.j"], ids[np.array(earlier, int)])
    left = np.array([k for k in range(len(ids)) if k not in gone])
    found = with_rows(whole, ids[left])
    there = [j for j in earlier if j not in gone]
    assert left[found["pairs.j"]].tolist() == left[found["candidates"][:, 0]].tolist() == there
    assert left[found["steps.ends"]].tolist() == [[row, j] for j in there]
    # Each row of a table keeps its own values.
    assert found["pairs.floor"][:, 4].tolist() == there and found["candidates.distance"].tolist() == [
        j / 2 for j in there
    ]
    assert found["steps.words"].tolist() == [str(j).encode() for j in there]
    if earlier and earlier[-1] in gone:
        assert found["first"].tolist() == [-1, 0, np.inf]
    elif earlier:
        assert left[int(found["first"][0])] == earlier[-1]
