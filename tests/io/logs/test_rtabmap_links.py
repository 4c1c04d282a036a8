import importlib
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.logs import rtabmap_links
from ebjax.io.logs.rtabmap import open_rtabmap
from ebjax.io.logs.rtabmap_links import Closure, Written, write_closures

sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("rtabmap_database")
Link, drive, make_database, planar = (getattr(made, name) for name in "Link drive make_database planar".split())
LOOSE = np.diag([0.04, 0.09, 0.01])
CORRELATED = np.array([[4e-2, 1e-2, 5e-3], [1e-2, 2e-2, 2e-3], [5e-3, 2e-3, 1e-2]])


def rows_of(path, query):
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        return database.execute(query).fetchall()


def links_of(path):
    """(from, to) -> type, information, transform, user_data of the user closures."""
    query = "SELECT from_id, to_id, type, information_matrix, transform, user_data FROM Link WHERE type = 4"
    return {
        (a, b): (kind, np.frombuffer(matrix).reshape(6, 6), np.frombuffer(pose, "<f4").reshape(3, 4), data)
        for a, b, kind, matrix, pose, data in rows_of(path, query)
    }


def everything(path):
    """Every table, trigger and index, in SQL."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        return list(database.iterdump())


def odometry_links(count=5, diagonal=100.0):
    matrix = diagonal * np.eye(6)
    return [Link(k, k + 1, 0, matrix) for k in range(1, count)] + [Link(k + 1, k, 0, matrix) for k in range(1, count)]


@pytest.fixture
def source(tmp_path):
    """Five nodes in a chain; odometry's information is 100, at one link 400 1 400 1 1 900."""
    links = odometry_links()
    links[0].information = np.diag([400.0, 1, 400, 1, 1, 900])
    return make_database(tmp_path / "run.db", drive(), links)


def closure(a=5, b=1, covariance=LOOSE, pose=(0.3, -0.2, 3.0)):
    return Closure(a, b, *pose, covariance)


def test_both_directions_with_the_same_information(source, tmp_path):
    before = source.read_bytes()
    written = write_closures(source, tmp_path / "out.db", [closure()])
    assert written == Written(1, 0, 0) and written.summary().startswith("1 closures inserted")
    assert source.read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["out.db", "run.db"]
    links = links_of(tmp_path / "out.db")
    assert set(links) == {(5, 1), (1, 5)}
    (_, forth, there, data), (_, back, home, _) = links[5, 1], links[1, 5]
    assert data is None
    np.testing.assert_allclose(there, planar(0.3, -0.2, 3.0)[:3], atol=1e-7)
    np.testing.assert_allclose(home, np.linalg.inv(planar(0.3, -0.2, 3.0))[:3], atol=1e-6)
    np.testing.assert_array_equal(forth, back)
    np.testing.assert_allclose(forth, np.diag([25, 100 / 9, 100, 100, 100, 100]))


def test_information_is_capped_at_the_greatest_of_odometry(source, tmp_path):
    write_closures(source, tmp_path / "out.db", [closure(covariance=np.diag([1e-6, 4e-2, 1e-6]))])
    np.testing.assert_allclose(links_of(tmp_path / "out.db")[5, 1][1].diagonal(), [400, 25, 100, 100, 100, 900])


@pytest.mark.parametrize("scale", [1.0, 1e-2, 1e-4])
def test_correlations_are_kept_under_the_cap(source, tmp_path, scale):
    write_closures(source, tmp_path / "out.db", [closure(covariance=scale * CORRELATED)])
    found = links_of(tmp_path / "out.db")[5, 1][1]
    assert np.linalg.eigvalsh(found).min() > 0 and (found.diagonal() <= [400, 100, 400, 100, 100, 900]).all()
    planar_axes = np.ix_([0, 1, 5], [0, 1, 5])
    wanted = np.linalg.inv(scale * CORRELATED)

    def correlation(matrix):
        root = np.sqrt(matrix.diagonal())
        return matrix / root[:, None] / root

    np.testing.assert_allclose(correlation(found[planar_axes]), correlation(wanted), atol=1e-9)
    if scale == 1.0:
        np.testing.assert_allclose(found[planar_axes], wanted)
    assert not found[np.ix_([2, 3, 4], [0, 1, 5])].any()


