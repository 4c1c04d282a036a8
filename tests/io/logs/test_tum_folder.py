import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.io.logs.camera import calibration_of, camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import open_log
from ebjax.io.sequence import BrokenFrame, read_sequence
from ebjax.logs.convert import convert

Image = pytest.importorskip("PIL.Image")
WIDTH, HEIGHT, FRAMES = 32, 24, 4
CAMERA = {"fx": 40.0, "fy": 40.0, "cx": 15.5, "cy": 11.5, "width": WIDTH, "height": HEIGHT, "depth_scale": 1000}
MOUNT = [[0, 0, 1, 0.27], [-1, 0, 0, 0], [0, -1, 0, 0.54], [0, 0, 0, 1]]
UPRIGHT = MountOptions(height_m=0.5, pitch_deg=20.0)


def picture(k, width=WIDTH, height=HEIGHT):
    rows, columns = np.mgrid[:height, :width]
    return np.stack([rows * 5, columns * 5, np.full_like(rows, 20 * k)], axis=2).astype(np.uint8)


def write_camera(folder, **changes):
    (folder / "camera.json").write_text(json.dumps(CAMERA | {"T_base_camera": MOUNT} | changes))


def edit_images(folder, change):
    for path in sorted((folder / "rgb").iterdir()):
        change(path)


@pytest.fixture
def folder(tmp_path):
    """Four frames at 2 Hz with depth of k + 1 metres, rgb.txt and camera.json."""
    for name in ("rgb", "depth"):
        (tmp_path / name).mkdir()
        rows = "".join(f"{100 + k / 2} {name}/{k}.png\n" for k in range(FRAMES))
        (tmp_path / f"{name}.txt").write_text(rows)
    for k in range(FRAMES):
        Image.fromarray(picture(k)).save(tmp_path / "rgb" / f"{k}.png")
        cv2.imwrite(str(tmp_path / "depth" / f"{k}.png"), np.full((HEIGHT, WIDTH), 1000 * (k + 1), np.uint16))
    write_camera(tmp_path)
    return tmp_path


def check_frames(run):
    assert len(run) == FRAMES
    np.testing.assert_array_equal(run.timestamps, [100, 100.5, 101, 101.5])
    for k in range(FRAMES):
        np.testing.assert_array_equal(run.rgb(k), picture(k))
        np.testing.assert_array_equal(run.depth(k), k + 1)


def notes_of(run):
    return [note for note in run.notes if "odometry" not in note]


def test_a_plain_folder_has_nothing_to_note(folder):
    run = read_sequence(folder)
    check_frames(run)
    assert notes_of(run) == []


@pytest.mark.parametrize("factor", [2, 3, 0.5])
def test_a_calibration_at_another_resolution_is_scaled_and_it_is_said(folder, factor):
    right = read_sequence(folder).camera
    scaled = {key: CAMERA[key] * factor for key in ("fx", "fy", "width", "height")}
    centre = {key: (CAMERA[key] + 0.5) * factor - 0.5 for key in ("cx", "cy")}
    write_camera(folder, **scaled, **centre)
    run = read_sequence(folder)
    check_frames(run)
    np.testing.assert_allclose(run.camera.intrinsics, right.intrinsics, atol=1e-12)
    width, height = int(WIDTH * factor), int(HEIGHT * factor)
    assert notes_of(run) == [f"{folder / 'camera.json'}: {width} x {height} px, scaled to the images' 32 x 24"]
    assert camera_of(open_log(folder))[1] == tuple(notes_of(run))


@pytest.mark.parametrize("size", [(WIDTH, 18), (HEIGHT, WIDTH), (31, 30)])
def test_a_calibration_of_another_shape_is_refused_by_its_file(folder, size):
    write_camera(folder, width=size[0], height=size[1])
    words = rf"camera\.json: a camera of {size[0]} x {size[1]} px, but the images have 32 x 24, another shape; give the"
    with pytest.raises(ValueError, match=words):
        read_sequence(folder)
    (folder / "right.json").write_text(json.dumps(CAMERA | {"T_base_camera": MOUNT}))
    camera, _ = camera_of(open_log(folder), folder / "right.json")
    check_frames(read_sequence(folder, camera=camera))


