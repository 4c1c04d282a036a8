"""A log as the differentiable path takes it: `ebjax.slam.soft` corrects its trajectory, with a derivative."""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np

from ebjax.front.log import Log
from ebjax.io.sequence import require_odometry
from ebjax.models.luma import luma
from ebjax.slam.soft import SoftRun
from ebjax.slam.soft_pairs import chain_of
from ebjax.slam.world import planar


def soft_run(log: Log, *, frames: Iterable[int] | None = None) -> SoftRun:
    """The run of a log, all images in memory, for the gradient of its trajectory's error.

        run = soft_run(open_log("run.bag", topics={"truth": "/ground_truth"}))

    `notebooks/06_gradients.ipynb` shows what is done with it. Frames that cannot be read, and those without truth, are
    left out. Mount and clock are taken as the log gives them; pixels that are no floor are not left out.

    Args:
      log: from `open_log`, with odometry and truth.
      frames: numbers of those that are taken, increasing; None: all.

    Returns:
      Grey images in [0, 1], s since the log's first frame, odometry as a chain, the log's camera, true positions, m.

    Raises:
      ValueError: the log has no odometry or no truth, or fewer than two frames are left; says how to give them.
    """
    odometry, truth, path = planar(require_odometry(log.sequence, "soft_run")), log.truth, log.sequence.path
    if truth is None:
        raise ValueError(
            f"{path}: soft_run needs the truth, and the log has none: a folder has it in groundtruth.txt, a bag under "
            'a topic that open_log is told, topics={"truth": TOPIC}'
        )
    numbers = np.arange(len(log)) if frames is None else np.array(list(frames), int)
    if len(numbers) and (numbers[0] < 0 or numbers[-1] >= len(log) or (np.diff(numbers) <= 0).any()):
        raise ValueError(f"{path}: soft_run takes frames 0 to {len(log) - 1}, increasing: give frames so")
    camera, taken, images = log.camera, [], []
    for k in numbers.tolist():
        if np.isfinite(truth[k]).all() and (rgb := log.images.rgb(k)) is not None:
            taken.append(k)
            images.append(luma(jnp.asarray(rgb, jnp.float32))[..., None] / 255)
    if len(taken) < 2:
        broken = f"; {told}" if (told := log.images.told()) else ""
        raise ValueError(f"{path}: {len(taken)} frames with an image and truth, soft_run needs two at least{broken}")
    return SoftRun(
        jnp.stack(images),
        jnp.asarray(log.sequence.timestamps[taken] - log.sequence.timestamps[0]),
        chain_of(odometry[taken], log.options.odometry),
        camera,
        jnp.asarray(truth[taken, :2]),
    )
