"""The depth images of a log that are files of their own: looked at before the run, for faults that all have alike."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ebjax.io.depth_images import depth_values, read_depth, units_per_metre
from ebjax.io.images import BrokenFrame, same_shape
from ebjax.io.logs.image_list import ImageList
from ebjax.io.logs.image_survey import spread
from ebjax.io.logs.log import Images

LOOKED_AT = 5


def depth_images(
    listed: ImageList,
    files: Sequence[Path],
    notes: tuple[str, ...],
    depth_scale: float,
    colour_sizes: Sequence[tuple[int, int]],
) -> Images:
    """The depth images of a list; a few are decoded.

    Args:
      listed: their names and times.
      files: of them.
      notes: of how the list was read.
      depth_scale: file units per metre.
      colour_sizes: (width, height) that the colour images can be read at, px.

    Raises:
      ValueError: none of those looked at is depth, or all have another shape than the colour images; says why.
    """
    source = str(listed.path)
    values, faults = [], []
    for row in spread(len(files), LOOKED_AT):
        try:
            values.append(depth_values(files[row]))
        except BrokenFrame as fault:
            faults.append(str(fault))
    if faults and not values:
        raise ValueError(
            f"{source}: none of {len(faults)} depth images looked at can be used; first {faults[0]}; or run with "
            "--depth none"
        )
    sizes = {(image.shape[1], image.shape[0]) for image in values}
    if sizes and colour_sizes and not any(same_shape(size, colour) for size in sizes for colour in colour_sizes):
        (width, height), (across, down) = sorted(sizes)[0], colour_sizes[0]
        raise ValueError(
            f"{source}: depth images of {width}x{height} pixels, another shape than the colour images' "
            f"{across}x{down}: they are not registered to them; register depth to colour, or run with --depth none"
        )
    floats = [image for image in values if image.dtype != np.uint16]
    if floats:
        together = np.concatenate([image[image > 0] for image in floats])
        scale = units_per_metre(together, depth_scale)
        unit = "metres" if scale == 1 else f"1/{scale:g} m"
        notes += (f"{source}: depth images of floating-point numbers, read as {unit}",)
        depth_scale = scale
    return Images(
        source, listed.names, listed.timestamps, lambda k: read_depth(files[k], depth_scale), tuple(files), notes=notes
    )
