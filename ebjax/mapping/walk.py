"""The path of a finished session as arrays."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from ebjax.odometry.chain import Edges
from ebjax.slam.path import Path

EDGES = "edges"


def packed_walk(path: Path) -> dict[str, np.ndarray]:
    """As `put_state` takes it."""
    plain = {field.name: getattr(path, field.name) for field in dataclasses.fields(path) if field.name != EDGES}
    return plain | {f"{EDGES}.{name}": np.asarray(value) for name, value in path.edges._asdict().items()}


def unpacked_walk(kept: Mapping[str, np.ndarray]) -> Path:
    """The same again."""
    edges = Edges(*(kept[f"{EDGES}.{name}"] for name in Edges._fields))
    return Path(edges=edges, **{name: value for name, value in kept.items() if not name.startswith(f"{EDGES}.")})
