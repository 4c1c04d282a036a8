import functools

import numpy as np
import pytest

from ebjax.posegraph.g2o import format_g2o, read_g2o


@pytest.fixture
def command(program):
    return functools.partial(program, "ebjax.posegraph")


def test_optimises_a_file_and_writes_it_whole(command, ring, tmp_path):
    graph, truth = ring(n=30, loops=4)
    (tmp_path / "graph.g2o").write_text(format_g2o(graph))
    done = command("graph.g2o", "--out", "out/better.g2o", "--robust", "cauchy", "--strict", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
    before, after = next(line for line in done.stdout.splitlines() if line.startswith("cost"))[5:].split(" -> ")
    assert float(after) < float(before)
    better, _ = read_g2o(tmp_path / "out" / "better.g2o")
    error = lambda poses: np.linalg.norm(np.asarray(poses)[:, :2] - truth[:, :2], axis=1).mean()  # noqa: E731
    assert error(better.poses) < error(graph.poses)


def test_missing_vertices_are_noted(command, tmp_path):
    (tmp_path / "thin.g2o").write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    done = command("thin.g2o", "--quiet", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == "note: thin.g2o: no VERTEX line for 1; they start where the edges put them\n"


def test_bad_input_is_one_line_exit_2_and_no_output(command, tmp_path):
    (tmp_path / "bad.g2o").write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0\n")
    done = command("bad.g2o", "--out", "out.g2o", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: bad.g2o:2: EDGE_SE2 has 10 numbers")
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out.g2o").exists()
    assert command("absent.g2o", cwd=tmp_path).returncode == 2


def test_steps_used_up_is_exit_3_only_when_strict(command, ring, tmp_path):
    graph, _ = ring(n=30, loops=4, false_loops=2)
    (tmp_path / "graph.g2o").write_text(format_g2o(graph))
    assert command("graph.g2o", "--max-steps", "1", cwd=tmp_path).returncode == 0
    assert command("graph.g2o", "--max-steps", "1", "--strict", cwd=tmp_path).returncode == 3


PLANE = """VERTEX_XY 10 2.2 1.1
VERTEX_SE2 1 0 0 0
VERTEX_SE2 2 1.1 0 0
EDGE_SE2 1 2 1.1 0 0 100 0 0 100 0 400
EDGE_SE2_XY 1 10 2 1 1000 0 1000
EDGE_SE2_XY 2 10 1 1 1000 0 1000
"""


def test_counts_landmarks_and_priors_and_writes_them_back(command, tmp_path):
    (tmp_path / "map.g2o").write_text(PLANE + "EDGE_PRIOR_SE2_XY 1 0 0 50 0 50\nEDGE_PRIOR_XY 10 2 1 50 0 50\n")
    done = command("map.g2o", "--quiet", "--robust", "none", "--out", "out.g2o", "--plot", "map.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "map.g2o: 2 poses, 1 landmarks, 2 priors, 3 edges, SE2, least squares\n" in done.stdout
    assert done.stderr == ""
    graph, ids = read_g2o(tmp_path / "out.g2o")
    assert ids.tolist() == [1, 2, 10]
    assert [line.split()[0] for line in (tmp_path / "out.g2o").read_text().splitlines()] == [
        *("VERTEX_SE2", "VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY", "EDGE_SE2_XY"),
        *("EDGE_PRIOR_SE2_XY", "EDGE_PRIOR_XY"),
    ]
    assert np.isfinite(graph.poses).all()


def test_what_is_held_is_said_and_what_is_open_is_named_until_it_is_fixed(command, tmp_path):
    (tmp_path / "one.g2o").write_text(PLANE + "EDGE_PRIOR_SE2_XY 2 1 0 50 0 50\n")
    done = command("one.g2o", "--quiet", cwd=tmp_path)
    assert done.returncode == 0
    assert (
        done.stderr == "note: one.g2o: the measurements leave a motion of the whole free; vertex 1 is held against it\n"
    )
    (tmp_path / "open.g2o").write_text(PLANE + "VERTEX_XY 11 0 1\nEDGE_SE2_XY 1 11 0 1 1000 0 0\n")
    done = command("open.g2o", "--quiet", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        "error: open.g2o: the measurements do not determine 11; measure these in every direction, or FIX them\n"
    )
    (tmp_path / "open.g2o").write_text((tmp_path / "open.g2o").read_text() + "FIX 11\n")
    assert command("open.g2o", "--quiet", cwd=tmp_path).returncode == 0
