"""Says what is in a log, and what is missing; writes it as a folder in TUM layout."""

import json
import shlex
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from ebjax.command import dump_config, progress, run
from ebjax.io.calibration.depth_scale import depth_scale_in
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import LogOptions, kind_of, open_log
from ebjax.logs.convert import check_out, convert
from ebjax.logs.describe import lines
from ebjax.logs.facts import bag_facts, log_facts
from ebjax.logs.part_facts import Facts


@dataclass(frozen=True)
class Config:
    """Says what is in a log, and what is missing and how to give it; writes it as a folder in TUM layout."""

    log: tyro.conf.Positional[Path]
    """Folder in TUM layout, ROS bag (.bag, .db3, .mcap or their folder), RTAB-Map database, video, folder of images."""
    out: Path | None = None
    """Folder to write in TUM layout: rgb, depth, odometry.txt, groundtruth.txt, camera.json. Interrupted, the same
    command goes on where it stopped."""
    options: Annotated[LogOptions, tyro.conf.arg(name="")] = field(default_factory=LogOptions)
    camera: Path | None = None
    """A calibration file to use in place of the log's own, of any kind that `python -m ebjax.slam` reads."""
    mount: MountOptions = field(default_factory=MountOptions)
    max_time_difference_s: float = 0.02
    """How far apart in time an image may be from its depth image or pose, s."""
    json: bool = False
    """Print one JSON object in place of lines."""


def main(config: Config) -> None:
    """Opens, says, writes."""
    if config.out is not None:
        check_out(config.out, config.log)
    log = opened(config)
    camera = None if config.out is None else camera_of(log, config.camera, config.mount)[0]
    facts = log_facts(log, config.camera, config.mount, config.max_time_difference_s)
    facts["run"] = slam_command(config)
    if not config.json:
        print("\n".join(lines(facts)), flush=True)
    if config.out is not None and camera is not None:
        written = convert(
            log,
            camera,
            config.out,
            options=config.options,
            max_time_difference_s=config.max_time_difference_s,
            progress=lambda frames, total: progress(frames, total, "writing"),
        )
        dump_config(config, config.out / "config.yaml")
        facts["written"] = written.facts()
        if not config.json:
            print("\n".join(written.lines()))
    if config.json:
        print(as_json(facts))


def opened(config: Config) -> Log:
    """The log; of a bag without images its topics are printed before it is refused."""
    scale = None if config.camera is None else depth_scale_in(config.camera)
    try:
        return open_log(config.log, config.options, depth_scale=scale)
    except ValueError as fault:
        if kind_of(config.log) != "bag":
            raise
        facts = bag_facts(config.log)
        # The topics are said already.
        sentence = str(fault).partition(" Topics: ")[0]
        print(as_json(facts | {"refused": sentence}) if config.json else "\n".join(lines(facts)), flush=True)
        raise ValueError(sentence) from None


def slam_command(config: Config) -> str:
    """The command that runs the log with the same options."""
    given = {"camera": config.camera, "max_time_difference_s": config.max_time_difference_s}
    given |= _flat(config.options, "") | _flat(config.mount, "mount.")
    words = ["python", "-m", "ebjax.slam", str(config.log)]
    usual = {"max_time_difference_s": Config.max_time_difference_s, "images": LogOptions.images}
    for name, value in given.items():
        if value is not None and value != usual.get(name):
            words += [f"--{name.replace('_', '-')}", str(value)]
    return shlex.join(words)


def _flat(options: Any, prefix: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for one in fields(options):
        value = getattr(options, one.name)
        values |= _flat(value, f"{prefix}{one.name}.") if is_dataclass(value) else {f"{prefix}{one.name}": value}
    return values


def as_json(facts: Facts) -> str:
    """One object, over several lines."""
    return json.dumps(facts, indent=1, allow_nan=False, ensure_ascii=False)


if __name__ == "__main__":
    run(main, Config, needs_jax=False)
