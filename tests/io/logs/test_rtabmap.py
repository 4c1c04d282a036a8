import importlib
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.depth_images import read_depth
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.rtabmap import node_of, open_rtabmap
from ebjax.io.trajectory import read_tum

sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("rtabmap_database")
K, Link, Node, drive, make_database, model, mount, planar = (
    getattr(made, name) for name in "K Link Node drive make_database model mount planar".split()
)
P = np.array([[48.0, 0, 15.5, 0], [0, 48, 11.5, 0], [0, 0, 1, 0]])
K_AS_P = np.c_[K, np.zeros(3)]


def with_fields(nodes, **fields):
    for node in nodes:
        for name, value in fields.items():
            setattr(node, name, value)
    return nodes


def opened(tmp_path, nodes, links=(), version="0.23.8", **options):
    return open_rtabmap(make_database(tmp_path / "run.db", nodes, links, version), **options)


def note(log, words):
    found = [line for line in log.notes if words in line]
    assert len(found) == 1, log.notes
    return found[0]


def test_images_poses_and_depth(tmp_path):
    nodes = with_fields(drive(), depth=made.depth_rvl(made.depth_mm()), calibration=model(base_from_camera=mount()))
    nodes[2].truth = planar(0.31)
    log = opened(tmp_path, nodes, [Link(1, 2), Link(2, 1), Link(2, 3), Link(1, 5, 1), Link(5, 1, 1)])
    assert log.kind == "RTAB-Map database" and not log.missing and not log.notes
    assert log.colour.names == tuple(f"node {k}" for k in range(1, 6)) and node_of(log.colour.names[4]) == 5
    np.testing.assert_array_equal(log.colour.timestamps, 100.0 + np.arange(1, 6))
    assert log.colour.decode(3).shape == (24, 32, 3) and (log.colour.decode(3) == 40).all()
    np.testing.assert_allclose(log.odometry.poses[:, 0, 3], 0.1 * np.arange(1, 6), atol=1e-7)
    np.testing.assert_array_equal(log.truth.timestamps, [103.0])
    np.testing.assert_allclose(log.truth.poses[0], planar(0.31), atol=1e-7)
    np.testing.assert_allclose(log.camera.base_from_camera, mount(), atol=1e-7)
    np.testing.assert_array_equal(log.camera.intrinsics, K)
    assert (log.camera.width, log.camera.height, log.camera.distortion_model) == (32, 24, "pinhole")
    assert log.contents == (
        "RTAB-Map 0.23.8",
        "session 0: 5 nodes, 5 images, 1 closures",
        "camera 0: 32 x 24 px, fx 50.0 px, 0.50 m over base_link, looks 30.0 degrees below the horizon",
        "depth: 32 x 24 px, RVL, millimetres",
        "links: 2 neighbour (odometry)",
        "links: 1 global closure",
    )


def test_colours_are_rgb(tmp_path):
    image = np.zeros((24, 32, 3), np.uint8)
    image[..., 0] = 200
    log = opened(tmp_path, with_fields(drive(2), image=made.cv2.imencode(".png", image)[1].tobytes()))
    assert log.colour.decode(0)[0, 0].tolist() == [0, 0, 200]


@pytest.mark.parametrize("kind", ["rvl", "png", "float", "half"])
def test_depth_of_every_kind(tmp_path, kind):
    millimetres = made.depth_mm()
    metres = millimetres / 1000
    metres[0, 1] = np.nan
    coded = {
        "rvl": made.depth_rvl(millimetres),
        "png": made.depth_png(millimetres),
        "float": made.depth_float(metres),
        "half": made.depth_rvl(millimetres[::2, ::2]),
    }[kind]
    log = opened(tmp_path, with_fields(drive(), depth=coded))
    depth = log.depth.decode(1)
    assert depth.dtype == np.float32 and depth.shape == ((12, 16) if kind == "half" else (24, 32))
    assert depth[0, 0] == 0 and (kind == "half" or depth[0, 1] == 0)
    np.testing.assert_allclose(depth[1:], 1.5, rtol=1e-6)
    assert "depth" not in log.missing and any(line.startswith("depth: ") for line in log.contents)


def test_depth_may_be_missing_at_some_nodes(tmp_path):
    nodes = with_fields(drive(), depth=made.depth_png(made.depth_mm()))
    nodes[0].depth, nodes[3].depth = None, made.png(3)
    log = opened(tmp_path, nodes)
    assert log.depth.names == ("node 2", "node 3", "node 4", "node 5")
    with pytest.raises(BrokenFrame, match=r"run\.db: node 4: its depth is no depth image"):
        log.depth.decode(2)


