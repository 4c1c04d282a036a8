import dataclasses
import json
import re

import numpy as np
import pytest
from small_run import CONFIG, camera, opened

from ebjax.command import parse
from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.geometry.lens import lens
from ebjax.io.map_file.file import MapFile
from ebjax.mapping.agreement import check_map, in_words, made_with, settings_of, with_settings
from ebjax.slam.config import PipelineConfig
from ebjax.slam.walker import default_view
from ebjax.views.run_view import from_camera


def with_config(**changes):
    return {"config": dataclasses.replace(CONFIG, **changes)}


def over_floor(height_m=0.5, pitch_deg=35.0, fx=260.0, width=320):
    return camera_over_floor(fx, 260.0, 159.5, 119.5, width, 240, height_m, float(np.radians(pitch_deg)))


def test_a_run_that_disagrees_with_the_map_is_refused(tmp_path):
    path = tmp_path / "a.ebmap"
    opened(path).close()
    bent = dataclasses.replace(camera(), lens=lens("plumb_bob", (-0.1, 0.01, 0.0, 0.0)))
    lower = from_camera(camera(), FloorView(0.5, 1.0, -0.3, 0.3, 0.01))
    for changes, words, remedy in (
        (with_config(extractor="rootsift"), "extractor floornet, this run has rootsift", "give --extractor floornet,"),
        (with_config(descriptor="hog"), "descriptor floornet, this run has hog", "give --descriptor floornet,"),
        (
            {"camera": over_floor(height_m=0.51)},
            r"mount \(height 0.5 m, .* has \(height 0.51 m",
            r"\(--camera, --mount",
        ),
        ({"camera": over_floor(pitch_deg=34.0)}, "pitch 35, roll.*pitch 34, roll", r"\(--camera, --mount"),
        ({"camera": over_floor(fx=261.0)}, r"intrinsics \(260 .* has \(261 ", "the calibration"),
        ({"camera": over_floor(width=322)}, r"image \(320 240\), this run has \(322 240\)", "the calibration"),
        ({"camera": bent}, r"lens \(pinhole\), this run has \(plumb_bob -0.1 0.01 0 0\)", "the calibration"),
        ({"view": lower}, r"floor view \(.*\), this run has \(60 50 ", "--view, --quad"),
    ):
        with pytest.raises(ValueError, match=f"{words}.*; .*{remedy}.*another map$") as fault:
            opened(path, **changes)
        assert str(fault.value).startswith(f"{path}: was made with") and "\n" not in str(fault.value)
    with MapFile.open(path, write=False) as file:
        assert [one.id for one in file.sessions()] == [1]
    # What two computations of one camera differ in is no disagreement.
    opened(path, camera=over_floor(height_m=0.5 + 1e-9), view=default_view(camera())).close()


@pytest.mark.slow
def test_a_session_is_gone_on_with_under_its_own_settings_alone(whole, tmp_path):
    path = tmp_path / "a.ebmap"
    with opened(path, facts={"--depth": "sequence"}) as store:
        whole.keep(store, range(4))
    for changes, words in (
        (with_config(verify=5), r"--verify 2, not 5; give --verify 2 to go on"),
        (with_config(kernel_width=2.0), "--kernel-width None, not 2; leave --kernel-width out to go on"),
        (
            with_config(believe=dataclasses.replace(CONFIG.believe, min_inliers=25)),
            "--min-inliers 20, not 25; give --min-inliers 20",
        ),
        ({"facts": {"--depth": "none"}}, "--depth sequence, not none; give --depth sequence"),
    ):
        with pytest.raises(ValueError, match=words) as fault:
            opened(path, **({"facts": {"--depth": "sequence"}} | changes))
        assert f"begin it anew after --map {path} --forget 1" in str(fault.value)
    with opened(path, facts={"--depth": "sequence"}) as store:
        assert len(store) == 4 and store.current == 1
        assert store.notes == (f"{path}: goes on with session 1 of monday after 4 keyframes",)
        store.file.forget(1)
    with opened(path, **with_config(verify=5)) as store:
        assert len(store) == 0 and store.current == 2


@pytest.mark.parametrize("left_out", [(), ("extractor",), ("mount", "lens")])
def test_what_a_repaired_map_does_not_say_is_noted(left_out):
    facts = made_with(CONFIG, camera(), default_view(camera()))
    notes = check_map("a.ebmap", {name: value for name, value in facts.items() if name not in left_out}, facts)
    assert len(notes) == bool(left_out)
    assert all(name in note for note in notes for name in left_out)


def test_settings_have_the_names_of_their_flags():
    from ebjax.slam.__main__ import Config

    flags = {"--min-inliers": "25", "--mount.refine": "all", "--odometry.scale-sigma": "0.05", "--verify": "4"}
    config = parse(Config, [part for pair in flags.items() for part in pair])
    found, usual = settings_of(config), settings_of(PipelineConfig())
    assert found.keys() == usual.keys()
    assert {name: in_words(name, found[name]) for name in found if found[name] != usual[name]} == flags
    assert not {"--weights", "--extractor", "--out", "--mount.height-m"} & found.keys()
    assert all(re.fullmatch(r"--[a-z0-9.-]+", name) for name in found)


def test_settings_are_taken_up_as_they_were_told():
    believe = dataclasses.replace(CONFIG.believe, min_inliers=25)
    was = dataclasses.replace(CONFIG, verify=5, kernel_width=2.0, ranking="cosine", descriptor="hog", believe=believe)
    told = json.loads(json.dumps(settings_of(was)))
    assert with_settings(PipelineConfig(), told) == dataclasses.replace(was, ranking="auto", descriptor="floornet")
    assert with_settings(was, {}) == was
