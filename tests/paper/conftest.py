import pytest

WORLD = """robot: {distance_m: 6.0, step_m: 0.4, lateral_offset_m: 0.15}
seed: 3
"""


@pytest.fixture(scope="session")
def small_worlds(tmp_path_factory):
    """A folder with one world, W, 6 m there and back."""
    folder = tmp_path_factory.mktemp("worlds")
    (folder / "W.yaml").write_text(WORLD)
    return folder
