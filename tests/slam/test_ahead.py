"""Work ahead of its turn: what fails in it is not lost."""

import time

import pytest

from ebjax.slam.ahead import Ahead


def test_what_nobody_waits_for_is_heard_of_when_it_fails():
    ahead, heard = Ahead(), []
    ahead.spare(lambda: heard.append("done"))
    ahead.spare(lambda: heard[1])
    while len(ahead._spare) and not ahead._spare[-1].done():
        time.sleep(0.01)
    with pytest.raises(IndexError):
        ahead.forget(0)
    assert heard == ["done"]
    ahead.forget(1)