@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
def test_pixels_lie_as_the_calibration_has_them_whatever_exif_asks(folder, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    edit_images(folder, lambda path: Image.open(path).save(path, exif=exif))
    run = read_sequence(folder)
    check_frames(run)
    assert len(notes_of(run)) == 1 and f"the EXIF orientation {orientation}; they are read as stored" in run.notes[0]


@pytest.mark.parametrize("orientation, turns", [(6, -1), (8, 1)])
def test_pixels_are_turned_where_only_so_they_fit_the_calibration(folder, tmp_path_factory, orientation, turns):
    exif = Image.Exif()
    exif[0x0112] = orientation
    edit_images(folder, lambda path: Image.open(path).save(path, exif=exif))
    write_camera(folder, width=HEIGHT, height=WIDTH)
    run = read_sequence(folder, depth=False)
    for k in range(FRAMES):
        np.testing.assert_array_equal(run.rgb(k), np.rot90(picture(k), turns))
    assert "read turned so, as the camera's shape is that of 24x32" in notes_of(run)[0] and len(notes_of(run)) == 1
    out = tmp_path_factory.mktemp("converted") / "run"
    log = open_log(folder, depth=False)
    convert(log, camera_of(log)[0], out)
    again = read_sequence(out, depth=False)
    assert notes_of(again) == [] and again.rgb(0).shape == (WIDTH, HEIGHT, 3)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_brightness_does_not_jump_from_frame_to_frame(folder, bits):
    for k in range(FRAMES):
        grey = np.full((HEIGHT, WIDTH), (1 << bits) // (4 * (FRAMES - k)), np.uint16)
        grey[0, 0] = (1 << bits) - 1 if k == 2 else 0
        cv2.imwrite(str(folder / "rgb" / f"{k}.png"), grey)
    run = read_sequence(folder)
    assert [int(run.rgb(k)[5, 5, 0]) for k in range(FRAMES)] == [16, 21, 32, 64]
    kept = "the upper 8 are used" if bits == 16 else f"{bits} are in use, scaled to 8 alike in all"
    assert f"4 of 4 images looked at have more than 8 bits: of 16, {kept}" in notes_of(run)[0]


def test_transparent_images_are_noted_opaque_ones_not(folder):
    for alpha in (255, 100):
        for k in range(FRAMES):
            pixels = np.dstack([picture(k), np.full((HEIGHT, WIDTH), alpha, np.uint8)])
            Image.fromarray(pixels).save(folder / "rgb" / f"{k}.png")
        run = read_sequence(folder)
        check_frames(run)
        assert ["transparent in places" in note for note in notes_of(run)] == ([] if alpha == 255 else [True])


@pytest.mark.parametrize("order", ["colour first", "depth first", "unnamed", "other file"])
def test_an_association_is_read_as_one(folder, order):
    rows = [(f"{100 + k / 2}", f"rgb/{k}.png", f"{100 + k / 2 + 0.01}", f"depth/{k}.png") for k in range(FRAMES)]
    if order == "depth first":
        rows = [(*row[2:], *row[:2]) for row in rows]
    if order == "unnamed":
        (folder / "depth").rename(folder / "d")
        rows = [(*row[:3], row[3].replace("depth", "d")) for row in rows]
    (folder / "depth.txt").unlink()
    (folder / "rgb.txt").unlink()
    path = folder / ("associations.txt" if order == "other file" else "rgb.txt")
    path.write_text("".join(" ".join(row) + "\n" for row in rows))
    run = read_sequence(folder)
    check_frames(run)
    said = "depth and colour" if order == "depth first" else "colour and depth"
    assert notes_of(run) == [f"{path}: its four columns are an association of {said} (associate.py), read as such"]


def test_an_association_of_two_colour_cameras_is_refused(folder):
    (folder / "rgb.txt").write_text("".join(f"{k} rgb/{k}.png {k} rgb/{k}.png\n" for k in range(FRAMES)))
    with pytest.raises(ValueError, match=r"rgb\.txt: four columns, neither of depth; write colour into rgb\.txt and"):
        open_log(folder)


@pytest.mark.parametrize("prefix", ["/media/stick/run/", "C:\\data\\run\\", "../elsewhere/"])
def test_a_folder_that_was_moved_is_found(folder, prefix):
    for name in ("rgb", "depth"):
        rows = "".join(f"{100 + k / 2} {prefix}{name}/{k}.png\n" for k in range(FRAMES))
        (folder / f"{name}.txt").write_text(rows.replace("/", "\\") if "\\" in prefix else rows)
    run = read_sequence(folder)
    check_frames(run)
    assert [note.partition(": ")[2] for note in notes_of(run)] == [
        f"its images are not where it says; taken from {folder / name}" for name in ("rgb", "depth")
    ]


def test_images_that_are_nowhere_are_named_and_the_remedy_works(folder):
    shutil.move(folder / "rgb", folder / "away")
    with pytest.raises(
        ValueError, match=r"rgb\.txt: none of 4 images looked at is there, first .*rgb/0\.png: no such file; put"
    ):
        open_log(folder)
    shutil.move(folder / "away", folder / "rgb")
    check_frames(read_sequence(folder))


@pytest.mark.parametrize(
    "content, words", [(b"", "the file is empty"), (b"\0\0\0\x18ftypheic", "a HEIC image, .*magick")]
)
def test_images_that_fail_alike_are_named_by_their_cause(folder, content, words):
    edit_images(folder, lambda path: path.write_bytes(content))
    with pytest.raises(
        ValueError, match=rf"rgb\.txt: none of 4 images looked at can be read; first .*0\.png: {words}"
    ) as error:
        open_log(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "depth, words",
    [
        (np.full((HEIGHT, WIDTH), 9, np.uint8), r"0\.png: 1 channel\(s\) of uint8; depth is one channel of 16 bits"),
        (np.full((HEIGHT, WIDTH, 3), 9, np.uint8), r"3 channel\(s\) of uint8.*a picture of depth in colours"),
        (
            np.full((21, 25), 900, np.uint16),
            r"of 25x21 pixels, another shape than the colour images' 32x24: .*register",
        ),
    ],
    ids=["8 bits", "colours", "shape"],
)
def test_depth_that_fails_alike_is_named_by_its_cause(folder, depth, words):
    for k in range(FRAMES):
        cv2.imwrite(str(folder / "depth" / f"{k}.png"), depth)
    with pytest.raises(ValueError, match=rf"depth\.txt: .*{words}.* with --depth none") as error:
        open_log(folder)
    assert "\n" not in str(error.value)
    assert len(read_sequence(folder, depth=False)) == FRAMES


@pytest.mark.parametrize("scale", [1, 1000])
def test_depth_of_floats_is_metres_unless_that_is_absurd(folder, scale):
    for k in range(FRAMES):
        cv2.imwrite(str(folder / "depth" / f"{k}.tiff"), np.full((HEIGHT, WIDTH), scale * (k + 1), np.float32))
    (folder / "depth.txt").write_text((folder / "depth.txt").read_text().replace(".png", ".tiff"))
    run = read_sequence(folder)
    check_frames(run)
    unit = "metres" if scale == 1 else "1/1000 m"
    assert notes_of(run) == [f"{folder / 'depth.txt'}: depth images of floating-point numbers, read as {unit}"]


SENSOR = """sensor_type: camera
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
resolution: [32, 24]
camera_model: pinhole
intrinsics: [40.0, 40.0, 15.5, 11.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.01, 0.0, 0.0]
"""


@pytest.mark.parametrize("part", [".", "cam0", "mav0/cam0"])
def test_a_folder_in_euroc_layout(folder, part, tmp_path_factory):
    root = tmp_path_factory.mktemp("euroc")
    camera = root / part
    camera.mkdir(parents=True, exist_ok=True)
    shutil.copytree(folder / "rgb", camera / "data")
    rows = "".join(f"{100_000_000_000 + 500_000_000 * k},{k}.png\r\n" for k in range(FRAMES))
    (camera / "data.csv").write_text("#timestamp [ns],filename\r\n" + rows)
    (camera / "sensor.yaml").write_text(SENSOR)
    log = open_log(root)
    assert log.kind == "folder in EuRoC layout" and "stamps are nanoseconds" in log.notes[0]
    with pytest.raises(
        ValueError, match=r"sensor\.yaml: nothing says how the camera is mounted; measure and give --mount"
    ):
        read_sequence(log)
    mounted, _ = camera_of(log, mount=UPRIGHT)
    assert mounted.distortion_model == "plumb_bob" and mounted.intrinsics[0, 0] == 40
    run = read_sequence(log, camera=mounted)
    np.testing.assert_array_equal(run.timestamps, [100, 100.5, 101, 101.5])
    np.testing.assert_array_equal(run.rgb(3), picture(3))


def test_a_folder_in_kitti_layout(folder):
    for name in ("rgb.txt", "depth.txt", "camera.json"):
        (folder / name).unlink()
    (folder / "rgb").rename(folder / "image_2")
    shutil.copytree(folder / "depth", folder / "image_0")
    (folder / "times.txt").write_text("".join(f"{k / 10:e}\n" for k in range(FRAMES)))
    projection = "40 0 15.5 -3 0 40 11.5 0 0 0 1 0"
    (folder / "calib.txt").write_text(f"P0: {projection}\nP1: {projection}\n")
    log = open_log(folder)
    assert (
        log.kind == "folder in KITTI layout" and "the images of image_2 are used; image_0 are left out" in log.notes[0]
    )
    np.testing.assert_allclose(log.colour.timestamps, [0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(log.colour.decode(1), picture(1))
    np.testing.assert_array_equal(calibration_of(log).intrinsics, [[40, 0, 15.5], [0, 40, 11.5], [0, 0, 1]])
    (folder / "times.txt").write_text("0\n1\n")
    with pytest.raises(ValueError, match=r"times\.txt: 2 times for 4 images in .*image_2; give one for each image"):
        open_log(folder)
    (folder / "times.txt").write_text("0\n1\n2\n3\n")
    (folder / "calib.txt").write_text("P0: 1 2 3\n")
    with pytest.raises(ValueError, match=r"calib\.txt line 1: not twelve numbers"):
        open_log(folder)


def test_one_frame_of_another_size_is_left_out_alone(folder):
    Image.fromarray(picture(1, 16, 12)).save(folder / "rgb" / "1.png")
    run = read_sequence(folder)
    with pytest.raises(BrokenFrame, match=r"1\.png: 16x12 pixels, but most images have 32x24"):
        run.rgb(1)
    np.testing.assert_array_equal(run.rgb(2), picture(2))
