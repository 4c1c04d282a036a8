import importlib.util
import sys

import numpy as np
import pytest

from ebjax.bench.corridor import corridor
from ebjax.bench.graphs import GraphConfig, bench_graphs
from ebjax.bench.gtsam_solver import gtsam_solver
from ebjax.posegraph import solve
from ebjax.posegraph.g2o import format_g2o

HAS_GTSAM = importlib.util.find_spec("gtsam") is not None


def test_the_corridor_comes_back_to_where_it_started():
    graph = corridor(400, 8)
    loops = np.abs(np.asarray(graph.i) - np.asarray(graph.j)) != 1
    assert loops.sum() == 8
    opposed = np.abs(np.abs(np.asarray(graph.measured)[loops, 2]) - np.pi)
    assert (opposed < 0.05).all() and (np.linalg.norm(np.asarray(graph.measured)[loops, :2], axis=1) < 0.3).all()
    solution = solve(graph, kernel="none")
    assert float(solution.cost) < 0.7 * float(solution.initial_cost)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_GTSAM, reason="gtsam is not installed")
def test_tables_are_written_whole(tmp_path, capsys, untouched_jax):
    (tmp_path / "graph.g2o").write_text(format_g2o(corridor(100, 4)))
    out = tmp_path / "bench.md"
    bench_graphs(GraphConfig((tmp_path / "graph.g2o",), out, sizes=(200,), batch=2, turns=1))
    assert out.read_text().strip() == capsys.readouterr().out.strip()
    rows = [line.split(" | ") for line in out.read_text().splitlines() if line.startswith("| graph Cauchy")]
    cost, theirs = float(rows[0][3]), float(rows[0][5])
    assert cost == pytest.approx(theirs, rel=1e-6)


def test_without_gtsam_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ValueError, match=r"pip install .ebjax\[oracle\]"):
        gtsam_solver(corridor(100, 1), "none")
