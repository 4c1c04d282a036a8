"""Two places that look alike: what agrees on the raw images is not believed where the floor says something else."""

import dataclasses
import json

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.contradict import _by_raw, contradictions
from ebjax.features.pair import Comparison, metric_view, quad_view, raw_view
from ebjax.features.record import FLOOR, RAW, TURNED
from ebjax.features.verify import Verified
from ebjax.geometry.camera import FloorView, camera_over_floor, raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.geometry.lens import lens

QUAD = np.array([[200.0, 150], [440, 150], [600, 400], [40, 400]])
RAW_VIEW, QUAD_VIEW = raw_view(640, 480), quad_view(QUAD, 400, 0.5)
POINTS = np.random.default_rng(0).uniform(50, 350, (60, 2))
TURN = np.array([[-1.0, 0, 400], [0, -1, 400], [0, 0, 1]])


def comparison(b_from_a, inliers, *, in_a=POINTS, believed=True):
    """What a comparison says of points of a whose motion is given, all in the plane that is compared."""
    rows, agree = np.arange(len(in_a)), np.arange(len(in_a)) < inliers
    motion = np.linalg.inv(b_from_a)
    matched = Verified(rows, rows, np.ones(len(in_a), bool), agree, motion)
    both = jnp.asarray(in_a), apply(b_from_a, in_a)
    return Comparison(inliers, len(in_a), believed, matched, both, both, motion)


def test_raw_images_that_put_the_floor_elsewhere_contradict_it():
    found = {RAW: comparison(np.eye(3), 55), TURNED: comparison(TURN, 30)}
    views = {RAW: RAW_VIEW, FLOOR: QUAD_VIEW}
    assert contradictions(found, views) == {RAW: TURNED}
    unsure = found | {TURNED: dataclasses.replace(found[TURNED], believed=False)}
    assert contradictions(unsure, views) == {}
    assert contradictions(found | {RAW: dataclasses.replace(found[RAW], believed=False)}, views) == {}


@pytest.mark.parametrize(("off_px", "contradict"), [(0, False), (20, False), (100, True)])
def test_raw_images_that_say_the_same_do_not(off_px, contradict):
    image_from_square = QUAD_VIEW.image_from_view @ np.linalg.inv(QUAD_VIEW.plane_from_view)
    moved = np.array([[1.0, 0, off_px], [0, 1, 0], [0, 0, 1]]) @ TURN
    raw = image_from_square @ moved @ np.linalg.inv(image_from_square)
    found = {RAW: comparison(raw, 20), TURNED: comparison(TURN, 50)}
    assert contradictions(found, {RAW: RAW_VIEW, FLOOR: QUAD_VIEW}) == ({RAW: TURNED} if contradict else {})


def test_of_two_floor_views_the_one_that_more_agree_on_stands():
    slid = np.array([[1.0, 0, 80], [0, 1, 0], [0, 0, 1]])
    found = {FLOOR: comparison(slid, 50), TURNED: comparison(TURN, 20)}
    assert contradictions(found, {RAW: RAW_VIEW, FLOOR: QUAD_VIEW}) == {TURNED: FLOOR}
    # As by a local feature that does not change when the view is turned.
    same = {FLOOR: comparison(TURN, 20), TURNED: comparison(TURN, 20)}
    assert contradictions(same, {RAW: RAW_VIEW, FLOOR: QUAD_VIEW}) == {}


def test_raw_pixels_of_a_bent_lens_are_straightened():
    camera = camera_over_floor(380.0, 380.0, 239.5, 179.5, 480, 360, 0.54, np.radians(24.0), 0.0, 0.2)
    camera = dataclasses.replace(camera, lens=lens("plumb_bob", [-0.3, 0.1, 0.0, 0.0, 0.0]))
    view = metric_view(camera, FloorView(0.6, 2.2, -0.7, 0.7, 0.004))
    floor = np.random.default_rng(1).uniform([0.65, 0.3], [1.2, 0.65], (60, 2))
    slid = np.array([[1.0, 0, 0.3], [0, 1, 0.0], [0, 0, 1]])
    there = np.asarray(apply(slid, floor))
    image_from_plane = view.image_from_view @ np.linalg.inv(view.plane_from_view)
    raw_a, raw_b = (
        np.asarray(raw_from_ideal(camera, np.asarray(apply(image_from_plane, at)))) for at in (floor, there)
    )
    by_raw = comparison(cv2.findHomography(raw_a, raw_b)[0], 60, in_a=raw_a)
    off = [np.linalg.norm(_by_raw(by_raw, floor, one) - there, axis=1) for one in (view, without_lens(view))]
    assert np.median(off[0]) < 0.002 * view.side < 0.01 * view.side < np.median(off[1])
    views = {RAW: raw_view(480, 360), FLOOR: view}
    assert contradictions({RAW: by_raw, FLOOR: comparison(slid, 40, in_a=floor)}, views) == {}
    turned = np.array([[-1.0, 0, 2.4], [0, -1, 0], [0, 0, 1]])
    assert contradictions({RAW: by_raw, FLOOR: comparison(turned, 40, in_a=floor)}, views) == {RAW: FLOOR}


def without_lens(view):
    return dataclasses.replace(view, camera=None)


@pytest.mark.slow
def test_two_ends_of_a_corridor_that_look_alike_are_told_by_the_floor(program, scene, tmp_path):
    made = scene()
    made.write(tmp_path)
    # The same doors and windows stand above either floor.
    alike = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (60, 480, 3), np.uint8), (0, 0), 1.2)
    for name, image in zip("ab", made.images, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.vstack([alike, image[60:, :, ::-1]]))
    done = program("ebjax.features", "a.png", "b.png", "--camera", "camera.json", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "transform.json").read_text())
    raw, _, turned = result["results"]
    assert raw["contradicts"] == TURNED and not raw["believed"]
    assert turned["believed"] and turned["contradicts"] is None and result["best"] == 2
    assert " !" in done.stdout and "puts the floor elsewhere" in done.stdout
    alone = program("ebjax.features", "a.png", "b.png", "--out", "alone", cwd=tmp_path)
    assert "only the raw images agree" in alone.stdout
