"""Measures ebjax on the machine it runs on."""

import sys

from ebjax.bench.bags import BagConfig, bench_bags
from ebjax.bench.drive import DriveConfig, bench_drive
from ebjax.bench.gate import GateConfig, bench_parts
from ebjax.bench.graphs import GraphConfig, bench_graphs
from ebjax.bench.lenses import LensConfig, bench_lenses
from ebjax.bench.matching import MatchingConfig, bench_matching
from ebjax.bench.networks import NetworkConfig, bench_networks
from ebjax.bench.parts import PARTS
from ebjax.bench.searching import SearchConfig, bench_search
from ebjax.command import Command, run, run_one_of

COMMANDS = {
    "drive": Command(bench_drive, DriveConfig),
    "graphs": Command(bench_graphs, GraphConfig),
    "nearest": Command(bench_search, SearchConfig),
    "pairs": Command(bench_matching, MatchingConfig),
    "networks": Command(bench_networks, NetworkConfig),
    "lenses": Command(bench_lenses, LensConfig),
    "bags": Command(bench_bags, BagConfig),
}


def main(argv: list[str]) -> None:
    """Runs the command that the first argument names, or times parts; says which there are without one."""
    if argv and argv[0] not in COMMANDS and argv[0] not in ("-h", "--help"):
        return run(bench_parts, GateConfig, argv)
    run_one_of(COMMANDS, "Measures ebjax on the machine it runs on.", argv)
    if not argv or argv[0] not in COMMANDS:
        parts = "".join(f"\n  {name:9} {part.what}" for name, part in PARTS.items())
        print(
            f"\npython -m ebjax.bench PART ... times parts; with --gate it fails if one is slower than before:\n{parts}"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
