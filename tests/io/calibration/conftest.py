import pytest

from ebjax.io.calibration.read import read_calibration


@pytest.fixture
def read(tmp_path):
    """Writes a text into a file without a telling name and reads it."""

    def written(text, **options):
        content = text if isinstance(text, bytes) else text.encode()
        (tmp_path / "camera.calibration").write_bytes(content)
        return read_calibration(tmp_path / "camera.calibration", **options)

    return written
