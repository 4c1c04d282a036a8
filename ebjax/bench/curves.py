"""Curves of a drive: what every keyframe took, and memory."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.bench.timeline import WARM, Timeline
from ebjax.viz.figures import AFTER, BEFORE, LOOP, new_figure, painted

SMOOTHED = 100
TICKS_MS = (10, 20, 50, 100, 200, 500, 1000)


def draw(timeline: Timeline, path: Path) -> None:
    """Writes a PNG.

    Raises:
      OSError: it cannot be written.
    """
    rows = timeline.rows
    shown = new_figure(11.0, 6.4)
    above, below = shown.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    keyframe = rows.keyframe[WARM:]
    above.plot(keyframe, rows.wall_ms[WARM:], ".", color=BEFORE, ms=2.5, alpha=0.5, label="each keyframe")
    for share, colour in ((50, AFTER), (99, LOOP)):
        label = f"{share} % of the last {SMOOTHED} take less"
        above.plot(keyframe, running(rows.wall_ms[WARM:], share), color=colour, lw=1.3, label=label)
    above.set(ylabel="from keyframe to keyframe, ms", yscale="log")
    above.set_yticks(TICKS_MS, [str(tick) for tick in TICKS_MS])
    above.minorticks_off()
    above.legend(frameon=False, fontsize=9, loc="upper left")
    below.plot(rows.keyframe, rows.peak_mb, color=AFTER, lw=1.3)
    above.set_ylim(10, 1500)
    below.set(ylabel="peak memory, MB", xlabel="keyframe", ylim=(0, None))
    path.write_bytes(painted(shown))


def running(values: Float[np.ndarray, " N"], share: int) -> Float[np.ndarray, " N"]:
    """That percentile of every value and those before it, SMOOTHED at most."""
    return np.array([np.percentile(values[max(0, k - SMOOTHED + 1) : k + 1], share) for k in range(len(values))])
