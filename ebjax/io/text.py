"""Text tables: data lines with their line numbers, plain or gzip, and errors that name file and line."""

import gzip
import itertools
import math
import zlib
from pathlib import Path


def read_text(path: str | Path) -> str:
    """Reads a UTF-8 text file, unpacking gzip by content; where only `path`.gz is there, that.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: damaged gzip, or not text.
    """
    path, packed = Path(path), Path(f"{path}.gz")
    content = (packed if packed.is_file() and not path.exists() else path).read_bytes()
    try:
        if content[:2] == b"\x1f\x8b":
            content = gzip.decompress(content)
        return content.decode("utf-8-sig")
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise ValueError(f"{path}: damaged gzip file; copy it again") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file; give a text table (or a .gz of one)") from None


def data_lines(path: str | Path) -> list[tuple[int, str]]:
    """Lists (line number, stripped line), without blank lines and `#` comments; numbers start at 1."""
    lines = enumerate(read_text(path).splitlines(), start=1)
    return [(number, line.strip()) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def floats(path: str | Path, number: int, fields: list[str]) -> list[float]:
    """Converts the fields of one line.

    Raises:
      ValueError: a field is not a finite number; names file and line.
    """
    values = []
    for field in fields:
        try:
            value = float(field)
        except ValueError:
            raise ValueError(f"{path} line {number}: {field!r} is not a number; correct or remove the line") from None
        if not math.isfinite(value):
            raise ValueError(f"{path} line {number}: {field} is not a finite number; correct or remove the line")
        values.append(value)
    return values


def check_increasing(path: str | Path, stamps: list[tuple[int, float]], *, repeats: bool = False) -> None:
    """Checks that (line number, timestamp) rows increase, strictly unless `repeats`.

    Raises:
      ValueError: unsorted or duplicate timestamps; names file, line and remedy.
    """
    for (before_number, before), (number, stamp) in itertools.pairwise(stamps):
        if stamp == before and not repeats:
            raise ValueError(
                f"{path} line {number}: timestamp {stamp:.6f} is also line {before_number}'s; remove one of the two"
            )
        if stamp < before:
            raise ValueError(
                f"{path} line {number}: timestamp {stamp:.6f} is earlier than {before:.6f} in line {before_number}; "
                "sort the file by time"
            )