@pytest.mark.parametrize("version", ["0.23.8", "0.17.3"])
def test_the_right_image_of_a_stereo_pair_is_no_depth(tmp_path, version):
    left, right = (model(p=P, base_from_camera=mount()) for _ in range(2))
    blob = made.stereo(left, right) if version == "0.23.8" else made.old_model(mount(), baseline=0.1)
    log = opened(tmp_path, with_fields(drive(), depth=made.png(7), calibration=blob), version=version)
    assert log.depth is None and "depth" in log.missing
    assert "the left images are used" in note(log, "a stereo pair")
    np.testing.assert_allclose(log.camera.intrinsics, P[:, :3] if version == "0.23.8" else K)
    np.testing.assert_allclose(log.camera.base_from_camera, mount(), atol=1e-7)
    assert log.colour.decode(0).shape == (24, 32, 3)


@pytest.mark.parametrize("version", ["0.17.3", "0.11.10", "0.9.10", "0.18.0"])
def test_versions_are_compared_by_numbers(tmp_path, version):
    blob = model(base_from_camera=mount()) if version == "0.18.0" else made.old_model(mount())
    nodes = with_fields(drive(), calibration=blob)
    if version == "0.9.10":
        with pytest.raises(ValueError, match=r"run\.db: of RTAB-Map 0\.9\.10, older than 0\.11\.10.*rtabmap-reprocess"):
            opened(tmp_path, nodes, version=version)
        return
    log = opened(tmp_path, nodes, [Link(1, 2)], version=version)
    np.testing.assert_allclose(log.camera.intrinsics, K)
    np.testing.assert_allclose(log.camera.base_from_camera, mount(), atol=1e-7)


def test_a_newer_version_is_noted(tmp_path):
    assert "newer than 0.23" in note(opened(tmp_path, drive(), version="0.24.0"), "0.24.0")


def test_the_camera_that_sees_the_floor_is_used(tmp_path):
    image = np.concatenate([np.full((24, 32, 3), 30 * k, np.uint8) for k in (1, 2, 3)], axis=1)
    up, down, behind = mount(-10), mount(30), mount(30, yaw_deg=180)
    blob = b"".join(model(base_from_camera=pose) for pose in (up, behind, down))
    coded = made.cv2.imencode(".png", image)[1].tobytes()
    depth = np.concatenate([made.depth_mm(1000 * k) for k in (1, 2, 3)], axis=1)
    nodes = with_fields(drive(), image=coded, calibration=blob, depth=made.depth_rvl(depth))
    log = opened(tmp_path, nodes)
    assert "camera 2 of 3 is used, its axis meets the floor nearest, at 1.00 m" in note(log, "camera 2")
    assert (log.colour.decode(0) == 90).all() and log.colour.decode(0).shape == (24, 32, 3)
    assert np.median(log.depth.decode(0)) == 3
    np.testing.assert_allclose(log.camera.base_from_camera, down, atol=1e-7)
    given = open_rtabmap(log.path, camera_index=0)
    assert (given.colour.decode(0) == 30).all() and not given.notes
    with pytest.raises(ValueError, match=r"run\.db: no camera 3; its images hold 3, give 0 to 2"):
        open_rtabmap(log.path, camera_index=3)


def test_an_image_of_another_shape_is_broken(tmp_path):
    nodes = drive()
    nodes[1].image = made.png(5, width=64)
    log = opened(tmp_path, nodes)
    with pytest.raises(BrokenFrame, match=r"run\.db: node 2: 64 x 24 px, but its calibration has 1 camera"):
        log.colour.decode(1)


def test_the_session_with_most_images_is_run(tmp_path):
    nodes = drive(2) + with_fields(drive(4, first=3), session=1) + with_fields(drive(1, first=7), session=5)
    log = opened(tmp_path, nodes, [Link(6, 1, 1), Link(3, 4, 0)])
    assert log.colour.names == ("node 3", "node 4", "node 5", "node 6") and len(log.odometry.poses) == 4
    words = note(log, "session 1 is run, the one with most images")
    assert "left out: 0 (2 images), 5 (1 images)" in words
    assert "session 0: 2 nodes, 2 images, 1 closures" in log.contents
    assert "session 5: 1 nodes, 1 images, 0 closures" in log.contents
    given = open_rtabmap(log.path, session=0)
    assert given.colour.names == ("node 1", "node 2") and "as given" in note(given, "session 0")
    with pytest.raises(ValueError, match=r"run\.db: no session 2; give one of 0, 1, 5"):
        open_rtabmap(log.path, session=2)


