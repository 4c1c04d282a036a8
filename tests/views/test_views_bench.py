import re

import pytest

from ebjax.command import run
from ebjax.views.__main__ import BenchConfig, show_bench


def test_the_table_has_a_line_a_lens(capsys):
    run(show_bench, BenchConfig, ["--frames", "1", "--turns", "1"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:]] == [
        "pinhole",
        "equidistant",
        "plumb_bob",
        "omnidirectional",
    ]
    assert all(float(re.split(r"\s*\|\s*", line)[4]) > 40 for line in lines[2:])


def test_no_frames_are_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        run(show_bench, BenchConfig, ["--frames", "0"])
    assert stop.value.code == 2 and "--frames is 0" in capsys.readouterr().err
