"""Ratios that were measured before, in a file, and what they depend on: processor, libraries, Python.

[{"machine": {"processor": ..., "numpy": ..., ...}, "turns": 15, "ratios": {"solver": 0.34, ...}}, ...]

There is one entry a processor: the same code on two processors of the same speed gives ratios that differ by a half.
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

    @property
    def processor(self) -> str:
        """Whose ratios they are."""
        return self.machine.get("processor", "")

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
    """Writes it beside those of other processors.

    Raises:
      ValueError: the file is there, and is not one of baselines.
      OSError: it cannot be written.
    """
    others = [one for one in _read(path) if one.processor != baseline.processor] if path.is_file() else []
    with whole_file(path) as file:
        file.write(json.dumps([dataclasses.asdict(one) for one in [*others, baseline]], indent=1) + "\n")


def read_baseline(path: Path, of: str) -> Baseline:
    """Reads that of a processor.

    Raises:
      ValueError: there is none, or the file is not what `write_baseline` writes.
    """
    if not path.is_file():
        raise ValueError(f"{path}: there is no baseline; {REMEDY}")
    for one in _read(path):
        if one.processor == of:
            return one
    raise ValueError(f"{path}: there is no baseline of this processor ({of}); {REMEDY}, which keeps the others")


def _read(path: Path) -> list[Baseline]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(values, list):
            raise ValueError("the file must be a list of baselines")
        return [_checked(one) for one in values]
    except ValueError as fault:
        raise ValueError(f"{path}: {fault}; remove the file, and {REMEDY}") from None


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
