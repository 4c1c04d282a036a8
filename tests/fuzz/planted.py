"""Readers with the faults that the harness must find: they show that it does."""

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np


def _raise(error: BaseException) -> None:
    raise error


def _endless() -> None:
    while True:
        pass


def _deep(n: int = 0) -> None:
    _deep(n + 1)


PLANTED: dict[str, Callable[[Path], Sequence[Callable[[], object]]]] = {
    "planted-good": lambda path: [lambda: 1],
    "planted-value": lambda path: [lambda: _raise(ValueError(f"{path}: not a number; correct it"))],
    "planted-os": lambda path: [(path / "none").read_bytes],
    "planted-key": lambda path: [lambda: {}["x"]],
    "planted-lines": lambda path: [lambda: _raise(ValueError(f"{path}: one\ntwo"))],
    "planted-silent": lambda path: [lambda: _raise(ValueError())],
    "planted-repr": lambda path: [lambda: _raise(ValueError(f"{path}: {object()}"))],
    "planted-unnamed": lambda path: [lambda: _raise(ValueError("wrong"))],
    "planted-warning": lambda path: [lambda: warnings.warn("overflow", RuntimeWarning, stacklevel=1)],
    "planted-deep": lambda path: [_deep],
    "planted-crash": lambda path: [os.abort],
    "planted-endless": lambda path: [_endless],
    "planted-large": lambda path: [lambda: bytes(3 << 30)],
    "planted-resident": lambda path: [lambda: np.ones(1100 << 17).sum()],
}
