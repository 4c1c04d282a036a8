"""A small run out and back over a painted floor, in memory, the same in every process; and driving it into a map."""

import functools
from pathlib import Path

import cv2
import numpy as np

from ebjax.geometry.camera import camera_over_floor, image_from_floor
from ebjax.geometry.planar import between, compose
from ebjax.io.map_file.file import MapFile
from ebjax.mapping.store import open_map
from ebjax.slam.config import PipelineConfig
from ebjax.slam.drive import drive
from ebjax.slam.finish import finish
from ebjax.slam.mapper import Mapper
from ebjax.slam.recording import Recording
from ebjax.slam.walker import default_view

LOG, WIDTH, HEIGHT = "monday", 320, 240
TEXTURE_M, LENGTH_M = 0.005, 2.6
CONFIG = PipelineConfig(keyframe_m=0.2, min_gap_s=2.0, min_gap_m=2.0)


@functools.cache
def camera(pitch_deg=35.0):
    return camera_over_floor(260.0, 260.0, 159.5, 119.5, WIDTH, HEIGHT, 0.5, float(np.radians(pitch_deg)))


@functools.cache
def floor():
    """Marks of many sizes; pixel (0, 0) lies at (-1, -2) m, x to the right, y down."""
    rng, shape = np.random.default_rng(5), (round(4 / TEXTURE_M), round((LENGTH_M + 3) / TEXTURE_M))
    layers = [rng.standard_normal((shape[0] // k + 1, shape[1] // k + 1, 3)) for k in (2, 5, 12)]
    whole = sum(cv2.resize(one, shape[::-1], interpolation=cv2.INTER_CUBIC) for one in layers)
    return np.clip(128 + 35 * whole, 0, 255).astype(np.uint8)


@functools.cache
def truth():
    """There, a turn on the spot, and back."""
    ahead = np.arange(0, LENGTH_M, 0.1)
    turn = np.linspace(0, np.pi, 13)[1:]
    there = [np.stack([ahead, 0 * ahead, 0 * ahead], 1), np.stack([ahead[-1] + 0 * turn, 0 * turn, turn], 1)]
    back = np.stack([ahead[::-1], 0.03 + 0 * ahead, np.pi + 0 * ahead], 1)
    return np.concatenate([*there, back])


@functools.cache
def odometry(seed=1):
    rng, poses = np.random.default_rng(seed), [truth()[0]]
    for step in between(truth()[:-1], truth()[1:]):
        poses.append(compose(poses[-1], step * (1 + rng.normal(0, 0.03, 3)) + rng.normal(0, 0.001, 3)))
    return np.array(poses)


@functools.cache
def image(frame, pitch_deg=35.0):
    """What the camera sees of the floor."""
    texture_from_floor = np.array([[1 / TEXTURE_M, 0, 1 / TEXTURE_M], [0, 1 / TEXTURE_M, 2 / TEXTURE_M], [0, 0, 1]])
    x, y, heading = truth()[frame]
    c, s = np.cos(heading), np.sin(heading)
    world_from_base = np.array([[c, -s, x], [s, c, y], [0, 0, 1]])
    image_from_texture = np.asarray(image_from_floor(camera(pitch_deg)), float) @ np.linalg.inv(
        texture_from_floor @ world_from_base
    )
    return cv2.warpPerspective(floor(), image_from_texture, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)


def recording(count=None, pitch_deg=35.0, wheels=True):
    count = len(truth()) if count is None else count
    stamps = 100 + 0.2 * np.arange(count)
    names = tuple(f"rgb/{k:04d}.png" for k in range(count))
    odom = odometry()[:count] if wheels else None
    return Recording(lambda frame: (image(frame, pitch_deg), None), stamps, odom, names=names)


def opened(path, config=CONFIG, **changes):
    mounted = changes.pop("camera", camera())
    run = {"log": LOG, "first_stamp_s": 100.0, "camera": mounted, "view": default_view(mounted), "config": config}
    return open_map(path, **(run | changes))


def nothing(update):
    """What is done with an update."""


def driven(store, run=None, config=CONFIG, told=nothing, mounted=None, lean=None):
    """The run in the store, as far as it goes."""
    run = recording() if run is None else run
    mounted = camera() if mounted is None else mounted
    engine = Mapper(mounted, config, view=default_view, recording=run, lean=lean, store=store)
    drive(engine, run, told=told)
    return engine


def finished(store, run=None, config=CONFIG, told=nothing, mounted=None):
    """The run thought over, its last frames and what it says kept in the map."""
    engines = [driven(store, run, config, told, mounted)]

    def again(engine, mounted, lean):
        more = engine.store.store.again(mounted, default_view(mounted), lean)
        engines.append(driven(more, run, config, told, mounted, lean))
        return engines[-1]

    found = finish(engines[0], again)
    engines[-1].store.store.finished(found, engines[-1]._between)
    return found


def drive_and_tell(path, connection, tilt_deg=0.0, wheels=True):
    """A process of its own: every frame is told of; at the end what came out.

    Args:
      path: of the map.
      connection: what is told to.
      tilt_deg: by how much more the camera is tilted than is said; the run is driven once more then.
      wheels: whether there are any.
    """
    from ebjax.command import setup_jax

    setup_jax()
    run = recording(pitch_deg=35.0 + tilt_deg, wheels=wheels)
    with opened(Path(path)) as store:
        found = finished(store, run, told=lambda update: connection.send(update.frame))
        connection.send(result(found))


def result(found):
    """What of a finished run must be the same however often it was killed."""
    some = found.candidates
    return found.poses, some.i, some.j, some.opposing, some.i_from_j, some.covariance, np.array(found.reasons)


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def held(path):
    """How many keyframes are in a map; none where there is no map yet."""
    if not path.exists():
        return 0
    with MapFile.open(path, write=False) as file:
        return len(file.keyframes())
