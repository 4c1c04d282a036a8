"""What `import ebjax` offers: names that load when they are used, the command as a function, the engine by hand."""

import ast
import csv
import dataclasses
import importlib
import json
import shlex
import shutil
import subprocess
import sys
from itertools import islice
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest

import ebjax
from ebjax.command import parse
from ebjax.command import run as run_command
from ebjax.front.log import Log
from ebjax.front.options import Options, made_by, options_from
from ebjax.front.soft import soft_run
from ebjax.io.map_file.file import MapFile
from ebjax.io.trajectory import read_tum
from ebjax.io.write_bag import write_bag
from ebjax.parts import name_of, version_of
from ebjax.slam.__main__ import Config, main

sys.path.insert(0, str(Path(__file__).parent / "mapping"))
small_run = importlib.import_module("small_run")
OPTIONS = {"keyframe_m": 0.2, "min_gap_s": 2.0, "min_gap_m": 2.0, "view": (0.2, 1.4, -0.6, 0.6)}
MINE = """
import jax, jax.numpy as jnp
from ebjax import Descriptor

def look(view, seen, image):
    weight = seen.astype(view.dtype)
    grey, share = (jax.image.resize(one, (24, 24), "linear") for one in (view.mean(-1) * weight, weight))
    shown = share > 0.1
    cells = jnp.where(shown, grey / jnp.maximum(share, 0.1), 0)
    cells = jnp.where(shown, cells - cells.sum() / jnp.maximum(shown.sum(), 1), 0)
    unit = cells / jnp.sqrt(jnp.maximum((cells**2).sum(), 1e-12))
    return {"vector": unit.reshape(-1), "turned": unit[::-1, ::-1].reshape(-1)}

GRID = Descriptor(look)
"""


