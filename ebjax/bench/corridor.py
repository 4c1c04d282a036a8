"""A pose graph of any length: a corridor out and back, with closures between the two ways."""

from dataclasses import replace

import numpy as np

from ebjax.posegraph import init
from ebjax.posegraph.graph import PoseGraph, make_graph


def corridor(poses: int, loops: int, seed: int = 0) -> PoseGraph:
    """Out along a corridor that bends, and back: odometry with noise, closures between the two ways; SE(2).

    Information allows for three times the noise, as is usual; the poses start from odometry.
    """
    rng = np.random.default_rng(seed)
    half = poses // 2
    turn = 0.02 * np.sin(np.arange(half) / 40)
    steps = np.stack([np.full(half, 0.1), np.zeros(half), turn], 1)
    back = np.stack([np.full(poses - 1 - half, 0.1), np.zeros(poses - 1 - half), -turn[::-1][: poses - 1 - half]], 1)
    steps = np.concatenate([steps, back])
    steps[half - 1, 2] += np.pi
    first = np.sort(rng.choice(half - 2, loops, replace=False)) + 1
    second = 2 * half - first
    second = np.minimum(second, poses - 1)
    i, j = np.concatenate([np.arange(poses - 1), first]), np.concatenate([np.arange(1, poses), second])
    start = make_graph(
        np.zeros((poses, 3)), i[: poses - 1], j[: poses - 1], steps, np.tile(np.eye(3), (poses - 1, 1, 1))
    )
    truth = init.to_matrices(init.odometry(start))
    relative = init.from_matrices(np.linalg.inv(truth[i]) @ truth[j])
    sigma = np.concatenate([np.tile([0.002, 0.001, 0.0005], (poses - 1, 1)), np.tile([0.02, 0.02, 0.005], (loops, 1))])
    measured = relative + sigma * rng.normal(size=sigma.shape)
    information = np.eye(3)[None] / (3 * sigma[:, :, None]) ** 2
    graph = make_graph(np.zeros((poses, 3)), i, j, measured, information)
    return replace(graph, poses=init.odometry(graph))
