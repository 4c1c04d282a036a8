"""The shared command line on a small command, the YAML reader, and the real commands' help."""

import dataclasses
import functools
import io
import os
import subprocess
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import jax
import pytest
import tyro

import ebjax
from ebjax.__main__ import commands
from ebjax.command import _flatten, _mend_or_show, dump_config, parse, progress, run, setup_jax
from ebjax.config import load_config


@dataclass(frozen=True)
class Kernel:
    """The robust kernel."""

    width: float = 1.0
    """Where it starts to bend, m."""
    sizes: tuple[int, int] = (4, 5)
    """Two sizes, px."""


@dataclass(frozen=True)
class Job:
    """Does a small job."""

    path: tyro.conf.Positional[str]
    """The input file."""
    kind: Literal["a", "b"] = "a"
    """The kind."""
    quad: tuple[tuple[float, float], ...] | None = None
    """Corners, px."""
    depth: bool = True
    """Whether depth is used."""
    count: int = 3
    """How many."""
    out: Path | None = None
    """Where to."""
    kernel: Kernel = field(default_factory=Kernel)


def no_jax(main, argv):
    run(main, Job, argv, needs_jax=False)


def failure(capsys, main, argv):
    with pytest.raises(SystemExit) as stop:
        no_jax(main, argv)
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and "Traceback" not in captured.err
    return stop.value.code, captured.err


@pytest.fixture
def yaml_file(tmp_path):
    def write(text):
        (tmp_path / "c.yaml").write_text(text)
        return str(tmp_path / "c.yaml")

    return write


