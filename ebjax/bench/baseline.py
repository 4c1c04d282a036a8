"""Ratios that were measured before, in a file, and what they depend on: processor, libraries, Python.

{"machine": {"processor": ..., "numpy": ..., ...}, "turns": 15, "ratios": {"solver": 0.34, ...}}
"""

import dataclasses
import importlib.metadata
import json
import platform
from pathlib import Path
from typing import Any

from ebjax.io.atomic import whole_file

BASELINE = Path(__file__).with_name("baseline.json")
PACKAGES = ("jax", "jaxlib", "numpy", "opencv-python-headless", "gtsam", "faiss-cpu")
REMEDY = "write it with python -m ebjax.bench --write-baseline"


@dataclasses.dataclass(frozen=True)
class Baseline:
    """What a gate compares with.

    Attributes:
      machine: where it was measured, as `machine` says it.
      turns: of each part.
      ratios: by part.
    """

    machine: dict[str, str]
    turns: int
    ratios: dict[str, float]

    def differences(self, here: dict[str, str]) -> list[str]:
        """What is not as it was, a line each."""
        names = self.machine | here
        pairs = {name: (self.machine.get(name, "none"), here.get(name, "none")) for name in names}
        return [f"{name}: the baseline's is {was}, this is {now}" for name, (was, now) in pairs.items() if was != now]


def machine() -> dict[str, str]:
    """What ratios depend on, here."""
    found = {"processor": processor(), "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """Its kind."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    said = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    names = ("model name", "cpu family", "model", "CPU implementer", "CPU part")
    kind = ", ".join(f"{name} {said[name]}" for name in names if name in said)
    return kind.removeprefix("model name ") or platform.machine()


def write_baseline(path: Path, baseline: Baseline) -> None:
    """Writes it.

    Raises:
      OSError: it cannot be written.
    """
    with whole_file(path) as file:
        file.write(json.dumps(dataclasses.asdict(baseline), indent=1) + "\n")


def read_baseline(path: Path) -> Baseline:
    """Reads it.

    Raises:
      ValueError: it is absent, or not what `write_baseline` writes.
    """
    if not path.is_file():
        raise ValueError(f"{path}: there is no baseline; {REMEDY}")
    try:
        return _checked(json.loads(path.read_text(encoding="utf-8")))
    except ValueError as fault:
        raise ValueError(f"{path}: {fault}; {REMEDY}") from None


def _checked(values: Any) -> Baseline:
    names = {field.name for field in dataclasses.fields(Baseline)}
    if not isinstance(values, dict) or values.keys() != names:
        raise ValueError(f"a baseline is an object of {', '.join(sorted(names))}")
    machine, ratios = values["machine"], values["ratios"]
    if not isinstance(machine, dict) or not all(isinstance(value, str) for value in machine.values()):
        raise ValueError(f"machine must be an object of texts, not {machine!r}")
    if not isinstance(ratios, dict):
        raise ValueError(f"ratios must be an object of numbers, not {ratios!r}")
    for name, ratio in ratios.items():
        if isinstance(ratio, bool) or not isinstance(ratio, int | float) or not 0 < ratio < float("inf"):
            raise ValueError(f"{name}: the ratio must be a number above 0, not {ratio!r}")
    return Baseline(**values)
