"""The engine frame by frame: what it says as it drives, and that only the past decides."""

import dataclasses

import numpy as np
import pytest

from ebjax.geometry.camera import camera_from
from ebjax.geometry.planar import between
from ebjax.io.frames import Frames
from ebjax.io.sequence import read_sequence
from ebjax.slam import drive as driving
from ebjax.slam.config import PipelineConfig
from ebjax.slam.drive import drive
from ebjax.slam.frame import Frame
from ebjax.slam.mapper import Mapper
from ebjax.slam.recording import Recording
from ebjax.slam.store import InMemory
from ebjax.slam.world import planar

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(rendered):
    """The rendered corridor: camera and recording."""
    sequence = read_sequence(rendered)
    frames = Frames(sequence)
    recording = Recording(frames.both, sequence.timestamps, planar(sequence.odom_from_base), names=sequence.names)
    return camera_from(sequence.camera), recording


def driven(run, store=None, **settings):
    camera, recording = run
    said = []
    engine = Mapper(camera, PipelineConfig(**settings), recording=recording, store=store)
    drive(engine, recording, told=said.append)
    return engine, said


@pytest.fixture(scope="module")
def whole(run):
    store = InMemory()
    return store, *driven(run, store)


def thought_over(engine):
    return engine.finish(lambda *_: pytest.fail("this run needs no second look"))


def test_closures_are_believed_as_they_come(whole):
    _, engine, said = whole
    believed = {}
    for update in said:
        for closure in update.closures:
            assert closure.i <= update.frame and closure.j < closure.i
            believed[closure.i, closure.j, closure.opposing] = closure.kept
    run = thought_over(engine)
    c, kept = run.candidates, run.kept
    final = {(int(c.i[k]), int(c.j[k]), bool(c.opposing[k])) for k in np.flatnonzero(kept)}
    early = {ends for ends, good in believed.items() if good}
    assert len(final) >= 4
    assert len(early & final) >= 0.95 * len(final)


def test_every_update_says_where_the_robot_is(whole):
    _, engine, said = whole
    run = thought_over(engine)
    assert [update.frame for update in said] == list(range(len(said)))
    last = said[-1]
    off = np.abs(between(last.map_from_base, run.poses[-1]))
    assert off[:2].max() < 0.05 and off[2] < 0.02
    assert all(update.map_from_odom is not None and update.milliseconds > 0 for update in said)
    rows = [update.keyframe for update in said if update.keyframe is not None]
    assert rows == list(range(len(engine.keyframes)))
    assert all(np.linalg.eigvalsh(update.covariance).min() > -1e-12 for update in said)
    assert any(update.path is not None for update in said)


@pytest.mark.parametrize(("decoded", "looked_at"), [(1, 0), (7, 1), (64, 64)])
def test_bits_do_not_depend_on_how_far_images_are_decoded_and_looked_at_ahead(
    run, whole, monkeypatch, decoded, looked_at
):
    monkeypatch.setattr(driving, "PREFETCH", decoded)
    monkeypatch.setattr(driving, "LOOKED_AHEAD", looked_at)
    engine, said = driven(run)
    np.testing.assert_array_equal(engine.chain.poses, whole[1].chain.poses)
    np.testing.assert_array_equal(engine.belief.reasons, whole[1].belief.reasons)
    for mine, theirs in zip(said, whole[2], strict=True):
        np.testing.assert_array_equal(mine.map_from_base, theirs.map_from_base)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_run_that_was_left_goes_on_to_the_same_bits(run, whole, share):
    store, engine, _ = whole
    half = InMemory()
    for row in range(int(share * len(store))):
        half.keep(store.arrays(row))
    again, _ = driven(run, half)
    assert len(half) == len(store)
    np.testing.assert_array_equal(again.chain.poses, engine.chain.poses)
    np.testing.assert_array_equal(again.belief.reasons, engine.belief.reasons)
    one, other = thought_over(engine), thought_over(again)
    np.testing.assert_array_equal(one.poses, other.poses)
    assert one.reasons == other.reasons


def test_without_wheels_the_floor_is_followed_and_can_be_left(run):
    camera, recording = run
    floor = dataclasses.replace(recording, timestamps=recording.timestamps[:24], odom_from_base=None)
    store = InMemory()
    engine, said = driven((camera, floor), store)
    assert all(update.map_from_odom is None for update in said)
    half = InMemory()
    for row in range(len(store) // 2):
        half.keep(store.arrays(row))
    again, _ = driven((camera, floor), half)
    np.testing.assert_array_equal(again.chain.poses, engine.chain.poses)
    np.testing.assert_array_equal(again.way_everywhere(), engine.way_everywhere())
    np.testing.assert_array_equal(thought_over(again).poses, thought_over(engine).poses)


def test_no_images_are_asked_again_of_a_robot(run):
    camera, recording = run
    engine = Mapper(camera)
    for k in range(12):
        rgb, depth = recording.load(k)
        engine.add(Frame(float(recording.timestamps[k]), rgb, depth, recording.odom_from_base[k], str(k)))
    found = engine.finish()
    assert found.poses.shape == (12, 3) and len(found.keyframes) == len(engine.keyframes)


def test_frames_that_cannot_be_are_refused_in_one_line(run):
    camera, recording = run
    rgb, depth = recording.load(0)
    odom = np.zeros(3)
    engine = Mapper(camera)
    engine.add(Frame(1.0, rgb, depth, odom, "a.png"))
    with pytest.raises(ValueError, match=r"frame b.png at 1.000000 s is not later than the one before, at 1.000000 s"):
        engine.add(Frame(1.0, rgb, depth, odom, "b.png"))
    with pytest.raises(ValueError, match=r"frame c.png is an image of shape \(10, 10, 3\), the camera's are"):
        engine.add(Frame(2.0, rgb[:10, :10], None, odom, "c.png"))
    with pytest.raises(ValueError, match=r"frame d.png: some frames have odometry and some have none"):
        engine.add(Frame(2.0, rgb, depth, None, "d.png"))
    with pytest.raises(ValueError, match=r"frame e.png has depth of shape \(10, 10\), the camera's images are"):
        engine.add(Frame(2.0, None, np.zeros((10, 10), np.float32), odom, "e.png"))
    for stamp_s, wheels in ((np.nan, odom), (2.0, np.array([0.0, np.nan, 0.0]))):
        with pytest.raises(ValueError, match=r"frame f\.png has a time or odometry that is not finite"):
            engine.add(Frame(stamp_s, rgb, depth, wheels, "f.png"))
    with pytest.raises(ValueError, match="--motion wheels needs odometry"):
        Mapper(camera, PipelineConfig(motion="wheels")).add(Frame(1.0, rgb, depth))
    assert engine.add(Frame(3.0, rgb, depth, odom, "e.png")).frame == 1
