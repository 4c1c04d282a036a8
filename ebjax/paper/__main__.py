"""Repeats the paper's experiments on synthetic worlds, and on real data where there is any."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from ebjax.command import Command, run_one_of


@dataclass(frozen=True)
class TablesConfig:
    """Repeats the paper's tables and figures on synthetic worlds, and on real data where there is any.

    Writes paper.md, tables.json and PNGs. What OUT holds already is not measured again.
    """

    out: Path = Path("runs/paper")
    """Folder for the results, the rendered worlds among them."""
    quick: bool = False
    """Fewer frames, straight ways cut short, one pair a set."""
    sets: tuple[str, ...] = ("D1", "D2", "D3", "D4", "D5", "D6", "D7")
    """Worlds of tables 1 to 3."""
    plans: tuple[str, ...] = ("S1", "S2", "S3")
    """Worlds of table 4."""
    worlds: Path | None = None
    """Folder with NAME.yaml for every world; None: configs/worlds of the checkout."""
    data: Path | None = None
    """Folder of real data, opposing_pairs and d5_pose_graph in it; None: $EBJAX_DATA."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    seed: int = 0
    """Of vocabularies and RANSAC."""


@dataclass(frozen=True)
class AblationsConfig:
    """Measures what recall and trajectory depend on: length of the way, floor, lateral shift, closures, kernel.

    Writes ablations.md, ablations.json and a PNG each. What OUT holds already is not measured again.
    """

    out: Path = Path("runs/ablations")
    """Folder for the results, the rendered worlds among them."""
    quick: bool = False
    """Shorter ways, fewer frames, fewer values of every setting."""
    seed: int = 0
    """Of the worlds, vocabularies and RANSAC."""


@dataclass(frozen=True)
class CropsConfig:
    """Ranks descriptors by retrieval among crops of photographed floors, and of synthetic floors beside them.

    Local features match some of the crops with what is seen of them again. Writes crops.md, crops.json and PNGs of
    examples; prints Kendall's tau of the two rankings.
    """

    floors: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of photographs of floors, or of facing pairs with gt.json."""
    out: Path = Path("runs/crops")
    """Folder for the results."""
    only: str = "*"
    """Images that count, as a pattern of their names."""
    crops: int = 800
    """Crops in the database, at most."""
    pairs: int = 60
    """Crops that local features match with their queries, at most."""
    synthetic: bool = True
    """Measure on synthetic floors too."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    seed: int = 0
    """Of viewpoints, light, synthetic floors and vocabularies."""


@dataclass(frozen=True)
class StressConfig:
    """Measures descriptors by retrieval on the floor views of runs there and back, clean and corrupted.

    Every view is corrupted by itself: rotation, scale, blur, gamma, a hard shadow, a saturated spot, noise. Writes
    stress.md, stress.json and stress.png.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of runs there and back, with ground truth for every frame."""
    out: Path = Path("runs/stress")
    """Folder for the results."""
    descriptors: tuple[str, ...] = ("rootsift-vlad",)
    """Global descriptors that look at floor views."""
    strength: float = 1.0
    """Of all corruptions; 0 corrupts nothing."""
    seeds: int = 3
    """How often every view is corrupted anew."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""


@dataclass(frozen=True)
class KeypointsConfig:
    """Measures whether matched keypoints are placed as well as their covariances say: their NEES under the truth.

    Drives every log and takes the steps and closures that it measured on the floor. Writes keypoints.md and
    keypoints.json.
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Logs whose truth is known."""
    out: Path = Path("runs/keypoints")
    """Folder for the results."""


def ablations(config: AblationsConfig) -> None:
    """Measures, draws, writes, prints the tables."""
    from ebjax.paper.ablation_table import make

    print("\n".join(make(config.out, quick=config.quick, seed=config.seed)))
    print(f"wrote {config.out / 'ablations.md'}")


def crops(config: CropsConfig) -> None:
    """Measures, writes, prints the table."""
    from ebjax.paper.crop_table import make

    common = (config.only, config.crops, config.weights, config.seed)
    print("\n".join(make(config.floors, config.out, *common, pairs=config.pairs, side_by_side=config.synthetic)))
    print(f"wrote {config.out / 'crops.md'}")


def tables(config: TablesConfig) -> None:
    """Measures, draws, writes, prints the tables."""
    from ebjax.paper.tables import make

    lines = make(
        config.out,
        config.sets,
        config.plans,
        config.worlds,
        config.data,
        config.weights,
        quick=config.quick,
        seed=config.seed,
    )
    print("\n".join(lines))
    print(f"wrote {config.out / 'paper.md'}")


def stress(config: StressConfig) -> None:
    """Measures, writes, prints the tables."""
    from ebjax.paper.stress_table import make

    common = (config.descriptors, config.weights, config.strength, config.seeds)
    print("\n".join(make(config.runs, config.out, *common)))
    print(f"wrote {config.out / 'stress.md'}")


def keypoints(config: KeypointsConfig) -> None:
    """Measures, writes, prints the table."""
    from ebjax.paper.keypoints import make

    print("\n".join(make(config.logs, config.out)))
    print(f"wrote {config.out / 'keypoints.md'}")


COMMANDS = {
    "tables": Command(tables, TablesConfig),
    "crops": Command(crops, CropsConfig),
    "stress": Command(stress, StressConfig),
    "ablations": Command(ablations, AblationsConfig),
    "keypoints": Command(keypoints, KeypointsConfig),
}


def main(argv: list[str]) -> None:
    """Runs the command that the first argument names; help without one."""
    run_one_of(COMMANDS, "Repeats the paper's experiments.", argv)


if __name__ == "__main__":
    main(sys.argv[1:])
