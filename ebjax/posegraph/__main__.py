"""Optimises a g2o pose graph."""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import tyro

from ebjax.command import run


@dataclass(frozen=True)
class Config:
    """Optimises a g2o pose graph and prints its cost, the sum of rho, before and after."""

    graph: tyro.conf.Positional[Path]
    """The graph: SE2 or SE3:QUAT edges, vertices optional."""
    out: Path | None = None
    """Where to write the optimised graph, as g2o."""
    robust: Literal["cauchy", "none", "huber", "geman-mcclure", "dcs"] = "cauchy"
    """Robust kernel; none is plain least squares."""
    width: float = 1.0
    """Width of the kernel in standard deviations of a residual."""
    robust_on: Literal["all", "loops"] = "all"
    """Edges the kernel applies to; loops join vertices that are not neighbours in the file."""
    init: Literal["file", "odometry", "spanning-tree", "chordal"] = "file"
    """Starting point; without vertices in the file, file means odometry."""
    solver: Literal["auto", "elimination", "qdldl", "cholmod"] = "auto"
    """Linear solver of a step."""
    max_steps: int = 200
    """Steps tried at most."""
    rtol: float = 1e-9
    """Stop when a step lowers the cost by less than this share."""
    strict: bool = False
    """Exit with code 3 if the steps did not converge."""


def main(config: Config) -> None:
    """Reads, optimises, prints, writes."""
    import numpy as np

    from ebjax.io.atomic import whole_file
    from ebjax.posegraph import STATUS, init
    from ebjax.posegraph.g2o import format_g2o, read_g2o
    from ebjax.posegraph.lm import compile_solve

    if config.max_steps < 1 or config.width <= 0 or config.rtol < 0:
        raise ValueError("--max-steps and --width must be positive, --rtol not negative")
    start = time.perf_counter()
    graph, ids = read_g2o(config.graph)
    read_s = time.perf_counter() - start
    if config.robust_on == "loops":
        graph = replace(graph, robust=np.abs(np.asarray(graph.i) - np.asarray(graph.j)) != 1)
    starts = {"odometry": init.odometry, "spanning-tree": init.spanning_tree, "chordal": init.chordal}
    if config.init in starts:
        graph = replace(graph, poses=starts[config.init](graph))
    start = time.perf_counter()
    compiled = compile_solve(
        graph,
        kernel=config.robust,
        width=config.width,
        max_steps=config.max_steps,
        rtol=config.rtol,
        solver=config.solver,
    )
    compile_s = time.perf_counter() - start
    start = time.perf_counter()
    solution = compiled()
    cost = float(solution.cost)
    solve_s = time.perf_counter() - start
    kernel = "least squares" if config.robust == "none" else f"{config.robust}, width {config.width:g}"
    print(f"{config.graph}: {len(ids)} poses, {len(graph.i)} edges, {graph.group.upper()}, {kernel}")
    print(f"cost {float(solution.initial_cost):.9g} -> {cost:.9g}")
    print(f"{int(solution.iterations)} iterations, {STATUS[int(solution.status)]}")
    print(f"seconds: read {read_s:.2f}, compile {compile_s:.2f}, solve {solve_s:.3f}")
    if config.out is not None:
        text = format_g2o(replace(graph, poses=np.asarray(solution.poses)), ids)
        with whole_file(config.out) as file:
            file.write(text)
        print(f"wrote {config.out}")
    if config.strict and int(solution.status) != 0:
        print(f"error: {STATUS[int(solution.status)]}; raise --max-steps or change --init", file=sys.stderr)
        sys.exit(3)


if __name__ == "__main__":
    run(main, Config)
