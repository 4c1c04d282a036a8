"""Arrays that were costly to compute, kept between runs in HDF5, keyed by image and by everything else they depend on.

    FOLDER/MODEL-SETTINGS/DIGEST.h5      a shard: one group a key, in it one dataset an array

A shard is written whole and never changed; its name is the digest of its content, so one that was cut short or altered
at any byte is found before HDF5 reads it, removed, and computed again. A process that is killed loses what it had not
written yet, seconds of work; several processes may write to one folder.
"""

import contextlib
import hashlib
import io
import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import ebjax
from ebjax.io.atomic import whole_file

FORMAT = 1
SHARD_BYTES = 2**26
SHARD_S = 5.0
STALE_S = 3600.0


def content_key(path: str | Path) -> str | None:
    """The file's name and the digest of its content, or None if it cannot be read."""
    try:
        return f"{Path(path).name} {digest(Path(path).read_bytes())}"
    except OSError:
        return None


def digest(*parts: bytes | np.ndarray) -> str:
    """Of bytes and of arrays with their shapes and types, 32 hexadecimal digits."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            total.update(f"{part.dtype.str} {part.shape} ".encode())
            part = np.ascontiguousarray(part).tobytes()
        total.update(part)
    return total.hexdigest()[:32]


def open_cache(
    folder: str | Path, model: str, weights: Path | None, *, shard_s: float | int = SHARD_S, **settings: Any
) -> "Cache":
    """Opens the cache of a model; shards found damaged are named on stderr.

    Args:
      folder: of all caches.
      model: what computes the arrays.
      weights: its file, if it has one: the content counts, not the name.
      shard_s: as in `Cache`.
      settings: as in `Cache`; this version of ebjax is one.

    Raises:
      OSError: the folder or the weights cannot be read.
    """
    seen = None if weights is None else digest(weights.read_bytes())
    cache = Cache(folder, model, {"ebjax": ebjax.__version__, "weights": seen, **settings}, shard_s=shard_s)
    for shard in cache.damaged:
        print(f"{shard}: damaged; it is left out and made again", file=sys.stderr)
    return cache


class Cache:
    """A folder of shards.

    Attributes:
      folder: of these settings.
      damaged: shards that were found damaged and removed.
    """

    def __init__(self, folder: str | Path, model: str, settings: Mapping[str, Any], *, shard_s: float | int = SHARD_S):
        """Opens the cache and checks every shard.

        Args:
          folder: of all caches.
          model: what computes the arrays; part of the folder's name.
          settings: all else they depend on but the key; plain values.
          shard_s: at most so much work waits to be written, s.

        Raises:
          OSError: the folder cannot be read or made.
        """
        self._settings = json.dumps({"format": FORMAT, "model": model, **settings}, sort_keys=True)
        self.folder = Path(folder) / f"{model}-{digest(self._settings.encode())[:16]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.damaged: list[Path] = []
        self._shard_s, self._written = shard_s, time.monotonic()
        self._waiting: dict[str, dict[str, np.ndarray]] = {}
        self._where: dict[str, Path] = {}
        for path in sorted(self.folder.glob("*.h5")):
            if self._is_whole(path):
                with h5py.File(path, "r") as file:
                    self._where |= dict.fromkeys(file, path)
            else:
                path.unlink(missing_ok=True)
                self.damaged.append(path)
        for path in self.folder.glob(".*.partial"):  # of a process that was killed long ago
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > STALE_S:
                    path.unlink()

    def _is_whole(self, path: Path) -> bool:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:32] == path.stem

    def __contains__(self, key: str) -> bool:
        """Whether `get` would find something."""
        return key in self._waiting or key in self._where

    def __len__(self) -> int:
        """The number of keys."""
        return len(self._waiting.keys() | self._where.keys())

    def get(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays of a key, or None."""
        if key in self._waiting:
            return self._waiting[key]
        if key not in self._where:
            return None
        with h5py.File(self._where[key], "r") as file:
            return {name: data[()] for name, data in file[key].items()}

    def put(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps arrays; they are on the disk after `shard_s` seconds, SHARD_BYTES or `flush`, whichever comes first."""
        if "/" in key or key in ("", "."):
            raise ValueError(f"{key!r} cannot be the name of a group in HDF5")
        self._waiting[key] = {name: np.asarray(array) for name, array in arrays.items()}
        size = sum(array.nbytes for kept in self._waiting.values() for array in kept.values())
        if size >= SHARD_BYTES or time.monotonic() - self._written >= self._shard_s:
            self.flush()

    def flush(self) -> None:
        """Writes what waits as one shard."""
        if self._waiting:
            content = io.BytesIO()
            with h5py.File(content, "w") as file:
                file.attrs["settings"] = self._settings
                for key, arrays in self._waiting.items():
                    group = file.create_group(key)
                    for name, array in arrays.items():
                        group[name] = array
            path = self.folder / f"{digest(content.getvalue())}.h5"
            with whole_file(path, "wb") as out:
                out.write(content.getvalue())
            self._where |= dict.fromkeys(self._waiting, path)
            self._waiting = {}
        self._written = time.monotonic()

    def remember(self, compute: Callable[..., Mapping[str, Any]]) -> Callable[..., Mapping[str, np.ndarray]]:
        """A function of arrays that looks its result up under their digest, and computes and keeps it if need be."""

        def recalled(*arrays: Any) -> Mapping[str, np.ndarray]:
            return self.recall(digest(*map(np.asarray, arrays)), lambda: compute(*arrays))

        return recalled

    def recall(self, key: str | None, compute: Callable[[], Mapping[str, np.ndarray]]) -> Mapping[str, np.ndarray]:
        """The arrays of a key, computed and kept if they are not there; without a key, computed."""
        if key is None:
            return compute()
        kept = self.get(key)
        if kept is None:
            kept = {name: np.asarray(array) for name, array in compute().items()}
            self.put(key, kept)
        return kept
