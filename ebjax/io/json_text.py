"""JSON from text to plain values. Whatever is wrong with it is one kind of error."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ebjax.io.text import read_text

MOST_DEPTH = 100
"""Lists and mappings in each other. Files that people write have fewer than ten; thousands end Python's stack."""
DEEP = f"more than {MOST_DEPTH} brackets in each other"
MOST_DIGITS = 300


class NotJson(ValueError):  # noqa: N818 - a fault that the caller names the file of
    """`line` is where, from 1; 1 where that is not known."""

    def __init__(self, problem: str, line: int = 1):
        super().__init__(f"line {line}: not JSON ({problem})")
        self.problem, self.line = problem, line


def parse_json(text: str, pairs: Callable[[list[tuple[str, Any]]], Any] = dict) -> Any:
    """The plain values of a JSON text.

    Args:
      text: of the file.
      pairs: makes a mapping of its keys and values.

    Raises:
      NotJson: it is none; or what `pairs` raises.
    """
    try:
        values = json.loads(text, object_pairs_hook=pairs, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise NotJson(error.msg, error.lineno) from None
    except RecursionError:
        raise NotJson(DEEP) from None
    if is_deep(values):
        raise NotJson(DEEP)
    return values


def read_json(path: str | Path, pairs: Callable[[list[tuple[str, Any]]], Any] = dict) -> Any:
    """The plain values of a JSON file, plain or gzip; `pairs` as in `parse_json`.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: not text, or not JSON; names file and line.
    """
    text = read_text(path)
    try:
        return parse_json(text, pairs)
    except NotJson as error:
        raise ValueError(f"{path} line {error.line}: not JSON ({error.problem}); correct the file") from None


def is_deep(values: Any) -> bool:
    """Whether lists and mappings lie in each other more than MOST_DEPTH times."""
    level = [values]
    for _ in range(MOST_DEPTH):
        parts = (one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list))
        level = [part for inner in parts for part in inner]
    return any(isinstance(one, dict | list) for one in level)


def _whole(digits: str) -> int | float:
    """A whole number; as a float where it is long, for Python refuses to read thousands of digits."""
    return int(digits) if len(digits) <= MOST_DIGITS else float(digits)
