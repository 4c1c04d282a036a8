"""What a user says of a run, from the command line and from Python: how it is read and how its loops are closed."""

import dataclasses
import difflib
import shlex
import typing
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from ebjax.config import config_from, plain
from ebjax.features.extractor import EXTRACTORS
from ebjax.io.logs.mount_options import MountOptions
from ebjax.mapping.open_run import RunOptions
from ebjax.mapping.seen_floor import FloorOptions
from ebjax.parts import name_of
from ebjax.places.descriptor import DESCRIPTORS
from ebjax.slam.believe import BeliefConfig
from ebjax.slam.config import MountConfig, PipelineConfig

Config = TypeVar("Config")
PARTS: dict[str, Mapping[str, str]] = {"descriptor": DESCRIPTORS, "extractor": EXTRACTORS, "kernel": {}, "reader": {}}
"""Keys whose value may be an object, and the names of ours."""


@dataclasses.dataclass(frozen=True)
class Mount(MountConfig, MountOptions):
    """Where the camera sits on the robot, and how far that is trusted."""


@dataclasses.dataclass(frozen=True)
class Options(PipelineConfig, FloorOptions, RunOptions):
    """A run and how its loops are closed."""

    believe: Annotated[BeliefConfig, tyro.conf.arg(name="")] = dataclasses.field(default_factory=BeliefConfig)
    mount: Mount = dataclasses.field(default_factory=Mount)
    map_metres_per_px: float = 0.02
    """Of the floor map, m."""
    min_readable: float = 0.5
    """Share of frames that must be readable; fewer end the run."""
    cache: Path | None = None
    """Folder where what networks make of every view stays for the next run; None: nowhere."""


def options_from(given: Mapping[str, Any], config_class: type[Config], source: str) -> Config:
    """The options that keyword arguments describe.

    Args:
      given: by the keys of a config file, or of a flag without its group: `min_agreeing=1` is
        `believe={"min_agreeing": 1}`. A descriptor, extractor, kernel or reader may be an object.
      config_class: which keys there are.
      source: what was called, for messages.

    Raises:
      ValueError: an unknown key, with the nearest ones; a value of the wrong type.
    """
    where, values = _groups(config_class), {}
    for key, value in given.items():
        if key not in where:
            close = difflib.get_close_matches(key, where, n=3)
            hint = f"did you mean {' or '.join(close)}?" if close else "`python -m ebjax.slam --help` lists the options"
            raise ValueError(f"{source}: unknown option {key}; {hint}")
        if key in PARTS and value is not None and not isinstance(value, str | Path):
            value = name_of(value, PARTS[key])
        group = where[key]
        if group is None:
            values[key] = value
        else:
            values[group] = {**plain(values.get(group, {})), key: value}
    return config_from(values, config_class, source)


def made_by(options: Any, log: Path) -> list[list[str]]:
    """How a run was made: the command, settings that are not the defaults, version and date, a row each."""
    from ebjax import __version__

    flags = differences(options, type(options)())
    flags.pop("--sequence", None)
    words = [word for name, values in flags.items() for word in (name, *values)]
    return [
        ["command", shlex.join(["python", "-m", "ebjax.slam", str(log), *words])],
        ["settings", "defaults, but for those in the command; all are in config.yaml"],
        ["version", f"ebjax {__version__}, JAX {metadata.version('jax')}"],
        ["date", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"],
    ]


def differences(options: Any, usual: Any, prefix: str = "--") -> dict[str, list[str]]:
    """The flags, with their values, of options that differ from others of their class."""
    found: dict[str, list[str]] = {}
    hints = typing.get_type_hints(type(options), include_extras=True)
    for field in dataclasses.fields(options):
        value, other = getattr(options, field.name), getattr(usual, field.name)
        name = prefix + field.name.replace("_", "-")
        if dataclasses.is_dataclass(value):
            found |= differences(value, other, prefix if _unnamed(hints[field.name]) else f"{name}.")
        elif value != other and isinstance(value, bool):
            found[name if value else f"{prefix}no-{name.removeprefix(prefix)}"] = []
        elif value != other:
            found[name] = list(map(str, value)) if isinstance(value, tuple | list) else [str(value)]
    return found


def _unnamed(hint: Any) -> bool:
    """Whether the flags of a group have no prefix."""
    return any(getattr(one, "name", None) == "" for one in typing.get_args(hint)[1:])


def _groups(config_class: type[Any]) -> dict[str, str | None]:
    """Every key and the group that it lies in: those of groups whose flags have no prefix come without it too."""
    found: dict[str, str | None] = {field.name: None for field in dataclasses.fields(config_class)}
    for name, kind in typing.get_type_hints(config_class, include_extras=True).items():
        inner = typing.get_args(kind)[0] if typing.get_origin(kind) is Annotated else kind
        if _unnamed(kind) and dataclasses.is_dataclass(inner):
            found |= {field.name: name for field in dataclasses.fields(inner) if field.name not in found}
    return found
