import cv2
import numpy as np
import pytest

from ebjax.io.mask import alpha_mask, read_mask

Image = pytest.importorskip("PIL.Image")
SIZE = 64, 48
IGNORED = np.zeros((48, 64), bool)
IGNORED[36:, :50] = True
USED = np.where(IGNORED, 0, 255).astype(np.uint8)
GREY = np.full((48, 64, 3), 90, np.uint8)


@pytest.mark.parametrize(
    "image",
    [
        USED,
        USED // 255,
        USED.astype(np.uint16) * 257,
        np.repeat(USED[..., None], 3, axis=2),
        np.dstack([GREY, USED]),
        np.dstack([np.repeat(USED[..., None], 3, axis=2), np.full((48, 64), 255, np.uint8)]),
        np.dstack([GREY, USED]).astype(np.uint16) * 257,
    ],
    ids=["0 and 255", "0 and 1", "16 bits", "colour", "alpha", "opaque", "16 bits of alpha"],
)
def test_black_or_transparent_is_ignored(tmp_path, image):
    cv2.imwrite(str(tmp_path / "mask.png"), image)
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png", SIZE)[0], IGNORED)


def test_one_bit_and_jpeg(tmp_path):
    cv2.imwrite(str(tmp_path / "mask.png"), USED, [cv2.IMWRITE_PNG_BILEVEL, 1])
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png", SIZE)[0], IGNORED)
    cv2.imwrite(str(tmp_path / "mask.jpg"), USED, [cv2.IMWRITE_JPEG_QUALITY, 60])
    assert (read_mask(tmp_path / "mask.jpg", SIZE)[0] == IGNORED).mean() > 0.99


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P"])
def test_a_mask_is_as_stored_unless_only_turned_it_fits(tmp_path, mode, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(USED).convert(mode).save(tmp_path / "mask.png", exif=exif)
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png", SIZE)[0], IGNORED)
    if orientation < 5:
        with pytest.raises(ValueError, match="64x48 pixels, but the images have 48x64"):
            read_mask(tmp_path / "mask.png", SIZE[::-1])
    else:
        turned = np.rot90(IGNORED, -1 if orientation == 6 else 1)
        np.testing.assert_array_equal(read_mask(tmp_path / "mask.png", SIZE[::-1])[0], turned)


def test_another_resolution_of_the_same_shape_is_scaled(tmp_path):
    cv2.imwrite(str(tmp_path / "mask.png"), USED)
    assert read_mask(tmp_path / "mask.png", SIZE)[1] == ()
    large, notes = read_mask(tmp_path / "mask.png", (640, 480))
    assert notes == (f"{tmp_path / 'mask.png'}: a mask of 64x48 pixels, scaled to the images' 640x480",)
    np.testing.assert_array_equal(large, np.kron(IGNORED, np.ones((10, 10), bool)))
    # 97 / 2 is no whole number of pixels.
    assert read_mask(tmp_path / "mask.png", (129, 97))[0].shape == (97, 129)
    cv2.imwrite(str(tmp_path / "large.png"), (~large).astype(np.uint8))
    np.testing.assert_array_equal(read_mask(tmp_path / "large.png", SIZE)[0], IGNORED)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (USED.T, r"mask\.png: 48x64 pixels, but the images have 64x48; give a mask of that size"),
        (np.vstack([USED, USED[:3]]), r"mask\.png: 64x51 pixels, but the images have 64x48"),
        (np.zeros_like(USED), r"mask\.png: ignores every pixel; make it black \(or transparent\) where .* no floor"),
        (np.full_like(USED, 255), r"mask\.png: ignores no pixel; make it black"),
        (b"not an image", r"mask\.png: not an image"),
        (None, r"mask\.png: no such file"),
    ],
    ids=["turned", "shape", "all black", "all white", "text", "absent"],
)
def test_wrong_masks_are_refused(tmp_path, content, words):
    path = tmp_path / "mask.png"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes())
    with pytest.raises(ValueError, match=words) as raised:
        read_mask(path, SIZE)
    assert "\n" not in str(raised.value)


def write_run(folder, alphas, suffix="png"):
    paths = []
    for i, alpha in enumerate(alphas):
        paths.append(folder / f"{i}.{suffix}")
        cv2.imwrite(str(paths[-1]), GREY if alpha is None else np.dstack([GREY, alpha]))
    return paths


def test_alpha_of_a_run_is_what_all_its_images_leave_out(tmp_path):
    corner = np.zeros_like(IGNORED)
    corner[:5, :5] = True
    alphas = [np.where(IGNORED | (corner if i else False), 0, 255).astype(np.uint8) for i in range(30)]
    paths = write_run(tmp_path, alphas)
    np.testing.assert_array_equal(alpha_mask(paths, SIZE), IGNORED)
    np.testing.assert_array_equal(alpha_mask([str(p) for p in paths[3:4]], SIZE), IGNORED | corner)
    paths[-1].write_bytes(b"broken")
    np.testing.assert_array_equal(alpha_mask([*paths, tmp_path / "absent.png"], SIZE), IGNORED)
    np.testing.assert_array_equal(alpha_mask(write_run(tmp_path, alphas, "webp"), SIZE), IGNORED)


def test_alpha_that_says_nothing(tmp_path):
    zero, opaque = np.zeros((48, 64), np.uint8), np.full((48, 64), 255, np.uint8)
    for alphas in [None] * 3, [zero] * 3, [opaque] * 3, [USED, None, USED]:
        assert alpha_mask(write_run(tmp_path, alphas), SIZE) is None
    assert alpha_mask(write_run(tmp_path, [USED] * 3), (640, 480)) is None
    assert alpha_mask([], SIZE) is None


def test_jpeg_and_rgb_png_are_not_decoded(tmp_path, monkeypatch):
    paths = [*write_run(tmp_path, [None] * 9, "jpg"), *write_run(tmp_path, [None] * 9)]
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    assert alpha_mask(paths[:9], SIZE) is None
    assert alpha_mask(paths[9:], SIZE) is None
