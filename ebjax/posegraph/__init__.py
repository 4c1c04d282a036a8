"""Pose graphs over SE(2) and SE(3), with landmarks and priors: robust, sparse, differentiable."""

from ebjax.posegraph.consistency import consistent_set
from ebjax.posegraph.graph import PoseGraph, add_priors, make_graph
from ebjax.posegraph.levenberg import STATUS, Solution
from ebjax.posegraph.linear import analyse
from ebjax.posegraph.lm import solve
from ebjax.posegraph.marginals import marginals

__all__ = [
    "STATUS",
    "PoseGraph",
    "Solution",
    "add_priors",
    "analyse",
    "consistent_set",
    "make_graph",
    "marginals",
    "solve",
]
