import numpy as np
import pytest

from ebjax.posegraph import solve
from ebjax.posegraph.g2o import format_g2o, parse_g2o, read_g2o

EDGE = "EDGE_SE2 {} {} 1 0 0.1 2 0.1 0 3 0 4"
SMALL = f"""# a comment
PARAMS_SE2OFFSET 0 0 0 0
VERTEX_SE2 7 0 0 0
VERTEX_SE2 3 1 0 0.1

VERTEX_SE2 5 2 0 0.2
FIX 3
{EDGE.format(7, 3)}
{EDGE.format(3, 5)}
"""


def test_sparse_unsorted_ids_fix_comments_and_parameters():
    graph, ids = parse_g2o(SMALL)
    assert ids.tolist() == [7, 3, 5]
    assert graph.fixed.tolist() == [False, True, False]
    assert (graph.i.tolist(), graph.j.tolist()) == ([0, 1], [1, 2])
    np.testing.assert_array_equal(graph.information[0], [[2, 0.1, 0], [0.1, 3, 0], [0, 0, 4]])


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_written_and_read_again_is_the_same(ring, group):
    graph, _ = ring(group, n=12, loops=2)
    ids = np.arange(12) * 5 + 100
    again, ids_again = parse_g2o(format_g2o(graph, ids))
    np.testing.assert_array_equal(ids_again, ids)
    for name in ("poses", "measured"):
        np.testing.assert_allclose(getattr(again, name), getattr(graph, name), atol=1e-15)
    np.testing.assert_array_equal(np.triu(again.information), np.triu(graph.information))
    assert again.group == group


def test_without_vertices_the_poses_start_from_odometry():
    graph, ids = parse_g2o("\n".join([EDGE.format(9, 20), EDGE.format(4, 9)]))
    assert ids.tolist() == [4, 9, 20]
    np.testing.assert_allclose(graph.poses[0], 0)
    np.testing.assert_allclose(graph.poses[2], [1 + np.cos(0.1), np.sin(0.1), 0.2])


def test_a_missing_vertex_starts_where_its_edge_puts_it():
    with pytest.warns(UserWarning, match="g2o text: no VERTEX line for 4 and 1 more"):
        graph, ids = parse_g2o("\n".join(["VERTEX_SE2 9 5 5 0", EDGE.format(9, 20), EDGE.format(4, 9)]))
    assert ids.tolist() == [4, 9, 20]
    np.testing.assert_allclose(graph.poses[1:], [[5, 5, 0], [6, 5, 0.1]])
    assert not graph.fixed.any()


def test_toro_is_read_with_its_own_order_of_the_information():
    graph, _ = parse_g2o("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 11 1 22 33 2 3")
    np.testing.assert_array_equal(graph.information[0], [[11, 1, 2], [1, 22, 3], [2, 3, 33]])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 7 3 1 0 0.1 2", r"bad.g2o:10: EDGE_SE2 has 6 numbers, needs 11"),
        ("EDGE_SE2 7 3 1 0 0 2 0 0 -3 0 4", r"bad.g2o:10: information matrix is not positive definite"),
        ("EDGE_SE2 7 3 1 nan 0 2 0 0 3 0 4", r"bad.g2o:10: edge holds a number that is not finite"),
        ("EDGE_SE2 7 3 1 0 0 2 0 0 3 zero 4", r"bad.g2o:10: EDGE_SE2 holds something that is not a number"),
        ("VERTEX_SE2 7 0 0 0", r"bad.g2o:10: vertex 7 appears twice"),
        ("VERTEX_SE2 8 0 inf 0", r"bad.g2o:10: VERTEX_SE2 8 is not finite"),
        ("VERTEX_SE3:QUAT 8 0 0 0 0 0 0 1", r"bad.g2o:10: .* keep one of SE2 and SE3"),
        ("EDGE_SWITCHABLE 7 3 1", r"bad.g2o:10: EDGE_SWITCHABLE is not supported"),
        ("FIX 12", r"bad.g2o:10: FIX names vertex 12"),
        (EDGE.format(7, 7), r"bad.g2o:10: edge joins vertex 7 with itself"),
    ],
)
def test_bad_lines_are_named(tmp_path, line, message):
    path = tmp_path / "bad.g2o"
    path.write_text(SMALL + line + "\n")
    with pytest.raises(ValueError, match=message) as caught:
        read_g2o(path)
    assert "\n" not in str(caught.value)


def test_empty_files_are_refused():
    with pytest.raises(ValueError, match="no vertices and no edges"):
        parse_g2o("# nothing\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kernel", "cost", "tolerance"),
    [
        ("d5_pose_graph/lessNoise.g2o", "cauchy", 2.889663, 1e-5),
        ("d5_pose_graph/lessNoise.g2o", "none", 2.95653689, 1e-6),
        ("d5_pose_graph/vpr.g2o", "cauchy", 52.020826914, 1e-3),
        ("pose_graphs_g2o/intel.g2o", "none", 45.004233088, 1e-6),
        ("pose_graphs_g2o/smallGrid3D.g2o", "none", 1035.850664721, 1e-6),
    ],
)
def test_reference_optima_of_real_graphs(data, name, kernel, cost, tolerance):
    graph, _ = read_g2o(data(name))
    assert float(solve(graph, kernel=kernel).cost) == pytest.approx(cost, rel=tolerance)
