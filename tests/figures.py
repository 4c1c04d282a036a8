"""The results that the READMEs show of `python -m ebjax.slam`, kept in figures.json and measured anew on request.

    python -m tests.figures

runs every command, on the recorded run of EBJAX_DATA too, writes what their metrics.json say into figures.json and
prints what changed. `tests/test_readmes.py` compares the READMEs with the file.
"""

import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("figures.json")
DATA = Path(os.environ.get("EBJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
HEAD = ("run", "frames", "closures kept", "within 5 cm and 1 degree", "ATE before", "ATE after")


def recorded() -> list[dict[str, Any]]:
    """What the file holds, a run each: how the READMEs call it, the command's arguments, its figures."""
    return json.loads(FILE.read_text(encoding="utf-8"))["slam"]


def cells(run: dict[str, Any]) -> list[str]:
    """A run as a row of a table, behind its name."""
    shown = run["figures"]
    right, ates = shown["within_5cm_1deg"], (shown["ate_before_m"], shown["ate_after_m"])
    return [
        str(shown["frames"]),
        str(shown["closures_kept"]),
        str(right) if shown["closures_kept"] else "-",
        *("-" if ate is None else f"{ate:.4f} m" for ate in ates),
    ]


def thinned(log: Path, rows: str, out: Path) -> Path:
    """A folder in TUM layout with some of a log's frames: START:STOP:STEP."""
    out.mkdir()
    for file in log.iterdir():
        if file.name != "rgb.txt":
            (out / file.name).symlink_to(file.resolve())
    lines = [line for line in (log / "rgb.txt").read_text().splitlines() if not line.startswith("#")]
    chosen = slice(*(int(part) if part else None for part in rows.split(":")))
    (out / "rgb.txt").write_text("\n".join(lines[chosen]) + "\n")
    return out


def measure(run: dict[str, Any], out: Path) -> dict[str, Any]:
    """The figures of a run, by its command."""
    log = [] if run["log"] is None else [DATA / run["log"]]
    if run.get("rows"):
        log = [thinned(log[0], run["rows"], out.with_name(f"{out.name}-log"))]
    arguments = [*map(str, log), *shlex.split(run["flags"]), "--out", str(out)]
    subprocess.run([sys.executable, "-m", "ebjax.slam", *arguments], check=True, stdout=subprocess.DEVNULL)
    metrics = json.loads((out / "metrics.json").read_text())
    wheels = "--motion floor" not in run["flags"]
    return {
        "frames": metrics["frames"],
        "closures_kept": metrics["closures_kept"],
        "within_5cm_1deg": metrics.get("closures_against_truth", {}).get("within_5cm_1deg", 0),
        "ate_before_m": round(metrics["ate_rmse_m"]["before"], 4) if wheels else None,
        "ate_after_m": round(metrics["ate_rmse_m"]["after"], 4),
    }


def main() -> None:
    """Measures all anew."""
    runs = recorded()
    with tempfile.TemporaryDirectory() as folder:
        for number, run in enumerate(runs):
            found = measure(run, Path(folder) / str(number))
            same = "as before" if found == run["figures"] else f"{found}, was {run['figures']}"
            print(f"{run['run']}: {same}", flush=True)
            run["figures"] = found
    FILE.write_text(json.dumps({"slam": runs}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
