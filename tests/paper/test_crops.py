import json

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.command import run
from ebjax.paper import crop_table, crops
from ebjax.paper.__main__ import CropsConfig
from ebjax.paper.__main__ import crops as command


def floor(seed, side=400):
    noise = np.random.default_rng(seed).standard_normal((side, side, 1))
    blurred = sum(s * gaussian_filter(noise, (s, s, 0)) for s in (2, 6))
    return np.repeat(np.clip(128 + 40 * blurred / blurred.std(), 0, 255), 3, 2).astype(np.uint8)


def test_crops_overlap_and_fit():
    cut = crops.cut({"a": floor(0), "b": floor(1, 310)}, 1000)
    assert [name for name, *_ in cut].count("a") == 9 and [name for name, *_ in cut].count("b") == 4
    assert len(crops.cut({"a": floor(0)}, 5)) == 5
    with pytest.raises(ValueError, match="larger photographs"):
        crops.cut({"a": floor(0, 150)}, 5)


def test_a_query_is_its_crop_turned(monkeypatch):
    for name in ("ROTATION_DEG", "SCALE", "SHIFT", "PERSPECTIVE"):
        monkeypatch.setattr(crops, name, 0.0)
    image, rng = floor(0), np.random.default_rng(0)
    centre = 50 + (crops.SIDE_PX - 1) / 2
    turned, photograph_from_query = crops._warped(image, ("a", centre, centre), rng)
    np.testing.assert_allclose(photograph_from_query, [[-1, 0, 249], [0, -1, 249], [0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(turned[::-1, ::-1].astype(int), image[50:250, 50:250].astype(int), atol=1)


def test_light_changes_and_the_seed_says_how():
    image = floor(0, 200)
    first, again, other = (crops.relit(image, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first.astype(int) - other).mean() > 5 < np.abs(first.astype(int) - image).mean()


def test_turning_by_pi_finds_the_crops_in_other_light(monkeypatch):
    for name in ("ROTATION_DEG", "SCALE", "SHIFT", "PERSPECTIVE"):
        monkeypatch.setattr(crops, name, getattr(crops, name) / 8)
    photographs = {"a": floor(0), "b": floor(1)}
    images, motions = crops.images_of(photographs, crops.cut(photographs, 18), seed=0)
    assert len(images) == 36 == 2 * len(motions)
    chosen = crops.BASELINES["rootsift grid"]
    found = crops.recall(crops.describe(chosen, images), chosen, "cosine", seed=0)
    assert found["floor + pi"] >= 0.9 and found["floor"] <= 0.3


@pytest.mark.slow
def test_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(crop_table, "DESCRIPTORS", ("hog", "netvlad"))
    monkeypatch.setattr(crop_table, "EXTRACTORS", ("rootsift", "d2net"))
    (tmp_path / "floors").mkdir()
    cv2.imwrite(str(tmp_path / "floors" / "a.png"), floor(0, 300))
    flags = ["--out", str(tmp_path / "out"), "--no-synthetic", "--weights", str(tmp_path)]
    run(command, CropsConfig, [str(tmp_path / "floors"), *flags])
    assert "real: 4 crops of 1 floors" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "crops.json").read_text())
    assert found["tables"]["real"].keys() == {"thumbnail", "rootsift grid", "hog"}
    assert found["features"]["real"].keys() == {"rootsift"} and found["features"]["real"]["rootsift"]["right"] >= 2
    assert "netvlad" in found["left_out"] and "kendall_tau" not in found
    assert cv2.imread(str(tmp_path / "out" / "crops_real.png")) is not None
    for words in (["--only", "b*"], ["--crops", "1"], ["--pairs", "0"]):
        with pytest.raises(SystemExit) as stop:
            run(command, CropsConfig, [str(tmp_path / "floors"), *flags, *words])
        assert stop.value.code == 2 and words[0] in capsys.readouterr().err
