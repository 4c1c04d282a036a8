"""Where a robot is in a map that stands still: recognised, carried away, started somewhere; and nothing is kept."""

import dataclasses
import hashlib

import numpy as np
import pytest

from ebjax.geometry.camera import camera_from
from ebjax.geometry.planar import between, compose
from ebjax.io.frames import Frames
from ebjax.io.sequence import read_sequence
from ebjax.slam import walking
from ebjax.slam.config import PipelineConfig
from ebjax.slam.doubt import PATIENCE
from ebjax.slam.drive import drive
from ebjax.slam.finish import finish
from ebjax.slam.frame import Frame
from ebjax.slam.localise import Localiser
from ebjax.slam.mapper import Mapper
from ebjax.slam.recording import Recording
from ebjax.slam.store import InMemory
from ebjax.slam.world import planar

pytestmark = pytest.mark.whole


class Driven:
    """A run out and back, and the map that it left."""

    def __init__(self, folder):
        sequence = read_sequence(folder)
        self.camera, self.stamps, self.load = camera_from(sequence.camera), sequence.timestamps, Frames(sequence).both
        self.odom, self.truth = planar(sequence.odom_from_base), planar(sequence.world_from_base)
        self.store = InMemory()
        recording = Recording(self.load, self.stamps, self.odom)
        engine = Mapper(self.camera, recording=recording, store=self.store)
        drive(engine, recording)
        run = finish(engine, lambda *_: pytest.fail("this run needs no second look"))
        self.rows, self.poses = run.keyframes, run.poses[run.keyframes]
        self.back = np.arange(len(self.stamps) // 2, len(self.stamps))

    def localiser(self, config=None, **options):
        return Localiser(self.camera, config, self.store, self.poses, **options)

    def frames(self, rows, odom=None, seen=None):
        """Some of the run again: other noise, other light; `seen` is what is made of an image."""
        rng = np.random.default_rng(1)
        odom = self.odom[rows] if odom is None else odom
        for k, row in enumerate(rows):
            rgb, depth_m = self.load(int(row))
            rgb = np.clip(255 * (rgb / 255) ** 1.15 + rng.normal(0, 4, rgb.shape), 0, 255).astype(np.uint8)
            rgb, depth_m = (rgb, depth_m) if seen is None else seen(k, rgb, depth_m)
            yield Frame(float(self.stamps[row]), rgb, depth_m, None if odom is False else odom[k], str(row))

    def off(self, rows, said):
        """How far each pose that is said is from the true one, seen from the map's nearest keyframe: m, degrees."""
        truth = self.truth[self.rows]
        found = []
        for row, one in zip(rows, said, strict=True):
            if one.map_from_base is None:
                continue
            j = np.argmin(np.linalg.norm(truth[:, :2] - self.truth[row, :2], axis=1))
            apart = between(between(truth[j], self.truth[row]), between(self.poses[j], one.map_from_base))
            found.append((np.hypot(*apart[:2]), np.degrees(abs(apart[2]))))
        return np.array(found).reshape(-1, 2)


@pytest.fixture(scope="module")
def run(rendered):
    return Driven(rendered)


@pytest.fixture(scope="module")
def way_back(run):
    there = run.localiser()
    return there, [there.add(frame) for frame in run.frames(run.back)]


def states(said):
    return [one.state for one in said]


def first_found(said):
    return states(said).index("found")


def test_from_the_first_place_that_it_knows_on_it_is_found(run, way_back):
    _, said = way_back
    first = first_found(said)
    assert first < 12 and set(states(said[first:])) == {"found"}
    off = run.off(run.back, said)
    assert ((off[:, 0] < 0.05) & (off[:, 1] < 1.0)).mean() >= 0.95


def test_what_it_says_is_consistent(run, way_back):
    there, said = way_back
    assert [one.frame for one in said] == list(range(len(run.back)))
    keyframes = [one.keyframe for one in said if one.keyframe is not None]
    assert keyframes == list(range(len(there.walk.keyframes)))
    for row, one in zip(run.back, said, strict=True):
        lost = one.state == "lost"
        assert lost == (one.map_from_base is None) == (one.covariance is None) == (one.map_from_odom is None)
        assert one.nearest is None or (not lost and 0 <= one.nearest < len(run.store))
        assert one.milliseconds > 0
        if not lost:
            again = compose(one.map_from_odom, run.odom[row])
            np.testing.assert_allclose(again[:2], one.map_from_base[:2], atol=1e-9)
            assert np.linalg.eigvalsh(one.covariance).min() > 0
    told = [closure for one in said for closure in one.closures]
    kept = [closure for closure in told if closure.kept]
    assert len(kept) >= 4 and all(len(run.store) > closure.rows[1] for closure in told)
    for closure in kept:
        row, frame = closure.rows[1], run.back[closure.i]
        assert closure.j == run.rows[row]
        off = between(between(run.truth[frame], run.truth[closure.j]), closure.i_from_j)
        assert np.hypot(*off[:2]) < 0.05


def test_nothing_is_kept(run, way_back, monkeypatch):
    before = [
        hashlib.sha256(b"".join(v.tobytes() for v in run.store.arrays(k).values())) for k in range(len(run.store))
    ]
    count = len(run.store)
    monkeypatch.setattr(walking, "LAST", 16)
    there = run.localiser()
    said = [there.add(frame) for frame in run.frames(run.back)]
    for one, other in zip(said, way_back[1], strict=True):
        assert one.state == other.state
        if one.map_from_base is not None:
            np.testing.assert_array_equal(one.map_from_base, other.map_from_base)
    assert len(run.store) == count == len(there.index)
    after = [hashlib.sha256(b"".join(v.tobytes() for v in run.store.arrays(k).values())) for k in range(count)]
    assert [one.digest() for one in before] == [one.digest() for one in after]
    store = there.walk.store.store
    assert len(store) == len(there.walk.keyframes) > 16 and len(store._kept) == 16
    assert not there.walk.names and not there.looked.told and not there.walk.looked.told
    assert len(there._closures.i) <= 4 * 32


@pytest.mark.parametrize("reset", [True, False], ids=["odometry begins anew", "odometry goes on"])
def test_carried_away_is_said_and_then_it_is_found_again(run, reset):
    count = len(run.back)
    cut = count // 2
    rows = np.concatenate([run.back[: cut + 1], np.arange(2, 2 + cut)])  # back where it set out, the other way round
    moves = between(run.odom[rows[:-1]], run.odom[rows[1:]])
    moves[cut] = [0.25, 0.0, 0.0]
    odom = [np.zeros(3)]
    for k, move in enumerate(moves):
        odom.append(np.zeros(3) if reset and k == cut else compose(odom[-1], move))
    stamps = run.stamps.copy()
    stamps[rows] = run.stamps[0] + 0.5 * np.arange(len(rows))
    there = run.localiser()
    said = []
    for k, frame in enumerate(run.frames(rows, np.array(odom))):
        said.append(there.add(dataclasses.replace(frame, stamp_s=float(stamps[rows[k]]))))
    since = [one for one in said[cut + 1 :] if one.keyframe is not None]
    assert said[cut].state == "found"
    assert "lost" in states(since[:PATIENCE])
    again = next(k for k in range(cut + 1, len(said)) if said[k].state == "lost")
    assert "found" in states(said[again:])
    off = run.off(rows[again:], said[again:])
    assert ((off[:, 0] < 0.05) & (off[:, 1] < 1.0)).mean() >= 0.95


def test_in_another_world_it_is_never_found(run):
    def mirrored(k, rgb, depth_m):
        return rgb[:, ::-1].copy(), None if depth_m is None else depth_m[:, ::-1].copy()

    there = run.localiser()
    frames = run.frames(np.arange(len(run.stamps)), run.odom * [1, -1, -1], mirrored)
    said = [there.add(frame) for frame in frames]
    assert set(states(said)) == {"lost"}
    assert not any(closure.kept for one in said for closure in one.closures)


@pytest.mark.parametrize("blind", [1, 2])
def test_a_frame_that_shows_nothing_does_not_make_it_lost(run, blind):
    def hidden(k, rgb, depth_m):
        nothing = k in range(14, 14 + blind)
        return (np.full_like(rgb, 90), depth_m) if nothing else (rgb, depth_m)

    there = run.localiser()
    said = [there.add(frame) for frame in run.frames(run.back, seen=hidden)]
    assert set(states(said[first_found(said) :])) == {"found"}
    assert np.trace(said[14].covariance) > np.trace(said[13].covariance)


def start_of(run, off):
    """Where the way back begins, in the map, and that far off."""
    row = run.back[0]
    j = np.argmin(np.linalg.norm(run.truth[run.rows, :2] - run.truth[row, :2], axis=1))
    at = compose(run.poses[j], between(run.truth[run.rows[j]], run.truth[row]))
    return tuple((at + off).tolist())


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.25, -0.2, 0.1)])
def test_a_start_holds_until_a_place_is_known(run, off):
    there = run.localiser(start=start_of(run, off))
    said = [there.add(frame) for frame in run.frames(run.back)]
    assert set(states(said)) == {"found"}
    known = next(k for k, one in enumerate(said) if one.nearest is not None)
    apart = np.hypot(*off[:2])
    assert known > 0 and run.off(run.back[:1], said[:1])[0, 0] == pytest.approx(apart, abs=0.03)
    assert np.sqrt(said[0].covariance[0, 0]) == pytest.approx(0.3)
    assert (run.off(run.back[known:], said[known:])[:, 0] < 0.05).mean() >= 0.95


