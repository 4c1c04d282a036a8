"""The task `words`: what it writes is what places are made by; what cannot be is refused by its key."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.models.floornet import SHIPPED
from ebjax.models.weights import load_weights
from ebjax.places.fixed_words import fixed_words, words_path
from ebjax.places.place import place_of
from ebjax.train import words as module
from ebjax.train.words import Config, run

SMALL = Config(canvases=7, places=1, side_px=96, cells=600)


@pytest.fixture
def quick_floors(monkeypatch):
    """Floors of random texture."""

    def made(number, *, seed):
        noise = gaussian_filter(np.random.default_rng([seed, number]).standard_normal((512, 512)), 2.0)
        base = 0.5 + 0.15 * noise / noise.std()
        return np.stack([base, 0 * base, 0 * base], -1).astype(np.float16)

    monkeypatch.setattr(module, "make_canvas", made)


@pytest.mark.slow
def test_words_for_other_weights_are_found_beside_them_by_the_remedy(tmp_path, quick_floors, capsys):
    file = tmp_path / "floornet.safetensors"
    data = bytearray(SHIPPED.read_bytes())
    data[-1] ^= 1
    file.write_bytes(bytes(data))
    with pytest.raises(ValueError, match=f"--task words --descriptors floornet --weights {file} --out {tmp_path}"):
        fixed_words("floornet", file)
    run(dataclasses.replace(SMALL, descriptors=("floornet",), weights=file), tmp_path, resume=False)
    assert "floornet.words.safetensors: words from" in capsys.readouterr().out
    words = fixed_words("floornet", file)
    rng = np.random.default_rng(0)
    kept = {"map": rng.standard_normal((12, 12, 64)).astype(np.float16), "cells": np.ones((12, 12), bool)}
    assert place_of(kept, words).vector.shape == (4096,)


@pytest.mark.slow
def test_the_same_seed_makes_the_same_words(tmp_path, quick_floors):
    only = dataclasses.replace(SMALL, descriptors=("rootsift-vlad",))
    for name in "ab":
        run(only, tmp_path / name, resume=False)
    a, b = (load_weights(words_path("rootsift-vlad", tmp_path / name))[1] for name in "ab")
    for name, array in a.items():
        np.testing.assert_array_equal(array, b[name])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"descriptors": ("hog",)}, "descriptors: hog has no words; these have: floornet, rootsift-vlad"),
        ({"descriptors": ()}, "descriptors is empty"),
        ({"canvases": 3}, "canvases is 3: needs 7 or more"),
        ({"places": 10}, "places is 10: needs 1 to 9"),
        ({"side_px": 100}, "side_px is 100: needs a multiple of 8"),
        ({"cells": 1}, "cells is 1: needs 128 or more"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        run(dataclasses.replace(Config(), **change), tmp_path, resume=False)


def test_nothing_is_resumed(tmp_path):
    with pytest.raises(ValueError, match="run it again without"):
        run(SMALL, tmp_path, resume=True)
