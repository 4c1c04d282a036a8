"""Converts, lists and checks the networks."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from ebjax.command import Command, run_one_of


@dataclass(frozen=True)
class ConvertConfig:
    """Turns a published checkpoint into weights for ebjax; the network is recognised by the file's keys."""

    checkpoint: tyro.conf.Positional[Path]
    """The published file: .pth, .pth.tar, .mat or .safetensors. Nothing in it is executed."""
    out: tyro.conf.Positional[Path]
    """The .safetensors file to write."""


@dataclass(frozen=True)
class ListConfig:
    """Lists the networks: the file their authors published, where, under which licence and how large."""


@dataclass(frozen=True)
class CheckConfig:
    """Compares every array of a folder of reference outputs with ours; exit code 1 if one is off."""

    folder: tyro.conf.Positional[Path]
    """inputs.npz, NETWORK__IMAGE.npz, README.md, and checkpoints that are no stand-ins."""
    seed: int | None = None
    """Of the stand-in weights; by default what the folder's README.md says."""
    networks: tuple[str, ...] = ()
    """Check these only; by default all there are."""


def convert(config: ConvertConfig) -> None:
    """Reads, converts, writes."""
    from ebjax.models.convert import convert_checkpoint
    from ebjax.models.weights import save_weights

    if config.out.suffix != ".safetensors":
        raise ValueError(f"{config.out}: weights are written as .safetensors; name such a file")
    name, arrays, origin = convert_checkpoint(config.checkpoint)
    save_weights(config.out, name, arrays, origin)
    total = sum(array.size for array in arrays.values())
    print(f"{config.checkpoint}: {name}, {len(arrays)} arrays, {total:,} numbers")
    print(f"wrote {config.out}")


def show_list(config: ListConfig) -> None:
    """Prints one block a network."""
    from ebjax.models.catalogue import MODELS

    for name, model in MODELS.items():
        print(f"{name:14} {model.file}, {model.size_mb:g} MB, {model.licence}")
        print(f"{'':14} {model.source}; {model.paper}")
        if model.install:
            print(f"{'':14} comes with {model.install}, and is then read from there")
    print("\npython -m ebjax.models convert FILE NAME.safetensors makes one of them usable here.")


def check(config: CheckConfig) -> None:
    """Prints one line an array."""
    from ebjax.models.check import check_folder

    count, over = 0, []
    for file, key, (error, tolerance) in check_folder(config.folder, config.seed, config.networks):
        count += 1
        bad = not error <= tolerance
        over += [f"{file} {key}"] * bad
        print(f"{file:24} {key:36} {error:9.2e}  of {tolerance:8.2e}{'  TOO LARGE' * bad}", flush=True)
    print(f"{count} arrays, {len(over)} too far off")
    if over:
        print(f"error: {len(over)} of {count} arrays are too far off, first {over[0]}", file=sys.stderr)
        sys.exit(1)


COMMANDS = {
    "convert": Command(convert, ConvertConfig),
    "list": Command(show_list, ListConfig, needs_jax=False),
    "check": Command(check, CheckConfig),
}


def main(argv: list[str]) -> None:
    """Runs the command that the first argument names; help without one."""
    run_one_of(COMMANDS, "Converts, lists and checks the networks.", argv)


if __name__ == "__main__":
    main(sys.argv[1:])
