"""Tables of pose graphs beside gtsam, and of what false loops do to a solution."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax
import tyro

from ebjax.bench.graph_rows import Row, batch, gradients, graphs, growth
from ebjax.command import progress
from ebjax.io.atomic import whole_file
from ebjax.posegraph.falseloops import false_loops
from ebjax.posegraph.robust import kernel_of


@dataclass(frozen=True)
class GraphConfig:
    """Times pose graphs beside gtsam, prints Markdown: graphs, gradients, growth, batches, false loops."""

    graphs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """g2o files; a reference.json beside them is compared with."""
    out: Path | None = None
    """Where to write the tables, as Markdown."""
    sizes: tuple[int, ...] = (1000, 4000, 16000, 64000)
    """Poses of the growing corridor with 20 loops."""
    false_loops: tuple[Path, ...] = ()
    """g2o files to add false loops to, 20 % and 50 % of all, and see what every robust setting makes of them."""
    seeds: int = 5
    """Draws of the false loops; the median is printed."""
    kernels: tuple[str, ...] = ("none", "cauchy", "dcs", "geman-mcclure", "gnc-tls", "consensus")
    """Columns of the false loops; many random loops make some of them slow on large graphs."""
    batch: int = 64
    """Graphs of 500 poses solved together; 0 leaves them out."""
    turns: int = 5
    """Every figure is the median of so many turns."""
    solver: Literal["auto", "elimination", "qdldl", "supernodal", "cholmod"] = "auto"
    """Linear solver of a step."""


def bench_graphs(config: GraphConfig) -> None:
    """Prints every table as it is ready, writes them all."""
    jax.config.update("jax_enable_compilation_cache", False)  # seconds of compilation are part of the tables

    if config.turns < 1 or config.seeds < 1 or config.batch < 0 or min(config.sizes, default=1000) < 100:
        raise ValueError("--turns and --seeds must be positive, --batch not negative, --sizes at least 100")
    for kernel in config.kernels:
        kernel_of(kernel)
    paths, turns = list(config.graphs), config.turns
    sections = {
        "Graphs": graphs(paths, config.solver, turns),
        "Gradients": gradients(paths, config.solver, turns),
        "Growth: a corridor with 20 loops, Cauchy": growth(config.sizes, config.solver, turns),
        "A batch under vmap, Cauchy": batch(config.batch, 500, config.solver, turns) if config.batch else (),
        "False loops: ATE in m from the clean solution, odometry start": false_loops(
            list(config.false_loops), seeds=config.seeds, kernels=config.kernels
        ),
    }
    text = ""
    for title, rows in sections.items():
        table = markdown(list(progress(rows, None, title)))
        if table:
            print(f"## {title}\n\n{table}", flush=True)
            text += f"## {title}\n\n{table}\n"
    if config.out is not None:
        with whole_file(config.out) as file:
            file.write(text)


def markdown(rows: list[Row]) -> str:
    """The rows as a table."""
    if not rows:
        return ""
    titles = list(rows[0])
    lines = [titles, ["---"] * len(titles), *([_text(row[t]) for t in titles] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _text(value):
    return value if isinstance(value, str) else f"{value:.3g}" if isinstance(value, float) else str(value)
