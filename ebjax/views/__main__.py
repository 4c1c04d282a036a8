"""Times the floor view through lenses."""

from dataclasses import dataclass

from ebjax.command import run
from ebjax.views.bench import bench


@dataclass(frozen=True)
class BenchConfig:
    """Times the floor view through a pinhole and through lenses, under a tilt that changes every frame."""

    frames: int = 40
    """Of a turn."""
    turns: int = 7
    """How often each runs."""
    seed: int = 0
    """Of the picture and the tilts."""


def show_bench(config: BenchConfig) -> None:
    """Runs and prints the table."""
    if config.frames < 1 or config.turns < 1:
        raise ValueError(f"--frames is {config.frames}, --turns {config.turns}; give at least 1 of each")
    rows = bench(config.frames, config.turns, config.seed)
    print("| lens | ms a frame | of the pinhole's | PSNR dB |\n|---|---|---|---|")
    for name, row in rows.items():
        print(f"| {name} | {row.ms:.2f} | {row.ratio:.2f} | {row.psnr_db:.1f} |")


if __name__ == "__main__":
    run(show_bench, BenchConfig)
