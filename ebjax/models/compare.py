"""Compares arrays with those a reference file keeps, each under a tolerance of its own."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int, UInt8

RELATIVE = 1e-4  # of a raw map's largest absolute value: ten times the float32 noise of the published code


class Deviation(NamedTuple):
    """The largest absolute error of one array, and what it may be."""

    error: float
    tolerance: float


@dataclass(frozen=True)
class Image:
    """One image of the folder."""

    rgb: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "H W"]


class Comparison:
    """Collects the deviation of every array of one reference file.

    Attributes:
      reference: the file's arrays.
      deviations: one for each array compared so far.
    """

    def __init__(self, reference: Mapping[str, np.ndarray]):
        self.reference = reference
        self.deviations: dict[str, Deviation] = {}

    def array(self, key: str, got: ArrayLike, tolerance: float | None = None) -> None:
        """Compares a whole array; the tolerance defaults to RELATIVE times the reference's largest absolute value.

        An array of another shape, or one that is not finite, is infinitely wrong.
        """
        expected = np.asarray(self.reference[key], np.float64)
        got = np.asarray(got, np.float64)
        if tolerance is None:
            tolerance = RELATIVE * float(np.abs(expected).max(initial=0))
        error = float(np.abs(got - expected).max(initial=0)) if got.shape == expected.shape else np.inf
        self.deviations[key] = Deviation(error if np.isfinite(error) else np.inf, tolerance)

    def map(self, name: str, got: ArrayLike, tolerance: float | None = None) -> None:
        """Compares a map, height x width x channels, with every part the file keeps of it.

        The parts are `name__shape` (channels, height, width), `name__stride`, `name__sub` (every stride-th pixel) and
        the means `__chmean` (over pixels), `__locmean` (over channels), `__rowmean`, `__colmean`.
        """
        got = np.moveaxis(np.asarray(got, np.float64), -1, 0)
        stride = int(self.reference[f"{name}__stride"])
        sample = got[:, ::stride, ::stride]
        location = got.mean(0)
        if tolerance is None:
            tolerance = RELATIVE * float(np.abs(self.reference[f"{name}__sub"]).max())
        self.array(f"{name}__shape", np.array(got.shape), 0.0)
        self.array(f"{name}__stride", np.array(stride), 0.0)
        self.array(f"{name}__sub", sample, tolerance)
        means = {"chmean": got.mean((1, 2)), "locmean": location, "rowmean": location.mean(1)}
        for part, mean in {**means, "colmean": location.mean(0)}.items():
            if f"{name}__{part}" in self.reference:
                self.array(f"{name}__{part}", mean, tolerance)

    def record(self, key: str, error: float | int | np.number, tolerance: float) -> None:
        """Records the deviation of an array that was compared in a way of its own."""
        self.deviations[key] = Deviation(float(error), tolerance)

    def maps(self) -> list[str]:
        """The names of the maps the file keeps."""
        return [key.removesuffix("__shape") for key in self.reference if key.endswith("__shape")]


def match_points(
    reference: Float[np.ndarray, "N 2"], got: Float[np.ndarray, "M 2"], radius: float
) -> Int[np.ndarray, "P 2"]:
    """Pairs points one to one, each reference point with the nearest free one whose coordinates are within `radius`."""
    pairs, used = [], set()
    for i, point in enumerate(reference):
        distance = np.abs(got - point[None, :]).max(1) if len(got) else np.zeros(0)
        for j in np.argsort(distance, kind="stable")[:4].tolist():
            if distance[j] <= radius and j not in used:
                used.add(j)
                pairs.append((i, j))
                break
    return np.array(pairs, int).reshape(-1, 2)
