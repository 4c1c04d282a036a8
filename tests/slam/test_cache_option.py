"""What networks make of views is looked up in --cache; a run that ends with an error has kept what it had."""

import contextlib

import numpy as np
import pytest

from ebjax.slam.__main__ import Config, remembering


def test_without_the_option_nothing_is_remembered():
    with contextlib.ExitStack() as at_end:
        assert remembering(Config(), at_end) is None


def test_a_view_is_looked_at_once_though_the_run_fails(tmp_path):
    calls = []

    def look(view):
        calls.append(view)
        return {"twice": 2 * view}

    config = Config(cache=tmp_path)
    for value in (1.0, 1.0, 2.0):
        with pytest.raises(RuntimeError), contextlib.ExitStack() as at_end:
            known = remembering(config, at_end)("net", None)(look)
            np.testing.assert_array_equal(known(np.full(3, value))["twice"], np.full(3, 2 * value))
            raise RuntimeError
    assert len(calls) == 2
    with contextlib.ExitStack() as at_end:
        faster = Config(cache=tmp_path, arithmetic="winograd")
        remembering(faster, at_end)("net", None)(look)(np.ones(3))
    assert len(calls) == 3
