"""Feeds damaged files to every reader for as long as asked; what must not be is kept with how to see it again.

    python -m tests.fuzz --hours 1 --seed 7 --readers g2o trajectory
    python -m tests.fuzz --replay runs/fuzz/g2o-7-123-KeyError

An input may give a result, ValueError or OSError, of one line. It may use 2 s of processor time a call, and 1 GB.
"""

import itertools
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import tyro

from .campaign import Tally, campaign, found, replay, table
from .readers import READERS

BLOCK = 100


@dataclass(frozen=True)
class Config:
    """Feeds damaged files to the readers and counts what comes of them. Exit code 1 where something was found."""

    hours: float = 0.1
    """How long."""
    seed: int = 0
    """Another seed gives other inputs."""
    first: int = 0
    """Number of the first input: a campaign goes on where another with its seed stopped."""
    readers: tuple[str, ...] = tuple(READERS)
    """Which."""
    out: Path = Path("runs/fuzz")
    """Folder for the inputs of findings."""
    replay: Path | None = None
    """A folder of a finding: only that input is read."""


def blocks(config: Config) -> Iterator[range]:
    """Blocks of input numbers until the time is over."""
    end = time.monotonic() + 3600 * config.hours
    for start in itertools.count(config.first, BLOCK):
        if time.monotonic() >= end:
            print(f"the next input is {start}: go on with --first {start}")
            return
        yield range(start, start + BLOCK)


def show(reader: str, tally: Tally) -> None:
    """A line of progress."""
    rate = tally.inputs / max(tally.seconds, 1e-9)
    print(f"{reader}: {tally.inputs} inputs, {rate:.0f} a second, {tally.findings.total()} findings", flush=True)


def main(config: Config) -> int:
    """Runs, prints; returns the exit code."""
    if config.replay is not None:
        verdict = replay(config.replay)
        print(json.dumps(verdict, indent=1))
        return 1 if verdict["faults"] else 0
    if unknown := sorted(set(config.readers) - set(READERS)):
        print(f"error: no reader {unknown[0]!r}; readers are {', '.join(READERS)}", file=sys.stderr)
        return 2
    tallies = campaign(config.readers, blocks(config), config.seed, config.out, show)
    print("\n".join([*table(tallies), *found(tallies)]))
    return 1 if any(tally.findings for tally in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config)))
