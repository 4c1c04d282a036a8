"""Every test runs in float64 with strict ranks; the shared data sets are found through EBJAX_DATA."""

import contextlib
import fcntl
import importlib.metadata
import importlib.util
import io
import os
import runpy
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from ebjax.bench import programs
from ebjax.command import setup_jax

# Most tests compile for longer than they compute: their programs are hardly optimised. XLA ends a process for a flag it
# does not know, so only the pinned version gets them; XLA_FLAGS of one's own, empty ones too, go before.
PINNED = Path(__file__).parents[1] / "configs" / "constraints.txt"
if f"jaxlib=={importlib.metadata.version('jaxlib')}" in PINNED.read_text().split():
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0")

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

MAPS, MOST_MAPS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
DATA = Path(os.environ.get("EBJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session", autouse=True)
def programs_are_kept():
    """Compiled programs are kept as commands keep them: for the other worker, and for the next run of the tests."""
    setup_jax()


@pytest.fixture(scope="module", autouse=True)
def room_for_programs():
    """Drops compiled programs long before their memory maps reach Linux' limit for a process."""
    yield
    if MOST_MAPS.exists() and 4 * MAPS.read_bytes().count(b"\n") > int(MOST_MAPS.read_text()):
        jax.clear_caches()


@pytest.fixture
def data():
    """Returns a function that gives the path of a shared data set, or skips where it is absent."""

    def find(name: str) -> Path:
        path = DATA / name
        if not path.exists():
            pytest.skip(f"{name} is not in {DATA}; set EBJAX_DATA to the folder that holds it")
        return path

    return find


@contextlib.contextmanager
def settings_put_back():
    """What is set in JAX inside is as it was afterwards."""
    before = dict(jax.config.values)
    try:
        yield
    finally:
        for name, value in before.items():
            if jax.config.values[name] != value:
                jax.config.update(name, value)


@pytest.fixture
def untouched_jax():
    """What a test sets in JAX is put back."""
    with settings_put_back():
        yield


@pytest.fixture
def program():
    """Returns a function: `python -m MODULE ARGUMENTS`, in this process, its imports and compiled programs at hand.

    What the command sets in JAX is put back.
    """

    def ended(module, *arguments, cwd):
        argv, out, err = [module, *map(str, arguments)], io.StringIO(), io.StringIO()
        with settings_put_back(), contextlib.chdir(cwd), pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", argv)
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    runpy.run_path(importlib.util.find_spec(f"{module}.__main__").origin, run_name="__main__")
                    code = 0
                except SystemExit as stop:
                    code = stop.code or 0
        return subprocess.CompletedProcess(argv, code, out.getvalue(), err.getvalue())

    return ended


@pytest.fixture
def unpainted(monkeypatch):
    """Figures are made and not painted: tests of a run do not look at them."""
    monkeypatch.setattr("ebjax.viz.figures.painted", lambda figure: b"")


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """Returns a function: a folder that `make(folder)` fills once for all of xdist's workers; the others wait."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name, make):
        folder = base / name
        with open(base / f"{name}.made", "a+") as done:
            fcntl.flock(done, fcntl.LOCK_EX)
            if not done.seek(0, os.SEEK_END):
                folder.mkdir()
                make(folder)
                done.write("whole")
        return folder

    return made


@pytest.fixture
def counted():
    """Returns a context manager: the programs that JAX compiles, or reads from its cache, inside; by its events."""
    return programs.counted
