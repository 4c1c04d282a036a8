"""Configs: frozen dataclasses hold schema and defaults, YAML files hold differences; errors name file and key."""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tyro
import yaml

from ebjax.io.atomic import whole_file
from ebjax.io.text import read_text
from ebjax.io.yaml_text import parse_yaml

Config = TypeVar("Config")
SHOWN = 80
"""Letters of a value in a message."""


def load_config(path: str | Path, config_class: type[Config]) -> Config:
    """Builds the config that a YAML file's differences describe; required fields it does not name are `tyro.MISSING`.

    Args:
      path: a YAML mapping from field names to values, nested as the dataclass is.
      config_class: the schema and the defaults.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: not YAML, an unknown key or a value of the wrong type; names file and key.
    """
    try:
        values = parse_yaml(read_text(path))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark else ""
        raise ValueError(f"{path}{line}: not YAML ({getattr(error, 'problem', None) or 'unreadable'})") from None
    return _build(path, "", config_class, {} if values is None else values)


def config_from(values: Mapping[str, Any], config_class: type[Config], source: str) -> Config:
    """Builds the config that Python values describe, as `load_config` does of a file's; configs are mappings too.

    Args:
      values: by the names of the fields.
      config_class: the schema and the defaults.
      source: what was called, for messages.

    Raises:
      ValueError: as `load_config`.
    """
    return _build(source, "", config_class, plain(values))


def dump_config(config: Any, path: str | Path) -> None:
    """Writes every field of a config as YAML, whole; `--config` reads it back."""
    with whole_file(path) as file:
        yaml.safe_dump(plain(config), file, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def plain(value: Any) -> Any:
    """A config, or a value of one, as YAML holds it."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return str(value) if isinstance(value, Path) else value


def _build(path: str | Path, prefix: str, kind: Any, values: Any) -> Any:
    if not isinstance(values, dict):
        raise ValueError(f"{path}: {prefix.rstrip('.') or 'the file'} is not a mapping of keys to values")
    fields = {field.name: field for field in dataclasses.fields(kind)}
    for key in values:
        if key not in fields:
            raise ValueError(f"{path}: unknown key {prefix}{_named(key)}; {_meant(key, prefix, kind)}")
    hints = typing.get_type_hints(kind)
    arguments = {}
    for name, field in fields.items():
        if name in values:
            arguments[name] = _value(path, prefix + name, hints[name], values[name])
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            arguments[name] = tyro.MISSING
    return kind(**arguments)


def _meant(key: Any, prefix: str, kind: Any) -> str:
    """The key that is most like one that nobody knows, the same name in a group before another one beside it."""
    fields = [field.name for field in dataclasses.fields(kind)]
    inside = [name for name in _inside(kind) if name.rpartition(".")[2] == key]
    close = inside or difflib.get_close_matches(str(key), fields, n=1)
    return f"did you mean {prefix}{close[0]}?" if close else f"known keys: {', '.join(fields)}"


def _inside(kind: Any, prefix: str = "") -> list[str]:
    """The dotted names of all keys in the groups of a config."""
    found = []
    for name, hint in typing.get_type_hints(kind).items():
        for group in (hint, *typing.get_args(hint)):
            if dataclasses.is_dataclass(group):
                found += [f"{prefix}{name}.{field.name}" for field in dataclasses.fields(group)]
                found += _inside(group, f"{prefix}{name}.")
    return found


def _value(path: str | Path, key: str, kind: Any, value: Any) -> Any:
    """Converts a YAML value to a field's type; integers pass for floats, nothing else changes its type."""
    wrong = ValueError(f"{path}: key {key} is {_shown(value)}, not {_describe(kind)}; correct the value")
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        return _build(path, key + ".", kind, value)
    if origin in (typing.Union, types.UnionType):
        for option in arguments:
            try:
                return _value(path, key, option, value)
            except ValueError as error:
                # Inside a nested mapping the exact key says more than "not any of these".
                if dataclasses.is_dataclass(option) and isinstance(value, dict):
                    raise error
        raise wrong
    if origin is typing.Literal:
        if any(value == option and type(value) is type(option) for option in arguments):
            return value
        raise wrong
    if origin in (tuple, list):
        if not isinstance(value, list):
            raise wrong
        if origin is list or arguments[-1] is Ellipsis:
            return origin(_value(path, f"{key}[{i}]", arguments[0], item) for i, item in enumerate(value))
        if len(value) != len(arguments):
            raise wrong
        pairs = zip(arguments, value, strict=True)
        return tuple(_value(path, f"{key}[{i}]", option, item) for i, (option, item) in enumerate(pairs))
    if kind is float:
        return _float(value, wrong)
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is Any or (isinstance(value, kind) and not (kind is int and isinstance(value, bool))):
        return value
    raise wrong


def _float(value: Any, wrong: ValueError) -> float:
    # YAML 1.1 reads 1e-3 as a string.
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            raise wrong from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong
    try:
        value = float(value)
    except OverflowError:
        raise wrong from None
    if math.isnan(value):
        raise wrong
    return value


def _shown(value: Any) -> str:
    """A value as Python writes it; a long one is cut."""
    words = repr(value)
    return words if len(words) <= SHOWN else f"{words[:SHOWN]}..."


def _named(key: Any) -> str:
    """A key as the file has it, if that is one word or line."""
    words = str(key)
    return words if words.isprintable() and 0 < len(words) <= SHOWN else _shown(key)


def _describe(kind: Any) -> str:
    if kind is type(None):
        return "null"
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return "one of " + ", ".join(map(str, arguments))
    if origin in (typing.Union, types.UnionType):
        return " or ".join(map(_describe, arguments))
    if origin in (tuple, list):
        if origin is list or arguments[-1] is Ellipsis:
            return f"a list of {_describe(arguments[0])}"
        return f"a list of {len(arguments)} ({', '.join(map(_describe, arguments))})"
    names = {float: "a number", int: "a whole number", str: "text", bool: "true or false", Path: "a path"}
    return names.get(kind, getattr(kind, "__name__", str(kind)))
