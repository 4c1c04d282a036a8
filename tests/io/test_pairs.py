import json

import numpy as np
import pytest

from ebjax.io.pairs import read_pairs

GOOD = {"quad": [[1, 1], [9, 1], [9, 9], [1, 9]], "H_a_to_b": [[1, 0, 2], [0, 1, 0], [0, 0, 1]], "note": "more is fine"}


def make(folder, values=GOOD, images=("a.png", "b.JPG")):
    folder.mkdir()
    (folder / "gt.json").write_text(values if isinstance(values, str) else json.dumps(values))
    for image in images:
        (folder / image).touch()


def test_reads_every_pair_by_name(tmp_path):
    for name in ("two", "one"):
        make(tmp_path / name)
    (tmp_path / "other").mkdir()
    one, two = read_pairs(tmp_path)
    assert (one.name, two.name) == ("one", "two")
    assert one.a == tmp_path / "one" / "a.png" and one.b == tmp_path / "one" / "b.JPG"
    np.testing.assert_array_equal(one.quad, GOOD["quad"])
    np.testing.assert_array_equal(one.b_from_a, GOOD["H_a_to_b"])


@pytest.mark.parametrize(
    "values",
    [
        "{",
        "[]",
        {"quad": GOOD["quad"]},
        {**GOOD, "quad": GOOD["quad"][:3]},
        {**GOOD, "quad": None},
        {**GOOD, "H_a_to_b": [[0, 0, 0]] * 3},
        {**GOOD, "H_a_to_b": [[1, 0], [0, 1, 0], [0, 0, 1]]},
        {**GOOD, "H_a_to_b": [[1e999, 0, 0], [0, 1, 0], [0, 0, 1]]},
    ],
)
def test_bad_truth_is_one_line_that_says_the_form(tmp_path, values):
    make(tmp_path / "pair", values)
    with pytest.raises(ValueError, match=r'pair.gt\.json: give "quad": four .* "H_a_to_b": 3 x 3') as error:
        read_pairs(tmp_path)
    assert "\n" not in str(error.value)


def test_what_is_missing_is_named(tmp_path):
    with pytest.raises(ValueError, match="no pair in it"):
        read_pairs(tmp_path)
    with pytest.raises(NotADirectoryError):
        read_pairs(tmp_path / "absent")
    make(tmp_path / "pair", images=("a.png", "b.txt"))
    with pytest.raises(ValueError, match=r"pair: no image b\.png"):
        read_pairs(tmp_path)


def test_two_images_of_one_side_and_one_that_is_not_read(tmp_path):
    make(tmp_path / "pair", images=("a.png", "a.jpg", "b.png"))
    with pytest.raises(ValueError, match=r"pair: both a\.jpg and a\.png; remove one of the two"):
        read_pairs(tmp_path)
    (tmp_path / "pair" / "a.jpg").unlink()
    (tmp_path / "pair" / "b.png").rename(tmp_path / "pair" / "b.heic")
    with pytest.raises(
        ValueError, match=r"no image b\.png or b\.jpg; b\.heic is not read: convert it to PNG.*b\.heic b\.png"
    ):
        read_pairs(tmp_path)
    (tmp_path / "pair" / "b.png").touch()
    assert len(read_pairs(tmp_path)) == 1
