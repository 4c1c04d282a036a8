"""Makes small maps, and the model of what they hold. As a program: appends until it is killed, and says what it has."""

import gzip
import sys
from pathlib import Path

import numpy as np

from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.rows import EdgeRow, FrameRow, KeyframeRow

FACTS = {"words": "floornet 1", "side": 200, "weights": {"floornet": "abc"}}
GOLDEN = Path(__file__).parents[2] / "data" / "map-version-1.ebmap.gz"


def arrays_of(number, size=300):
    """Arrays of every sort, told by the number alone."""
    rng = np.random.default_rng(number)
    return {
        "view": rng.integers(0, 256, size + number % 7).astype(np.uint8),
        "floor": rng.random((9, 11)) < 0.9,
        "points": rng.standard_normal((5, 2)).astype(np.float32),
        "exact": np.array([-0.0, np.nan, np.inf, 1e-310]),
        "scale": np.array(0.1 * number),
        "none": np.zeros((0, 3), np.int8),
    }


def keyframe_of(number, session=1):
    pose = np.array([0.1 * number, -0.0, -0.01 * number])
    return KeyframeRow(number, session, 2 * number, 100 + 0.1 * number, f"rgb/{number:06d} ä.png", pose)


def edge_of(number, i, j, kind="closure"):
    rng = np.random.default_rng(number)
    spread = rng.standard_normal((3, 3))
    return EdgeRow(
        *(number, kind, i, j, kind == "closure", bool(number % 2), "as it is", rng.standard_normal(3)),
        *(spread @ spread.T, 20 + number, 200, float("nan") if number % 3 else 0.25),
    )


def frame_of(number, keyframe):
    return FrameRow(number, 100 + 0.05 * number, f"rgb/{number:06d}.png", keyframe, np.array([0.01, -0.0, number]))


def append(kept, number, session=1, size=300):
    """Appends a keyframe with a step to the one before, a closure to the first, and a frame."""
    edges = [(edge_of(2 * number, number, number - 1, "step"), {})] if number else []
    edges += [(edge_of(2 * number + 1, number, 0), {"matches": np.arange(number)})] if number > 1 else []
    kept.append(keyframe_of(number, session), arrays_of(number, size), edges, [frame_of(2 * number + 1, number)])


def filled(path, count=12, size=300):
    """A map of one session, closed."""
    with MapFile.create(path, FACTS) as kept:
        session = kept.begin_session("monday.bag", {"camera": "left"})
        for number in range(count):
            append(kept, number, session, size)
        kept.settle(np.arange(count - 1), solved(count - 1), edges=[5], kept=[False], reasons=["taken back"])
        kept.put_state(session, "odometry", {"chain": np.arange(3.0)})
        kept.end_session(session)
    return Path(path)


def solved(count):
    return np.stack([np.arange(count) + 0.5, np.full(count, -0.0), -np.arange(count)], axis=1).astype(float)


def assert_arrays(found, expected):
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        assert found[name].dtype == np.asarray(array).dtype and found[name].shape == np.shape(array)
        assert found[name].tobytes() == np.asarray(array).tobytes()


def assert_filled(kept, count=12, size=300):
    """Everything that `filled` wrote, bit for bit."""
    keyframes, edges, frames = kept.keyframes(), kept.edges(), kept.frames()
    assert kept.facts == FACTS and len(keyframes) == len(frames) == count and len(edges) == 2 * count - 3
    expected = [keyframe_of(number) for number in range(count)]
    for name in ("id", "session", "frame", "stamp_s", "name"):
        assert list(getattr(keyframes, name)) == [getattr(row, name) for row in expected]
    assert keyframes.pose.tobytes() == np.vstack([solved(count - 1), expected[-1].pose]).tobytes()
    for k, number in enumerate(edges.id.tolist()):
        kind = edges.kind[k]
        assert kind == ("closure" if number % 2 else "step")
        row = edge_of(number, number // 2, number // 2 - 1 if kind == "step" else 0, kind)
        assert (edges.i[k], edges.j[k], edges.opposing[k]) == (row.i, row.j, row.opposing)
        assert (edges.kept[k], edges.reason[k]) == ((False, "taken back") if number == 5 else (row.kept, row.reason))
        assert edges.i_from_j[k].tobytes() == row.i_from_j.tobytes()
        assert edges.covariance[k].tobytes() == row.covariance.tobytes()
        assert (edges.inliers[k], edges.matches[k]) == (row.inliers, row.matches)
        np.testing.assert_equal(edges.distance[k], row.distance)
        assert_arrays(kept.edge_arrays(number), {"matches": np.arange(number // 2)} if kind == "closure" else {})
    assert frames.keyframe.tolist() == list(range(count))
    assert (
        frames.keyframe_from_base.tobytes()
        == np.array([frame_of(2 * k + 1, k).keyframe_from_base for k in range(count)]).tobytes()
    )
    for number in range(count):
        assert_arrays(kept.arrays(number), arrays_of(number, size))
    assert_arrays(kept.state(1, "odometry"), {"chain": np.arange(3.0)})
    (session,) = kept.sessions()
    assert (session.id, session.name, session.finished, session.state) == (1, "monday.bag", True, ("odometry",))
    assert session.facts == {"camera": "left"}


def append_until_killed(path, size):
    kept = MapFile.open(path, write=True)
    first = len(kept.keyframes())
    for number in range(first, first + 100_000):
        append(kept, number, size=size)
        print(number, flush=True)


def write_golden():
    """Writes the map of this version that every later one must read."""
    made = filled(GOLDEN.with_suffix(""))
    GOLDEN.write_bytes(gzip.compress(made.read_bytes(), mtime=0))
    made.unlink()


if __name__ == "__main__":
    append_until_killed(sys.argv[1], int(sys.argv[2]))
