"""Which linear solver a graph gets.

A sparse factor on the host is the fastest on a CPU, for one graph as for a batch. On other devices elimination in pure
JAX keeps the numbers there, as long as the loops leave a small core.
"""

import hashlib
import importlib.util
from collections import OrderedDict
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.posegraph import elimination, sparse
from ebjax.posegraph.assembly import Pattern, System
from ebjax.posegraph.gauge import Gauge, anchored, gauge
from ebjax.posegraph.graph import PoseGraph

SOLVERS = ("auto", "elimination", "qdldl", "supernodal", "cholmod")
LARGEST_CORE = 400
WORTH_DENSE = {"cholmod": 40.0, "supernodal": 100.0}  # fill from which dense blocks are faster than qdldl
_STRUCTURES: OrderedDict[bytes, "Structure"] = OrderedDict()
_KEPT = 32


class Structure(NamedTuple):
    """The symbolic part of a graph's solve: where blocks go, the linear solver's plan, and `fixed` with the gauge.

    `held` are numbers of tangents that stay zero, as those of a landmark's rotation; None where there are none. No plan
    is there in programs that leave the linear solve to the host.
    """

    pattern: Pattern
    plan: elimination.Elimination | sparse.SparsePlan | None
    fixed: Bool[Array | np.ndarray, " N"]
    held: Bool[Array | np.ndarray, "N d"] | None = None

    @property
    def free(self) -> Bool[Array, " N"] | Bool[Array, "N d"]:
        """Rows that move, or where some move in part, the numbers of their tangents."""
        fixed = jnp.asarray(self.fixed)
        return ~fixed if self.held is None else ~(fixed[:, None] | jnp.asarray(self.held))


def analyse(graph: PoseGraph, solver: str = "auto", *, look: bool = False) -> Structure:
    """Chooses and prepares the linear solver; the answer is remembered per structure. Host code.

    Args:
      graph: its `i`, `j`, `fixed` must be concrete (not traced), and so must all be where there are landmarks or
        positions (`ebjax.posegraph.gauge`); else the other fields may be anything.
      solver: "elimination", "qdldl", "supernodal", "cholmod", or "auto": on a GPU or TPU elimination if its dense core
        has at most `LARGEST_CORE` unknowns; else, where there is much fill, CHOLMOD if it is installed, or supernodal;
        else qdldl.
      look: whether to look at the information for what it leaves undetermined; else, unless there are landmarks or
        positions, every edge is taken to measure all of a pose.

    Raises:
      ValueError: unknown solver, one that is not installed, traced edges, or rows that the edges leave undetermined.
    """
    if solver not in SOLVERS:
        raise ValueError(f"solver {solver!r} is unknown; choose one of {', '.join(SOLVERS)}")
    if any(isinstance(x, jax.core.Tracer) for x in (graph.i, graph.j, graph.fixed)):
        raise ValueError(
            "the graph's edges are traced; call analyse(graph) outside jit and pass its result as structure="
        )
    i, j, fixed = (np.ascontiguousarray(x) for x in (graph.i, graph.j, graph.fixed))
    if len(i) and (min(i.min(), j.min()) < 0 or max(i.max(), j.max()) >= len(fixed)):
        raise ValueError(f"an edge names a pose outside 0 to {len(fixed) - 1}; renumber i and j by row")
    look = look or graph.position is not None or graph.landmark is not None
    settled = gauge(graph) if look else Gauge(anchored(fixed, i, j), None, np.zeros(0, int))
    digest = hashlib.sha1(f"{solver} {graph.group} {i.dtype} {len(i)}".encode())
    for x in (i, j, settled.fixed, b"" if settled.held is None else settled.held):
        digest.update(bytes(x))
    key = digest.digest()
    structure = _STRUCTURES.pop(key, None) or _analyse(replace(graph, fixed=settled.fixed), solver, settled.held)
    _STRUCTURES[key] = structure
    if len(_STRUCTURES) > _KEPT:
        _STRUCTURES.popitem(last=False)
    return structure


def _analyse(graph, solver, held):
    if solver == "elimination" or (solver == "auto" and jax.default_backend() != "cpu"):
        pattern, plan = elimination.analyse(graph)
        if solver == "elimination" or len(plan.core) * graph.lie.dim <= LARGEST_CORE:
            return Structure(pattern, plan, graph.fixed, held)
    has_cholmod = importlib.util.find_spec("cvxopt") is not None
    if solver == "cholmod" and not has_cholmod:
        raise ValueError('solver cholmod is not installed; run: pip install "ebjax[cholmod]"')
    if solver == "auto":
        fill, dense = sparse.fill(graph), "cholmod" if has_cholmod else "supernodal"
        solver = dense if fill > WORTH_DENSE[dense] else "qdldl"
    return Structure(*sparse.analyse(graph, solver), graph.fixed, held)


def linear_solve(structure: Structure, system: System, right: Float[Array, "N d"]) -> Float[Array, "N d"]:
    """H^-1 right by the structure's solver."""
    module = elimination if isinstance(structure.plan, elimination.Elimination) else sparse
    return module.solve(structure.plan, system, right)
