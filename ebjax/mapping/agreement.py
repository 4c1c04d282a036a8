"""What a map and a run that goes on with it must agree in: by value, and refused by name where they do not."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ebjax.features.extractor import extractor
from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import apply
from ebjax.geometry.mount_numbers import mount_of
from ebjax.parts import is_own, version_of
from ebjax.places.descriptor import descriptor
from ebjax.places.fixed_words import NAMES, digest_of, fixed_words
from ebjax.slam.config import PipelineConfig
from ebjax.views.run_view import RunView

Facts = Mapping[str, Any]
VERSION = "version of the extractor"
TOLERANCE = 1e-6
"""Of numbers, absolute and relative: what two ways of computing one camera differ in is less."""
MADE_BY = ("descriptor", "extractor", "weights")
"""Settings that a whole map shares."""
LOOKED_UP_BY = ("arithmetic", "ranking")
"""Settings that change with them when a map is described anew."""
REMEDIES = {
    "extractor": "give --extractor {was}",
    "descriptor": "give --descriptor {was}",
    "weights of the extractor": "give the weights that it was made with (--weights)",
    "weights of the descriptor": "give the weights that it was made with (--weights)",
    VERSION: "use that version of it",
    "version of the descriptor": "use that version of it",
    "words of places": "use the ebjax and the weights (--weights) that it was made with",
    "image": "give the calibration that it was made with (--camera)",
    "intrinsics": "give the calibration that it was made with (--camera)",
    "lens": "give the calibration that it was made with (--camera)",
    "mount": "give the mount that it was made with (--camera, --mount.*)",
    "floor view": "look at the same floor (--view, --quad, --metres-per-px)",
}
"""Of every fact of a map, what makes a run agree with it."""
DESCRIBED_BY = (
    *("extractor", "weights of the extractor", "descriptor", "weights of the descriptor"),
    *(VERSION, "version of the descriptor", "words of places"),
)
ANEW = "describe the map anew as this run is (--map {path} --redescribe with its --extractor, --descriptor, --weights)"


def made_with(config: PipelineConfig, camera: Camera, view: RunView) -> dict[str, Any]:
    """The facts of a map: what its views were seen and described with.

    Raises:
      ValueError, OSError: as `described_with`.
    """
    return described_with(config) | seen_with(camera, view)


def described_with(config: PipelineConfig) -> dict[str, Any]:
    """What views are described with.

    Raises:
      ValueError: an unknown descriptor or extractor, or no words or weights of them.
      OSError: weights cannot be read.
    """
    features = extractor(config.extractor, config.weights, config.arithmetic)
    places = descriptor(config.descriptor, config.weights, config.arithmetic)
    told = [name for name in NAMES if config.descriptor in (name, "joint")]
    words = [fixed_words(name, config.weights if name == "floornet" else None).version for name in told]
    parts = {"extractor": config.extractor, "descriptor": config.descriptor}
    own = {f"version of the {what}": version_of(name) for what, name in parts.items() if is_own(name)}
    return {
        "extractor": config.extractor,
        "weights of the extractor": digest_of(features.weights),
        "descriptor": config.descriptor,
        "weights of the descriptor": digest_of(places.weights),
        "words of places": " ".join(words) or "none",
        **({VERSION: str(features.version)} | own),
    }


def seen_with(camera: Camera, view: RunView) -> dict[str, Any]:
    """What views are seen with."""
    k = np.asarray(camera.intrinsics, np.float64)
    height, width = view.size
    corners = np.array([[0.0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]])
    on_floor = np.asarray(apply(np.asarray(view.floor_from_view, np.float64), corners))
    return {
        "image": [camera.width, camera.height],
        "intrinsics": [float(value) for value in (k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1])],
        "lens": [camera.lens.model, *np.asarray(camera.lens.coefficients, float).tolist()],
        "mount": np.asarray(camera.base_from_camera, np.float64)[:3].ravel().tolist(),
        "floor view": [width, height, *on_floor.ravel().tolist()],
    }


def settings_of(config: PipelineConfig) -> dict[str, Any]:
    """The settings of the engine under the names of their flags; those that the whole map shares are left out."""
    found: dict[str, Any] = {}
    for flag, name, inner in _flags():
        value = getattr(config, name)
        found[flag] = value if inner is None else getattr(value, inner)
    return found


def with_settings(config: PipelineConfig, was: Facts) -> PipelineConfig:
    """The settings that `settings_of` told, as far as it did, and of the given ones what describes and looks up."""
    changed: dict[str, Any] = {}
    for flag, name, inner in _flags():
        if flag in was and name not in LOOKED_UP_BY:
            value = was[flag]
            whole = changed.get(name, getattr(config, name))
            changed[name] = value if inner is None else dataclasses.replace(whole, **{inner: value})
    return dataclasses.replace(config, **changed)


def _flags() -> Iterator[tuple[str, str, str | None]]:
    """Of every setting its flag, the field and the one within that."""
    for field in dataclasses.fields(PipelineConfig):
        made = field.default_factory
        if made is not dataclasses.MISSING:
            within = "" if field.name == "believe" else f"{field.name}."
            for inner in dataclasses.fields(made()):  # type: ignore[arg-type]
                yield f"--{within}{inner.name}".replace("_", "-"), field.name, inner.name
        elif field.name not in MADE_BY:
            yield f"--{field.name}".replace("_", "-"), field.name, None


def disagreeing(was: Facts, now: Facts) -> str | None:
    """The first fact of `was` that `now` has another value of; None where there is none."""
    told = _with_version(was)
    return next((name for name in told if name in now and not _equal(told[name], now[name])), None)


def _with_version(was: Facts) -> Facts:
    """Maps that do not say the version of their extractor have its first."""
    return {**was, VERSION: was.get(VERSION, "1")} if "extractor" in was else was


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    if _is_number(one) and _is_number(other):
        return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    return bool(one == other)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def check_map(path: object, was: Facts, now: Facts) -> tuple[str, ...]:
    """Refuses a run that does not agree with the map; returns notes of what the map does not say.

    Raises:
      ValueError: names the fact, both values, and what to give.
    """
    name = disagreeing(was, now)
    if name is not None:
        values = in_words(name, _with_version(was)[name]), in_words(name, now[name])
        remedy = REMEDIES[name].format(was=values[0])
        if name in DESCRIBED_BY:
            remedy += f", {ANEW.format(path=path)}"
        raise ValueError(
            f"{path}: was made with {name} {values[0]}, this run has {values[1]}; {remedy}, or keep this run in "
            "another map"
        )
    unsaid = [name for name in now if name not in _with_version(was)]
    said = f"{path}: does not say what it was made with ({', '.join(unsaid)}); taken to be as this run's"
    return (said,) * bool(unsaid)


def check_session(path: object, session: int, log: str, was: Facts, now: Facts) -> None:
    """Refuses to go on with a session that was begun with other settings.

    Raises:
      ValueError: names the setting, both values, and what to give.
    """
    name = disagreeing(was, now)
    if name is None:
        return
    value = _with_version(was)[name]
    change = "run it as it was begun"
    if name.startswith("--"):
        change = f"leave {name} out" if value is None else f"give {name} {in_words(name, value)}"
    raise ValueError(
        f"{path}: session {session} of {log} was begun with {name} {in_words(name, value)}, not "
        f"{in_words(name, now[name])}; {change} to go on, or begin it anew after --map {path} --forget {session}"
    )


def in_words(name: str, value: Any) -> str:
    """A value as a message shows it."""
    if name == "mount":
        pitch, roll, yaw, height, x, y = mount_of(np.vstack([np.reshape(value, (3, 4)), [0, 0, 0, 1]]))
        angles = np.degrees([pitch, roll, yaw])
        return (
            f"(height {height:.6g} m, x {x:.6g} m, y {y:.6g} m, pitch {angles[0]:.6g}, roll {angles[1]:.6g}, "
            f"yaw {angles[2]:.6g} degrees)"
        )
    if isinstance(value, list | tuple):
        return f"({' '.join(in_words('', one) for one in value)})"
    if isinstance(value, float):
        return f"{value:.9g}"
    return str(value)
