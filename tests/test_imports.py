"""Reads every import of the package and keeps the rooms in their order; io and viz stand at the edge."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "ebjax"
NUMERICAL = {"geometry", "models", "views", "places", "features", "posegraph", "odometry", "floors", "slam"}
MAY_IMPORT = {
    "geometry": set(),
    "models": {"geometry"},
    "views": {"geometry"},
    "places": {"geometry", "models"},
    "features": {"geometry", "models", "views"},
    "posegraph": {"geometry"},
    "odometry": {"geometry", "views", "features", "posegraph"},
    "floors": {"geometry"},
    "slam": {"geometry", "models", "views", "places", "features", "posegraph", "odometry", "floors"},
    "evaluation": {"io"},
    # Only what loads no JAX: the names of lenses.
    "io": {"geometry"},
    "viz": {"geometry", "io", "evaluation", "features", "views", "places", "odometry", "posegraph", "slam"},
    # The paper's experiments: every room put to work, as only commands do otherwise. No room imports it.
    "paper": {*NUMERICAL, "evaluation", "io", "viz", "config", "command"},
    # Training puts every room to work too; only its own command imports it.
    "train": {*NUMERICAL, "evaluation", "io", "config", "command"},
    # What is in a log, and writing it in another form; loads no JAX.
    "logs": {"geometry", "io", "config", "command"},
    "config.py": {"io"},
    "command.py": {"config", "io"},
}
FILES = sorted(file for file in PACKAGE.rglob("*.py") if file.name != "__main__.py" and file.parent != PACKAGE)
FILES += [PACKAGE / "config.py", PACKAGE / "command.py"]


def imported(file: Path) -> set[str]:
    """Every dotted module a file imports, inside functions too, relative ones resolved."""
    package = ["ebjax", *file.parent.relative_to(PACKAGE).parts]
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1], *(node.module or "").split(".")] if node.level else []
            module = ".".join(filter(None, base)) if base else str(node.module)
            names |= {f"{module}.{alias.name}" for alias in node.names}
    return names


def rooms(names: set[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("ebjax.")}


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_only_rooms_below(file):
    room = file.relative_to(PACKAGE).parts[0]
    assert room in MAY_IMPORT, f"{room} is a new room: say here and in the README which rooms it may import"
    wrong = rooms(imported(file)) - MAY_IMPORT[room] - {room}
    assert not wrong, (
        f"{file.relative_to(PACKAGE)} imports {sorted(wrong)}; {room} may import {sorted(MAY_IMPORT[room])}"
    )


def test_rooms_have_no_cycle():
    order = ["geometry", "models", "views", "places", "features", "posegraph", "odometry", "floors", "slam"]
    for room in NUMERICAL:
        assert all(order.index(below) < order.index(room) for below in MAY_IMPORT[room])
        assert not MAY_IMPORT[room] & {"io", "viz", "evaluation", "command", "config"}
    assert not any({"paper", "train", "logs"} & below for below in MAY_IMPORT.values())


@pytest.mark.parametrize("room", ["io", "evaluation", "logs"])
def test_host_rooms_load_no_jax(room):
    files = [file.relative_to(PACKAGE.parent).with_suffix("") for file in (PACKAGE / room).rglob("*.py")]
    names = ["ebjax.config", *(".".join(file.parts) for file in files if file.name not in ("__main__", "__init__"))]
    code = f"import importlib, sys\nfor name in {names}: importlib.import_module(name)\nassert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGE.parent)


def test_reader_of_imports_sees_every_form(tmp_path):
    file = PACKAGE / "places" / "example.py"

    class Source:
        parent = file.parent

        @staticmethod
        def read_text(encoding):
            return (
                "import ebjax.io.text\nfrom ebjax import viz\nfrom ..slam import map\nfrom . import netvlad\n"
                "def f():\n    from ebjax.features.match import x\n"
            )

    assert rooms(imported(Source)) == {"io", "viz", "slam", "places", "features"}
