"""Text tables: data lines with their line numbers, plain or gzip, and errors that name file and line."""

import gzip
import io
import itertools
import math
import re
import zlib
from pathlib import Path

MOST = 1e30
"""No length, angle or time in any unit is larger; squares of such numbers still are finite."""
MOST_BYTES = 1 << 27
NO_TEXT = "not a text file; give a text table (or a .gz of one)"
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}


def read_text(path: str | Path) -> str:
    """Reads a text file, unpacking gzip by content; where only `path`.gz is there, that.

    UTF-8, or UTF-16 that begins with its byte order mark, as Windows writes it; the mark is left out.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: damaged gzip, or not text.
    """
    path, packed = Path(path), Path(f"{path}.gz")
    content = (packed if packed.is_file() and not path.exists() else path).read_bytes()
    try:
        if content[:2] == b"\x1f\x8b":
            content = _unpacked(path, content)
        encoding = next((name for mark, name in MARKS.items() if content.startswith(mark)), "utf-8")
        text = content.decode(encoding)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise ValueError(f"{path}: damaged gzip file; copy it again") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: {_undecodable(content, error)}") from None
    if "\0" in text:
        raise ValueError(f"{path}: {NO_TEXT}")
    return text


def _unpacked(path: Path, content: bytes) -> bytes:
    """What gzip holds; a few kB can hold more than memory does."""
    with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
        unpacked = file.read(MOST_BYTES + 1)
    if len(unpacked) > MOST_BYTES:
        raise ValueError(
            f"{path}: unpacks to more than {MOST_BYTES >> 20} MB; unpack it, and give the part that you need"
        )
    return unpacked


def _undecodable(content: bytes, error: UnicodeDecodeError) -> str:
    """Tells text in another encoding from what is no text, which has control bytes."""
    if error.encoding != "utf-8" or re.search(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]", content):
        return NO_TEXT
    number = len(re.findall(rb"\r\n|\r|\n", content[: error.start])) + 1
    return f"line {number} is not UTF-8; save the file as UTF-8"


def lines_of(text: str) -> list[str]:
    """Splits text at the ends of lines that an editor counts: LF, CR LF and CR alone."""
    return re.split(r"\r\n|\r|\n", text)


def data_lines(path: str | Path) -> list[tuple[int, str]]:
    """Lists (line number, stripped line), without blank lines and `#` comments; numbers start at 1."""
    lines = enumerate(lines_of(read_text(path)), start=1)
    return [(number, line.strip()) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def floats(path: str | Path, number: int, fields: list[str]) -> list[float]:
    """Converts the fields of one line.

    Raises:
      ValueError: a field is not a finite number, or larger than MOST; names file and line.
    """
    values = []
    for field in fields:
        try:
            # Python reads 1_000 as a number; no table means that.
            value = float(field.replace("_", "?"))
        except ValueError:
            raise ValueError(
                f"{path} line {number}: {field[:80]!r} is not a number; correct or remove the line"
            ) from None
        if not abs(value) < MOST:
            what = f"larger than {MOST:g}" if math.isfinite(value) else "not a finite number"
            raise ValueError(f"{path} line {number}: {field[:80]} is {what}; correct or remove the line")
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
