"""Places of all that was seen, looked up in two stages, in both directions; grows in chunks of one shape.

First random projections of every vector by the query's and by that of the query turned by pi: the PROJECTED best of
each direction stay. Then the exact cosines of these, and of the `top` best of each direction the
ranking of `search`: the mean of that cosine and of the correlation of their maps. What comes out depends on the places
and their order alone, never on how they came in.

A place takes 4 PROJECTED_LENGTH bytes and one a component of its vector: 6 kB by fixed words, 60 MB for 10,000 places.
Of maps only the spectra of those that were compared last are kept (`held_spectra`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ebjax.places.fixed_words import FixedWords
from ebjax.places.held_spectra import HeldSpectra, MapsOf
from ebjax.places.pairwise import correlate_rows, spectrum
from ebjax.places.place import Place, turned_map

CHUNK = 4096
PROJECTED_LENGTH = 512
PROJECTED = 400
EXACT = 1024
"""Products of two eight-bit numbers whose sum float32 holds without rounding: 1024 * 127^2 < 2^24."""
Comparable = Bool[np.ndarray, "N"] | int
"""Which rows may be compared, or how many of the first."""


class Candidates(NamedTuple):
    """Rows, best first: seen from the opposite side or not, distance (1 - score), shift of the maps in cells.

    The query's map at x + shift lies on the reference's at x; that of an opposing reference is turned by pi.
    """

    j: Int[np.ndarray, "K"]
    opposing: Bool[np.ndarray, "K"]
    distance: Float[np.ndarray, "K"]
    shift: Int[np.ndarray, "K 2"]


class PlaceIndex:
    """See above.

    Args:
      words: that the places are made by, where they have maps; None ranks by cosine alone.
      maps_of: reads the maps of rows.
    """

    def __init__(self, words: FixedWords | None = None, maps_of: MapsOf | None = None):
        if (words is None) != (maps_of is None):
            raise ValueError("an index needs both words and maps_of to correlate maps, or neither")
        self._words, self._spectra = words, None if maps_of is None else HeldSpectra(maps_of)
        self._count = 0
        self._projected: list[np.ndarray] = []
        self._vectors: list[np.ndarray] = []
        self._norms: list[np.ndarray] = []
        self._projection: Projection | None = None
        self._shape: tuple[int, ...] | None = None

    def __len__(self) -> int:
        return self._count

    def __repr__(self) -> str:
        return f"PlaceIndex({self._count} places, {self.bytes_held / 1e6:.1f} MB)"

    @property
    def bytes_held(self) -> int:
        """Of the places, not of chunks that are still empty."""
        length = 0 if self._projection is None else self._projection.length
        return self._count * (4 * PROJECTED_LENGTH + 8 + length)

    def add(self, place: Place) -> int:
        """The row of a new place.

        Raises:
          ValueError: its vector or map has another shape than those before.
        """
        self._check(place)
        chunk, row = divmod(self._count, CHUNK)
        if chunk == len(self._projected):
            # Pages of memory that are never written cost nothing.
            self._projected.append(np.zeros((CHUNK, PROJECTED_LENGTH), np.float32))
            self._vectors.append(np.zeros((CHUNK, len(place.vector)), np.int8))
            self._norms.append(np.ones(CHUNK))
        assert self._projection is not None
        self._projected[chunk][row] = self._projection(place.vector)
        self._vectors[chunk][row] = place.vector
        self._norms[chunk][row] = _norm(place.vector)
        self._count += 1
        return self._count - 1

    def query(self, place: Place, same: Comparable, opposing: Comparable, top: int = 10) -> Candidates:
        """The best of both directions, ranked together; only such as may be compared.

        Args:
          place: as of `add`; it need not be in the index.
          same: rows that may be compared in the same direction.
          opposing: and from the opposite side.
          top: of each direction.
        """
        self._check(place)
        found = self._best(place, (self._mask(same), self._mask(opposing)), top)
        rows = np.concatenate([j for j, _ in found])
        cosine = np.concatenate([score for _, score in found])
        way = np.repeat([False, True], [len(j) for j, _ in found])
        score, shift = cosine, np.zeros((len(rows), 2), np.int32)
        if self._spectra is not None and len(rows):
            correlation, shift = self._correlate(place, rows, way, top)
            score = (cosine + correlation) / 2
        order = np.lexsort((rows, way, -score))
        return Candidates(rows[order], way[order], (1 - score)[order], shift[order])

    def _best(
        self, place: Place, masks: tuple[Bool[np.ndarray, "N"], Bool[np.ndarray, "N"]], top: int
    ) -> list[tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k"]]]:
        """Of each direction the `top` rows of largest cosine, and these."""
        if not any(mask.any() for mask in masks):
            return [(np.zeros(0, np.int64), np.zeros(0))] * 2
        assert self._projection is not None
        ways = place.vector, place.turned
        found = []
        for vector, mask in zip(ways, masks, strict=True):
            ours = self._projection(vector)
            scores = np.concatenate([products(chunk, ours) for chunk in self._filled()])
            rows = _largest(np.where(mask, scores, -np.inf), max(PROJECTED, top))
            rows = rows[mask[rows]]
            cosine = self._cosine(vector, rows)
            order = np.lexsort((rows, -cosine))[:top]
            found.append((rows[order], cosine[order]))
        return found

    def _filled(self) -> Iterator[Float[np.ndarray, "n P"]]:
        for k, chunk in enumerate(self._projected):
            yield chunk[: self._count - k * CHUNK]

    def _cosine(self, vector: Int8[np.ndarray, "V"], rows: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Exact: sums of EXACT products of integers at a time."""
        chunks, within = np.divmod(rows, CHUNK)
        theirs, norms = np.empty((len(rows), len(vector)), np.int8), np.empty(len(rows))
        for chunk in np.unique(chunks):
            some = chunks == chunk
            theirs[some], norms[some] = self._vectors[chunk][within[some]], self._norms[chunk][within[some]]
        parts = range(0, len(vector), EXACT)
        sums = [products(theirs[:, k : k + EXACT], vector[k : k + EXACT]) for k in parts]
        return np.sum(sums, 0, dtype=np.float64) / (norms * _norm(vector))

    def _correlate(
        self, place: Place, rows: Int[np.ndarray, "K"], way: Bool[np.ndarray, "K"], top: int
    ) -> tuple[Float[np.ndarray, "K"], Int[np.ndarray, "K 2"]]:
        """By one program whose shapes depend on `top` alone. An opposing query is turned, not its references."""
        assert self._spectra is not None and self._words is not None
        assert place.map is not None and place.weight is not None
        slots = self._spectra.slots(rows)
        assert self._spectra.held is not None
        asked, column = np.zeros((2, top), np.int64), np.where(way, np.cumsum(way), np.cumsum(~way)) - 1
        asked[way.astype(int), column] = slots
        straight = spectrum(place.map, place.weight)
        other = spectrum(turned_map(place.map, self._words), place.weight[::-1, ::-1])
        found = jax.tree.map(np.asarray, correlate_rows(straight, other, self._spectra.held, asked))
        score, shift = (part[way.astype(int), column] for part in found)
        return score.astype(np.float64), (shift * np.where(way, -1, 1)[:, None]).astype(np.int32)

    def _mask(self, which: Comparable) -> Bool[np.ndarray, "N"]:
        if isinstance(which, np.ndarray):
            if which.shape != (self._count,):
                raise ValueError(f"a mask of {which.shape} over an index of {self._count} places")
            return which
        return np.arange(self._count) < which

    def _check(self, place: Place) -> None:
        shape = place.vector.shape if place.map is None else (*place.vector.shape, *place.map.shape)
        if self._shape is None:
            self._shape, self._projection = shape, Projection(len(place.vector))
        if shape != self._shape:
            raise ValueError(
                f"a place of {_told(shape)} beside places of {_told(self._shape)}: look at a floor of the same size "
                "with the same descriptor"
            )
        if self._spectra is not None and place.map is None:
            raise ValueError("this place has no map to correlate; make the index without maps_of")


