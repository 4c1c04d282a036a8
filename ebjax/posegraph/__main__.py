"""Optimises a g2o pose graph."""

import sys
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tyro

from ebjax.command import run


@dataclass(frozen=True)
class Config:
    """Optimises a g2o pose graph and prints its cost, the sum of rho, before and after."""

    graph: tyro.conf.Positional[Path]
    """The graph: g2o or TORO, 2D or 3D, with landmarks and priors or without; vertices optional."""
    out: Path | None = None
    """Where to write the optimised graph, as g2o."""
    robust: str = "cauchy"
    """Robust kernel: cauchy, none (least squares), huber, geman-mcclure, dcs, tls, or gnc-tls, gnc-gm, pcm and
    consensus, which survive many loops being false; or your own, package.module:NAME, whose code is then run."""
    width: float | None = None
    """Of the kernel, in standard deviations of a residual; None: 1, for tls, gnc-*, consensus the 99.9 % point."""
    robust_on: Literal["all", "loops"] = "all"
    """Edges the kernel applies to; loops join poses that are not neighbours in the file."""
    information: Literal["auto", "g2o", "gtsam"] = "auto"
    """Of 3D rotations, information is g2o's, of the quaternion's vector part, or gtsam's, of the rotation vector."""
    init: Literal["file", "odometry", "spanning-tree", "chordal"] = "file"
    """Starting point; without vertices in the file, file means odometry."""
    solver: Literal["auto", "elimination", "qdldl", "supernodal", "cholmod"] = "auto"
    """Linear solver of a step."""
    max_steps: int = 200
    """Steps tried at most."""
    rtol: float = 1e-9
    """Stop when a step lowers the cost by less than this share."""
    plot: Path | None = None
    """Where to draw the graph before and after, as PNG."""
    quiet: bool = False
    """No line per step on stderr."""
    strict: bool = False
    """Exit with code 3 if the steps did not converge."""


def _report(step: Any, cost: Any, accepted: Any, damping: Any) -> None:
    sign = "" if accepted else "  rejected"
    print(f"step {int(step):3d}  cost {float(cost):.9g}  damping {float(damping):.0e}{sign}", file=sys.stderr)


def _stays(graph: Any, chosen: Any, ids: Any) -> str:
    """What the gauge chose to hold, if that is not just the first pose of the file."""
    if not len(chosen.chosen) or (chosen.held is None and chosen.chosen.tolist() == [0]):
        return ""
    whole = [str(ids[k]) for k in chosen.chosen if chosen.fixed[k]]
    part = [str(ids[k]) for k in chosen.chosen if not chosen.fixed[k]]
    says = []
    if whole:
        says.append(f"nothing says where the pieces of {_few(whole)} lie; these vertices stay where they are")
    if part:
        says.append(f"the measurements leave a motion of the whole free; vertex {_few(part)} is held against it")
    return "; ".join(says)


def _few(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _contents(graph: Any) -> str:
    """Counts of poses, landmarks, priors and other edges, the middle two where there are any."""
    poses, priors = graph.pose_count, int((graph.i == len(graph.poses) - 1).sum()) if graph.world else 0
    landmarks = len(graph.poses) - poses - graph.world
    counts = [(poses, "poses"), (landmarks, "landmarks"), (priors, "priors"), (len(graph.i) - priors, "edges")]
    return ", ".join(f"{n} {what}" for n, what in counts if n or what in ("poses", "edges"))


def main(config: Config) -> None:
    """Reads, optimises, prints, writes."""
    import numpy as np

    from ebjax.io.atomic import whole_file
    from ebjax.posegraph import STATUS, init
    from ebjax.posegraph.g2o import format_g2o, read_g2o
    from ebjax.posegraph.gauge import gauge
    from ebjax.posegraph.graph import loops_of, poses_alone
    from ebjax.posegraph.lm import compile_solve
    from ebjax.viz.figures import pose_graph

    if config.max_steps < 1 or (config.width is not None and config.width <= 0) or config.rtol < 0:
        raise ValueError("--max-steps and --width must be positive, --rtol not negative")
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        graph, ids = read_g2o(config.graph, information=config.information)
    for note in notes:
        print(f"note: {note.message}", file=sys.stderr)
    read_s = time.perf_counter() - start
    if config.robust_on == "loops":
        graph = replace(graph, robust=loops_of(graph))
    try:
        chosen = gauge(graph, ids)
    except ValueError as error:
        raise ValueError(f"{config.graph}: {error}") from None
    if stays := _stays(graph, chosen, ids):
        print(f"note: {config.graph}: {stays}", file=sys.stderr)
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
        report=None if config.quiet else _report,
    )
    compile_s = time.perf_counter() - start
    start = time.perf_counter()
    solution = compiled()
    cost = float(solution.cost)
    solve_s = time.perf_counter() - start
    kernel = (
        "least squares"
        if config.robust == "none"
        else config.robust + (f", width {config.width:g}" if config.width else "")
    )
    print(f"{config.graph}: {_contents(graph)}, {graph.group.upper()}, {kernel}")
    print(f"cost {float(solution.initial_cost):.9g} -> {cost:.9g}")
    print(f"{int(solution.iterations)} iterations, {STATUS[int(solution.status)]}")
    print(f"seconds: read {read_s:.2f}, compile {compile_s:.2f}, solve {solve_s:.3f}")
    if config.out is not None:
        text = format_g2o(replace(graph, poses=np.asarray(solution.poses)), ids, information=config.information)
        with whole_file(config.out) as file:
            file.write(text)
        print(f"wrote {config.out}")
    if config.plot is not None:
        with whole_file(config.plot, "wb") as file:
            file.write(pose_graph(poses_alone(graph), np.asarray(solution.poses)[: graph.pose_count]))
        print(f"drew {config.plot}")
    if config.strict and int(solution.status) != 0:
        print(f"error: {STATUS[int(solution.status)]}; raise --max-steps or change --init", file=sys.stderr)
        sys.exit(3)


if __name__ == "__main__":
    run(main, Config)
