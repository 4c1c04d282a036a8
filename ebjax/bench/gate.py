"""Whether a part has become slower than a baseline says."""

import sys
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path

import tyro

from ebjax.bench.baseline import BASELINE, Baseline, machine, read_baseline, write_baseline
from ebjax.bench.measure import measure
from ebjax.bench.parts import PARTS
from ebjax.bench.turns import Interval, median_interval

ALLOWED = 0.15
"""Share of the baseline's ratio by which a ratio may differ from it."""
FEWEST_TURNS = 15


@dataclass(frozen=True)
class GateConfig:
    """Times parts of ebjax beside other libraries; with --gate, exit code 1 if one is slower than it was."""

    parts: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which of slam, solver, warp, search and matching; none named: all."""
    gate: bool = False
    """Fail where the 95 % interval of a ratio lies wholly more than 15 % above the baseline."""
    write_baseline: bool = False
    """Make what is measured the baseline of this processor. Do so on a quiet machine."""
    baseline: Path = BASELINE
    """File of ratios, by processor."""
    turns: int = 21
    """How often each part and its reference run, 15 at least; the median counts."""
    slow_down: tuple[str, ...] = ()
    """PART=1.25: the part is made to take 1.25 times as long, to see that the gate fails."""


class Verdict(StrEnum):
    """On a part."""

    SLOWER = "slower"
    FASTER = "faster"
    AS_BEFORE = "as before"


def verdict(ratio: Interval, before: float) -> Verdict:
    """Whether all of a ratio's interval is off by more than ALLOWED."""
    if ratio.low > (1 + ALLOWED) * before:
        return Verdict.SLOWER
    return Verdict.FASTER if ratio.high < before / (1 + ALLOWED) else Verdict.AS_BEFORE


def bench_parts(config: GateConfig) -> None:
    """Measures; prints a line a part; compares or writes the baseline."""
    names = _chosen(config)
    slow_downs = dict(_slow_down(text, names) for text in config.slow_down)
    here = machine()
    before = read_baseline(config.baseline, here["processor"]) if config.gate else None
    if before is not None:
        _comparable(config.baseline, before, names, here)
    print(f"{'part':10}{'ms':>9}{'beside':>9}{'ratio':>9}{'95 % interval':>19}{'before':>9}", flush=True)
    ratios: dict[str, float] = {}
    verdicts: dict[str, Verdict] = {}
    for name, found in measure(names, config.turns, slow_downs).items():
        ratio, sides = median_interval(found.ratios), (found.ours_ms, found.reference_ms)
        ours_ms, beside_ms = (median_interval(side).median for side in sides)
        shown = f"{name:10}{ours_ms:9.2f}{beside_ms:9.2f}{ratio.median:9.4f}{ratio.low:10.4f}{ratio.high:9.4f}"
        if before is not None:
            verdicts[name] = verdict(ratio, before.ratios[name])
            shown += f"{before.ratios[name]:9.4f}  {ratio.median / before.ratios[name] - 1:+.1%}, {verdicts[name]}"
        print(shown, flush=True)
        ratios[name] = round(ratio.median, 4)
    if config.write_baseline:
        write_baseline(config.baseline, Baseline(here, config.turns, ratios))
        print(f"wrote {config.baseline}")
    if slower := [name for name, found in verdicts.items() if found is Verdict.SLOWER]:
        print(f"error: slower than {config.baseline} by more than {ALLOWED:.0%}: {', '.join(slower)}", file=sys.stderr)
        sys.exit(1)


def _chosen(config: GateConfig) -> list[str]:
    """Parts that are named and can be timed; the others are said."""
    if unknown := [name for name in config.parts if name not in PARTS]:
        raise ValueError(f"no part {unknown[0]!r}; there are {', '.join(PARTS)}")
    if config.turns < FEWEST_TURNS:
        raise ValueError(f"--turns is {config.turns}; give {FEWEST_TURNS} or more")
    if config.write_baseline and (config.parts or config.gate or config.slow_down):
        raise ValueError("--write-baseline measures all parts as they are: name none, without --gate and --slow-down")
    names = list(dict.fromkeys(config.parts or PARTS))
    absent = {name: needs for name in names if (needs := PARTS[name].needs) and not find_spec(needs)}
    said = [f'{name}: {needs} is not installed; pip install "ebjax[oracle]"' for name, needs in absent.items()]
    if said and (config.write_baseline or len(absent) == len(names)):
        raise ValueError(said[0])
    for line in said:
        print(f"left out: {line}", file=sys.stderr)
    return [name for name in names if name not in absent]


def _slow_down(text: str, names: list[str]) -> tuple[str, float]:
    """A part, and how many times as long it shall take."""
    name, _, times = text.partition("=")
    try:
        factor = float(times)
    except ValueError:
        factor = 0.0
    if name not in names or not 1 <= factor <= 100:
        raise ValueError(f"--slow-down {text}: give PART=TIMES, one of {', '.join(names)}, and a number from 1 to 100")
    return name, factor


def _comparable(path: Path, before: Baseline, names: list[str], here: dict[str, str]) -> None:
    """Says what else may have changed ratios; refuses parts that the baseline does not have."""
    if new := [name for name in names if name not in before.ratios]:
        raise ValueError(f"{path}: it has no {new[0]}; write it anew with python -m ebjax.bench --write-baseline")
    for line in before.differences(here):
        print(f"note: {line}; ratios may differ for that alone", file=sys.stderr)
