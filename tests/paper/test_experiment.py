import json

import cv2
import numpy as np
import pytest

from ebjax.paper import experiment
from ebjax.paper.experiment import REAL, Experiment
from ebjax.paper.pairs import cut_pairs
from ebjax.paper.run import read_run


@pytest.mark.slow
@pytest.mark.parametrize(("rms_px", "right"), [(None, 1), (50.0, 1), (0.001, 0)])
def test_real_pairs_are_judged_by_what_their_truth_is_known_to(small_run, tmp_path, monkeypatch, rms_px, right):
    monkeypatch.setattr(experiment, "EXTRACTORS", ("orb",))
    (made,) = cut_pairs(read_run(small_run), "W", 1)
    folder = tmp_path / "pairs" / "one"
    folder.mkdir(parents=True)
    for name, image in zip("ab", (made.image_a, made.image_b), strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), np.asarray(image)[..., ::-1])
    truth = {"quad": made.quad.tolist(), "H_a_to_b": made.b_from_a.tolist(), "rms_px": rms_px}
    (folder / "gt.json").write_text(json.dumps(truth))

    def measured():
        found = Experiment(tmp_path / "out", tmp_path, quick=True, pairs=1, weights=None, seed=0)
        found.correspondences((), folder.parent)
        return found.tables["table 3"]["orb: floor + pi"][REAL], found.cells.measured

    assert measured()[0]["right"] == right
    assert measured()[1] == 0
    (folder / "gt.json").write_text(json.dumps({**truth, "rms_px": 40.0}))
    again, count = measured()
    assert count == 1 and again["right"] == 1  # judged anew where the truth says something else
