"""What SQLite says of a map's file, in one line that names the file and what to do."""

import contextlib
import errno
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from ebjax.io.map_file.lock import Locked
from ebjax.io.map_file.schema import DamagedRowsError
from ebjax.io.one_line import one_line

REPAIR = "save what can be read into a new file with --repair"


class Damaged(ValueError):  # noqa: N818 - the state of a file
    """Bytes of a map's file are not those that were written."""


@contextlib.contextmanager
def sqlite_faults(path: Path) -> Iterator[None]:
    """Turns errors of SQLite inside the block into ours.

    Raises:
      Damaged: a page or a row is damaged.
      OSError: the disk is full or fails, another program holds the file, or it may not be written.
      ValueError: a number or a name that SQLite cannot hold; a map that was closed.
    """
    try:
        yield
    except DamagedRowsError as fault:
        raise Damaged(f"{path}: {fault}; {REPAIR}") from None
    except sqlite3.ProgrammingError as error:
        raise ValueError(f"{path}: {one_line(error)}; open the map anew") from None
    except sqlite3.DataError as error:
        raise ValueError(f"{path}: {one_line(error)}; a row holds at most 1 GB") from None
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise translated(path, error) from None
    except UnicodeEncodeError as error:
        raise ValueError(f"{path}: the name {ascii(error.object)[:80]} is not text; rename the file") from None
    except OverflowError:
        raise ValueError(f"{path}: a number of more than 64 bits; ids and counts are below 2^63") from None


def name_of(error: Exception) -> str:
    """SQLite's name of an error: "SQLITE_FULL"; "" where the error is Python's own."""
    return str(getattr(error, "sqlite_errorname", ""))


def translated(path: Path, error: Exception) -> OSError | ValueError:
    """The error that a user sees for one of SQLite's."""
    name, said = name_of(error), one_line(error)
    if name == "SQLITE_FULL":
        return OSError(errno.ENOSPC, f"the disk is full; make room and go on: {KEPT}", str(path))
    if name.startswith("SQLITE_IOERR"):
        return OSError(
            errno.EIO, f"the disk cannot be read or written ({said}); make room or check it: {KEPT}", str(path)
        )
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return Locked(f"{path}: another program has it open ({said}); close it and try again")
    if name == "SQLITE_READONLY_ROLLBACK":
        return OSError(f"{path}: was not closed; open it once for writing, with its -journal file beside it")
    if name.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM")):
        return OSError(f"{path}: cannot be opened or written ({said}); check the rights on it and on its folder")
    return Damaged(f"{path}: damaged ({said}); {REPAIR}")


KEPT = "what was acknowledged is kept"
