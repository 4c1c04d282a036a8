import cv2
import numpy as np
import pytest
import yaml

from ebjax.viz.nav2_map import write_nav2_map

CELLS = np.array([[0, 0, -1, -1], [0, 100, -1, 0], [100, -1, -1, -1]], np.int8)


def map_server_reads(path):
    """nav2_map_server's loadMapYaml and loadMapFromFile in trinary mode: cells from the lower left corner upwards."""
    said = yaml.safe_load(path.read_text())
    assert said["mode"] == "trinary" and len(said["origin"]) == 3
    image = cv2.imread(str(path.parent / said["image"]), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint8 and image.ndim == 2  # an alpha channel would be averaged in
    shade = image / 255.0
    occupied = shade if said["negate"] else 1.0 - shade
    cells = np.full(image.shape, -1, np.int8)
    cells[occupied < said["free_thresh"]] = 0
    cells[said["occupied_thresh"] < occupied] = 100
    return cells[::-1], said["resolution"], said["origin"]


def cell_at(grid, resolution, origin, x, y):
    """As costmap_2d's worldToMap: the origin is the corner of the first cell."""
    assert origin[2] == 0
    return grid[int((y - origin[1]) // resolution), int((x - origin[0]) // resolution)]


@pytest.mark.parametrize("corner, resolution", [((0.0, 0.0), 1.0), ((-3.217, 12.5), 0.02), ((100.1, -7.0), 0.05)])
def test_map_server_reads_each_cell_where_it_lies(tmp_path, corner, resolution):
    height, width = CELLS.shape
    extent = (corner[0], corner[0] + width * resolution, corner[1], corner[1] + height * resolution)
    write_nav2_map(tmp_path / "floor.yaml", CELLS, extent, resolution)
    found = map_server_reads(tmp_path / "floor.yaml")
    for row in range(height):
        for column in range(width):
            x, y = extent[0] + (column + 0.5) * resolution, extent[3] - (row + 0.5) * resolution
            assert cell_at(*found, x, y) == CELLS[row, column]


def test_the_image_is_named_beside_its_yaml(tmp_path):
    write_nav2_map(tmp_path / "new" / "my: map.yaml", CELLS, (0.0, 4.0, 0.0, 3.0), 1.0)
    assert sorted(file.name for file in (tmp_path / "new").iterdir()) == ["my: map.png", "my: map.yaml"]
    np.testing.assert_array_equal(map_server_reads(tmp_path / "new" / "my: map.yaml")[0][::-1], CELLS)
