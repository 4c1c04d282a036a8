"""What is driven by Python: a robot's camera, or a log, with options."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ebjax.command import setup_jax
from ebjax.front.log import Log
from ebjax.front.options import Options, options_from
from ebjax.geometry.camera import Camera
from ebjax.mapping.open_run import RunOptions
from ebjax.mapping.seen_floor import FloorOptions
from ebjax.posegraph.robust import kernel_of

FLOOR = ("view", "quad", "quad_margin", "metres_per_px")
"""Options of the floor that a camera alone needs too."""


def taken(given: Camera | Log, options: Mapping[str, Any], by: str) -> tuple[Options, Camera, Log | None]:
    """Sets JAX as the commands do; the options, the camera in float64, and the log, if it is one.

    Args:
      given: a robot's camera, or a log with its own options.
      options: that were given beside it.
      by: what takes them, for messages.

    Raises:
      ValueError: an unknown option, or one of how a log is read.
    """
    setup_jax()
    log = given if isinstance(given, Log) else None
    both = options_from({**(log.given if log else {}), **options}, Options, by)
    _check_reading(both, log, by)
    kernel_of(both.kernel)
    camera = given if isinstance(given, Camera) else given.camera
    return both, jax.tree.map(lambda leaf: jnp.asarray(leaf, float), camera), log  # made before JAX was set: float32


def _check_reading(options: Options, log: Log | None, by: str) -> None:
    """Refuses what can only be said when a log is opened."""
    base = log.options if log else Options()
    base = dataclasses.replace(base, mount=dataclasses.replace(base.mount, refine=options.mount.refine))
    kinds = (RunOptions, FloorOptions)
    for name in (field.name for kind in kinds for field in dataclasses.fields(kind)):
        if getattr(options, name) != getattr(base, name) and (log or name not in FLOOR):
            raise ValueError(f"{by}: {name} says how a log is read; give it to open_log, and its log to {by}")