def test_the_optimised_state_is_cleared_and_nothing_else_changes(source, tmp_path):
    out = tmp_path / "out.db"
    write_closures(source, out, [closure()])
    before, after = everything(source), everything(out)
    lost, new = [s for s in before if s not in after], [s for s in after if s not in before]
    assert len(lost) == 1 and lost[0].startswith('INSERT INTO "Admin"')
    assert sorted(line[:19] for line in new) == ['INSERT INTO "Admin"', 'INSERT INTO "Link" ', 'INSERT INTO "Link" ']
    kept = "SELECT version, opt_last_localization, opt_map_x_min, opt_map_y_min, opt_map_resolution FROM Admin"
    assert rows_of(out, kept) == [("0.23.8", b"\x03", 0, 0, 0)]
    cleared = "opt_ids, opt_poses, opt_map, opt_cloud, opt_polygons_size, opt_polygons, opt_tex_coords"
    assert rows_of(out, f"SELECT {cleared}, opt_tex_materials FROM Admin") == [(None,) * 8]


def test_linked_and_invalid_nodes_are_skipped(tmp_path):
    nodes = drive(8)
    nodes[5].weight, nodes[6].weight, nodes[7].weight = -9, -1, None
    source = make_database(tmp_path / "run.db", nodes, [*odometry_links(8), Link(4, 1, 1), Link(3, -7, 8)])
    wanted = [(5, 4), (4, 5), (1, 4), (5, 1), (5, 1), (1, 5), (6, 1), (9, 1), (2, 2), (3, -7), (7, 1), (8, 1)]
    written = write_closures(source, tmp_path / "out.db", [closure(a, b) for a, b in wanted])
    assert written == Written(inserted=3, linked=5, invalid=4)
    assert set(links_of(tmp_path / "out.db")) == {(5, 1), (1, 5), (7, 1), (1, 7), (8, 1), (1, 8)}


def test_without_a_new_link_the_copy_is_the_same(source, tmp_path):
    assert write_closures(source, tmp_path / "out.db", [closure(2, 1)]) == Written(0, 1, 0)
    assert everything(tmp_path / "out.db") == everything(source)


def test_an_old_database_without_optimised_state_is_written(tmp_path):
    source = make_database(tmp_path / "run.db", drive(), odometry_links(), version="0.13.0")
    assert write_closures(source, tmp_path / "new" / "out.db", [closure()]).inserted == 1
    assert set(links_of(tmp_path / "new" / "out.db")) == {(5, 1), (1, 5)}


def test_a_version_before_0_13_is_refused(tmp_path):
    source = make_database(tmp_path / "run.db", drive(), odometry_links(), version="0.12.9")
    with pytest.raises(ValueError, match=r"run\.db: of RTAB-Map 0\.12\.9; closures are written from 0\.13\.0 on"):
        write_closures(source, tmp_path / "out.db", [closure()])
    assert not (tmp_path / "out.db").exists()


def test_a_write_ahead_log_is_copied_too(tmp_path):
    source = make_database(tmp_path / "run.db", drive(), odometry_links(), wal=True)
    with closing(sqlite3.connect(source)) as writer:
        writer.execute("UPDATE Node SET stamp = stamp + 50")
        writer.commit()
        write_closures(source, tmp_path / "out.db", [closure()])
    assert sorted(file.name for file in tmp_path.iterdir() if not file.name.startswith("run.db")) == ["out.db"]
    assert open_rtabmap(tmp_path / "out.db").colour.timestamps[0] == 151
    assert set(links_of(tmp_path / "out.db")) == {(5, 1), (1, 5)}


@pytest.mark.parametrize(
    "covariance, pose",
    [
        (np.diag([1.0, 1.0, -1.0]), (0.0, 0.0, 0.0)),
        (np.diag([1.0, np.nan, 1.0]), (0.0, 0.0, 0.0)),
        (np.eye(3) + np.eye(3, k=1) / 2, (0.0, 0.0, 0.0)),
        (np.eye(3), (0.0, np.inf, 0.0)),
    ],
)
def test_what_is_no_measurement_is_refused_and_nothing_written(source, tmp_path, covariance, pose):
    with pytest.raises(ValueError, match="closure of nodes 5 and 2: its pose and covariance must be finite"):
        write_closures(source, tmp_path / "out.db", [closure(), closure(5, 2, covariance, pose)])
    assert list(tmp_path.iterdir()) == [source]


