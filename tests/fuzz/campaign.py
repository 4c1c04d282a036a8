"""A campaign: inputs one after the other through the readers, what came of them counted, what must not be kept."""

import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .mutate import Input, mutated
from .readers import READERS
from .watch import Worker

KEPT = 3
"""Inputs kept of each finding."""
OUTCOMES = ("result", "ValueError", "OSError")


@dataclass
class Tally:
    """What came of a reader's inputs; findings and weak messages by (kind, place)."""

    inputs: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    findings: Counter[tuple[str, str]] = field(default_factory=Counter)
    weak: Counter[tuple[str, str]] = field(default_factory=Counter)
    said: dict[tuple[str, str], str] = field(default_factory=dict)
    slowest_ms: float = 0.0
    slowest: int = 0
    most_bytes: int = 0
    seconds: float = 0.0

    def add(self, number: int, verdict: Any) -> list[tuple[str, str, str]]:
        """Counts the verdict on an input; returns the findings in it."""
        self.inputs += 1
        self.outcomes[verdict["outcome"]] += 1
        if verdict["ms"] > self.slowest_ms:
            self.slowest_ms, self.slowest = verdict["ms"], number
        self.most_bytes = max(self.most_bytes, verdict["bytes"])
        for counts, notes in ((self.findings, verdict["faults"]), (self.weak, verdict["weak"])):
            for kind, place, message in notes:
                counts[kind, place] += 1
                self.said.setdefault((kind, place), message)
        return [tuple(note) for note in verdict["faults"]]


def fuzz(
    reader: str, numbers: Iterable[int], seed: int, worker: Worker, scratch: Path, tally: Tally, out: Path | None = None
) -> None:
    """Reads mutated inputs.

    Args:
      reader: a name of READERS.
      numbers: of the inputs.
      seed: of the campaign.
      worker: of the reader's group.
      scratch: a folder to write inputs into.
      tally: is added to.
      out: keeps the inputs of findings, each with how to read it again.
    """
    seeds, start = READERS[reader].inputs(), time.perf_counter()
    for number in numbers:
        made = mutated(reader, seeds, seed, number)
        folder = scratch / "input"
        verdict = worker.read(reader, made.write(folder))
        for kind, place, message in tally.add(number, verdict):
            if out is not None and tally.findings[kind, place] <= KEPT:
                _keep(out, made, {"reader": reader, "seed": seed, "number": number, "kind": kind, "place": place,
                                  "message": message, "target": made.target})  # fmt: skip
        for left in scratch.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
    tally.seconds += time.perf_counter() - start


def _keep(out: Path, made: Input, facts: dict[str, Any]) -> None:
    name = f"{facts['reader']}-{facts['seed']}-{facts['number']}-{facts['kind']}".replace(" ", "_")
    folder = out / name
    if not folder.exists():
        made.write(folder / "input")
        facts["replay"] = f"python -m tests.fuzz --replay {folder}"
        (folder / "finding.json").write_text(json.dumps(facts, indent=1) + "\n")


def replay(folder: Path) -> Any:
    """Reads a kept input again."""
    facts = json.loads((folder / "finding.json").read_text())
    with tempfile.TemporaryDirectory(prefix="ebjax_fuzz_") as scratch:
        shutil.copytree(folder / "input", Path(scratch) / "input")
        with Worker(group_of(facts["reader"]), Path(scratch)) as worker:
            return worker.read(facts["reader"], Path(scratch) / "input" / facts["target"])


def group_of(reader: str) -> str:
    """Which worker has a reader."""
    return "jax" if reader in READERS and READERS[reader].needs_jax else "host"


def campaign(
    readers: Sequence[str],
    blocks: Iterable[range],
    seed: int,
    out: Path | None = None,
    progress: Callable[[str, Tally], None] = lambda reader, tally: None,
) -> dict[str, Tally]:
    """Fuzzes readers in turn, a block of inputs each, until the blocks end."""
    tallies = {reader: Tally() for reader in readers}
    with tempfile.TemporaryDirectory(prefix="ebjax_fuzz_") as folder:
        workers: dict[str, Worker] = {}
        try:
            for block in blocks:
                for reader in readers:
                    group, scratch = group_of(reader), Path(folder) / group_of(reader)
                    scratch.mkdir(exist_ok=True)
                    worker = workers.get(group) or workers.setdefault(group, Worker(group, scratch))
                    fuzz(reader, block, seed, worker, scratch, tallies[reader], out)
                    progress(reader, tallies[reader])
        finally:
            for worker in workers.values():
                worker.__exit__(*sys.exc_info())
    return tallies


def table(tallies: dict[str, Tally]) -> list[str]:
    """A line a reader."""
    heads = ("reader", "inputs", "a second", *(f"{name}s" for name in OUTCOMES))
    rows = [(*heads, "findings", "slowest ms", "its number", "most MB")]
    for reader, t in tallies.items():
        counts = (t.inputs, round(t.inputs / max(t.seconds, 1e-9)), *(t.outcomes[name] for name in OUTCOMES))
        most = (t.findings.total(), round(t.slowest_ms), t.slowest, round(t.most_bytes / 2**20))
        rows.append((reader, *map(str, (*counts, *most))))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)) for row in rows]


def found(tallies: dict[str, Tally]) -> list[str]:
    """Each finding, then each weak message, in a line with its count."""
    return [
        f"{title}{reader}: {count} x {kind} at {place or '?'}: {tally.said[kind, place]}"
        for title, name in (("", "findings"), ("weak, ", "weak"))
        for reader, tally in tallies.items()
        for (kind, place), count in getattr(tally, name).most_common()
    ]