def test_nodes_between_and_invalid_ones_are_skipped(tmp_path):
    nodes = drive(8)
    nodes[1].weight, nodes[2].weight, nodes[3].weight = -1, -9, -9
    nodes[4].image, nodes[5].pose, nodes[6].weight = None, None, None
    log = opened(tmp_path, nodes)
    assert log.colour.names == ("node 1", "node 6", "node 7", "node 8")
    np.testing.assert_array_equal(log.odometry.timestamps, [101, 102, 105, 107, 108])
    assert ": 1 nodes of weight -1" in note(log, "weight -1 ") and ": 2 nodes of weight -9" in note(log, "weight -9 ")
    assert ": 1 nodes without an image" in note(log, "without an image")
    assert ": 1 nodes have no odometry pose" in note(log, "no odometry pose")


def test_stamps_that_do_not_increase_are_left_out(tmp_path):
    nodes = drive()
    nodes[2].stamp, nodes[3].stamp = 102.0, None
    log = opened(tmp_path, nodes)
    assert log.colour.names == ("node 1", "node 2", "node 5") and ": 2 nodes left out" in note(log, "stamps")


def test_no_odometry_no_depth_no_camera(tmp_path):
    log = opened(tmp_path, with_fields(drive(), pose=None, calibration=None))
    assert log.odometry is None and log.truth is None and log.depth is None and log.camera is None
    assert set(log.missing) == {"camera", "mount", "odometry", "depth"}
    assert all("\n" not in words for words in log.missing.values())
    log = open_rtabmap(make_database(tmp_path / "mount.db", drive()))
    assert log.camera.base_from_camera is None and set(log.missing) == {"mount", "depth"}


def test_another_number_of_cameras_is_noted(tmp_path):
    nodes = with_fields(drive(), calibration=model(base_from_camera=mount()))
    nodes[1].calibration *= 2
    log = opened(tmp_path, nodes)
    assert len(log.colour) == 5 and ": 1 of 5 nodes have not 1 cameras" in note(log, "side by side")
    with pytest.raises(ValueError, match="no camera 1; the database holds no calibration"):
        open_rtabmap(make_database(tmp_path / "bare.db", with_fields(drive(), calibration=None)), camera_index=1)


@pytest.mark.parametrize("field", ["pose", "mount"])
def test_a_moving_camera_is_noted(tmp_path, field):
    nodes = with_fields(drive(), calibration=model(base_from_camera=mount()))
    other = {"base_from_camera": mount(40, 0.53)} if field == "pose" else {"k": K * 1.1, "base_from_camera": mount()}
    nodes[3].calibration = model(**other)
    log = opened(tmp_path, nodes)
    np.testing.assert_allclose(log.camera.base_from_camera, mount(), atol=1e-7)
    if field == "pose":
        assert "at 1 of 5 nodes" in note(log, "moves") and "by up to 0.030 m and 10.0 degrees" in note(log, "moves")
    else:
        assert "at 1 of 5 nodes the intrinsics differ" in note(log, "intrinsics")


def test_raw_images_are_suspected(tmp_path):
    d = (-0.05, 0.06, 0.001, 0.002, -0.02)
    nodes = with_fields(drive(), calibration=model(d=d, r=np.eye(3), p=K_AS_P, base_from_camera=mount()))
    log = opened(tmp_path, nodes)
    assert log.camera.distortion_model == "pinhole" and log.camera.distortion == ()
    assert "--images raw" in note(log, "probably not rectified")
    raw = open_rtabmap(log.path, images="raw")
    assert raw.camera.distortion_model == "plumb_bob" and raw.camera.distortion == d and not raw.notes


@pytest.mark.parametrize(
    "d, lens, expected",
    [
        ((1, 2, 0, 0, 3, 4), "equidistant", (1, 2, 3, 4)),
        ((1, 2, 3, 4), "plumb_bob", (1, 2, 3, 4)),
        (tuple(range(8)), "rational_polynomial", tuple(range(8))),
        ((0, 0, 0, 0, 0), "pinhole", ()),
    ],
)
def test_rectified_takes_p_and_raw_takes_k_and_the_lens(tmp_path, d, lens, expected):
    log = opened(tmp_path, with_fields(drive(), calibration=model(d=d, r=np.eye(3), p=P)))
    np.testing.assert_array_equal(log.camera.intrinsics, P[:, :3])
    assert log.camera.distortion_model == "pinhole" and not log.notes
    raw = open_rtabmap(log.path, images="raw")
    np.testing.assert_array_equal(raw.camera.intrinsics, K)
    assert raw.camera.distortion_model == lens and raw.camera.distortion == expected


