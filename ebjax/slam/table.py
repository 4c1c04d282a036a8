"""Columns that grow row by row without being copied each time."""

from typing import Any

import numpy as np


class Table:
    """Rows of named columns.

    Args:
      columns: of each its dtype, or (dtype, shape of an entry).
    """

    def __init__(self, **columns: Any):
        kinds = {name: kind if isinstance(kind, tuple) else (kind, ()) for name, kind in columns.items()}
        self._room = {name: np.zeros((64, *shape), dtype) for name, (dtype, shape) in kinds.items()}
        self._count = 0

    def __len__(self) -> int:
        """Returns the number of rows."""
        return self._count

    def __getattr__(self, name: str) -> np.ndarray:
        """A column, up to now; a view that a later row may leave behind."""
        room = self.__dict__["_room"]
        if name not in room:
            raise AttributeError(name)
        return room[name][: self._count]

    def append(self, **row: Any) -> int:
        """Adds one row; returns which it is."""
        for name, value in row.items():
            if self._count == len(self._room[name]):
                self._room[name] = np.concatenate([self._room[name], np.zeros_like(self._room[name])])
            self._room[name][self._count] = value
        self._count += 1
        return self._count - 1
