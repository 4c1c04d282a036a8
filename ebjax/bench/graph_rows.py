"""Rows of the tables of `solve` beside gtsam: real graphs, growth with the path, batches, gradients.

A figure is the median over turns. Compilation and the building of gtsam's graph are left out. Both stop at a relative
decrease of 1e-9, gtsam also at its own absolute one of 1e-5.
"""

import json
import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.bench.corridor import corridor
from ebjax.bench.gtsam_solver import RTOL, STEPS, gtsam_solver
from ebjax.bench.turns import in_turn
from ebjax.posegraph import init
from ebjax.posegraph.assembly import assemble, damped
from ebjax.posegraph.factors import edge_costs, gauss_newton_blocks
from ebjax.posegraph.g2o import read_g2o
from ebjax.posegraph.graph import PoseGraph, poses_alone
from ebjax.posegraph.levenberg import STATUS, Solution
from ebjax.posegraph.linear import Structure, analyse, linear_solve
from ebjax.posegraph.lm import compile_solve, solve

Row = dict[str, Any]


def _medians(*runs: Callable[[], Any], turns: int) -> tuple[list[float], list[Any]]:
    """Median seconds of every run, and its answer."""
    answers = [jax.block_until_ready(run()) for run in runs]
    seconds = in_turn({str(k): run for k, run in enumerate(runs)}, turns)
    return [float(np.median(taken)) for taken in seconds.values()], answers


def _compiled(graph: PoseGraph, **options: Any) -> tuple[Callable[[], Solution], float]:
    start = time.perf_counter()
    run = compile_solve(graph, rtol=RTOL, max_steps=STEPS, **options)
    return run, time.perf_counter() - start


@jax.jit
def _blocks(graph, poses):
    return gauss_newton_blocks(graph, poses, "none", jnp.asarray(1.0, poses.dtype))


@jax.jit
def _system(graph, structure, blocks):
    return assemble(graph, structure.pattern, blocks, ~jnp.asarray(structure.fixed))


@jax.jit
def _step(structure, system, gradient):
    return linear_solve(structure, damped(system, jnp.asarray(1e-5, gradient.dtype)), gradient)


@jax.jit
def _cost(graph, poses):
    return jnp.sum(edge_costs(graph, poses, "none", jnp.asarray(1.0, poses.dtype)))


def _shares(graph: PoseGraph, structure: Structure, turns: int) -> Row:
    """Share of an iteration in the Jacobians (with their products), the assembly, the linear solve, and the cost."""
    poses = jnp.asarray(graph.poses)
    blocks = _blocks(graph, poses)
    system, gradient = _system(graph, structure, blocks)
    stages = {
        "Jacobians": lambda: _blocks(graph, poses),
        "assembly": lambda: _system(graph, structure, blocks),
        "factor": lambda: _step(structure, system, gradient),
        "cost": lambda: _cost(graph, poses),
    }
    seconds, _ = _medians(*stages.values(), turns=turns)
    return {f"{name} %": 100 * s / sum(seconds) for name, s in zip(stages, seconds, strict=True)}


def graphs(paths: list[Path], solver: str, turns: int) -> Iterator[Row]:
    """A row per graph and kernel, from the file's start, or odometry where a reference.json beside it has no other."""
    for path in paths:
        graph, ids = read_g2o(path)
        if poses_alone(graph) is not graph:
            raise ValueError(f"{path}: landmarks and priors are not compared with gtsam; give graphs of poses alone")
        known = _references(path)
        start = "file" if not known or "file" in known["L2"] else "odometry"
        if start == "odometry":
            graph = replace(graph, poses=init.odometry(graph))
        structure = analyse(graph, solver)
        shares = _shares(graph, structure, turns)
        for kernel, title in (("none", "L2"), ("cauchy", "Cauchy")):
            run, compile_s = _compiled(graph, kernel=kernel, structure=structure)
            seconds, (found, (theirs, their_steps)) = _medians(run, gtsam_solver(graph, kernel), turns=turns)
            reference = known.get(title, {}).get(start)
            yield {
                "graph": f"{path.stem} {title}",
                "poses": len(ids),
                "edges": len(graph.i),
                "cost": f"{float(found.cost):.9g}",
                "off reference": "" if reference is None else f"{abs(float(found.cost) / reference - 1):.0e}",
                "gtsam's cost": f"{theirs:.9g}",
                "steps": int(found.iterations),
                "gtsam's steps": their_steps,
                "status": STATUS[int(found.status)],
                "compile s": compile_s,
                "ms": 1e3 * seconds[0],
                "gtsam ms": 1e3 * seconds[1],
                "times faster": seconds[1] / seconds[0],
            } | shares


