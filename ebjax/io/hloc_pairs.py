"""pairs.txt of hloc: two image names a line, separated by a blank, which images are to be matched."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ebjax.io.atomic import whole_file


def write_pairs(
    path: str | Path,
    names: Sequence[str],
    closures: Int[np.ndarray, "K 2"],
    *,
    successive: bool = False,
    sessions: Int[np.ndarray, " N"] | None = None,
) -> int:
    """Writes each pair of images once, closures first.

    Args:
      path: the file.
      names: of the images of N keyframes, relative to hloc's folder of images.
      closures: rows of `names` that a loop closure joins.
      successive: pairs of keyframes that follow on each other too, as mapping needs them.
      sessions: of each keyframe; keyframes of two sessions do not follow on each other. None: all are of one.

    Returns:
      How many pairs were written.

    Raises:
      ValueError: an image of a pair has no name, one with a blank in it, or the name of another image; names it.
      OSError: the file cannot be written.
    """
    pairs = closures.tolist()
    if successive:
        one = np.zeros(len(names), int) if sessions is None else sessions
        follows = np.flatnonzero(one[1:] == one[:-1])
        pairs += np.stack([follows, follows + 1], 1).tolist()
    unique: dict[frozenset[int], list[int]] = {}
    for pair in pairs:
        unique.setdefault(frozenset(pair), pair)
    check_names(path, names, set().union(*unique))
    with whole_file(path) as file:
        file.writelines(f"{names[i]} {names[j]}\n" for i, j in unique.values())
    return len(unique)


def check_names(path: str | Path, names: Sequence[str], rows: set[int]) -> None:
    """Refuses names that hloc would not read back as they are."""
    first: dict[str, int] = {}
    for row in sorted(rows):
        name = names[row]
        if name.split() != [name]:
            why = "has no name" if not name else f"is called {name!r}, and hloc splits names at blanks"
            raise ValueError(
                f"{path}: the image of keyframe {row} {why}; rename the images without blanks; of a bag, write them "
                "as files with `python -m ebjax.logs LOG --out FOLDER` and run that folder"
            )
        if (other := first.setdefault(name, row)) != row:
            raise ValueError(
                f"{path}: the images of keyframes {other} and {row} are both called {name!r}, which hloc cannot tell "
                "apart; give each session a folder of its own"
            )
