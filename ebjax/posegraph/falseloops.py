"""What false loops do to a solution: loops added at random, and the error they leave. Host code.

Errors are root mean squares of positions after alignment, against the solution of the graph without false loops:
least squares, and the paper's Cauchy on all edges, which differ where the true loops contradict each other.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.rigid import kabsch
from ebjax.posegraph import init
from ebjax.posegraph.g2o import read_g2o
from ebjax.posegraph.graph import PoseGraph, loops_of, poses_alone
from ebjax.posegraph.lm import solve


def add_false_loops(graph: PoseGraph, share: float, *, seed: int, group: int = 1) -> PoseGraph:
    """Appends false loops between random poses until `share` of all loops is false.

    Each claims a random direction and rotation at the distance of a random true loop, with the information of another.
    With `group` above one, so many in a row are shifted along the path in step and agree with each other, as where one
    corridor looks like another; `graph.poses` should then be right.

    Raises:
      ValueError: the graph has no loops to imitate, too few poses for a group, or the share is not in [0, 1).
    """
    true = np.flatnonzero(loops_of(graph))
    n, lie = len(graph.poses), graph.lie
    if not len(true) or n < 3 + group or not 0 <= share < 1:
        raise ValueError("false loops need a graph with loops, more poses than a group has, and a share below 1")
    rng = np.random.default_rng(seed)
    count = round(len(true) * share / (1 - share))
    groups = -(-count // group)
    first = rng.integers(0, n - group - 2, groups)
    second = rng.integers(first + 2, n - group)
    distance = np.linalg.norm(positions(graph.measured[rng.choice(true, groups)], graph.group), axis=1, keepdims=True)
    towards = _directions(rng, groups, lie.dim // 3 + 1) * distance
    turn = rng.uniform(-np.pi, np.pi, (groups, 1)) if lie.dim == 3 else _directions(rng, groups, 4)
    claim = jnp.asarray(np.concatenate([towards, turn] if lie.dim == 3 else [turn, towards], 1))
    one, step = (x.ravel()[:count] for x in np.mgrid[:groups, :group])
    i, j, poses = first[one] + step, second[one] + step, jnp.asarray(graph.poses)
    back = lie.compose(lie.inverse(poses[i]), poses[first[one]])
    on = lie.compose(lie.inverse(poses[second[one]]), poses[j])
    claimed = lie.compose(back, lie.compose(claim[one], on))
    information = np.asarray(graph.information)
    return replace(
        graph,
        i=np.concatenate([graph.i, i]),
        j=np.concatenate([graph.j, j]),
        measured=np.concatenate([graph.measured, claimed]),
        information=np.concatenate([information, information[rng.choice(true, count)]]),
        robust=np.concatenate([graph.robust, np.ones(count, bool)]),
    )


def _directions(rng, count, size):
    out = rng.normal(size=(count, size))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def positions(poses: Float[Array | np.ndarray, "N P"], group: str) -> Float[np.ndarray, "N D"]:
    """Translations of poses."""
    return np.asarray(poses)[:, :2] if group == "se2" else np.asarray(poses)[:, 4:]


def error_m(poses: Float[Array | np.ndarray, "N P"], truth: Float[Array | np.ndarray, "N P"], group: str) -> float:
    """Root mean square distance of positions after the best rigid motion."""
    a, b = positions(poses, group), positions(truth, group)
    rotation, translation = kabsch(a, b, np.ones(len(a)))
    return float(np.sqrt(np.mean(np.sum((a @ np.asarray(rotation).T + np.asarray(translation) - b) ** 2, 1))))


def false_loops(
    paths: list[Path],
    *,
    shares: tuple[float, ...] = (0.0, 0.2, 0.5),
    seeds: int = 5,
    group: int = 1,
    kernels: tuple[str, ...],
) -> Iterator[dict[str, Any]]:
    """Two rows per graph and share, the median error of every kernel against either clean solution, from odometry."""
    for path in paths:
        graph = poses_alone(read_g2o(path)[0])
        if not loops_of(graph).any():
            continue
        graph = replace(graph, poses=init.odometry(graph), robust=loops_of(graph))
        clean = {"L2": solve(graph, kernel="none").poses}
        clean["Cauchy"] = solve(replace(graph, robust=np.ones(len(graph.i), bool))).poses
        right = replace(graph, poses=clean["L2"])
        for share in shares:
            errors: dict[tuple[str, str], list[float]] = {}
            for seed in range(seeds if share else 1):
                spoilt = replace(add_false_loops(right, share, seed=seed, group=group), poses=graph.poses)
                for kernel in kernels:
                    poses = solve(spoilt, kernel=kernel).poses
                    for name, truth in clean.items():
                        errors.setdefault((name, kernel), []).append(error_m(poses, truth, graph.group))
            for name in clean:
                row = {"graph": path.stem, "false": f"{share:.0%}", "against": f"clean {name}"}
                yield row | {f"{kernel}, m": median(errors[name, kernel]) for kernel in kernels}