def _references(path: Path) -> dict[str, dict[str, float]]:
    file = path.parent / "reference.json"
    known = json.loads(file.read_text(encoding="utf-8")).get(path.name, {}) if file.exists() else {}
    return {"L2": known.get("L2", {}), "Cauchy": known.get("cauchy_width_1_all_edges", {})} if known else {}


def growth(sizes: tuple[int, ...], solver: str, turns: int) -> Iterator[Row]:
    """A corridor with 20 loops, longer and longer, under Cauchy; memory is what the process's peak grew by.

    gtsam runs once a size: it may take minutes.
    """
    for size in sizes:
        graph = corridor(size, 20)
        before = _peak_mb()
        start = time.perf_counter()
        structure = analyse(graph, solver)
        analyse_s = time.perf_counter() - start
        run, compile_s = _compiled(graph, kernel="cauchy", structure=structure)
        jax.block_until_ready(run())
        grown = _peak_mb() - before
        (own_s,), (found,) = _medians(run, turns=turns)
        theirs = gtsam_solver(graph, "cauchy")
        start = time.perf_counter()
        _, their_steps = theirs()
        their_s = time.perf_counter() - start
        yield {
            "poses": size,
            "analyse s": analyse_s,
            "compile s": compile_s,
            "steps": int(found.iterations),
            "gtsam's steps": their_steps,
            "ms": 1e3 * own_s,
            "us a pose": 1e6 * own_s / size,
            "us a pose and step": 1e6 * own_s / size / int(found.iterations),
            "MB more": grown,
            "gtsam ms": 1e3 * their_s,
            "times faster": their_s / own_s,
        }


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def batch(count: int, poses: int, solver: str, turns: int) -> Iterator[Row]:
    """Graphs of one shape under vmap and Cauchy, against a loop over gtsam."""
    made = [corridor(poses, 10, seed) for seed in range(count)]
    base, structure = made[0], analyse(made[0], solver)
    made = [replace(graph, i=base.i, j=base.j, measured=_between(graph, base)) for graph in made]
    made = [replace(graph, poses=init.odometry(graph)) for graph in made]
    measured, start = (jnp.stack([jnp.asarray(getattr(g, name)) for g in made]) for name in ("measured", "poses"))

    @jax.jit
    @jax.vmap
    def together(measured, poses):
        return solve(replace(base, measured=measured, poses=poses), structure=structure, rtol=RTOL)

    theirs = [gtsam_solver(graph, "cauchy") for graph in made]
    began = time.perf_counter()
    jax.block_until_ready(together(measured, start))
    compile_s = time.perf_counter() - began
    runs = (lambda: together(measured, start), lambda: [run() for run in theirs])
    seconds, (found, answers) = _medians(*runs, turns=turns)
    yield {
        "graphs": count,
        "poses": poses,
        "compile s": compile_s,
        "steps": int(np.max(np.asarray(found.iterations))),
        "gtsam's steps": max(steps for _, steps in answers),
        "largest cost off gtsam's": f"{np.abs(np.asarray(found.cost) / [c for c, _ in answers] - 1).max():.0e}",
        "ms": 1e3 * seconds[0],
        "gtsam ms": 1e3 * seconds[1],
        "times faster": seconds[1] / seconds[0],
    }


def _between(graph, base):
    """The graph's noise on the base's edges: odometry as it is, the base's closures from the graph's corrected path."""
    measured = np.array(base.measured)
    odometry = len(graph.poses) - 1
    measured[:odometry] = np.asarray(graph.measured)[:odometry]
    return measured


def gradients(paths: list[Path], solver: str, turns: int) -> Iterator[Row]:
    """Seconds of a solve, and of a solve with the gradient of its poses' spread with respect to every measurement."""
    for path in paths:
        graph, _ = read_g2o(path)
        structure = analyse(graph, solver)
        for kernel, title in (("none", "L2"), ("cauchy", "Cauchy")):

            def spread(measured, graph=graph, structure=structure, kernel=kernel):
                answer = solve(replace(graph, measured=measured), kernel=kernel, structure=structure, rtol=RTOL)
                return jnp.sum(answer.poses[:, -2:] ** 2)

            forward, backward = jax.jit(spread), jax.jit(jax.value_and_grad(spread))
            measured = jnp.asarray(graph.measured)
            runs = (partial(forward, measured), partial(backward, measured))
            seconds, _ = _medians(*runs, turns=turns)
            yield {
                "graph": f"{path.stem} {title}",
                "forward ms": 1e3 * seconds[0],
                "with gradient ms": 1e3 * seconds[1],
                "times forward": seconds[1] / seconds[0],
            }