def test_a_camera_without_a_size_has_the_images(tmp_path):
    log = opened(tmp_path, with_fields(drive(), calibration=model(size=(0, 0))))
    assert (log.camera.width, log.camera.height) == (32, 24)


def test_a_damaged_calibration_names_the_file(tmp_path):
    with pytest.raises(ValueError, match=r"run\.db: a calibration of 116 bytes that ends too early"):
        opened(tmp_path, with_fields(drive(), calibration=model(d=[1, 2, 3, 4])[:-32]))


def test_broken_images_are_found_when_decoded(tmp_path):
    nodes = drive()
    nodes[1].image, nodes[2].image, nodes[3].image = nodes[1].image[:-9], b"no image", b"\xff\xd8\xff\xe0 cut off"
    nodes[4].depth = made.depth_rvl(made.depth_mm())[:40]
    log = opened(tmp_path, nodes)
    for index, words in [(1, "truncated or damaged PNG"), (2, "not an image"), (3, "truncated JPEG")]:
        with pytest.raises(BrokenFrame, match=rf"run\.db: node {index + 1}: {words}"):
            log.colour.decode(index)
    with pytest.raises(BrokenFrame, match=r"run\.db: node 5: .*truncated"):
        log.depth.decode(0)


def test_what_is_no_database_is_refused_in_one_line(tmp_path):
    whole = make_database(tmp_path / "run.db", drive(40, depth=made.depth_png(made.depth_mm())))
    content = whole.read_bytes()
    cases = {
        "text.db": (b"0.1 0.2\n" * 40, "not a database; give the .db"),
        "empty.db": (b"", "not a database"),
        "cut.db": (content[: len(content) // 2], "a truncated database"),
        "damaged.db": (content[:4096] + bytes(8192) + content[12288:], "a damaged database"),
    }
    for name, (data, words) in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ValueError, match=f"{name}: {words}") as error:
            open_rtabmap(tmp_path / name)
        assert "\n" not in str(error.value)
    for path, words in [(tmp_path / "nowhere.db", "no such file"), (tmp_path, "is a folder")]:
        with pytest.raises(ValueError, match=words):
            open_rtabmap(path)


def test_values_that_are_no_numbers_are_damage(tmp_path):
    path = make_database(tmp_path / "run.db", drive())
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE Node SET weight = x'ff' WHERE id = 3")
        database.commit()
    with pytest.raises(ValueError, match=r"run\.db: a damaged database \(node 3 has values that are no numbers\)"):
        open_rtabmap(path)


@pytest.mark.parametrize(
    "schema, words",
    [
        ("CREATE TABLE topics(id); CREATE TABLE messages(id)", "a ROS 2 bag"),
        ("CREATE TABLE people(id)", "not RTAB-Map's"),
        ("CREATE TABLE Admin(version); CREATE TABLE Node(id)", "its table Node is not there"),
    ],
)
def test_another_sqlite_file_is_refused(tmp_path, schema, words):
    with closing(sqlite3.connect(tmp_path / "other.db")) as database:
        database.executescript(schema)
    with pytest.raises(ValueError, match=rf"other\.db: .*{words}"):
        open_rtabmap(tmp_path / "other.db")


def test_a_database_without_images_says_what_to_record(tmp_path):
    with pytest.raises(ValueError, match=r"run\.db: of RTAB-Map 0\.23\.8, session 0 has no image.*Mem/BinDataKept"):
        opened(tmp_path, with_fields(drive(), image=None))


def test_nothing_is_changed_or_left_beside_the_file(tmp_path):
    path = make_database(tmp_path / "run.db", drive(), wal=True)
    before = path.read_bytes()
    assert before[18:20] == b"\x02\x02"
    open_rtabmap(path).colour.decode(0)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_what_is_still_in_the_write_ahead_log_is_read(tmp_path):
    path = make_database(tmp_path / "run.db", drive(), wal=True)
    before = path.read_bytes()
    with closing(sqlite3.connect(path)) as writer:
        writer.execute("UPDATE Node SET stamp = stamp + 50")
        writer.commit()
        np.testing.assert_array_equal(open_rtabmap(path).colour.timestamps, 150.0 + np.arange(1, 6))
        assert path.read_bytes() == before


def test_a_database_that_was_not_closed_says_how_to_mend_it(tmp_path):
    path = make_database(tmp_path / "run.db", drive(200))
    with closing(sqlite3.connect(path)) as writer:
        writer.execute("PRAGMA cache_size=1")
        writer.execute("UPDATE Data SET image = x'00'")
        for suffix in ("", "-journal"):
            (tmp_path / f"left.db{suffix}").write_bytes(Path(f"{path}{suffix}").read_bytes())
    with pytest.raises(ValueError, match=r"left\.db: was not closed .*open it there once"):
        open_rtabmap(tmp_path / "left.db")


def test_a_camera_at_base_link_is_noted(tmp_path):
    log = opened(tmp_path, with_fields(drive(), calibration=model(base_from_camera=mount(30, 0.0))))
    assert "base_link is not on the floor" in note(log, "sits 0.00 m over base_link")


def test_names_of_nodes():
    assert node_of("node 12") == 12
    for name in ("node", "12", "node -1", "node 1.5", "frame 3"):
        with pytest.raises(ValueError, match="names no node"):
            node_of(name)


def test_real_corridor(data):
    path = data("logs/rtabmap") / "corridor_v0.23.8_86_nodes.db"
    log, folder = open_rtabmap(path), data("corridor_rgbd")
    assert len(log.colour) == len(log.depth) == 86 and log.truth is None and not log.missing and not log.notes
    odometry = read_tum(folder / "odometry.txt")
    rows = np.searchsorted(odometry.timestamps, log.colour.timestamps - 1e-4)
    np.testing.assert_allclose(log.colour.timestamps, odometry.timestamps[rows], atol=1e-6)
    np.testing.assert_allclose(log.odometry.timestamps, log.colour.timestamps)
    np.testing.assert_allclose(log.odometry.poses, odometry.poses[rows], atol=2e-6)
    np.testing.assert_array_equal(log.camera.intrinsics, [[615, 0, 320], [0, 615, 240], [0, 0, 1]])
    np.testing.assert_allclose(log.camera.base_from_camera[:3, 3], [0.27, 0, 0.54], atol=1e-6)
    assert log.colour.decode(85).shape == (480, 640, 3)
    lines = (folder / "depth.txt").read_text().splitlines()
    names = [line.split()[1] for line in lines if not line.startswith("#")]
    np.testing.assert_allclose(log.depth.decode(40), read_depth(folder / names[rows[40]], 1000.0), atol=1e-6)
    assert "session 0: 86 nodes, 86 images, 0 closures" in log.contents
    assert "links: 85 neighbour (odometry)" in log.contents


def test_real_gazebo(data):
    log = open_rtabmap(data("logs/rtabmap") / "v0.17.3_one_node_gazebo.db")
    assert log.colour.timestamps.tolist() == [623.422] and log.colour.decode(0).shape == (480, 640, 3)
    np.testing.assert_allclose(log.camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]], [554.3827, 554.3827, 320.5, 240.5])
    np.testing.assert_allclose(log.camera.base_from_camera[:3, 3], [0.2, 0, 0.2], atol=1e-6)
    depth = log.depth.decode(0)
    assert depth.shape == (480, 640) and 3 < np.median(depth[depth > 0]) < 4
    assert "depth: 640 x 480 px, PNG, float metres" in log.contents


def test_real_realsense(data):
    path = data("logs/rtabmap") / "v0.21.1_one_node_realsense.db"
    log = open_rtabmap(path)
    assert (log.camera.width, log.camera.height, log.camera.distortion_model) == (1280, 720, "pinhole")
    assert "probably not rectified" in note(log, "lens bends") and log.colour.decode(0).shape == (720, 1280, 3)
    depth = log.depth.decode(0)
    assert depth.shape == (720, 1280) and 0.5 < np.median(depth[depth > 0]) < 2 and depth.max() < 60
    assert "0.00 m over base_link" in note(log, "not on the floor")
    raw = open_rtabmap(path, images="raw")
    assert raw.camera.distortion_model == "plumb_bob"
    np.testing.assert_allclose(raw.camera.distortion, [-0.055574, 0.061667, -0.00035, 0.000458, -0.019861], atol=1e-6)


def test_real_empty(data):
    with pytest.raises(ValueError, match=r"v0\.11\.13_empty\.db: of RTAB-Map 0\.11\.13, has no nodes"):
        open_rtabmap(data("logs/rtabmap") / "v0.11.13_empty.db")