def poses_file(path, stamps, poses):
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, (x, y, heading) in zip(stamps, poses, strict=True):
        rows.append(f"{stamp:.6f} {x:.9f} {y:.9f} 0 0 0 {np.sin(heading / 2):.12f} {np.cos(heading / 2):.12f}")
    path.write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A small run out and back as a TUM folder."""
    folder = tmp_path_factory.mktemp("world") / "run"
    (folder / "rgb").mkdir(parents=True)
    recording, camera = small_run.recording(), small_run.camera()
    lines = []
    for k, (stamp, name) in enumerate(zip(recording.timestamps, recording.names, strict=True)):
        cv2.imwrite(str(folder / name), recording.load(k)[0][..., ::-1])
        lines.append(f"{stamp:.6f} {name}")
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    poses_file(folder / "odometry.txt", recording.timestamps, recording.odom_from_base)
    poses_file(folder / "groundtruth.txt", recording.timestamps, small_run.truth())
    k = np.asarray(camera.intrinsics, float)
    values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "depth_scale": 1000.0}
    values |= {"width": camera.width, "height": camera.height}
    values |= {"T_base_camera": np.asarray(camera.base_from_camera, float).tolist()}
    (folder / "camera.json").write_text(json.dumps(values))
    return folder


@pytest.fixture(scope="module")
def closed(world):
    return ebjax.close_loops(world, quiet=True, **OPTIONS)


def python(code, **environment):
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_importing_costs_nothing_until_a_name_is_used():
    python("import sys, ebjax; dir(ebjax); assert not {'jax', 'numpy', 'cv2'} & set(sys.modules), 'loaded'")
    assert len(ebjax.__all__) <= 20
    for name in ebjax.__all__:
        assert getattr(ebjax, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'close_loop'"):
        ebjax.close_loop  # noqa: B018


def test_type_checkers_see_the_same_names():
    tree = ast.parse((Path(ebjax.__file__).parent / "__init__.pyi").read_text())
    imports = {
        alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert {*imports, "__version__"} == set(ebjax.__all__)
    assert {name: module for name, module in imports.items() if name != "testing"} == ebjax._FROM
    assert (Path(ebjax.__file__).parent / "py.typed").exists()


@pytest.mark.whole
def test_python_and_the_command_give_the_same_bits(world, tmp_path):
    """Python in a process of its own, which nobody told of float64."""
    options = {"keyframe_m": 0.2, "min_gap_s": 2.0, "min_gap_m": 2.0, "view": [0.2, 1.4, -0.6, 0.6]}
    python(
        f"import ebjax; run = ebjax.close_loops({str(world)!r}, quiet=True, **{options})\n"
        f"assert run.poses.dtype == 'f8'; run.save({str(tmp_path / 'python')!r})"
    )
    flags = ["--keyframe-m", "0.2", "--min-gap-s", "2", "--min-gap-m", "2", "--view", "0.2", "1.4", "-0.6", "0.6"]
    run_command(main, Config, [str(world), "--out", str(tmp_path / "command"), *flags])
    for name in ("trajectory.tum", "loop_closures.csv", "pose_graph.g2o", "steps.csv"):
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    with open(tmp_path / "python" / "loop_closures.csv") as file:
        assert any(int(row["kept"]) for row in csv.DictReader(file))


@pytest.mark.slow
def test_a_run_says_what_it_found(closed, tmp_path):
    assert repr(closed).startswith(f"Run({len(closed.poses)} frames, ") and "\n" not in repr(closed)
    assert "loop closures kept" in closed.summary() and "ATE rmse" in closed.summary()
    assert len(closed.closures.i) == closed.kept.sum() > 0 and (closed.closures.i > closed.closures.j).all()
    assert closed.timestamps.shape == closed.poses.shape[:1]
    picture = closed.plot()
    assert cv2.imdecode(np.frombuffer(picture.png, np.uint8), cv2.IMREAD_COLOR) is not None
    picture.save(tmp_path / "path.png")
    assert (tmp_path / "path.png").read_bytes() == picture._repr_png_()
    saved = closed.save(tmp_path / "run")
    assert {file.name for file in (tmp_path / "run").iterdir()} >= set(saved.files)
    assert repr(saved) == f"{tmp_path / 'run'}: {', '.join(saved.files)}"
    np.testing.assert_allclose(
        read_tum(tmp_path / "run" / "trajectory.tum").poses[:, :2, 3], closed.poses[:, :2], atol=1e-6
    )


def test_a_log_is_gone_through_frame_by_frame(world, tmp_path):
    log = ebjax.open_log(world, **OPTIONS)
    assert repr(log) == f"Log({world}, {log.sequence.log.kind}: {len(log)} frames, odometry, no depth)"
    frames = list(islice(log, 3))
    assert [frame.stamp_s for frame in frames] == [100.0, 100.2, 100.4]
    assert repr(frames[0]) == "Frame(rgb/0000.png at 100.000 s: 320 x 240, odometry 0.000 m, 0.000 m, 0.0 degrees)"
    write_bag(tmp_path / "run.mcap", world, "mcap")
    bag = ebjax.open_log(tmp_path / "run.mcap")
    mapper = ebjax.Mapper(bag, keyframe_m=0.2)
    updates = [mapper.add(frame) for frame in islice(bag, 4)]
    assert [update.frame for update in updates] == [0, 1, 2, 3] and updates[0].keyframe == 0
    assert "\n" not in repr(updates[-1]) and repr(updates[-1]).startswith("Update(frame 3")


def test_a_log_tells_the_truth_where_it_has_one(world, tmp_path):
    np.testing.assert_allclose(ebjax.open_log(world).truth, small_run.truth(), atol=1e-8)
    write_bag(tmp_path / "run.mcap", world, "mcap")
    assert ebjax.open_log(tmp_path / "run.mcap").truth is None
    named = ebjax.open_log(tmp_path / "run.mcap", topics={"truth": "/ground_truth"})
    np.testing.assert_allclose(named.truth, small_run.truth(), atol=1e-8)


def test_views_of_closures_are_found_by_keyframe(closed):
    rows = np.searchsorted(closed.keyframes, closed.closures.i)
    np.testing.assert_array_equal(closed.keyframes[rows], closed.closures.i)
    assert rows[-1] < closed.closures.i[-1], "else frames and keyframes are the same here"
    assert closed.seen(int(rows[-1])).shape == closed.seen(0).shape


def copied(world, folder, *left_out):
    """The run without some of its files."""
    shutil.copytree(world, folder, ignore=shutil.ignore_patterns(*left_out))
    return folder


def test_a_log_becomes_a_differentiable_run(world):
    log = ebjax.open_log(world, **OPTIONS)
    run = soft_run(log)
    assert run.images.shape == (len(log), 240, 320, 1) and run.images.dtype == "float32"
    grey = cv2.cvtColor(log.images.rgb(7), cv2.COLOR_RGB2GRAY)
    np.testing.assert_allclose(run.images[7, ..., 0], grey / 255, atol=0.51 / 255)
    np.testing.assert_allclose(run.times_s, 0.2 * np.arange(len(log)), atol=1e-6)
    np.testing.assert_allclose(run.truth, small_run.truth()[:, :2], atol=1e-8)
    np.testing.assert_allclose(run.chain.poses, small_run.odometry(), atol=1e-8)
    assert run.camera is log.camera
    some = soft_run(log, frames=range(0, len(log), 5))
    np.testing.assert_array_equal(some.images, run.images[::5])
    np.testing.assert_array_equal(some.times_s, run.times_s[::5])
    np.testing.assert_allclose(some.chain.poses, run.chain.poses[::5], atol=1e-12)


def test_frames_without_image_or_truth_are_left_out_of_a_differentiable_run(world, tmp_path):
    folder = copied(world, tmp_path / "run")
    (folder / "rgb" / "0003.png").write_bytes(b"no image")
    known = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(known[:-4]) + "\n")
    run, whole = soft_run(ebjax.open_log(folder)), len(small_run.truth())
    np.testing.assert_allclose(
        run.truth, np.delete(small_run.truth(), [3, *range(whole - 4, whole)], 0)[:, :2], atol=1e-8
    )


@pytest.mark.parametrize(
    ("left_out", "options", "frames", "words"),
    [
        ("groundtruth.txt", {}, None, r"the log has none: a folder has it in groundtruth\.txt, a bag .*topics={"),
        ("odometry.txt", {}, None, r"soft_run needs odometry, and .*odometry\.txt"),
        ("", {"motion": "floor"}, None, "soft_run needs odometry, and the run was read without"),
        ("", {}, [3], "1 frames with an image and truth, soft_run needs two at least"),
        ("", {}, [4, 3], "soft_run takes frames 0 to .*, increasing"),
        ("", {}, [0, 1000], "soft_run takes frames 0 to "),
    ],
)
def test_what_no_differentiable_run_can_be_made_of(world, tmp_path, left_out, options, frames, words):
    log = ebjax.open_log(copied(world, tmp_path / "run", left_out), **options)
    with pytest.raises(ValueError, match=words) as stop:
        soft_run(log, frames=frames)
    assert str(stop.value).startswith(str(tmp_path / "run")) and "\n" not in str(stop.value)


@pytest.mark.slow
def test_a_database_of_rtabmap_is_gone_through(data):
    log = ebjax.open_log(data("logs/rtabmap/corridor_v0.23.8_86_nodes.db"))
    mapper = ebjax.Mapper(log.camera)
    for frame in islice(log, 2):
        assert frame.depth_m is not None and frame.odom_from_base is not None
        assert mapper.add(frame).keyframe is not None


@pytest.fixture(scope="module")
def by_hand(world):
    log = ebjax.open_log(world, **OPTIONS)
    mapper = ebjax.Mapper(log)
    for frame in log:
        mapper.add(frame)
    return mapper.finish()


@pytest.mark.slow
def test_a_mapper_says_what_the_log_gave(by_hand, closed, tmp_path):
    assert by_hand.closures.i.tolist() == closed.closures.i.tolist()
    np.testing.assert_array_equal(by_hand.poses, closed.poses)
    assert by_hand.summary().splitlines()[:3] == closed.summary().splitlines()[:3]


def test_a_robot_without_a_log_gets_its_files(world, tmp_path):
    log = ebjax.open_log(world, **OPTIONS)
    stopped = ebjax.Mapper(log)
    made_before_jax_was_set = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), log.camera)
    mapper = ebjax.Mapper(made_before_jax_was_set, **OPTIONS)
    for frame in islice(log, 12):
        mapper.add(frame)
        stopped.add(frame)
    run = mapper.finish()
    assert len(run.poses) == len(stopped.finish().timestamps) == 12 and run.summary()
    saved = run.save(tmp_path / "run")
    assert "trajectory.tum" in saved.files and (tmp_path / "run" / "report.html").is_file()


def test_how_a_log_is_read_is_no_option_of_a_mapper(world):
    log = ebjax.open_log(world)
    for camera, option in ((log.camera, {"depth": "none"}), (log, {"mask": "none"}), (log, {"mount": {"x_m": 1.0}})):
        with pytest.raises(
            ValueError, match=f"Mapper: {next(iter(option))} says how a log is read; give it to open_log"
        ):
            ebjax.Mapper(camera, **option)


@pytest.mark.slow
def test_a_map_keeps_a_run_that_was_stopped(world, by_hand, tmp_path):
    log, path = ebjax.open_log(world, **OPTIONS), tmp_path / "building.ebmap"
    frames = list(log)
    with ebjax.Mapper(log, map=path) as mapper:
        before = [mapper.add(frame) for frame in frames[:40]]
    again = ebjax.Mapper(log, map=path)
    updates = [again.add(frame) for frame in frames]
    assert any("goes on with session 1" in note for note in again.notes)
    assert [update.frame for update in updates] == list(range(len(frames)))
    assert [update.keyframe for update in updates[:40]] == [update.keyframe for update in before]
    run = again.finish()
    np.testing.assert_array_equal(run.poses, by_hand.poses)
    assert run.seen(0).dtype == np.uint8
    with MapFile.open(path, write=True) as file:
        assert [one.finished for one in file.sessions()] == [True]
    kept = ebjax.close_loops(log, map=tmp_path / "other.ebmap", quiet=True)
    assert kept.seen(0).shape == run.seen(0).shape
    with MapFile.open(tmp_path / "other.ebmap", write=True) as file:
        assert [one.finished for one in file.sessions()] == [True]


@pytest.mark.slow
def test_a_robot_is_localised_in_the_map_of_a_run(world, by_hand, tmp_path):
    log, path = ebjax.open_log(world, **OPTIONS), tmp_path / "building.ebmap"
    ebjax.close_loops(log, map=path, quiet=True)
    before = path.read_bytes()
    with ebjax.Localiser(log, map=path) as localiser:
        where = [localiser.add(frame) for frame in log]
    found = [one for one in where if one.state == "found"]
    assert where[0].state == "lost" and len(found) > len(where) / 2
    far_m = [np.hypot(*(one.map_from_base - by_hand.poses[one.frame])[:2]) for one in found]
    assert max(far_m) < 0.05 and path.read_bytes() == before
    x, y, heading = by_hand.poses[0]
    with ebjax.Localiser(log.camera, map=path, start=(x, y, np.degrees(heading)), **OPTIONS) as localiser:
        assert localiser.add(next(iter(log))).state == "found"
    with pytest.raises(ValueError, match="was made with descriptor floornet, this run has hog"):
        ebjax.Localiser(log, map=path, descriptor="hog")
    with pytest.raises(ValueError, match="Localiser: depth says how a log is read"):
        ebjax.Localiser(log.camera, map=path, depth="none")
    with pytest.raises(ValueError, match=r"nowhere\.ebmap: there is no such map"):
        ebjax.Localiser(log, map=tmp_path / "nowhere.ebmap")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"keyframe": 1}, "close_loops: unknown option keyframe; did you mean keyframe_m or keyframe_deg"),
        ({"min_agreeeing": 1}, "unknown option min_agreeeing; did you mean min_agreeing"),
        ({"xyzzy": 1}, "unknown option xyzzy; `python -m ebjax.slam --help` lists the options"),
        ({"keyframe_m": "far"}, "close_loops: key keyframe_m is 'far', not a number"),
        ({"mount": {"height": 1}}, "close_loops: unknown key mount.height; did you mean mount.height_m?"),
        ({"min_agreeing": "two"}, "key believe.min_agreeing is 'two', not a whole number"),
        ({"kernel": "cauchi"}, "kernel 'cauchi' is unknown; choose one of none, cauchy"),
        ({"descriptor": "gist"}, "descriptor 'gist' is unknown; choose one of floornet, .*, or package.module:NAME"),
        ({"extractor": "no.such:NAME"}, "extractor 'no.such:NAME': there is no module no; install it, or put"),
        ({"descriptor": "numpy:Grid"}, "descriptor 'numpy:Grid': numpy has no Grid; it has "),
        ({"descriptor": "numpy:pi"}, "descriptor 'numpy:pi' is a float; give an ebjax.Descriptor, or a function"),
    ],
)
def test_wrong_options_are_one_line(world, options, words):
    with pytest.raises(ValueError, match=words) as stop:
        ebjax.close_loops(world, quiet=True, **options)
    assert "\n" not in str(stop.value)


def test_options_are_those_of_the_config():
    given = {
        "min_agreeing": 1,
        "mount": {"height_m": 0.4},
        "topics": {"image": "/a"},
        "view": np.array([0.0, 1, -1, 1]),
    }
    options = options_from(given, Options, "close_loops")
    assert options.believe.min_agreeing == 1 and options.mount.height_m == 0.4 and options.log.topics.image == "/a"
    assert options.view == (0.0, 1.0, -1.0, 1.0)
    whole = options_from({"believe": options.believe, "seed": 3}, Options, "close_loops")
    assert whole.believe == options.believe and whole.seed == 3


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A module of the user's, outside the package."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "own_parts.py").write_text(MINE)
    yield tmp_path / "own_parts.py"
    sys.modules.pop("own_parts", None)


@pytest.mark.slow
def test_a_descriptor_of_ones_own_runs_and_a_map_records_it(own, world, tmp_path):
    assert len(MINE.strip().splitlines()) <= 15
    ebjax.testing.check_descriptor("own_parts:GRID")
    path = tmp_path / "own.ebmap"
    run = ebjax.close_loops(
        world, map=path, quiet=True, descriptor="own_parts:GRID", cache=tmp_path / "cache", **OPTIONS
    )
    assert len(run.candidates.i) > 0
    with MapFile.open(path, write=False) as file:
        facts = file.facts
    assert facts["descriptor"] == "own_parts:GRID" and facts["version of the descriptor"] == version_of(
        "own_parts:GRID"
    )
    saved = run.save(tmp_path / "run")
    assert saved.files and "descriptor: own_parts:GRID" in (tmp_path / "run" / "config.yaml").read_text()
    own.write_text(MINE + "# changed\n")
    with pytest.raises(ValueError, match=r"was made with version of the descriptor source .*use that version of it"):
        ebjax.close_loops(world, map=path, quiet=True, descriptor="own_parts:GRID", **OPTIONS)


def test_what_is_defined_anew_counts(own):
    from ebjax.places.descriptor import descriptor

    module = importlib.import_module("own_parts")
    first = module.GRID
    assert name_of(first, {}) == "own_parts:GRID" and descriptor("own_parts:GRID") is first
    module.GRID = ebjax.Descriptor(lambda *_: {}, jitted=False)
    assert descriptor("own_parts:GRID") is module.GRID is not first
    held = name_of(first, {})
    assert held.startswith("own_parts:") and descriptor(held) is first
    assert options_from({"descriptor": first}, Options, "close_loops").descriptor == held


def test_a_module_that_fails_is_named(own):
    own.write_text("1 / 0\n")
    with pytest.raises(
        ValueError, match=r"extractor 'own_parts:X': own_parts cannot be imported \(ZeroDivisionError: div"
    ):
        ebjax.Mapper(small_run.camera(), extractor="own_parts:X")


def test_a_reader_of_ones_own(world):
    from ebjax.io.logs.tum_folder import open_tum_folder

    opened = []

    def mine(path):
        opened.append(path)
        return open_tum_folder(path)

    assert len(ebjax.open_log(world, reader=mine)) == len(ebjax.open_log(world)) and opened == [world]
    with pytest.raises(ValueError, match=r"returned a int; it must return an ebjax.io.logs.log.Log"):
        ebjax.open_log(world, reader=lambda path: 3)
    with pytest.raises(ValueError, match="--session is for RTAB-Map databases"):
        ebjax.open_log(world, reader=mine, session=2)


def test_a_kernel_of_ones_own():
    import jax.numpy as jnp

    rng = np.random.default_rng(0)
    poses = np.cumsum(rng.normal(1, 0.1, (12, 3)), 0)
    i, j = np.r_[np.arange(11), 0, 3], np.r_[np.arange(1, 12), 9, 11]
    measured = np.asarray([[1.0, 0.1, 0.05]] * 11 + [[5.0, 5, 0], [3.0, 1, 0.4]])
    graph = ebjax.make_graph(poses, i, j, measured, np.tile(np.eye(3), (13, 1, 1)))

    def mine(s, width_squared):
        return width_squared * jnp.log1p(s / width_squared)

    ours, own = (ebjax.solve(graph, kernel=kernel, width=0.7) for kernel in ("cauchy", mine))
    np.testing.assert_allclose(own.poses, ours.poses, atol=1e-9)
    np.testing.assert_allclose(own.cost, ours.cost, rtol=1e-12)

    def mine(s, width_squared):  # the same name, another kernel
        return s + 0 * width_squared

    np.testing.assert_allclose(
        ebjax.solve(graph, kernel=mine).poses, ebjax.solve(graph, kernel="none").poses, atol=1e-9
    )


def test_a_demo_is_rendered_once(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr("ebjax.front.demo.render_sequence", lambda config, out: made.append(out))
    assert ebjax.demo(tmp_path / "demo") == tmp_path / "demo" == made[0]
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "rgb.txt").write_text("")
    assert ebjax.demo(tmp_path / "demo") == tmp_path / "demo" and len(made) == 1


def test_a_log_remembers_how_it_was_opened(world):
    log = ebjax.open_log(world, **OPTIONS)
    assert isinstance(log, Log) and log.options.view == OPTIONS["view"]


def test_a_report_says_how_its_run_was_made():
    given = {"min_agreeing": 1, "view": (0.2, 1.4, -0.6, 0.6), "motion": "floor", "mount": {"height_m": 0.4}}
    options = options_from(given, Options, "test")
    made = dict(made_by(options, Path("a run.bag")))
    flags = "--min-agreeing 1 --view 0.2 1.4 -0.6 0.6 --motion floor --mount.height-m 0.4"
    assert made["command"].startswith("python -m ebjax.slam 'a run.bag' ")
    parsed = parse(Config, shlex.split(made["command"])[3:])
    for field in dataclasses.fields(Options):
        if field.name != "sequence":
            assert getattr(parsed, field.name) == getattr(options, field.name)
    assert len(shlex.split(made["command"])) == 4 + len(flags.split())
    assert f"ebjax {ebjax.__version__}" in made["version"] and made["date"].endswith("UTC")
