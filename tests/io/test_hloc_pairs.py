import numpy as np
import pytest

from ebjax.io.hloc_pairs import write_pairs

NAMES = [f"run/{k}.png" for k in range(6)]
CLOSURES = np.array([[5, 0], [4, 1]])


def hloc_reads(path):
    """`parse_retrieval` of hloc/utils/parsers.py: lines, each split at blanks into two names."""
    found = {}
    for line in path.read_text().rstrip("\n").split("\n"):
        if line:
            query, reference = line.split()
            found.setdefault(query, []).append(reference)
    return found


def test_closures_are_pairs(tmp_path):
    assert write_pairs(tmp_path / "pairs.txt", NAMES, CLOSURES) == 2
    assert hloc_reads(tmp_path / "pairs.txt") == {"run/5.png": ["run/0.png"], "run/4.png": ["run/1.png"]}


@pytest.mark.parametrize("sessions, expected", [(None, 5), (np.array([0, 0, 0, 1, 1, 1]), 4), (np.arange(6), 0)])
def test_keyframes_that_follow_on_each_other_are_asked_for(tmp_path, sessions, expected):
    path = tmp_path / "pairs.txt"
    assert write_pairs(path, NAMES, CLOSURES, successive=True, sessions=sessions) == 2 + expected
    lines = [tuple(line.split()) for line in path.read_text().splitlines()]
    assert lines[:2] == [("run/5.png", "run/0.png"), ("run/4.png", "run/1.png")]
    assert len(lines) == 2 + expected
    assert (("run/2.png", "run/3.png") in lines) == (sessions is None)


def test_a_pair_is_written_once_whichever_way_round(tmp_path):
    twice = np.array([[2, 1], [1, 2], [2, 1], [5, 0]])
    assert write_pairs(tmp_path / "pairs.txt", NAMES, twice, successive=True) == 6
    lines = [frozenset(line.split()) for line in (tmp_path / "pairs.txt").read_text().splitlines()]
    assert len(set(lines)) == len(lines) == 6


def test_no_closure_is_an_empty_file(tmp_path):
    assert write_pairs(tmp_path / "pairs.txt", NAMES, CLOSURES[:0]) == 0
    assert hloc_reads(tmp_path / "pairs.txt") == {}


@pytest.mark.parametrize("name", ["my run/1.png", "1\t.png", " 1.png", "1.png\n", "a\u00a0b.png", ""])
def test_a_name_that_hloc_would_split_is_refused_by_name(tmp_path, name):
    names = [*NAMES[:1], name, *NAMES[2:]]
    with pytest.raises(
        ValueError, match=r"pairs\.txt: the image of keyframe 1 .*rename the images.*python -m ebjax\.logs LOG"
    ) as told:
        write_pairs(tmp_path / "pairs.txt", names, CLOSURES)
    assert not (tmp_path / "pairs.txt").exists()
    assert "\n" not in str(told.value) and repr(name)[1:-1] in str(told.value)
    # The remedy; and an image of no pair may be called anything.
    assert write_pairs(tmp_path / "pairs.txt", NAMES, CLOSURES) == 2
    assert write_pairs(tmp_path / "pairs.txt", names, CLOSURES[:1]) == 1


def test_two_images_of_one_name_are_refused(tmp_path):
    names = [*NAMES[:4], NAMES[0], NAMES[5]]
    with pytest.raises(ValueError, match=r"keyframes 0 and 4 are both called 'run/0\.png'.*a folder of its own"):
        write_pairs(tmp_path / "pairs.txt", names, CLOSURES)