class Projection:
    """A fixed random projection to PROJECTED_LENGTH numbers of unit scale: shuffled, signed and summed in turn.

    Inner products of vectors keep their value, with a variance of 1 / PROJECTED_LENGTH (Achlioptas 2003; Charikar, Chen
    and Farach-Colton 2002). Sums of integers: no bit depends on the order in which a computer adds.

    Args:
      length: of the vectors.
    """

    def __init__(self, length: int):
        rng = np.random.default_rng(0)
        padded = -(-length // PROJECTED_LENGTH) * PROJECTED_LENGTH
        self.length = length
        self._order = rng.permutation(padded)
        self._sign = rng.choice(np.array([-1, 1], np.int8), padded)
        self._padding = padded - length

    def __call__(self, vector: Int8[np.ndarray, "V"]) -> Float[np.ndarray, "P"]:
        """Of the vector at unit length."""
        padded = np.concatenate([vector, np.zeros(self._padding, np.int8)]) * self._sign
        sums = padded[self._order].reshape(-1, PROJECTED_LENGTH).sum(0, dtype=np.int64)
        return (sums / _norm(vector)).astype(np.float32)


def products(
    rows: Float[np.ndarray, "n P"] | Int8[np.ndarray, "n P"], vector: Float[np.ndarray, "P"] | Int8[np.ndarray, "P"]
) -> Float[np.ndarray, "n"]:
    """Of every row with the vector, in float32, each by itself; threads of a BLAS would wait on the network's."""
    return np.einsum("ij,j->i", rows.astype(np.float32, copy=False), vector.astype(np.float32, copy=False))


def _norm(vector: Int8[np.ndarray, "V"]) -> float:
    wide = vector.astype(np.int64)
    return max(float(np.sqrt(wide @ wide)), 1.0)


def _largest(scores: Float[np.ndarray, "N"], count: int) -> Int[np.ndarray, "k"]:
    """The rows of the largest scores, in no order."""
    return np.arange(len(scores)) if len(scores) <= count else np.argpartition(-scores, count)[:count]


def _told(shape: tuple[int, ...]) -> str:
    vector, *cells = shape
    return f"{vector} numbers" + (f" and a map of {cells[0]}x{cells[1]} cells" if cells else "")
