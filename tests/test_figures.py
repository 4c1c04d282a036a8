"""READMEs show the figures of figures.json, all of them and no others; and how that file is written."""

import functools
import re

import pytest

from . import figures

ROOT = figures.ROOT
PAGES = ["README.md", "notebooks/README.md", *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("ebjax/**/README.md"))]
ENTRIES = figures.recorded()
A_NUMBER = re.compile(r"(?<![\w@.])(?<!\w[-(])\d+(?:,\d{3})*(?:\.\d+)?(?=x?(?!\w))")
"""No digits of names: D1, VGG-16, SE(2), R@1, float32, 3D."""

NO_RESULTS = {
    "README.md": [
        "arXiv 2010.01421",
        "Python 3.11",
        "an 18 m tiled corridor",
        "within 5 cm and 1 degree",
        "exit code 2",
        "contradict it by 5 %",
    ],
    "ebjax/README.md": [
        "top-left one at (0, 0)",
        "exit code 2",
        "0 at 0 and of slope 1",
        "within 2 s of processor time and 1 GB",
        "the exit code is 1",
        "2,000 such inputs",
    ],
    "ebjax/bench/README.md": [
        "exit code 1",
        "a corridor of 1000 poses and 20 closures",
        "the best 20 of 2000 descriptors for 100 others",
        "the 95 % interval",
        "more than 15 % above",
        "a 640 x 480 image",
        "8 x 8 samples a pixel",
        "The first 64 keyframes",
        "48 passes of a 50 m corridor",
        "just past 2048 and 4096 keyframes",
    ],
    "ebjax/evaluation/README.md": [
        "3, the number of degrees of freedom",
        *(f"relative poses {distance_m} m apart" for distance_m in (1, 5, 20)),
    ],
    "ebjax/features/README.md": [
        "the paper's table 3",
        "within 3 px of a 400 px view",
        "held to its 1000 strongest keypoints",
        "median over them, in px of a 400 px view",
    ],
    "ebjax/floors/README.md": ["2.9 m and 0.8 m across", "120 degrees across", "(ROS 1)", "(ROS 2)"],
    "ebjax/io/README.md": [
        "from 0.11.10 on",
        "16-bit images",
        "(4 to 14 coefficients)",
        "at most 2 s apart",
        "16-bit PNG or TIFF, 0 = missing",
        "1000 for millimetres",
        "a 4 x 4 matrix",
        "the floor at z = 0",
        *(f"| {columns} |" for columns in (3, 4, 7, 8, 9, 11, 12, 13, 16, 17)),
    ],
    "ebjax/models/README.md": [
        "VGG-16 and -19",
        "| batch 1 / 8 |",
        "| 224 x 224 |",
        "| 400 x 400 |",
        "| 640 x 480 |",
        "| 30 x 30 x 512 |",
        "| 200 x 200 |",
    ],
    "ebjax/paper/README.md": [
        "shows floor within 1 m",
        "frames 0.4 m apart, straight ways cut to 12 m",
        "up to 6 degrees, scaled by up to 7 %, smeared by up to 7 of 200 pixels, gamma 0.5 to 1.8",
    ],
    "ebjax/posegraph/README.md": [
        "gtsam 4.3",
        "64 corridors of 500 poses",
        "a corridor of 64,000 poses with 20 loops",
        "| intel, 20 % |",
        "| intel, 50 % |",
        "D5 with its 21 loops, 20 %",
        "D5 with its 21 loops, 50 %",
        ", 20 % and 50 %, three draws",
    ],
    "ebjax/slam/README.md": [
        "the last 16 MB",
        "within 0.3 m and 10 degrees",
        "within 5 cm and 1 degree",
        "an 18 m tiled corridor",
        "lies within 1 m",
        "87 degrees from its axis",
        "contradict it by 5 %",
    ],
    "ebjax/train/README.md": ["within 1 m and 0.3 m"],
    "notebooks/README.md": [f"[{number}. " for number in range(1, 8)],
}
"""What numbers in READMEs stand for that are no results: settings, definitions, formats, limits, names."""

each_page = pytest.mark.parametrize("page", PAGES)
each_entry = pytest.mark.parametrize("entry", ENTRIES, ids=[entry["name"] for entry in ENTRIES])


@functools.cache
def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def read_aloud(page: str) -> str:
    """A page with blanks for code and for where links lead."""
    text = text_of(page)
    for left_out in (r"^```.*?^```$", r"^ {4}[^\n]*$", r"`[^`]*`", r"\]\([^)]*\)"):
        text = re.sub(left_out, lambda m: re.sub(r"[^\n]", " ", m.group()), text, flags=re.MULTILINE | re.DOTALL)
    return text


def places_of(page: str) -> set[int]:
    """Where in a page a figure of the file stands, or a number that is no result."""
    found: set[int] = set()
    for entry in ENTRIES:
        for line in entry["shown"].get(page, ()):
            for match in figures.pattern(line, entry["printed"]).finditer(text_of(page)):
                found.update(*(range(*match.span(group)) for group in match.groupdict()))
    for words in NO_RESULTS.get(page, ()):
        for match in figures.pattern(words, {}).finditer(text_of(page)):
            found.update(range(*match.span()))
    return found


