"""A pose graph as gtsam optimises it, from the same start to the same relative decrease."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ebjax.posegraph.graph import PoseGraph

RTOL, STEPS = 1e-9, 200


def gtsam_solver(graph: PoseGraph, kernel: str) -> Callable[[], tuple[float, int]]:
    """Builds the graph in gtsam; the answer optimises it and returns (cost, iterations).

    Raises:
      ValueError: gtsam is not installed.
    """
    try:
        import gtsam
    except ModuleNotFoundError:
        raise ValueError('the benchmark needs gtsam; run: pip install "ebjax[oracle]"') from None
    planar = graph.group == "se2"
    order = np.arange(3) if planar else np.array([3, 4, 5, 0, 1, 2])
    between = gtsam.BetweenFactorPose2 if planar else gtsam.BetweenFactorPose3
    hold = gtsam.NonlinearEqualityPose2 if planar else gtsam.NonlinearEqualityPose3
    noise, factors, start = gtsam.noiseModel, gtsam.NonlinearFactorGraph(), gtsam.Values()

    def pose(p):
        return gtsam.Pose2(*p) if planar else gtsam.Pose3(gtsam.Rot3.Quaternion(*p[:4]), p[4:])

    poses = [pose(p) for p in np.asarray(graph.poses, float)]
    for k, p in enumerate(poses):
        start.insert(k, p)
    edges = zip(*(np.asarray(x) for x in (graph.i, graph.j, graph.measured, graph.information)), strict=True)
    for i, j, measured, information in edges:
        model: Any = noise.Gaussian.Information(information[np.ix_(order, order)])
        if kernel == "cauchy":
            model = noise.Robust.Create(noise.mEstimator.Cauchy.Create(1.0), model)
        factors.add(between(int(i), int(j), pose(measured), model))
    factors.add(hold(0, poses[0]))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(STEPS)
    settings.setRelativeErrorTol(RTOL)

    def run():
        optimiser = gtsam.LevenbergMarquardtOptimizer(factors, start, settings)
        return 2 * factors.error(optimiser.optimize()), optimiser.iterations()

    return run
