import cv2
import numpy as np
import pytest

from ebjax.io.image_folder import list_images


def paint(path):
    assert cv2.imwrite(str(path), np.zeros((4, 6), np.uint8))


def test_only_images_in_natural_order(tmp_path):
    for name in ("b10.png", "b2.png", "Größe 1.JPG", ".hidden.png"):
        paint(tmp_path / name) if not name.startswith(".") else (tmp_path / name).touch()
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "notes.txt").touch()
    (tmp_path / "link.png").symlink_to(tmp_path / "b2.png")
    (tmp_path / "lost.png").symlink_to(tmp_path / "nowhere.png")
    assert [path.name for path in list_images(tmp_path)] == ["b2.png", "b10.png", "Größe 1.JPG", "link.png", "lost.png"]


@pytest.mark.parametrize(
    "suffix, kind", [("heic", "a HEIC image"), ("DNG", "a camera's raw picture"), ("exr", "an OpenEXR")]
)
def test_images_that_are_not_read_are_named_with_their_conversion(tmp_path, suffix, kind):
    for name in ("img 10", "img 9"):
        (tmp_path / f"{name}.{suffix}").touch()
    with pytest.raises(ValueError, match=rf"2 such as img 9\.{suffix}, {kind}.*, are not read: convert .*magick '.*'"):
        list_images(tmp_path)
    paint(tmp_path / "img 9.png")
    assert len(list_images(tmp_path)) == 1
