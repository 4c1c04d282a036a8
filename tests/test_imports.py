"""Reads every import of the package and keeps the rooms in their order; io, viz and the like stand at the edge."""

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "ebjax"
ORDER = ["geometry", "models", "views", "places", "features", "posegraph", "odometry", "floors", "slam"]
"""The numerical rooms, each above those it may import."""
EDGE = {"io", "viz", "evaluation", "worlds", "mapping", "front", "command", "config"}
"""What commands stand on beside the numerical rooms."""
MAY_IMPORT = {
    "geometry": set(),
    "models": {"geometry"},
    "views": {"geometry"},
    "places": {"geometry", "models"},
    "features": {"geometry", "models", "views"},
    "posegraph": {"geometry"},
    "odometry": {"geometry", "views", "features", "posegraph"},
    "floors": {"geometry"},
    "slam": {"geometry", "models", "views", "places", "features", "posegraph", "odometry"},
    "evaluation": {"io"},
    # Only what loads no JAX: the names of lenses.
    "io": {"geometry"},
    "viz": {"geometry", "io", "evaluation", "features", "views", "places", "odometry", "posegraph", "slam"},
    # The engine with a log before it and a map's file behind it; only commands import it.
    "mapping": {*ORDER, "io", "viz", "evaluation"} - {"floors"},
    # What `import ebjax` offers, and its commands stand on: the engine with all that surrounds it.
    "front": {*ORDER, *EDGE} - {"front"},
    # Checks of what users add, over ours too.
    "testing.py": {"models", "places", "features"},
    # Descriptors, extractors, kernels and readers by name; loads no JAX. Every room may use it.
    "parts.py": set(),
    # Rendered runs as folders.
    "worlds": {"floors", "geometry", "io", "config", "command"},
    # The paper's experiments: every room put to work, as only commands do otherwise. No room imports it.
    "paper": {*ORDER, *EDGE},
    # Measures the rest; no room imports it.
    "bench": {*ORDER, *EDGE},
    # Training puts every room to work too; only its own command imports it.
    "train": {*ORDER, *EDGE} - {"viz"},
    # What is in a log, and writing it in another form; loads no JAX.
    "logs": {"geometry", "io", "config", "command"},
    "config.py": {"io"},
    "command.py": {"config", "io"},
    "__main__.py": set(),
    "__init__.py": set(),
}
FILES = sorted(PACKAGE.rglob("*.py"))


def module(file: Path) -> str:
    """A file's dotted name."""
    return ".".join(("ebjax", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


MODULES = {module(file) for file in FILES}


def imported(file: Path) -> set[str]:
    """Every dotted name a file imports, inside functions and for annotations too, relative ones resolved."""
    package = ["ebjax", *file.parent.relative_to(PACKAGE).parts]
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1], *(node.module or "").split(".")] if node.level else []
            source = ".".join(filter(None, base)) if base else str(node.module)
            names |= {f"{source}.{alias.name}" for alias in node.names}
    return names


def rooms(names: set[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("ebjax.")} - {"__version__"}


def files(names: set[str]) -> set[str]:
    """The package's modules among imported names, which may be of what is in them."""
    return {name if name in MODULES else name.rpartition(".")[0] for name in names} & (MODULES - {"ebjax"})


def allowed(file: Path) -> set[str]:
    """The rooms a file may import beside its own; a room's command may import all below it, and the edge."""
    room, *inner = file.relative_to(PACKAGE).parts
    assert room in MAY_IMPORT, f"{room} is a new room: say here and in ebjax/README.md which rooms it may import"
    if inner != ["__main__.py"]:
        return MAY_IMPORT[room]
    below = ORDER[: ORDER.index(room)] if room in ORDER else []
    return {*MAY_IMPORT[room], *below, *EDGE}


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_only_rooms_below(file):
    name, names, may = file.relative_to(PACKAGE), imported(file), allowed(file)
    wrong = rooms(names) - may - {name.parts[0], "parts"}
    assert not wrong, f"{name} imports {sorted(wrong)}; it may import {sorted(may)}"
    commands = [found for found in files(names) if found.endswith("__main__")]
    assert not commands, f"{name} imports the command {commands}; move what both need into a file of its own"


def test_rooms_have_no_cycle():
    for room in ORDER:
        assert all(ORDER.index(below) < ORDER.index(room) for below in MAY_IMPORT[room])
    graphlib.TopologicalSorter({room: MAY_IMPORT[room] for room in MAY_IMPORT if room not in EDGE}).prepare()
    graphlib.TopologicalSorter({room: MAY_IMPORT.get(room, set()) & EDGE for room in EDGE}).prepare()
    users = {"paper", "train", "logs"}
    assert not any(users & below for below in MAY_IMPORT.values())


def test_files_have_no_cycle():
    graphlib.TopologicalSorter({module(file): files(imported(file)) for file in FILES}).prepare()


@pytest.mark.parametrize("room", ["io", "evaluation", "logs"])
def test_host_rooms_load_no_jax(room):
    inside = (file for file in sorted((PACKAGE / room).rglob("*.py")) if file.stem not in ("__main__", "__init__"))
    names = ["ebjax.config", *map(module, inside)]
    code = f"import importlib, sys\nfor name in {names}: importlib.import_module(name)\nassert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGE.parent)


def test_reader_of_imports_sees_every_form():
    class Source:
        parent = PACKAGE / "places"

        @staticmethod
        def read_text(encoding):
            return (
                "import ebjax.io.text\nfrom ebjax import viz\nfrom ..slam import map\nfrom . import netvlad\n"
                "from ebjax.floors import __main__\nfrom ebjax.slam.__main__ import main\n"
                "def f():\n    from ebjax.features.matching import x\n"
                "if TYPE_CHECKING:\n    from ebjax.posegraph.graph import PoseGraph\n"
            )

    assert rooms(imported(Source)) == {"io", "viz", "slam", "places", "floors", "features", "posegraph"}
    reached = files(imported(Source))
    assert reached >= {"ebjax.io.text", "ebjax.places.netvlad", "ebjax.features.matching", "ebjax.posegraph.graph"}
    assert {name for name in reached if name.endswith("__main__")} == {"ebjax.floors.__main__", "ebjax.slam.__main__"}
