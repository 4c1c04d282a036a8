"""A run's loop closures for RTAB-Map: its own database, copied, with the kept closures as user links."""

from pathlib import Path

from ebjax.io.logs.rtabmap import node_of
from ebjax.io.logs.rtabmap_links import Closure, write_closures
from ebjax.io.sequence import Sequence
from ebjax.slam.run import Run

NAME = "rtabmap.db"


def write_rtabmap_copy(folder: Path, out: Path, sequence: Sequence, result: Run) -> tuple[str, ...]:
    """Writes rtabmap.db where the log is an RTAB-Map database and closures were kept.

    Args:
      folder: to write into.
      out: where the folder will be in the end, for the lines.
      sequence: what was run.
      result: of the pipeline.

    Returns:
      What was written and how to use it, a line each; or why it could not be written.
    """
    if sequence.log.kind != "RTAB-Map database" or not result.kept.any():
        return ()
    c, nodes = result.candidates, [node_of(name) for name in sequence.names]
    closures = [
        Closure(nodes[c.i[k]], nodes[c.j[k]], float(x), float(y), float(theta), c.covariance[k])
        for k, (x, y, theta) in enumerate(c.i_from_j)
        if result.kept[k]
    ]
    try:
        written = write_closures(sequence.path, folder / NAME, closures)
    except ValueError as fault:
        return (f"{out / NAME}: not written: {fault}",)
    copy = out / NAME
    return (
        f"{copy}: {written.summary()}, as user links; use them with",
        f"  rtabmap-export --poses {copy}",
        f"  rtabmap-reprocess -pub_loops {copy} {out / 'reprocessed.db'}",
    )
