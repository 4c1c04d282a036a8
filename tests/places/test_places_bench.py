"""The bench of the search: everyone finds the same, and the command prints a line a size."""

import numpy as np
import pytest

from ebjax.command import run
from ebjax.places.__main__ import BenchConfig, show_bench
from ebjax.places.bench import bench, top_k_by_numpy


def test_everyone_finds_the_same():
    row = bench(500, 20, 64, 10, 1, 0)
    assert row.same == 1 and {"ebjax", "NumPy"} <= row.ms.keys() and min(row.ms.values()) > 0


def test_numpy_s_way_is_a_full_sort():
    rng = np.random.default_rng(1)
    queries, references = (rng.standard_normal((n, 8)).astype(np.float32) for n in (5, 60))
    for some in (queries, queries[:1]):
        expected = np.argsort(-some @ references.T, axis=1)[:, :7]
        np.testing.assert_array_equal(top_k_by_numpy(some, references, 7), expected)


def test_the_command_prints_a_line_a_size(capsys):
    flags = ["--length", "16", "--turns", "1", "--sizes", "50", "4", "30", "1"]
    run(show_bench, BenchConfig, flags, needs_jax=False)
    assert [line.split()[:2] for line in capsys.readouterr().out.splitlines()[1:3]] == [["50", "4"], ["30", "1"]]
    with pytest.raises(SystemExit) as stop:
        run(show_bench, BenchConfig, ["--top", "0"], needs_jax=False)
    assert stop.value.code == 2
