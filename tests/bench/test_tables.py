"""Tables of times beside other libraries: both sides do the same, and the commands say it."""

import numpy as np
import pytest

from ebjax.bench.__main__ import main
from ebjax.bench.searching import same, searches_of, top_k_by_numpy


def lines_of(capsys, *argv):
    main(list(argv))
    return capsys.readouterr().out.splitlines()


def refused(capsys, *argv):
    with pytest.raises(SystemExit) as stop:
        main(list(argv))
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_everyone_finds_the_same():
    found = searches_of(500, 20, 64, 10, 0)
    assert {"ebjax", "NumPy"} <= found.keys()
    assert same({name: np.asarray(search()) for name, search in found.items()}) == 1


def test_numpy_s_way_is_a_full_sort():
    rng = np.random.default_rng(1)
    queries, references = (rng.standard_normal((n, 8)).astype(np.float32) for n in (5, 60))
    for some in (queries, queries[:1]):
        expected = np.argsort(-some @ references.T, axis=1)[:, :7]
        np.testing.assert_array_equal(top_k_by_numpy(some, references, 7), expected)


def test_a_search_has_a_line_a_size(capsys):
    lines = lines_of(capsys, "nearest", "--length", "16", "--turns", "1", "--sizes", "50", "4", "30", "1")
    assert [line.split()[:2] for line in lines[1:3]] == [["50", "4"], ["30", "1"]]
    assert "--top" in refused(capsys, "nearest", "--top", "0")


@pytest.mark.slow
def test_lenses_have_a_line_each(capsys):
    lines = [line.split("|") for line in lines_of(capsys, "lenses", "--frames", "1", "--turns", "1")]
    assert [line[1].strip() for line in lines[2:]] == ["pinhole", "equidistant", "plumb_bob", "omnidirectional"]
    assert all(float(line[4]) > 40 for line in lines[2:])
    assert "--frames is 0" in refused(capsys, "lenses", "--frames", "0")


def test_motions_come_out_right_on_both_sides(capsys):
    flags = ["--pairs", "2", "--keypoints", "200", "--length", "64", "--turns", "1"]
    _, ours, theirs = lines_of(capsys, "pairs", *flags)
    assert "100% of the motions right" in ours and "100%" in theirs and "times as long" in theirs
    assert "at least 1" in refused(capsys, "pairs", "--pairs", "0")


def test_a_bag_is_listed_and_read(capsys):
    pytest.importorskip("rosbags.highlevel")
    lines = lines_of(capsys, "bags", "--size-gb", "0.05", "--frames", "3", "--kind", "mcap")
    assert [line.split()[0] for line in lines] == ["bag", "list", "frame", "memory"]
    assert "--size-gb" in refused(capsys, "bags", "--size-gb", "0")
