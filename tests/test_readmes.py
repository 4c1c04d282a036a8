"""READMEs: how long the first one is, and that links, headings, commands, flags and options that they name exist."""

import functools
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

import ebjax.command
from ebjax.__main__ import commands

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "ebjax").rglob("*.md"))]
MOST_WORDS = 1500
WITH_RESULTS = {"slam", "posegraph", "features", "places", "evaluation", "paper", "train", "floors", "models", "bench"}
OTHERS = {"help", "version", "config", "hours", "seed", "readers", "t_offset"}
"""Flags that every command has, and those of other programs."""

each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


@functools.cache
def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def headings(page: Path) -> set[str]:
    """The anchors of a page, as GitHub makes them of its headings."""
    titles = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def command_lines(page: Path) -> list[str]:
    """What a page says to type, to a command of ours."""
    return re.findall(r"^    (python -m ebjax\..+)$", text_of(page), re.MULTILINE)


def test_the_first_page_is_short():
    words = len(text_of(README).split())
    assert words <= MOST_WORDS, (
        f"README.md has {words} words: at most {MOST_WORDS}; the rest belongs to a room's README"
    )


def test_every_room_with_results_has_a_page():
    absent = [room for room in sorted(WITH_RESULTS) if not (ROOT / "ebjax" / room / "README.md").is_file()]
    assert not absent


@each_page
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)]+)\)", text_of(page)):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{target}: there is no {path}"
        assert there.is_relative_to(ROOT), f"{target} leads out of the repository"
        if anchor:
            assert anchor in headings(there), (
                f"{target}: no such heading; there are {', '.join(sorted(headings(there)))}"
            )


def test_every_page_is_linked():
    linked = {
        (page.parent / target.partition("#")[0]).resolve()
        for page in PAGES
        for target in re.findall(r"\]\(([^)]+)\)", text_of(page))
    }
    assert {page for page in PAGES if page != README} <= linked


@each_page
def test_commands_that_are_named_exist(page):
    text = text_of(page)
    named = set(re.findall(r"python -m (ebjax\.\w+)", text)) | {
        f"ebjax.{one}" for one in re.findall(r"`ebjax (\w+)", text)
    }
    assert named <= set(commands())
    for module in re.findall(r"python -m (tests[\w.]*)", text):
        path = ROOT.joinpath(*module.split("."))
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


@each_page
def test_flags_that_are_named_exist(page):
    """By its last word: the name of a field of some command's options."""
    prose = re.sub(r"^ {4}[^\n]*$|^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    flags = {
        flag for span in re.findall(r"`[^`\n]+`", prose) for flag in re.findall(r"--([a-z][\w-]*(?:\.[\w-]+)*)", span)
    }
    for flag in flags:
        name = flag.rpartition(".")[2].removeprefix("no-").replace("-", "_")
        assert name in OTHERS | fields(), f"--{flag}"


@functools.cache
def fields() -> set[str]:
    """The names of fields of options, those of `make_dataclass` too."""
    found: set[str] = set()
    for file in (ROOT / "ebjax").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        found.update(
            re.findall(r"^    (\w+): ", text, re.MULTILINE), re.findall(r"^ +\(\"(\w+)\", ", text, re.MULTILINE)
        )
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", sorted({line for page in PAGES for line in command_lines(page)}), ids=lambda line: line[16:70]
)
def test_a_command_takes_what_it_is_given(line, monkeypatch):
    """Every line to type is parsed by the command that it names."""
    _, _, module, *arguments = shlex.split(line)
    parsed = []

    def parse_only(main, config_class, argv=None, **_):
        parsed.append(ebjax.command.parse(config_class, sys.argv[1:] if argv is None else argv))

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(ebjax.command, "run", parse_only)
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    # As a process of its own finds it: not imported yet.
    monkeypatch.delitem(sys.modules, f"{module}.__main__", raising=False)
    # What the tests' type checks make of a command must not be what `python -m` finds compiled.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    runpy.run_module(module, run_name="__main__", alter_sys=True)
    assert len(parsed) == 1