def test_defaults_then_yaml_then_flags(yaml_file):
    file = yaml_file("kind: b\ncount: 7\nkernel: {width: 1e-3, sizes: [1, 2]}\nquad: [[0, 1], [2, 3]]\nout: x/y\n")
    seen = []
    no_jax(
        lambda job: seen.append(job),
        ["in.txt", "--config", file, "--count", "9", "--kernel.sizes", "8", "9", "--no-depth"],
    )
    corners = ((0.0, 1.0), (2.0, 3.0))
    assert seen == [Job("in.txt", "b", corners, False, 9, Path("x/y"), Kernel(0.001, (8, 9)))]
    assert type(seen[0]) is Job
    assert parse(Job, ["in.txt"]) == Job("in.txt")


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize(
    ("given", "meant"),
    [(("--kernel.widths", "3"), "--kernel.width"), (("--detph",), "--depth")],
    ids=["number", "switch"],
)
def test_flags_that_may_be_meant_are_named(given, meant, encoding, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    with pytest.raises(ValueError) as fault:
        parse(Job, ["in.txt", *given])
    said = f"Unrecognized options: {', '.join(given)}; perhaps you meant {meant} (--help lists the options)"
    assert str(fault.value) == said


def test_a_message_without_a_frame_is_said_whole():
    assert _flatten("no such\nthing\n") == "no such thing" and _flatten("") == ""


def test_yaml_may_give_the_positional_argument(yaml_file):
    assert parse(Job, [f"--config={yaml_file('path: q')}"]).path == "q"
    assert parse(Job, ["r", "--config", yaml_file("path: q")]).path == "r"


@pytest.mark.parametrize(
    "text, words",
    [
        ("kidn: b", "unknown key kidn; did you mean kind?"),
        ("width: 3", "unknown key width; did you mean kernel.width?"),
        ("kernel: {zzz: 1}", "unknown key kernel.zzz; known keys: width, sizes"),
        ("kernel: 3", "kernel is not a mapping"),
        ("kernel: {width: wide}", "key kernel.width is 'wide', not a number"),
        ("kernel: {width: .nan}", "key kernel.width is nan, not a number"),
        ("kernel: {sizes: [1]}", "key kernel.sizes is [1], not a list of 2 (a whole number, a whole number)"),
        ("kernel: {sizes: [1, 2.5]}", "key kernel.sizes[1] is 2.5, not a whole number"),
        ("count: true", "key count is True, not a whole number"),
        ("depth: 1", "key depth is 1, not true or false"),
        ("kind: c", "key kind is 'c', not one of a, b"),
        ("quad: [1]", "key quad is [1], not a list of a list of 2 (a number, a number) or null"),
        ("- 1", "the file is not a mapping"),
        ("a: [", "line 2: not YAML"),
    ],
)
def test_bad_yaml_names_file_and_key(yaml_file, capsys, text, words):
    code, line = failure(capsys, print, ["in.txt", "--config", yaml_file(text + "\n")])
    assert code == 2 and line.startswith("error: ") and "c.yaml" in line and words in line


def test_dumped_config_reads_back(tmp_path):
    job = Job("größe", "b", ((1.5, 2.0),), False, 4, tmp_path, Kernel(2.0))
    dump_config(job, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml", Job) == job
    assert parse(Job, ["--config", str(tmp_path / "config.yaml")]) == job


def raising(error):
    def main(config):
        raise error

    return main


@pytest.mark.parametrize(
    "argv, words",
    [
        ([], "PATH"),
        (["x", "--cuont", "3"], "--cuont"),
        (["x", "--count", "many"], "--count"),
        (["x", "--kind", "c"], "'c'"),
        (["x", "y"], "y"),
        (["x", "--config"], "--config"),
        (["x", "--config", "nowhere.yaml"], "nowhere.yaml: no such file"),
    ],
)
def test_bad_flags_are_one_line(capsys, argv, words):
    code, line = failure(capsys, print, argv)
    assert code == 2 and line.startswith("error: ") and words in line


def test_errors_of_the_command_are_one_line(capsys, tmp_path, monkeypatch):
    assert failure(capsys, raising(ValueError("a.txt line 3:\n  wrong")), ["x"]) == (2, "error: a.txt line 3: wrong\n")
    code, line = failure(capsys, lambda _: (tmp_path / "absent").read_text(), ["x"])
    assert code == 2 and line == f"error: {tmp_path / 'absent'}: no such file or directory\n"
    assert failure(capsys, raising(KeyboardInterrupt()), ["x"]) == (130, "interrupted\n")
    with pytest.raises(RuntimeError):
        no_jax(raising(RuntimeError("our mistake")), ["x"])
    monkeypatch.setenv("EBJAX_DEBUG", "1")
    with pytest.raises(ValueError, match="wrong"):
        no_jax(raising(ValueError("wrong")), ["x"])


def test_help_shows_docstrings_defaults_and_config(capsys):
    with pytest.raises(SystemExit) as stop:
        no_jax(print, ["--help"])
    out = capsys.readouterr().out
    assert stop.value.code == 0
    for words in ("Does a small job.", "PATH", "Where it starts to bend, m.", "(default: 1.0)", "--config"):
        assert words in out


def test_progress_is_silent_without_a_terminal(capfd):
    assert list(progress(iter("abc"), 3, "letters")) == ["a", "b", "c"]
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_progress_shows_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress([1, 2], label="numbers")) == [1, 2]
    captured = capsys.readouterr()
    assert captured.out == "" and "numbers" in captured.err


def test_jax_keeps_its_cache_with_the_user(tmp_path, monkeypatch, untouched_jax):
    jax.config.update("jax_compilation_cache_dir", None)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    setup_jax()
    assert jax.config.jax_compilation_cache_dir is None
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    setup_jax()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "cache" / "ebjax")
    assert jax.config.jax_enable_x64
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    setup_jax()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "cache" / "ebjax")


@pytest.fixture
def own_cache(tmp_path, untouched_jax):
    from jax.experimental.compilation_cache import compilation_cache

    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    compilation_cache.reset_cache()
    yield tmp_path
    compilation_cache.reset_cache()


