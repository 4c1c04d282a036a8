import contextlib
import io
import re

import pytest

from ebjax.viz.ticker import COMPILES, LiveLine, PlainLines, ticker


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")


def run(total, frames, seconds_a_frame, *, first=0, ms=(20.0,), stream=io.StringIO):
    """What a run writes to stderr."""
    now = [100.0]
    with contextlib.redirect_stderr(stream()) as written, ticker(total, clock=lambda: now[0]) as t:
        for k in range(first, first + frames):
            now[0] += seconds_a_frame
            t.update(k, k // 2, k // 10, ms[k % len(ms)])
    told = written.getvalue()
    if total and stream is io.StringIO:
        first_line, _, told = told.partition("\n")
        assert first_line == f"frame 0 of {total:,}: waits while JAX {COMPILES}"
    return told


def test_lines_come_every_five_seconds_and_at_the_end():
    lines = run(None, 130, 0.125).splitlines()
    assert len(lines) == 4
    assert lines[0] == "frame 40: 19 keyframes, 3 closures, 20 ms a frame, 8.0 frames/s"
    assert lines[3] == "frame 130: 64 keyframes, 12 closures, 20 ms a frame, 8.0 frames/s"


@pytest.mark.parametrize("frames, seconds, expected", [(1000, 0.015625, 10), (64, 0.0625, 4), (40, 1.0, 10)])
def test_lines_come_after_a_tenth_but_not_within_a_second(frames, seconds, expected):
    lines = run(frames, frames, seconds).splitlines()
    assert len(lines) == expected
    assert lines[-1].startswith(f"frame {frames:,} of {frames:,} (100%): ")


def test_the_last_frame_is_told_once():
    assert run(10, 0, 1.0) == ""
    assert len(run(10, 10, 5.0).splitlines()) == 10


@pytest.mark.parametrize("first", [0, 5000])
def test_a_run_that_is_taken_up_again_has_the_rate_of_its_own_frames(first):
    line, *_ = run(10_000, 60, 0.125, first=first).splitlines()
    assert line.startswith(f"frame {first + 40:,} of 10,000 ({(first + 40) / 10_000:.0%})") and "8.0 frames/s" in line


def test_means_are_those_since_the_last_line():
    assert re.findall(r"(\d+) ms", run(None, 4, 2.5, ms=(10.0, 30.0, 100.0, 200.0))) == ["20", "150"]


def test_an_error_leaves_what_was_done():
    with contextlib.redirect_stderr(io.StringIO()) as written, pytest.raises(KeyboardInterrupt), ticker(10) as t:
        t.update(0, 1, 0, 5.0)
        raise KeyboardInterrupt
    assert written.getvalue().splitlines()[1].startswith("frame 1 of 10 (10%): 1 keyframes")


@pytest.mark.parametrize("total, counted", [(64, "64/64"), (None, "64/?")])
def test_a_terminal_has_one_live_line_which_goes(total, counted):
    shown = run(total, 64, 0.125, stream=Terminal)
    assert "31 keyframes, 6 closures, 20 ms a frame, 8.0 frames/s" in shown and counted in shown
    assert "frame 64" not in shown
    wiped, left = shown.rpartition("\x1b[2K")[::2]
    assert "keyframes" in wiped and re.sub(r"\x1b\[\??[0-9;]*[a-zA-Z]|\s", "", left) == ""


@pytest.mark.parametrize("stream, term, kind", [
    (Terminal, "xterm", LiveLine), (Terminal, "dumb", PlainLines), (io.StringIO, "xterm", PlainLines),
])  # fmt: skip
def test_what_is_no_terminal_gets_lines(monkeypatch, stream, term, kind):
    monkeypatch.setenv("TERM", term)
    with contextlib.redirect_stderr(stream()):
        assert isinstance(ticker(1), kind)