@each_page
def test_every_number_of_a_page_is_a_figure_of_the_file_or_no_result(page):
    told = places_of(page)
    unknown = [match for match in A_NUMBER.finditer(read_aloud(page)) if match.start() not in told]
    where = [" ".join(text_of(page)[max(match.start() - 40, 0) : match.end() + 20].split()) for match in unknown]
    assert not where, f"{page}: let a command print it (tests/figures.json), or say in NO_RESULTS what it is: {where}"


@each_entry
def test_every_figure_of_the_file_is_shown(entry):
    for page, lines in entry["shown"].items():
        for line in lines:
            found = figures.pattern(line, entry["printed"]).findall(text_of(page))
            assert len(found) == 1, f"{page}: {len(found)} times {line!r} with the figures of {entry['name']}"
    shown = {key for lines in entry["shown"].values() for key in figures.keys_of(lines)}
    printed = figures.keys_of(entry["prints"])
    assert len(printed) == len(set(printed))
    assert shown == set(printed) == set(entry["printed"])


@each_entry
def test_pages_name_the_command_that_prints_their_figures(entry):
    command = re.search(r"python -m ebjax\.\w+(?: [a-z]+\b(?!\.))?", entry["commands"][-1])
    assert command is not None
    for page in entry["shown"]:
        assert command.group() in text_of(page)


@each_page
def test_what_is_said_to_be_no_result_is_there(page):
    for words in NO_RESULTS.get(page, ()):
        assert figures.pattern(words, {}).search(text_of(page)), f"{page} has no {words!r} any more"


def test_an_entry_has_a_name_of_its_own():
    names = [entry["name"] for entry in ENTRIES]
    assert len(names) == len(set(names))


@pytest.fixture
def entry():
    return {
        "name": "three",
        "commands": [
            "echo 'of 7: first 1.5 m' # {work}",
            "echo '# Table'; echo '| a | 2,000 |  | 2.96 |'; echo '| b | 1 | 2 | x |'; echo '| c |'",
        ],
        "needs": [],
        "minutes": 0,
        "machine": False,
        "prints": ["first {first} m", "$ echo '# Table'", "| a | {second} | {} | {third.1} |", "| b | {_} | {rest*} |"],
        "printed": {"first": "1.4", "second": "1", "third": "2.0", "rest": "none"},
        "shown": {"page.md": ["it is {first} m,", "| row | {second} | {third} | {rest*} |"]},
    }


@pytest.fixture
def written(entry, tmp_path, monkeypatch):
    """A file of this one entry, and a page that shows it."""
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    monkeypatch.setattr(figures, "FILE", tmp_path / "figures.json")
    (tmp_path / "page.md").write_text("Mostly it\nis 1.4 m, as 1.4 s.\n\n| row | 1 | 2.0 | none |\n", encoding="utf-8")
    figures.write([entry])
    return tmp_path


def test_what_commands_print_goes_into_file_and_page(written, capsys):
    assert figures.main(["three", "--work", str(written / "work")]) == 0
    assert "first 1.4 -> 1.5, second 1 -> 2,000" in capsys.readouterr().out
    page = (written / "page.md").read_text(encoding="utf-8")
    assert page == "Mostly it\nis 1.5 m, as 1.4 s.\n\n| row | 2,000 | 3.0 | 2 | x |\n"
    assert figures.recorded()[0]["printed"] == {"first": "1.5", "second": "2,000", "third": "3.0", "rest": "2 | x"}
    assert figures.main(["--work", str(written / "work"), "--kept"]) == 0
    assert "three: as before" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"commands": ["exit 3"]}, "exit code 3 of exit 3"),
        ({"prints": ["last {first} m"]}, "print no line 'last {first} m'"),
        ({"shown": {"page.md": ["it was {first} m"]}}, "page.md: does not show 'it was {first} m'"),
    ],
)
def test_what_fails_is_named_and_changes_nothing(entry, written, capsys, change, told):
    figures.write([entry | change])
    before = [(written / name).read_text(encoding="utf-8") for name in ("page.md", "figures.json")]
    assert figures.main(["--work", str(written / "work")]) == 1
    assert told in capsys.readouterr().out
    assert [(written / name).read_text(encoding="utf-8") for name in ("page.md", "figures.json")] == before


@pytest.mark.parametrize(
    ("printed", "shown"),
    [("0.9741", "0.97"), ("3.4e-09", "0.00"), ("10.6", "10.6"), ("12,345", "12345"), ("1.24e+03", "1240")],
)
def test_rounding_adds_no_places(printed, shown):
    assert figures.rounded(printed, 2) == shown


def test_what_is_absent_is_said(entry, written, capsys):
    figures.write([entry | {"needs": ["pytest", "no_such_data"], "machine": True}])
    assert figures.main(["--work", str(written / "work")]) == 0
    assert capsys.readouterr().out == "three: left out, there is no no_such_data\n"
    assert figures.main(["--list", "--work", str(written / "work")]) == 0
    assert capsys.readouterr().out == "three: 0 min, times of one machine; lacks no_such_data\n"


def test_a_name_that_is_no_entry_is_refused(written, capsys):
    with pytest.raises(SystemExit):
        figures.main(["four", "--work", str(written / "work")])
    assert "no entry four" in capsys.readouterr().err
