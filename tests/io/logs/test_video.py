import random
import struct
import sys
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import cv2
import numpy as np
import pytest

from ebjax.io.images import BrokenFrame
from ebjax.io.logs.video import open_video
from ebjax.io.logs.video_frames import VideoFrames
from ebjax.io.logs.video_source import VideoFacts
from ebjax.io.logs.video_times import clock, times_of_frames
from ebjax.io.opencv_log import set_log_level

BITS, WIDTH, HEIGHT = 10, 160, 64
GAPS_MS = [33, 20, 50, 400]


def picture(index):
    """A strip of bars, which are the index in binary."""
    bars = np.array([255 * (index >> bit & 1) for bit in range(BITS)], np.uint8)
    return np.repeat(np.tile(np.repeat(bars, WIDTH // BITS), (HEIGHT, 1))[:, :, None], 3, axis=2)


def index_of(image):
    return sum(int(bar > 128) << bit for bit, bar in enumerate(image[HEIGHT // 2, 8 :: WIDTH // BITS, 0]))


def write(path, count, codec="mp4v", rate=20, painted=picture):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate, (WIDTH, HEIGHT))
    for index in range(count):
        writer.write(painted(index))
    writer.release()
    return path


def write_by_av(path, codec, count=300, gaps_ms=(50,), **options):
    av = pytest.importorskip("av")
    try:
        av.codec.Codec(codec, "w")
    except Exception:
        pytest.skip(f"this PyAV has no encoder {codec}")
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=20)
        stream.width, stream.height, stream.pix_fmt, stream.options = WIDTH, HEIGHT, "yuv420p", options
        stream.codec_context.time_base = Fraction(1, 1000)
        time = 0
        for index in range(count):
            frame = av.VideoFrame.from_ndarray(picture(index), format="rgb24")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            time += gaps_ms[index % len(gaps_ms)]
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def with_rotation_tag(path, degrees):
    """Writes the turn into the display matrix of an MP4's track header."""
    content = bytearray(path.read_bytes())
    cos, sin = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    matrix = [cos << 16, sin << 16, 0, -sin * 65536, cos << 16, 0, 0, 0, 1 << 30]
    start = content.index(b"tkhd") + 44
    content[start : start + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(content)
    return path


def check_access(images):
    """Each frame is itself: in order, at random, backwards."""
    count = len(images)
    assert [index_of(images.decode(index)) for index in range(count)] == list(range(count))
    for index in [*random.Random(0).sample(range(count), 25), *range(count - 1, count - 6, -1), 0]:
        assert index_of(images.decode(index)) == index


@pytest.mark.parametrize("name, codec", [("a.avi", "MJPG"), ("a.mp4", "mp4v")])
def test_frames_are_found_in_any_order(tmp_path, name, codec):
    log = open_video(write(tmp_path / name, 400, codec))
    assert log.kind == "video" and log.notes == () and len(log.colour) == 400
    np.testing.assert_allclose(log.colour.timestamps, np.arange(400) / 20, atol=1e-6)
    assert log.colour.names[247] == "0:12.350"
    assert log.contents[1:] == ("400 frames, 20 frames/s, constant rate", "duration 0:19.950")
    assert "160x64" in log.contents[0]
    assert set(log.missing) == {"camera", "mount", "odometry", "depth"} and "--camera" in log.missing["camera"]
    image = log.colour.decode(3)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    check_access(log.colour)


def test_colours_are_rgb(tmp_path):
    def red(index):
        return np.full((HEIGHT, WIDTH, 3), (0, 0, 200), np.uint8)

    assert open_video(write(tmp_path / "a.avi", 3, "MJPG", painted=red)).colour.decode(1)[0, 0, 0] > 150


def test_two_threads_read_their_own_frames(tmp_path):
    images = open_video(write(tmp_path / "a.mp4", 200)).colour
    asked = [*range(100), *random.Random(1).sample(range(200), 60), *range(199, 150, -1)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda index: index_of(images.decode(index)), asked)) == asked


@pytest.mark.parametrize(
    "name, codec, gaps_ms, options",
    [
        ("variable.mkv", "libx264", GAPS_MS, {"g": "30", "bf": "3"}),
        ("variable.mp4", "libx264", GAPS_MS, {"g": "30", "bf": "3"}),
        ("long_groups.ts", "libx264", (50,), {"g": "250", "bf": "3"}),
    ],
)
def test_variable_rate_and_b_frames(tmp_path, name, codec, gaps_ms, options):
    log = open_video(write_by_av(tmp_path / name, codec, gaps_ms=gaps_ms, **options))
    times = np.cumsum([0, *(gaps_ms[k % len(gaps_ms)] / 1000 for k in range(299))])
    np.testing.assert_allclose(log.colour.timestamps, times, atol=1e-3)
    assert log.notes == () and ("variable" in log.contents[1]) == (len(gaps_ms) > 1)
    check_access(log.colour)


def test_times_that_do_not_increase_are_left_out(tmp_path):
    path = write_by_av(tmp_path / "b.avi", "mpeg4", g="30", bf="2")
    log = open_video(path)
    assert len(log.colour) == 299 and "1 of 300 frames are left out, as their times do not" in log.notes[0]
    check_access(log.colour)
    every = open_video(path, frames_per_s=10.0)
    assert len(every.colour) == 300 and "10 frames/s, as given" in every.notes[0]
    np.testing.assert_allclose(every.colour.timestamps, np.arange(300) / 10)
    check_access(every.colour)


def test_a_stream_without_times_has_a_rate(tmp_path):
    path = write_by_av(tmp_path / "a.h264", "libx264", count=60)
    log = open_video(path, frames_per_s=30.0)
    np.testing.assert_allclose(log.colour.timestamps, np.arange(60) / 30)
    check_access(log.colour)


def test_a_rate_of_the_file_is_taken_with_a_note_if_it_can_be_one(tmp_path):
    read = np.zeros(4)
    kept, times, counted, notes = times_of_frames(tmp_path, read, VideoFacts("h264", 25.0, 0.0, 0), None)
    assert counted and kept.tolist() == [0, 1, 2, 3] and times.tolist() == [0, 0.04, 0.08, 0.12]
    assert "holds no times; 25 frames/s are taken" in notes[0] and "--frames-per-s" in notes[0]
    for rate in (0.0, 1000.0):
        with pytest.raises(ValueError, match="holds no times and no rate; give --frames-per-s"):
            times_of_frames(tmp_path, read, VideoFacts("h264", rate, 0.0, 0), None)


def test_what_opencv_cannot_decode_is_read_by_pyav(tmp_path, monkeypatch, capfd):
    path = write_by_av(tmp_path / "a.mkv", "libsvtav1", count=200, gaps_ms=GAPS_MS, g="30")
    capfd.readouterr()
    log = open_video(path)
    # The FFmpeg of OpenCV 4 complains of AV1 while it opens the file, at a level that only its first use can set.
    assert capfd.readouterr().err == "" or cv2.__version__ < "5"
    assert log.contents[0] == "codec av1, 160x64" and len(log.colour) == 200
    check_access(log.colour)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r'a\.mkv: .*pip install "ebjax\[av\]"'):
        open_video(tmp_path / "a.mkv")


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_the_rotation_tag_turns_the_pictures_in_both_decoders(tmp_path, degrees):
    pytest.importorskip("av")
    from ebjax.io.logs.video_av import PyAvVideo

    path = with_rotation_tag(write(tmp_path / "a.mp4", 5), degrees)
    log, other = open_video(path), PyAvVideo(path)
    assert f"turned by {degrees} degrees clockwise" in log.notes[0]
    other.grab()
    assert other.grab() == log.colour.timestamps[1] and other.facts().turned_deg == degrees
    image = log.colour.decode(1)
    assert index_of(np.rot90(image, degrees // 90)) == 1
    np.testing.assert_allclose(image.astype(int), other.image().astype(int), atol=3)


def test_a_video_cut_off_in_the_middle_says_so(tmp_path):
    path = write(tmp_path / "a.avi", 100, "MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    log = open_video(path)
    assert 20 < len(log.colour) < 80 and "lasts 0:05.000, but its frames end at" in log.notes[-1]


@pytest.mark.parametrize("frames", [0, 1])
def test_too_few_frames(tmp_path, frames):
    path = write(tmp_path / "a.mp4", frames)
    with pytest.raises(ValueError, match=r"a\.mp4: (no video in it|holds one picture only); give"):
        open_video(path)


def sound(path):
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as file:
        stream = file.add_stream("aac", rate=48000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate, frame.pts = 48000, 0
        file.mux(stream.encode(frame))
        file.mux(stream.encode(None))


def cut(path):
    write(path, 50)
    path.write_bytes(path.read_bytes()[:-2000])


@pytest.mark.parametrize(
    "name, make, words",
    [
        ("a.mp4", cut, r"cut off: its index \(moov atom\) is missing"),
        ("a.m4a", sound, "an audio file"),
        ("a.wav", lambda path: path.write_bytes(b"RIFF\0\0\0\0WAVEfmt " + bytes(99)), "an audio file"),
        ("a.txt", lambda path: path.write_text("1.0 rgb/0.jpg é\n" * 999), "a text"),
        ("a.mkv", lambda path: path.write_bytes(b""), "the file is empty"),
        ("a.mov", lambda path: None, "no such file"),
        ("folder", lambda path: path.mkdir(), "a folder"),
        ("a.heic", lambda path: path.write_bytes(b"\0\0\0\x18ftypheic" + bytes(99)), "a picture"),
    ],
)
def test_what_is_no_video_is_refused_in_one_quiet_line(tmp_path, capfd, name, make, words):
    make(tmp_path / name)
    capfd.readouterr()
    with pytest.raises(ValueError, match=rf"{name}: ({words})") as caught:
        open_video(tmp_path / name)
    assert "\n" not in str(caught.value) and capfd.readouterr().err == ""


def test_a_rate_must_be_positive(tmp_path):
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"--frames-per-s: .*above 0"):
            open_video(tmp_path / "a.mp4", frames_per_s=rate)


def test_noise_is_no_video(tmp_path):
    (tmp_path / "a.avi").write_bytes(bytes(range(256)) * 99)
    with pytest.raises(ValueError, match=r"a\.avi: (not a video|OpenCV finds no picture)"):
        open_video(tmp_path / "a.avi")


def test_opening_leaves_the_log_level_as_it_was(tmp_path):
    before = set_log_level(2)
    open_video(write(tmp_path / "a.mp4", 3))
    assert set_log_level(before) == 2


def test_a_frame_that_cannot_be_decoded_is_named(tmp_path):
    path = write(tmp_path / "a.mp4", 30)
    images = open_video(path).colour
    write(path, 20)
    images.decode(19)
    with pytest.raises(BrokenFrame, match=r"a\.mp4 at 0:01\.250: the frame cannot be decoded"):
        images.decode(25)
    assert index_of(images.decode(3)) == 3


class Stubborn:
    """A source whose jumps all end at the same frame, far ahead."""

    opened = 0

    def __init__(self):
        Stubborn.opened += 1
        self.at = -1

    def facts(self):
        return VideoFacts("", 10.0, 100.0, 0)

    def grab(self):
        self.at += 1
        return self.at / 10 if self.at < 1000 else None

    def seek(self, time_s):
        self.at = 990

    def image(self):
        return np.full((1, 1, 3), self.at // 10, np.uint8)


def test_a_video_that_jumps_wrongly_is_read_from_its_start():
    frames = VideoFrames(Stubborn, np.arange(1000) / 10, counted=False)
    for index in (0, 900, 950, 20, 40, 500):
        assert frames.read(index)[0, 0, 0] == index // 10
    # 900 lies far ahead of 0 and 20 behind 950; after the first vain jump the video goes on without any.
    assert Stubborn.opened == 3


def test_clock():
    assert [clock(time) for time in (0.0, 12.3451, 59.9999, 3723.5)] == [
        "0:00.000",
        "0:12.345",
        "1:00.000",
        "1:02:03.500",
    ]


def test_real_video(data):
    log = open_video(data("logs/robot_video/carpet_320x240.avi"))
    images = log.colour
    assert len(images) == 1631 and log.notes == ()
    assert log.contents == ("codec FMP4, 320x240", "1631 frames, 24 frames/s, constant rate", "duration 1:07.917")
    chosen = [0, 7, 300, 301, 900, 1630]
    seen = [images.decode(index) for index in chosen]
    for index, image in reversed(list(zip(chosen, seen, strict=True))):
        np.testing.assert_array_equal(images.decode(index), image)
    assert not np.array_equal(seen[2], seen[3]) and seen[0].shape == (240, 320, 3)
