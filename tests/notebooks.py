"""Makes the notebooks anew, outputs included: `python -m tests.notebooks [NAME ...]`.

Every notebook runs from top to bottom in a kernel of its own, warnings as errors. All run in one temporary folder,
where the demo is rendered first. Written back are the outputs without what differs from run to run: progress, times of
execution, paths of this machine. Pictures are made small. Exit code 1 where a notebook fails, takes too long or is too
large; then it is left as it was.
"""

import base64
import hashlib
import os
import re
import resource
import sys
import tempfile
import time
from pathlib import Path

import cv2
import nbformat
import numpy as np
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

import ebjax

DEMO = "runs/demo/sequence"
"""Where notebooks look for the demo's corridor."""
FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LONGEST_S, LARGEST_KB = 60, 300
WIDEST_PX, JPEG_QUALITY = 760, 80
MACHINE = re.compile(r"(?<![\w.~}/<])/(?:tmp|var|work|home|root|opt|usr|Users|private)/[\w.]")
STRICT = "import warnings\n\nwarnings.simplefilter('error')\nwarnings.filterwarnings('ignore', module='ipykernel')"
REMEDY = "python -m tests.notebooks"


def code_of(notebook: nbformat.NotebookNode) -> str:
    """What tells whether outputs belong to the code: a digest of all cells of code."""
    code = "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    return hashlib.sha256(code.encode()).hexdigest()[:16]


def outputs_of(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def executed(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs that it has when it runs in a folder.

    Raises:
      CellExecutionError: a cell fails or warns.
    """
    # Through the filter and not PYTHONWARNINGS: the kernel's own imports are not ours to judge.
    strict = nbformat.v4.new_code_cell(STRICT)
    whole = nbformat.v4.new_notebook(cells=[strict, *notebook.cells], metadata=notebook.metadata)
    where = {"metadata": {"path": folder}}
    NotebookClient(whole, timeout=300, kernel_name="python3", record_timing=False, resources=where).execute()
    del whole.cells[0]
    return whole


def cleaned(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """The notebook as it is kept; it ran in that folder."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code" and cell.source]
    for number, cell in enumerate(cells, 1):
        said = [output for output in cell.outputs if output.get("name") != "stderr"]
        cell.outputs = [_kept(output, folder, number) for output in said]
        cell.execution_count = number
        cell.metadata.pop("execution", None)
    for output in outputs_of(notebook):
        output.pop("transient", None)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = nbformat.NotebookNode(
        kernelspec=kernel, language_info={"name": "python"}, ebjax={"outputs_of": code_of(notebook)}
    )
    return notebook


def _kept(output: nbformat.NotebookNode, folder: Path, number: int) -> nbformat.NotebookNode:
    if "text" in output:
        output.text = _without(output.text, folder)
    if "execution_count" in output:
        output.execution_count = number
    data = output.get("data", {})
    if "image/png" in data:
        kind, content = small(base64.b64decode(data.pop("image/png")))
        data[kind] = base64.b64encode(content).decode()
    if "text/plain" in data:
        data["text/plain"] = _without(data["text/plain"], folder)
    return output


def _without(text: str, folder: Path) -> str:
    """Paths in the folder that the notebook ran in are named from there."""
    return text.replace(f"{folder}/", "").replace(str(folder), ".")


def small(png: bytes) -> tuple[str, bytes]:
    """A picture's kind and content, not wider than `WIDEST_PX`: PNG, or JPEG where that takes half of it."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    height, width = image.shape[:2]
    if width > WIDEST_PX:
        size = WIDEST_PX, round(height * WIDEST_PX / width)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    lossless = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    lossy = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return ("image/jpeg", lossy) if 2 * len(lossy) < len(lossless) else ("image/png", lossless)


def faults(text: str) -> list[str]:
    """What is wrong with a notebook as it is kept, a line each."""
    notebook = nbformat.reads(text, as_version=4)
    nbformat.validate(notebook)
    found, kept = [], outputs_of(notebook)
    if notebook.metadata.get("ebjax", {}).get("outputs_of") != code_of(notebook):
        found.append(f"its outputs are not those of its code: {REMEDY}")
    if not any(kind.startswith("image/") for output in kept for kind in output.get("data", {})):
        found.append("it shows no picture")
    if wrong := [output for output in kept if output.output_type == "error" or output.get("name") == "stderr"]:
        found.append(f"it shows a fault: {wrong[0]}")
    if named := MACHINE.search(text):
        found.append(f"it names a path of a machine, {text[named.start() :][:40]!r}")
    if len(text.encode()) > 1000 * LARGEST_KB:
        found.append(f"it has {len(text.encode()) / 1000:.0f} kB; at most {LARGEST_KB}: show less, or smaller pictures")
    return found


def make(path: Path, folder: Path) -> list[str]:
    """Runs a notebook and writes it back; returns what is wrong, and then leaves it as it was."""
    notebook = nbformat.read(path, as_version=4)
    began_s, used_s = time.perf_counter(), _used_s()
    try:
        done = executed(notebook, folder)
    except CellExecutionError as fault:
        return [str(fault)]
    wall_s, processor_s = time.perf_counter() - began_s, _used_s() - used_s
    text = nbformat.writes(cleaned(done, folder)) + "\n"
    found = faults(text)
    # Where others work too, the wall's clock says how much; the processor's is ours.
    if min(wall_s, processor_s) > LONGEST_S:
        found.append(f"it takes {wall_s:.0f} s, {processor_s:.0f} s of processor time; at most {LONGEST_S}")
    if not found:
        path.write_text(text, encoding="utf-8")
    print(f"{path.stem}: {wall_s:.0f} s, {processor_s:.0f} s of processor time, {len(text.encode()) / 1000:.0f} kB")
    return found


def _used_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(names: list[str]) -> int:
    if unknown := set(names) - {path.stem for path in NOTEBOOKS}:
        print(f"error: no notebook {', '.join(sorted(unknown))}; there are {', '.join(p.stem for p in NOTEBOOKS)}")
        return 2
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        os.environ["IPYTHONDIR"] = f"{temporary}/ipython"  # no profile of the user's, and none left behind
        folder = Path(temporary).resolve() / "work"
        folder.mkdir()
        ebjax.demo(folder / DEMO)
        for path in NOTEBOOKS:
            if not names or path.stem in names:
                wrong = make(path, folder)
                print("\n".join(f"{path.name}: {line}" for line in wrong), end="\n" if wrong else "")
                failed |= bool(wrong)
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
