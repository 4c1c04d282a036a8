"""Lines that g2o, RTAB-Map, gtsam and TORO write beside plain pose graphs: what they mean, and back again."""

import gzip
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.posegraph import solve
from ebjax.posegraph.factors import squared_residuals
from ebjax.posegraph.g2o import format_g2o, parse_g2o, read_g2o
from ebjax.posegraph.graph import loops_of, poses_alone

PLANE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0 0
VERTEX_SE2 2 2.2 0.1 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 0 100 0 0 100 0 400
"""
SIX = "1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6"
SPACE = f"""VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0 0 0 0 1
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {SIX}
"""


def read(text, **options):
    """The graph without regard to notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return parse_g2o(text, **options)


def best(text):
    graph, _ = read(text)
    return solve(graph, kernel="none", rtol=1e-12)


def same(a, b):
    for name in ("poses", "i", "j", "measured", "information", "fixed", "position", "landmark"):
        one, other = getattr(a, name), getattr(b, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_allclose(np.asarray(one, float), np.asarray(other, float), rtol=1e-12, atol=1e-12)
    assert (a.group, a.world) == (b.group, b.world)


@pytest.mark.parametrize("x", [2.5, 2.2])
def test_an_edge_of_the_tutorial_counts_like_any_other(x):
    text = PLANE + f"FIX 0\nTUTORIAL_EDGE_SE2 0 2 {x} 0 0 10000 0 0 10000 0 40000\n"
    solution = best(text)
    expected = 1 / (1 / 100 + 1 / 100 + 1 / 10000) * (x - 2) ** 2
    assert float(solution.cost) == pytest.approx(expected, rel=1e-6)
    assert float(solution.poses[2, 0]) == pytest.approx(x - (x - 2) / 201, rel=1e-6)
    same(read(text)[0], read(text.replace("TUTORIAL_", ""))[0])


def test_online_tags_lower_case_and_windows_are_read_as_what_they_are():
    plain, _ = parse_g2o(PLANE)
    for text in (
        PLANE.replace("VERTEX", "ONLINE_VERTEX").replace("EDGE", "ONLINE_EDGE"),
        PLANE.lower(),
        "\ufeff" + PLANE,
        PLANE.replace("\n", "\r\n"),
        PLANE.replace("\n", " # a remark\n"),
    ):
        same(parse_g2o(text)[0], plain)


def test_packed_files_and_byte_order_marks_are_read_by_content(tmp_path):
    path = tmp_path / "packed.g2o"
    path.write_bytes(gzip.compress(("\ufeff" + PLANE).encode()))
    same(read_g2o(path)[0], parse_g2o(PLANE)[0])
    path.write_bytes(gzip.compress(PLANE.encode())[:60])
    with pytest.raises(ValueError, match=r"packed.g2o: damaged gzip file"):
        read_g2o(path)
    path.write_bytes(b"\x89PNG\x00\xff")
    with pytest.raises(ValueError, match=r"packed.g2o: not a text file"):
        read_g2o(path)


@pytest.mark.parametrize("text", [PLANE, SPACE])
def test_decimal_commas_are_points(text):
    commas = (
        text.replace("1.1", "1,1").replace("2.2", "2,2").replace("0.1", "0,1").replace("3:QUAT 1 1", "3:QUAT 1 1,0")
    )
    with pytest.warns(UserWarning, match="decimal commas are read as points, as in ., in line|as in .,. in line 2"):
        graph, _ = parse_g2o(commas)
    same(graph, parse_g2o(text)[0])


def test_commas_that_are_not_decimal_are_refused():
    with pytest.raises(ValueError, match="g2o text:1: commas between fields; separate them by spaces"):
        parse_g2o(PLANE.replace(" ", ","))
    with pytest.raises(ValueError, match="g2o text:2: VERTEX_SE2 holds decimal points in a file with decimal commas"):
        parse_g2o(PLANE.replace("VERTEX_SE2 0 0", "VERTEX_SE2 0 0,5"))


@pytest.mark.parametrize(("x", "weight"), [(2.0, 10000.0), (2.3, 50.0)])
def test_planar_priors_pull(x, weight):
    text = (
        PLANE + f"EDGE_PRIOR_SE2 0 0 0 0 1e6 0 0 1e6 0 1e6\nEDGE_PRIOR_SE2 2 {x} 0 0 {weight} 0 0 {weight} 0 {weight}\n"
    )
    solution = best(text)
    assert float(solution.cost) == pytest.approx((x - 2) ** 2 / (1e-6 + 2 / 100 + 1 / weight), abs=1e-6)
    graph, ids = parse_g2o(text)
    assert graph.world
    assert ids.tolist() == [0, 1, 2]
    assert poses_alone(graph).poses.shape == (3, 3)
    assert not loops_of(graph).any()


def test_the_priors_of_rtabmap():
    text = """PARAMS_SE2OFFSET 0 0 0 0
VERTEX_SE2 1 0 0 0
VERTEX_SE2 2 1.1 0 0.02
VERTEX_SE2 3 2.2 0.05 0.04
EDGE_PRIOR_SE2 1 0 0 0 10000 0 0 10000 0 10000
EDGE_SE2 1 2 1.1 0 0.02 100 0 0 100 0 400
EDGE_SE2 2 3 1.1 0.03 0.02 100 0 0 100 0 400
EDGE_PRIOR_SE2 3 2 0 0 10000 0 0 10000 0 10000
"""
    solution = best(text)
    assert float(solution.cost) == pytest.approx(2.3275, abs=2e-4)
    expected = [[-0.001, -0.0001, -0.001], [1.0, -0.0146, -0.0016], [2.001, 0.0001, 0.0007]]
    np.testing.assert_allclose(solution.poses[:3], expected, atol=6e-5)


def test_spatial_priors_in_every_form_are_the_same():
    prior = f"1.1 0 0 0 0 0.1 0.995 {SIX}"
    forms = [
        f"EDGE_SE3_PRIOR 1 {prior}",
        f"PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nEDGE_SE3_PRIOR 1 0 {prior}",
        f"EDGE_SE3_PRIOR:QUAT 1 1 {prior}",
        f"EDGE_SE3_PRIOR 1 1 {prior}",
    ]
    graphs = [read(SPACE + form)[0] for form in forms]
    for graph in graphs[1:]:
        same(graph, graphs[0])
    assert (int(graphs[0].i[-1]), int(graphs[0].j[-1])) == (2, 1)
    with pytest.warns(UserWarning) as notes:
        parse_g2o(SPACE + f"EDGE_SE3_PRIOR 1 0 {prior}")
    assert any("line 4: no PARAMS line for 0; taken as no offset" in str(note.message) for note in notes)
    with pytest.raises(
        ValueError, match=r"g2o text:4: EDGE_SE3_PRIOR takes the offset 7; add a line PARAMS_SE3OFFSET 7"
    ):
        read(SPACE + f"EDGE_SE3_PRIOR 1 7 {prior}")


@pytest.mark.parametrize("weight", [1000, 5])
def test_landmarks_of_the_plane(weight):
    text = "VERTEX_XY 10 2.2 1.1\n" + PLANE.replace("1 0 0 100", "1.1 0 0 100").replace("2.2 0.1", "2.2 0") + "FIX 0\n"
    text += "\n".join(f"EDGE_SE2_XY {k} 10 {2 - k} 1 {weight} 0 {weight}" for k in range(3))
    solution = best(text)
    graph, ids = parse_g2o(text)
    assert ids.tolist() == [0, 1, 2, 10]
    assert graph.landmark.tolist() == [False, False, False, True]
    if weight == 1000:
        expected = [[0, 0, 0], [1.0239, -0.0134, 0.016], [2.0496, 0.0021, 0.0346], [2.0076, 1.0013, 0]]
        np.testing.assert_allclose(solution.poses, expected, atol=6e-5)
        assert float(solution.cost) == pytest.approx(1.504, abs=5e-4)
    same(parse_g2o(format_g2o(graph, ids))[0], graph)
    tutorial = text.replace("VERTEX_XY", "TUTORIAL_VERTEX_POINT_XY").replace(
        "EDGE_SE2_XY", "TUTORIAL_EDGE_SE2_POINT_XY"
    )
    same(parse_g2o(tutorial)[0], graph)


def test_landmarks_need_no_vertex_line():
    with pytest.warns(UserWarning, match="no VERTEX line for 10; they start where the edges put them"):
        graph, ids = parse_g2o(PLANE + "EDGE_SE2_XY 1 10 0.5 1 1 0 1\n")
    assert ids.tolist() == [0, 1, 2, 10]
    np.testing.assert_allclose(graph.poses[3], [1.6, 1, 0])


OFFSET = [0.3, -0.2, 0.1, *Rotation.from_euler("xyz", [0.2, -0.4, 0.7]).as_quat().tolist()]


def rigid(x):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(x[3:]).as_matrix(), x[:3]
    return out


def log(m):
    w = Rotation.from_matrix(m[:3, :3]).as_rotvec()
    t = np.linalg.norm(w)
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    inverse = np.eye(3) - k / 2 + (1 / t**2 - (1 + np.cos(t)) / (2 * t * np.sin(t))) * k @ k
    return np.concatenate([inverse @ m[:3, 3], w])


@pytest.mark.parametrize("information", ["g2o", "gtsam"])
@pytest.mark.parametrize(
    ("line", "residual"),
    [
        ("EDGE_SE3_PRIOR 1 5 {z} {i}", lambda a, b, p, z: log(np.linalg.inv(z) @ b @ p)),
        ("EDGE_SE3_OFFSET 0 1 5 5 {z} {i}", lambda a, b, p, z: log(np.linalg.inv(z) @ np.linalg.inv(a @ p) @ b @ p)),
        ("EDGE_SE3_TRACKXYZ 0 9 5 {t} {j}", lambda a, b, p, z: (np.linalg.inv(a @ p) @ [2, 3, 1, 1])[:3] - z[:3, 3]),
        ("EDGE_SE3_XYZ_PRIOR 1 5 {t} {j}", lambda a, b, p, z: b[:3, 3] - z[:3, 3]),
        ("EDGE_POINTXYZ_PRIOR 9 {t} {j}", lambda a, b, p, z: np.array([2, 3, 1]) - z[:3, 3]),
        ("EDGE_POINTXYZ 9 8 {t} {j}", lambda a, b, p, z: np.array([1, 1, 1]) - [2, 3, 1] - z[:3, 3]),
    ],
)
def test_costs_with_the_offset_of_a_sensor(line, residual, information):
    a, b, z = (
        np.array([*t, *Rotation.from_rotvec(w).as_quat()])
        for t, w in (
            ([0.1, 0.2, 0.3], [0.3, 0.1, -0.5]),
            ([1.0, 0.4, 0.1], [-0.2, 0.6, 0.1]),
            ([0.8, 0.1, -0.3], [0.1, 0.2, 0.9]),
        )
    )
    root = np.random.default_rng(0).normal(size=(6, 6))
    omega = root @ root.T
    text = "\n".join(
        [
            "VERTEX_SE3:QUAT 0 " + " ".join(map(repr, a.tolist())),
            "VERTEX_SE3:QUAT 1 " + " ".join(map(repr, b.tolist())),
            "VERTEX_TRACKXYZ 9 2 3 1\nVERTEX_TRACKXYZ 8 1 1 1",
            "PARAMS_SE3OFFSET 5 " + " ".join(map(repr, OFFSET)),
            line.format(
                z=" ".join(map(repr, z.tolist())),
                t=" ".join(map(repr, z[:3].tolist())),
                i=" ".join(map(repr, omega[np.triu_indices(6)].tolist())),
                j=" ".join(map(repr, omega[:3, :3][np.triu_indices(3)].tolist())),
            ),
        ]
    )
    graph, ids = read(text, information=information)
    r = residual(rigid(a), rigid(b), rigid(OFFSET), rigid(z))
    by = np.repeat([1, 0.5 if information == "g2o" else 1.0], 3)[: len(r)]
    expected = (by * r) @ omega[: len(r), : len(r)] @ (by * r)
    cost = squared_residuals(graph, jnp.asarray(graph.poses))
    np.testing.assert_allclose(np.asarray(cost), [expected], rtol=1e-10)
    same(read(format_g2o(graph, ids, information=information), information=information)[0], graph)


def test_information_of_rotations_is_g2os_where_only_g2o_writes_the_file():
    plain, _ = parse_g2o(SPACE)
    np.testing.assert_array_equal(np.diag(plain.information[0]), [1, 2, 3, 4, 5, 6])
    with pytest.warns(UserWarning, match="of the quaternion's vector part; --information gtsam"):
        graph, ids = parse_g2o(SPACE + "EDGE_POINTXYZ_PRIOR 1 1 0 0 1 0 0 1 0 1")
    np.testing.assert_array_equal(np.diag(graph.information[0]), [1, 2, 3, 1, 1.25, 1.5])
    assert SIX in format_g2o(graph, ids).replace(".0 ", " ").replace(".0\n", "\n")
    for information, scale in (("g2o", 0.25), ("gtsam", 1.0)):
        graph, ids = parse_g2o(SPACE, information=information)
        np.testing.assert_array_equal(np.diag(graph.information[0])[3:], scale * np.array([4, 5, 6]))
        assert SIX in format_g2o(graph, ids, information=information).replace(".0 ", " ").replace(".0\n", "\n")
    with pytest.raises(ValueError, match="information 'ros' is unknown; choose one of auto, g2o, gtsam"):
        parse_g2o(SPACE, information="ros")


@pytest.mark.parametrize(
    ("zeros", "expected"), [("1000 0 0 1000 0 0", 0.13608), ("1000 0 0 0 0 0", None), ("0 0 0 0 0 400", None)]
)
def test_information_may_be_semidefinite(zeros, expected):
    text = PLANE + f"FIX 0\nEDGE_SE2 0 2 2.05 0.02 0 {zeros}\n"
    graph, ids = parse_g2o(text)
    solution = best(text)
    assert np.isfinite(solution.poses).all()
    assert int(solution.status) == 0
    if expected:
        assert float(solution.cost) == pytest.approx(expected, abs=1e-5)
        np.testing.assert_allclose(
            solution.poses[1:], [[1.02381, 0.00852, 0.00212], [2.04762, 0.01915, 0.00212]], atol=1e-5
        )
    same(parse_g2o(format_g2o(graph, ids))[0], graph)


def test_eigenvalues_that_rounding_made_negative_are_zero():
    sigma = np.array([[1.0, 0.123456789, 0], [0, 0, 0], [0, 0, 0]])
    omega = np.round(sigma.T @ sigma, 5)
    numbers = " ".join(map(repr, omega[np.triu_indices(3)].tolist()))
    with pytest.warns(UserWarning, match="line 6: a negative eigenvalue, by rounding, is taken as zero"):
        graph, ids = parse_g2o(PLANE + f"EDGE_SE2 0 2 2 0 0 {numbers}\n")
    assert np.linalg.eigvalsh(graph.information[-1])[0] > -1e-15
    same(parse_g2o(format_g2o(graph, ids))[0], graph)
    with pytest.raises(ValueError, match="g2o text:6: information matrix is not positive definite: it has a negative"):
        parse_g2o(PLANE + "EDGE_SE2 0 2 2 0 0 1 0.2 0 0 0 0\n")


@pytest.mark.parametrize("tag", ["2", ""])
def test_toro_of_the_plane_in_both_orders_of_its_information(tag):
    vertices = f"VERTEX{tag} 0 0 0 0\nVERTEX{tag} 1 1 0 0\n"
    graph, _ = parse_g2o(vertices + f"EDGE{tag} 0 1 1 0 0 11 1 22 33 2 3")
    np.testing.assert_array_equal(graph.information[0], [[11, 1, 2], [1, 22, 3], [2, 3, 33]])
    with pytest.warns(UserWarning, match="line 3: information of EDGE2 is read row by row"):
        graph, _ = parse_g2o(vertices + f"EDGE{tag} 0 1 1 0 0 11 0 0 22 0 33")
    np.testing.assert_array_equal(np.diag(graph.information[0]), [11, 22, 33])


def test_toro_in_space_is_gtsams(tmp_path):
    gtsam = pytest.importorskip("gtsam")
    root = np.random.default_rng(1).normal(size=(6, 6))
    numbers = " ".join(map(repr, (root @ root.T)[np.triu_indices(6)].tolist()))
    text = f"VERTEX3 0 0 0 0 0 0 0\nVERTEX3 1 1 0.2 0.3 0.4 -0.5 0.6\nEDGE3 0 1 0.9 0.2 0.1 0.3 -0.2 0.5 {numbers}\n"
    path = tmp_path / "toro.graph"
    path.write_text(text)
    with pytest.warns(
        UserWarning, match="information of EDGE3 is read as TORO and gtsam mean it: the rotation stands first"
    ):
        graph, _ = read_g2o(path)
    factors, values = gtsam.readG2o(str(path), True)
    pose = values.atPose3(1)
    np.testing.assert_allclose(graph.poses[1, 4:], pose.translation(), atol=1e-12)
    np.testing.assert_allclose(
        abs(graph.poses[1, :4] @ pose.rotation().toQuaternion().coeffs()[[3, 0, 1, 2]]), 1, atol=1e-12
    )
    cost = float(squared_residuals(graph, jnp.asarray(graph.poses))[0])
    assert cost == pytest.approx(2 * factors.error(values), rel=1e-9)


def test_equivalent_vertices_stay_two():
    with pytest.warns(UserWarning, match="line 6: EQUIV 0 1: the vertices stay two, joined by their edge as measured"):
        graph, _ = parse_g2o(PLANE + "EQUIV 0 1\n")
    same(graph, parse_g2o(PLANE)[0])
    with pytest.raises(
        ValueError, match="g2o text:6: EQUIV 0 2 merges vertices that no edge joins; add an edge or delete"
    ):
        parse_g2o(PLANE + "EQUIV 0 2\n")


def test_ids_of_64_bits_and_no_more():
    big = 2**63 - 1
    graph, ids = parse_g2o(PLANE.replace("SE2 2", f"SE2 {big}").replace("SE2 1 2", f"SE2 1 {big}"))
    assert ids.tolist() == [0, 1, big]
    assert f"VERTEX_SE2 {big} " in format_g2o(graph, ids)
    with pytest.raises(ValueError, match=f"g2o text:6: {2**63} does not fit into 64 bits"):
        parse_g2o(PLANE + f"VERTEX_SE2 {2**63} 0 0 0\n")


def test_quaternions_are_made_unit_and_zero_is_refused():
    text = SPACE.replace("1 1 0 0 0 0 0 1\n", "1 1 0 0 0 0 0 2\n")
    with pytest.warns(UserWarning, match="line 2: the quaternion is not of unit length; made so"):
        graph, _ = parse_g2o(text)
    same(graph, parse_g2o(SPACE)[0])
    with pytest.raises(ValueError, match="g2o text:2: vertex 1 has a zero quaternion"):
        parse_g2o(SPACE.replace("1 1 0 0 0 0 0 1\n", "1 1 0 0 0 0 0 0\n"))


def test_scans_are_left_out_with_a_note():
    with pytest.warns(UserWarning, match="2 lines ROBOTLASER1, from line 6, are sensor data, no constraints; left out"):
        graph, _ = parse_g2o(PLANE + "ROBOTLASER1 0 1 2 3\nROBOTLASER1 0 1 2 3\n")
    same(graph, parse_g2o(PLANE)[0])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("VERTEX_SWITCH 9 1", "VERTEX_SWITCH is not supported: it makes an edge switchable; export without switches"),
        ("EDGE_SE2_SWITCHABLE 0 1 9 1 0 0 1 0 0 1 0 1", "EDGE_SE2_SWITCHABLE is not supported"),
        ("EDGE_SWITCH_PRIOR 9 1 1.0", "EDGE_SWITCH_PRIOR is not supported"),
        ("EDGE_BEARING_SE2_XY 0 9 0.1 1", "EDGE_BEARING_SE2_XY is not supported: it measures a bearing alone"),
        ("VERTEX_CAM 9 0 0 0 0 0 0 1", "VERTEX_CAM is not supported: it belongs to bundle adjustment"),
        ("EDGE_PROJECT_P2MC 0 9 1 2 1 0 1", "EDGE_PROJECT_P2MC is not supported"),
        ("EDGE_SE2_LINE2D 0 9 1 2 1 0 1", "EDGE_SE2_LINE2D is not supported; convert it to one of VERTEX_SE2, "),
        ("tutorial_edge_se2_line 0 9", "tutorial_edge_se2_line is not supported"),
        ("SOMETHING 1 2 3", "SOMETHING is not supported"),
        ("EDGE_SE2_XY 0 1.5 1 1 1 0 1", "EDGE_SE2_XY begins with ids, and 1.5 is none"),
        ("EDGE_PRIOR_SE2 9 0 0 0 1 0 0 1 0", "EDGE_PRIOR_SE2 has 9 numbers, needs 11"),
        ("VERTEX_XY 9 0 0\nEDGE_SE2 0 9 1 0 0 1 0 0 1 0 1", "7: EDGE_SE2 names vertex 9, a landmark without rotation"),
        ("VERTEX_XY 9 0 0\nEDGE_SE2_XY 9 0 1 0 1 0 1", "7: EDGE_SE2_XY begins with vertex 9, a landmark; put the pose"),
        ("EDGE_POINTXY 0 9 1 0 1 0 1", "EDGE_POINTXY begins with vertex 0, a pose; put a landmark first"),
        ("VERTEX_TRACKXYZ 9 0 0 0", "VERTEX_TRACKXYZ in a graph of VERTEX_SE2; keep one of SE2 and SE3 per file"),
    ],
)
def test_what_is_not_understood_is_named_with_its_line(line, message):
    with pytest.raises(ValueError, match=r"g2o text:[67]: ") as caught:
        parse_g2o(PLANE + line + "\n")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parameters_that_nothing_uses_may_pass():
    same(parse_g2o("PARAMS_CAMERACALIB 0 1 2 3\nPARAMS_SE2OFFSET 0 0 0 0\n" + PLANE)[0], parse_g2o(PLANE)[0])
