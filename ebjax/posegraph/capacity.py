"""Room for graphs of many sizes: inert rows and edges fill a graph up to a capacity, whose programs it shares.

An inert row is fixed and joins nothing. An inert edge goes from the first row to itself and has no information. Both
add exact zeros. Host code.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from ebjax.posegraph.assembly import Pattern
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.sparse import SparsePlan

Kind = Literal["rows", "edges", "closures"]


class Room(NamedTuple):
    """Smallest capacities."""

    rows: int = 256
    edges: int = 256
    closures: int = 64


_LEAST = Room()
_ROOM = ContextVar("room", default=_LEAST)


@contextmanager
def room_for(rows: int = 0, edges: int = 0, closures: int = 0) -> Iterator[None]:
    """Inside, capacities are at least those of a graph of this size: programs can be made before there is one."""
    token = _ROOM.set(Room(capacity(rows, "rows"), capacity(edges, "edges"), capacity(closures, "closures")))
    try:
        yield
    finally:
        _ROOM.reset(token)


def capacity(count: int, kind: Kind) -> int:
    """The smallest capacity of the kind, doubled until it holds `count`."""
    least = getattr(_ROOM.get(), kind)
    return least << max(0, -(-count // least) - 1).bit_length()


def capacities(rows: int, edges: int) -> tuple[int, int]:
    """Of a graph: at least two edges for a row, so that both mostly grow together."""
    room = capacity(rows, "rows")
    return room, max(2 * room, capacity(edges, "edges"))


def filled(x: Array | np.ndarray, length: int, value: Any = 0) -> np.ndarray:
    """`x` with rows of `value` behind it, `length` in all."""
    x = np.asarray(x)
    out = np.empty((length, *x.shape[1:]), x.dtype)
    out[: len(x)], out[len(x) :] = x, value
    return out


def concrete(*trees: Any) -> bool:
    """Whether nothing is traced: no array in `trees`, and no program around."""
    around = jax.device_put(np.zeros(()))
    return not any(isinstance(x, jax.core.Tracer) for x in [around, *jax.tree.leaves(trees)])


def on_host(structure: Structure, *trees: Any) -> bool:
    """Whether the host can make the linear solves: a sparse factor is planned and nothing is traced."""
    return isinstance(structure.plan, SparsePlan) and concrete(structure, trees)


def at_capacity(graph: PoseGraph) -> PoseGraph:
    """The graph, filled up, as its edges see it: landmarks and the world are rows like others."""
    rows, edges = capacities(len(graph.poses), len(graph.i))
    return PoseGraph(
        poses=filled(graph.poses, rows, graph.lie.identity),
        i=filled(np.asarray(graph.i, np.int32), edges),
        j=filled(np.asarray(graph.j, np.int32), edges),
        measured=filled(graph.measured, edges, graph.lie.identity),
        information=filled(graph.information, edges),
        robust=filled(graph.robust, edges, False),
        fixed=filled(graph.fixed, rows, True),
        group=graph.group,
        position=None if graph.position is None else filled(graph.position, edges, False),
    )


def structure_at_capacity(structure: Structure) -> Structure:
    """The structure of the graph filled up, without its plan."""
    pattern = structure.pattern
    rows, edges = capacities(len(structure.fixed), len(pattern.slot))
    slots = max(len(pattern.first), edges)
    slot = np.asarray(pattern.slot)
    nowhere = slot >= len(pattern.first)
    flipped = np.zeros(len(slot), bool) if pattern.flipped is None else pattern.flipped
    return Structure(
        Pattern(
            filled(np.where(nowhere, slots, slot).astype(np.int32), edges, slots),
            filled(flipped, edges, False),
            *(filled(np.asarray(x, np.int32), slots) for x in (pattern.first, pattern.second)),
        ),
        None,
        filled(structure.fixed, rows, True),
        None if structure.held is None else filled(structure.held, rows, False),
    )
