"""A kind of calibration file: how it is recognised by its content, and how it is read."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.document import Document
from ebjax.io.calibration.values import shown


@dataclass(frozen=True)
class Kind:
    """One kind.

    Attributes:
      name: in words.
      recognises: whether a document looks like this kind, faulty or not.
      read: makes the calibration, or raises ValueError.
      several: whether one file can hold several cameras.
    """

    name: str
    recognises: Callable[[Document], bool]
    read: Callable[[Document], Calibration]
    several: bool = False


def choose(
    path: Path, names: Sequence[str], asked: str | None, default: str | None = None
) -> tuple[str, tuple[str, ...]]:
    """The camera that is asked for, by its name or the end of it; else the default, with a note of the others.

    Raises:
      ValueError: no camera, or more than one, has that name; lists those there are.
    """
    if asked is None:
        name = default or names[0]
        others = ", ".join(shown(other) for other in names if other != name)
        return name, (f"{path}: camera {shown(name)} is used; the file also has {others}",) if others else ()
    if not any(names):
        raise ValueError(f"{path}: one camera without a name; do not name a camera ({asked!r})")
    wanted = asked.strip().lower()
    found = [name for name in names if name.lower() == wanted] or [n for n in names if n.lower().endswith(wanted)]
    if len(found) != 1 or not wanted:
        raise ValueError(
            f"{path}: {len(found) or 'no'} cameras named {asked!r}; give one of {', '.join(map(shown, names))}"
        )
    return found[0], ()
