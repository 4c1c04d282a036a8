"""`python -m ebjax.places` on small folders of images: the ranking that it writes, and what it says of bad input."""

import csv
import json

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.io.image_folder import natural
from ebjax.places.__main__ import Looker, PlacesConfig, main
from ebjax.places.descriptor import descriptor

HEADER = ["query", "rank", "name", "direction", "distance"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory, floor_texture):
    """Eleven references; queries are five of them, the odd ones turned by pi; one file of each folder is broken."""
    root = tmp_path_factory.mktemp("images")
    (root / "database").mkdir()
    (root / "queries").mkdir()
    rng = np.random.default_rng(3)

    def save(path, image):
        cv2.imwrite(str(path), np.clip(255 * image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8))

    for k in range(11):
        save(root / "database" / f"img{k}.png", floor_texture((72, 96), k))
    for k in range(5):
        image = floor_texture((72, 96), 2 * k)
        save(root / "queries" / f"q{k}.png", np.rot90(image, 2) if k % 2 else image)
    whole = (root / "database" / "img10.png").read_bytes()
    (root / "database" / "img9.png").write_bytes(whole[: len(whole) // 2])
    (root / "queries" / "q5.jpg").write_bytes(b"\xff\xd8\xff")
    (root / "queries" / "notes.txt").write_text("no image")
    (root / "truth.json").write_text(json.dumps({str(k): [2 * k] for k in range(5)}))
    return root


def rows_of(path):
    with open(path, newline="") as file:
        header, *rows = csv.reader(file)
    assert header == HEADER
    return rows


def command(*arguments):
    with pytest.raises(SystemExit) as stopped:
        run(main, PlacesConfig, [str(a) for a in arguments], needs_jax=False)
    return stopped.value.code


def ranked(folders, out, *arguments):
    queries = folders / "queries"
    run(
        main, PlacesConfig, [str(a) for a in (folders / "database", queries, "--out", out, *arguments)], needs_jax=False
    )
    return rows_of(out / "ranked.csv")


@pytest.mark.slow
def test_finds_images_from_both_sides_and_names_broken_ones(folders, tmp_path, capsys):
    rows = ranked(folders, tmp_path, "--raw", "--truth", folders / "truth.json", "--top", 3)
    assert [row[1] for row in rows] == ["1", "2", "3"] * 5
    first = [row for row in rows if row[1] == "1"]
    assert [(row[0], row[2]) for row in first] == [(f"q{k}.png", f"img{2 * k}.png") for k in range(5)]
    assert [row[3] for row in first] == ["same", "opposing", "same", "opposing", "same"]
    assert all(float(row[4]) < 0.4 for row in first)
    captured = capsys.readouterr()
    assert "R@1 100.0 %  R@5 100.0 %  of 5 queries" in captured.out and "2 images skipped" in captured.out
    assert "img9.png: truncated or damaged PNG" in captured.err and "q5.jpg" in captured.err
    assert (tmp_path / "config.yaml").is_file() and sorted(p.name for p in tmp_path.iterdir())[-1] == "ranked.csv"


@pytest.mark.parametrize("opposing, expected", [("only", {"opposing"}), ("none", {"same"})])
def test_one_direction_only(folders, tmp_path, opposing, expected):
    rows = ranked(folders, tmp_path, "--raw", "--ranking", "cosine", "--opposing", opposing)
    assert {row[3] for row in rows} == expected and len(rows) == 5 * 10


def test_one_folder_twice_leaves_out_the_image_itself(folders, tmp_path):
    database = folders / "database"
    run(main, PlacesConfig, [str(a) for a in (database, database, "--raw", "--out", tmp_path)], needs_jax=False)
    rows = rows_of(tmp_path / "ranked.csv")
    assert rows and all(row[0] != row[2] for row in rows)
    assert [row[0] for row in rows if row[1] == "1"] == [f"img{k}.png" for k in (*range(9), 10)]


@pytest.mark.slow
def test_four_points_and_a_camera_fix_the_view(folders, tmp_path):
    quad = ("--quad", *(20, 15, 75, 15, 75, 55, 20, 55))
    rows = ranked(folders, tmp_path / "quad", *quad)
    assert [row[2] for row in rows if row[1] == "1"] == [f"img{2 * k}.png" for k in range(5)]
    down = [[0, -1, 0, 0.5], [-1, 0, 0, 0], [0, 0, -1, 1.0], [0, 0, 0, 1]]
    values = dict(fx=80, fy=80, cx=47.5, cy=35.5, width=96, height=72, T_base_camera=down)
    (tmp_path / "camera.json").write_text(json.dumps(values))
    rows = ranked(folders, tmp_path / "camera", "--camera", tmp_path / "camera.json")
    assert [row[2] for row in rows if row[1] == "1"] == [f"img{2 * k}.png" for k in range(5)]


def test_the_cache_changes_nothing_and_a_damaged_one_is_rebuilt(folders, tmp_path, capsys, monkeypatch):
    flags = ("--raw", "--descriptor", "hog", "--cache", tmp_path / "cache")
    plain = ranked(folders, tmp_path / "plain", *flags[:3])
    assert ranked(folders, tmp_path / "first", *flags) == plain
    before = {path: path.read_bytes() for path in (tmp_path / "cache").glob("hog-*/*.h5")}
    assert len(before) == 2, "one of each folder"
    shard, content = max(before.items(), key=lambda item: len(item[1]))
    monkeypatch.setattr(Looker, "_describe", None)  # of whole images nothing is left to describe
    whole = [path for path in (folders / "database").iterdir() if path.name != "img9.png"]
    looker = Looker(
        PlacesConfig(folders / "database", folders / "queries", raw=True, cache=tmp_path / "cache", descriptor="hog"),
        descriptor("hog"),
    )
    assert len([looker.look(path) for path in whole]) == 10
    monkeypatch.undo()
    capsys.readouterr()
    shard.write_bytes(content[: len(content) // 3])
    assert ranked(folders, tmp_path / "again", *flags) == plain
    assert f"{shard.name}: damaged" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (tmp_path / "cache").glob("hog-*/*.h5")} == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hog", "joint"])
def test_other_descriptors_find_images_from_both_sides(folders, tmp_path, name):
    quad = ("--quad", *(20, 15, 75, 15, 75, 55, 20, 55))
    rows = ranked(folders, tmp_path, *quad, "--descriptor", name)
    assert [row[2] for row in rows if row[1] == "1"] == [f"img{2 * k}.png" for k in range(5)]


@pytest.mark.parametrize(
    "change, message",
    [
        ((), "0 of --camera, --quad and --raw are given"),
        (("--raw", "--quad", *range(8)), "2 of --camera, --quad and --raw are given"),
        (("--raw", "--top", 0), "--top is 0"),
        (("--raw", "--descriptor", "joint"), "--descriptor joint needs a floor"),
        (("--raw", "--descriptor", "gist"), "descriptor 'gist' is unknown"),
        (("--raw", "--descriptor", "hog", "--ranking", "correlation"), "no maps to correlate"),
        (("--raw", "--descriptor", "vgg19", "--weights", "OUT"), "python -m ebjax.models convert vgg19"),
        (("--raw", "--truth", "TRUTH"), "truth.json: key '9' is not the number of a query"),
        (("--camera", "CAMERA"), "camera.json: a camera of 640 x 400 px, but the images have "),
    ],
)
def test_bad_input_is_one_line(folders, tmp_path, capsys, change, message):
    down = [[0, -1, 0, 0.5], [-1, 0, 0, 0], [0, 0, -1, 1.0], [0, 0, 0, 1]]
    camera = dict(fx=300, fy=300, cx=320, cy=200, width=640, height=400, T_base_camera=down)
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    (tmp_path / "truth.json").write_text('{"9": [0]}')
    paths = {"TRUTH": tmp_path / "truth.json", "CAMERA": tmp_path / "camera.json", "OUT": tmp_path}
    out = tmp_path / "out"
    arguments = [paths.get(a, a) for a in change]
    assert command(folders / "database", folders / "queries", "--out", out, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
    assert not out.exists()


def test_folders_without_images(folders, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "a.png").write_bytes(b"")
    for folder, message in (("none", "not a folder"), ("empty", "no images in it"), ("broken", "none of 1 images")):
        assert command(folders / "database", tmp_path / folder, "--raw", "--out", tmp_path / "out") == 2
        assert f"{folder}: {message}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_natural_order(tmp_path):
    names = ["b1.png", "img10.png", "img2.png", "img02b.png", "7.png", "010.png"]
    expected = ["7.png", "010.png", "b1.png", "img2.png", "img02b.png", "img10.png"]
    assert [p.name for p in sorted((tmp_path / n for n in names), key=natural)] == expected
