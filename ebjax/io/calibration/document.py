"""A calibration file opened: its text, and its YAML, JSON or XML as plain dicts, lists, numbers and words.

OpenCV's dialect is read too: the header `%YAML:1.0`, the tag `!!opencv-matrix`, `key:value` without a space.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from ebjax.io.calibration.file_storage import file_storage
from ebjax.io.json_text import NotJson, parse_json
from ebjax.io.text import read_text
from ebjax.io.yaml_text import PlainLoader, parse_yaml

LONGEST = 1_000_000
"""Characters of one part; a longer one is some other table, which YAML would take minutes over."""


class _Loader(PlainLoader):
    """A loader that also refuses a key that is there twice with two values."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: dict[str, Any] = {}
        for key, value in node.value:
            plain = self.construct_object(value, deep=True)
            if key.value != "<<" and str(key.value) in seen and seen[str(key.value)] != plain:
                said = f"the key {key.value!r} is there twice, with two values; remove one of the two"
                raise yaml.constructor.ConstructorError(None, None, said, key.start_mark)
            seen[str(key.value)] = plain
        return super().construct_mapping(node, deep=True)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in pairs:
        if key in values and values[key] != value:
            raise ValueError(f"the key {key!r} is there twice, with two values; remove one of the two")
        values[key] = value
    return values


@dataclass(frozen=True)
class Document:
    """What is read, and what the caller wants of it.

    Attributes:
      path: of the file.
      text: its content.
      camera: the name of the camera that is asked for, where the file has several.
      size: width and height of the images, px, for files that do not say them.
    """

    path: Path
    text: str
    camera: str | None = None
    size: tuple[int, int] | None = None

    @cached_property
    def faults(self) -> list[str]:
        """What kept `mappings` from reading a part, so far."""
        return []

    @cached_property
    def values(self) -> dict[str, Any]:
        """The first mapping of the file; empty where there is none."""
        return next(self.mappings(), {})

    def mappings(self) -> Iterator[dict[str, Any]]:
        """Yields the mappings of the file one by one; lines `---` part them. Parts that cannot be read are left out."""
        found = False
        for values in list(self._whole()) or self._parts():
            if isinstance(values, dict) and values:
                found = True
                yield {str(key): value for key, value in values.items()}
        stored = None if found else file_storage(self.text)
        if stored:
            yield stored

    def _whole(self) -> Iterator[Any]:
        """The file as JSON."""
        if self.text.lstrip()[:1] in ("{", "["):
            try:
                yield parse_json(self.text, _once)
            except NotJson as error:
                self.faults.append(str(error))
            except ValueError as error:
                raise ValueError(f"{self.path}: {error}") from None

    def _parts(self) -> Iterator[Any]:
        lines = re.sub(r"!!(opencv-[\w-]+|python/tuple)", "", self.text.expandtabs(2)).splitlines()
        lines = ["" if line.startswith("%YAML") else line for line in lines]
        borders = [number for number, line in enumerate(lines) if re.fullmatch(r"(---|\.\.\.)\s*(#.*)?", line)]
        for start, end in zip([-1, *borders], [*borders, len(lines)], strict=True):
            part = "\n".join(lines[start + 1 : end])
            if len(part) > LONGEST:
                self.faults.append(f"line {start + 2}: longer than any calibration")
                continue
            try:
                yield parse_yaml(part, _Loader)
            except yaml.constructor.ConstructorError as error:
                line = start + 2 + (error.problem_mark.line if error.problem_mark else 0)
                raise ValueError(f"{self.path} line {line}: {error.problem}") from None
            except yaml.MarkedYAMLError as error:
                line = start + 2 + (error.problem_mark.line if error.problem_mark else 0)
                self.faults.append(f"line {line}: not YAML ({error.problem})")
            except yaml.YAMLError:
                self.faults.append(f"line {start + 2}: not YAML")


def open_document(path: str | Path, *, camera: str | None = None, size: tuple[int, int] | None = None) -> Document:
    """Opens a file: UTF-8, UTF-16 with its mark (a redirect of PowerShell), or any 8-bit text; also gzip.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: a folder, an empty file, not text.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: a folder; give the calibration file itself")
    try:
        text = read_text(path)
    except ValueError:
        content = path.read_bytes() if path.exists() else b"\x1f\x8b"
        if content[:2] == b"\x1f\x8b":
            raise
        marked = content[:2] in (b"\xff\xfe", b"\xfe\xff")
        if b"\0" in content and not marked:
            raise ValueError(f"{path}: not text; give the calibration as YAML, JSON, XML or another text") from None
        text = content.decode("utf-16" if marked else "latin-1", errors="replace")
    if "\0" in text:
        raise ValueError(f"{path}: not text; give the calibration as YAML, JSON, XML or another text")
    if not text.strip():
        raise ValueError(f"{path}: an empty file; give the calibration again")
    return Document(path, text, camera, size)