@pytest.mark.parametrize(
    "damaged",
    [
        lambda entry: entry[: len(entry) // 2],
        lambda entry: entry[:-1],
        lambda entry: b"",
        lambda entry: bytes(1000),
        lambda entry: entry[:20] + bytes(b ^ 255 for b in entry[20:]),
    ],
)
def test_a_damaged_program_in_the_cache_is_written_anew(own_cache, capsys, damaged):
    setup_jax()

    def tenfold(x):
        return x * 10 + len(str(damaged))

    def entries():
        jax.clear_caches()
        assert jax.jit(tenfold)(1.0) > 10
        return {file: file.read_bytes() for file in own_cache.glob("jit_tenfold-*")}

    with warnings.catch_warnings(record=True) as shown:
        warnings.showwarning = functools.partial(_mend_or_show, lambda *_, **__: pytest.fail("shown"))
        before = entries()
        assert len(before) == 1
        (file,) = before
        other = own_cache / "jit_tenfold_more-ab-cache"
        other.write_bytes(b"kept")
        file.write_bytes(damaged(before[file]))
        after = entries()[file]
        assert after != damaged(before[file])
        assert abs(len(after) - len(before[file])) < 100
        assert other.read_bytes() == b"kept"
        settled = entries()
    assert settled == {file: after} and not shown


def test_other_warnings_are_shown(own_cache):
    setup_jax()
    heard = []
    show = functools.partial(_mend_or_show, lambda message, *_, **__: heard.append(str(message)))
    gone = "Error reading persistent compilation cache entry for 'jit_gone': OSError: unreadable"
    for words in ("something else", gone):
        show(UserWarning(words), UserWarning, "a.py", 3)
    assert heard == ["something else", gone]


def python(*arguments):
    environment = {**os.environ, "COLUMNS": "100"}
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=False)


def test_package_lists_its_commands():
    result = python("-m", "ebjax")
    assert result.returncode == 0
    for name, line in commands().items():
        assert line.endswith((".", ":")) and f"  {name.replace('.', ' ')} " in result.stdout and line in result.stdout
    assert "ebjax.evaluation" in commands()
    assert python("-m", "ebjax", "--version").stdout == f"ebjax {ebjax.__version__}\n"
    wrong = python("-m", "ebjax", "slma")
    assert wrong.returncode == 2 and wrong.stderr == "error: there is no command 'slma'; did you mean `ebjax slam`?\n"
    assert python("-m", "ebjax", "xyzzy").stderr.endswith("`ebjax --help` lists them\n")


def test_the_console_runs_a_command_as_python_m_does(tmp_path):
    script = ["-c", "import sys; from ebjax.__main__ import main; main()"]
    assert python(*script, "evaluation", "--help").stdout == python("-m", "ebjax.evaluation", "--help").stdout
    absent = [str(tmp_path / "a.txt"), str(tmp_path / "b.txt")]
    result = python(*script, "evaluation", *absent)
    assert result.returncode == 2 and result.stderr.startswith(f"error: {absent[0]}") and result.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", commands())
def test_every_command_has_help_and_config(name):
    result = python("-m", name, "--help")
    assert result.returncode == 0, result.stderr
    assert f"python -m {name}" in result.stdout and "--config" in result.stdout and result.stderr == ""


@pytest.mark.parametrize("name", commands())
def test_every_command_refuses_an_unknown_flag_in_one_line(program, tmp_path, name):
    result = program(name, "--no-such-flag", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1


def test_closed_output_is_not_an_error():
    code = "from ebjax.command import run; from dataclasses import make_dataclass as m\n"
    code += "run(lambda c: [print('y' * 999) for _ in range(999)], m('C', [], frozen=True), [], needs_jax=False)"
    pipe = f'"{sys.executable}" -c "$0" | head -c 5'
    result = subprocess.run(["bash", "-c", pipe, code], capture_output=True, text=True, check=False)
    assert result.stdout == "yyyyy" and result.stderr == ""


@pytest.mark.parametrize("words", [("ebjax",), ("ebjax.evaluation", "--help")])
def test_a_reader_that_goes_away_gets_no_traceback(words):
    """It is gone before the first line comes."""
    code = "import subprocess, sys; p = subprocess.Popen(sys.argv[1:], stdout=-1, stderr=-1, text=True)\n"
    code += "p.stdout.close(); print(p.wait(), p.stderr.read())"
    assert python("-c", code, sys.executable, "-m", *words).stdout.split() == ["0"]


def test_config_classes_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        parse(Job, ["x"]).count = 4