def test_an_error_leaves_the_old_copy_alone(source, tmp_path, monkeypatch):
    out = tmp_path / "out.db"
    out.write_bytes(b"old")
    monkeypatch.setattr(rtabmap_links, "INSERT", "INSERT INTO Nothing VALUES(?, ?, ?, ?, ?)")
    with pytest.raises(ValueError, match="Nothing"):
        write_closures(source, out, [closure()])
    assert out.read_bytes() == b"old" and sorted(tmp_path.iterdir()) == [out, source]


def test_the_database_itself_is_never_the_copy(source, tmp_path):
    (tmp_path / "link.db").symlink_to(source)
    for out in (source, tmp_path / "link.db"):
        with pytest.raises(ValueError, match="is the database itself"):
            write_closures(source, out, [closure()])
    with pytest.raises(ValueError, match="is a folder"):
        write_closures(source, tmp_path, [closure()])
    (tmp_path / "out.db-wal").write_bytes(b"log")
    with pytest.raises(ValueError, match="another program has it open"):
        write_closures(source, tmp_path / "out.db", [closure()])


def test_without_odometry_links_a_closure_has_no_weight(tmp_path):
    source = make_database(tmp_path / "run.db", drive())
    with pytest.raises(ValueError, match=r"run\.db: no odometry link with information"):
        write_closures(source, tmp_path / "out.db", [closure()])


def test_three_closures_into_the_real_corridor(data, tmp_path):
    source, out = data("logs/rtabmap") / "corridor_v0.23.8_86_nodes.db", tmp_path / "out.db"
    before = source.read_bytes()
    tight = np.diag([1e-6, 1e-6, 1e-8])
    wanted = [closure(80, 6, tight, (0.5, 0.25, 3.1)), closure(70, 15, CORRELATED), closure(60, 26)]
    written = write_closures(source, out, [*wanted, closure(2, 1), closure(26, 60), closure(99, 1)])
    assert written == Written(inserted=3, linked=2, invalid=1)
    assert source.read_bytes() == before and list(tmp_path.iterdir()) == [out]
    links = links_of(out)
    assert set(links) == {(80, 6), (6, 80), (70, 15), (15, 70), (60, 26), (26, 60)}
    sizes = "SELECT DISTINCT length(information_matrix), length(transform), user_data FROM Link WHERE type = 4"
    assert rows_of(out, sizes) == [(288, 48, None)]
    for one in wanted:
        (_, forth, there, _), (_, back, home, _) = links[one.from_node, one.to_node], links[one.to_node, one.from_node]
        np.testing.assert_array_equal(forth, back)
        np.testing.assert_allclose(there, planar(one.x_m, one.y_m, one.theta_rad)[:3], atol=1e-6)
        np.testing.assert_allclose(there @ np.r_[home, [[0, 0, 0, 1]]], np.eye(4)[:3], atol=1e-6)
        assert (forth.diagonal() > 0).all() and (forth.diagonal() <= 1000).all()
    np.testing.assert_allclose(links[80, 6][1], 1000 * np.eye(6))
    tables = ["Node", "Data", "Word", "Feature", "GlobalDescriptor", "Info", "Statistics"]
    with closing(sqlite3.connect(f"file:{out}?mode=ro", uri=True)) as database:
        database.execute("ATTACH ? AS source", (f"file:{source}?mode=ro",))
        for table in tables:
            for one, other in (("main", "source"), ("source", "main")):
                query = f"SELECT count(*) FROM (SELECT * FROM {one}.{table} EXCEPT SELECT * FROM {other}.{table})"
                assert database.execute(query).fetchone() == (0,)
        old = "SELECT * FROM source.Link EXCEPT SELECT * FROM main.Link"
        assert database.execute(old).fetchall() == []
        assert database.execute("SELECT count(*) FROM main.Link").fetchone() == (170 + 6,)
        schemas = [database.execute(f"SELECT sql FROM {name}.sqlite_master").fetchall() for name in ("main", "source")]
        assert schemas[0] == schemas[1]
        assert database.execute("PRAGMA main.integrity_check").fetchone() == ("ok",)
        admin = "SELECT version, opt_last_localization, time_enter, dictionary_index FROM {}.Admin"
        assert len({database.execute(admin.format(name)).fetchone() for name in ("main", "source")}) == 1
    state = (
        "opt_ids, opt_poses, opt_map, opt_cloud, opt_polygons_size, opt_map_x_min, opt_map_y_min, opt_map_resolution"
    )
    assert rows_of(out, f"SELECT {state} FROM Admin") == [(None, None, None, None, None, 0, 0, 0)]
    log = open_rtabmap(out)
    assert len(log.colour) == 86 and "links: 3 user closure" in log.contents
