"""Notebooks: that they run, that what they show is theirs and of no machine, that what they import is there."""

import ast
import base64
import importlib.util
import shutil

import cv2
import nbformat
import numpy as np
import pytest

import ebjax

from . import notebooks
from .notebooks import NOTEBOOKS

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code(path):
    """The notebook as one script, without lines for the shell."""
    cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    return "\n".join(line for cell in cells for line in cell.splitlines() if not line.startswith(("!", "%")))


def test_they_are_numbered():
    assert [path.stem.partition("_")[0] for path in NOTEBOOKS] == [f"{k:02d}" for k in range(1, len(NOTEBOOKS) + 1)]


@each_notebook
def test_what_it_shows_is_as_it_was_made(path):
    text = path.read_text(encoding="utf-8")
    assert not notebooks.faults(text)
    cells = [cell for cell in nbformat.reads(text, as_version=4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1)), notebooks.REMEDY


@each_notebook
def test_what_it_imports_is_there(path):
    tree = ast.parse(code(path))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "ebjax":
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names):
                assert hasattr(module, name) or importlib.util.find_spec(f"{node.module}.{name}"), name
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ebjax":
            assert hasattr(ebjax, node.attr), f"ebjax.{node.attr}"


@pytest.fixture(scope="session")
def demo(made_once):
    """The corridor that two of them go through, rendered once."""
    return made_once("demo", lambda folder: ebjax.demo(folder / "sequence")) / "sequence"


@pytest.mark.whole
@each_notebook
def test_it_runs(path, tmp_path, monkeypatch, demo):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))  # no profile of the user's, and none left behind
    work = tmp_path / "work"
    shutil.copytree(demo, work / notebooks.DEMO)
    done = notebooks.cleaned(notebooks.executed(nbformat.read(path, as_version=4), work), work)
    assert not notebooks.faults(nbformat.writes(done))


def written(*cells, **changes):
    """A small notebook as it is kept, with a picture."""
    _, png = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))
    data = {"image/png": base64.b64encode(png.tobytes()).decode()}
    picture = nbformat.v4.new_output("display_data", data)
    first = nbformat.v4.new_code_cell("draw()", outputs=[picture], id="a")
    notebook = nbformat.v4.new_notebook(cells=[first, *cells])
    notebook.metadata["ebjax"] = {"outputs_of": notebooks.code_of(notebook)} | changes
    return nbformat.writes(notebook)


def said(text, name="stdout"):
    return nbformat.v4.new_code_cell(
        "print()", outputs=[nbformat.v4.new_output("stream", name=name, text=text)], id="b"
    )


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (written(outputs_of="of other code"), "outputs are not those of its code"),
        (written(said("read /tmp/work/run.bag")), "names a path"),
        (written(said("failed", "stderr")), "shows a fault"),
        (written(said("long " * 80_000)), "at most 300"),
        (nbformat.writes(nbformat.v4.new_notebook()), "no picture"),
    ],
    ids=["old", "path", "stderr", "large", "picture"],
)
def test_a_notebook_that_is_not_fit_to_be_kept(text, fault):
    assert fault in "\n".join(notebooks.faults(text))
    assert not notebooks.faults(written())


def test_pictures_are_made_small():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (300, 1500, 3), dtype=np.uint8)
    kind, content = notebooks.small(cv2.imencode(".png", noise)[1].tobytes())
    assert kind == "image/jpeg"
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).shape == (152, 760, 3)
    flat = np.full((40, 60, 3), 200, np.uint8)
    kind, content = notebooks.small(cv2.imencode(".png", flat)[1].tobytes())
    assert kind == "image/png"
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR), flat)


def test_what_runs_is_kept_without_its_machine(tmp_path):
    cell = nbformat.v4.new_code_cell("tell()", id="a", metadata={"execution": {"iopub.status.busy": "2026"}})
    shown, where = nbformat.v4.new_notebook(cells=[cell]), str(tmp_path)
    shown.cells[0].outputs = [
        nbformat.v4.new_output("stream", name="stdout", text=f"{where}/run.bag\n"),
        nbformat.v4.new_output("stream", name="stderr", text="12 frames, 3 ms a frame"),
        nbformat.v4.new_output("execute_result", {"text/plain": repr(where)}, execution_count=7),
    ]
    kept = notebooks.cleaned(shown, tmp_path)
    assert [output.get("text") or output.data["text/plain"] for output in kept.cells[0].outputs] == ["run.bag\n", "'.'"]
    assert kept.cells[0].metadata == {} and kept.cells[0].execution_count == 1
    assert kept.metadata["ebjax"] == {"outputs_of": notebooks.code_of(kept)}
