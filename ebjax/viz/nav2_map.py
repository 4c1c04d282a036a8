"""The floor as an occupancy map for nav2's map_server: a grey PNG and the YAML file that says where it lies.

White (254) is free, black (0) occupied, grey (205) unknown, as map_saver writes them.
"""

from pathlib import Path

import cv2
import numpy as np
import yaml
from jaxtyping import Int8

from ebjax.io.atomic import whole_file
from ebjax.viz.occupancy import FREE, OCCUPIED

GREY = {FREE: 254, OCCUPIED: 0}
UNKNOWN_GREY = 205
THRESHOLDS = {"occupied_thresh": 0.65, "free_thresh": 0.196}
"""Of 1 - grey / 255; unknown is 0.19608, which is not below the second."""


def write_nav2_map(
    path: str | Path,
    cells: Int8[np.ndarray, "H W"],
    extent: tuple[float, float, float, float],
    metres_per_px: float,
) -> None:
    """Writes `path`, a YAML file, and the image beside it with the same stem.

    Args:
      path: ends in .yaml.
      cells: -1 unknown, 0 free, 100 occupied; rows run along falling y, as those of a `FloorMap`.
      extent: x_min, x_max, y_min, y_max of the outer edges of the cells in the map, m.
      metres_per_px: side of a cell.

    Raises:
      OSError: a file cannot be written.
    """
    path = Path(path)
    grey = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    for value, shade in GREY.items():
        grey[cells == value] = shade
    done, content = cv2.imencode(".png", grey)
    assert done, path
    image = path.with_suffix(".png")
    values = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(metres_per_px),
        # The corner of the lower left cell: what map_server publishes as the origin of an OccupancyGrid.
        "origin": [float(extent[0]), float(extent[2]), 0.0],
        "negate": 0,
        **THRESHOLDS,
    }
    with whole_file(image, "wb") as file:
        file.write(content.tobytes())
    with whole_file(path) as file:
        yaml.safe_dump(values, file, sort_keys=False, default_flow_style=None)