@pytest.mark.parametrize("off", [(4.0, 2.0, 0.0), (0.0, 0.0, 2.5)])
def test_a_wrong_start_is_taken_back(run, off):
    there = run.localiser(start=start_of(run, off))
    said = [there.add(frame) for frame in run.frames(run.back)]
    assert said[0].state == "found"
    lost = states(said).index("lost")
    assert lost < 14 and said[-1].state == "found"
    assert run.off(run.back[-6:], said[-6:])[:, 0].max() < 0.05


def test_without_wheels_the_floor_carries_it_on(run):
    there = run.localiser()
    rows = run.back[: len(run.back) * 2 // 3]
    said = [there.add(frame) for frame in run.frames(rows, odom=False)]
    assert said[-1].state == "found" and all(one.map_from_odom is None for one in said)
    off = run.off(rows, said)
    assert ((off[:, 0] < 0.05) & (off[:, 1] < 1.0)).mean() >= 0.95


def test_keyframes_that_are_not_in_the_map_are_not_looked_for(run):
    poses = run.poses.copy()
    poses[len(poses) // 3 :] = np.nan
    there = Localiser(run.camera, None, run.store, poses)
    said = [there.add(frame) for frame in run.frames(run.back[-16:])]
    told = [closure for one in said for closure in one.closures]
    assert all(closure.rows[1] < len(poses) // 3 for closure in told)


def test_what_cannot_be_is_refused(run):
    with pytest.raises(ValueError, match=r"1 settled poses for \d+ keyframes of the map; give one of each"):
        Localiser(run.camera, None, run.store, run.poses[:1])
    with pytest.raises(ValueError, match="the map holds no keyframe to look for: drive a run into it first"):
        Localiser(run.camera, None, run.store, np.full_like(run.poses, np.nan))
    with pytest.raises(ValueError, match="the map holds no keyframe"):
        Localiser(run.camera, None, InMemory(), np.zeros((0, 3)))
    with pytest.raises(ValueError, match=r"start \(nan, 0.0, 0.0\) is no pose: give x \(m\), y \(m\) and heading"):
        run.localiser(start=(np.nan, 0.0, 0.0))
    with pytest.raises(ValueError, match="--motion wheels needs odometry"):
        there = run.localiser(PipelineConfig(motion="wheels"))
        there.add(next(iter(run.frames(run.back, odom=False))))
