import numpy as np
import pytest

from ebjax.io.logs.rvl import decode, encode


def slow_encode(depth):
    """Wilson's encoder, nibble by nibble."""
    nibbles, flat, place, previous = [], depth.reshape(-1).astype(int).tolist(), 0, 0

    def put(value):
        while True:
            nibble, value = value & 7, value >> 3
            nibbles.append(nibble | (8 if value else 0))
            if not value:
                return

    while place < len(flat):
        for is_run in (lambda v: v == 0, lambda v: v != 0):
            start = place
            while place < len(flat) and is_run(flat[place]):
                place += 1
            put(place - start)
        for value in flat[start:place]:
            difference = value - previous
            put((difference << 1) ^ (difference >> 31))
            previous = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << (28 - 4 * k) for k, n in enumerate(nibbles[i : i + 8])) for i in range(0, len(nibbles), 8)]
    return np.array(words, "<u4").tobytes()


def images():
    draw = np.random.default_rng(0)
    ramp = (1000 + 3 * np.arange(40 * 30)).reshape(30, 40)
    yield ramp
    yield np.where(draw.random((30, 40)) < 0.3, 0, ramp)
    yield np.zeros((5, 7))
    yield np.full((5, 7), 65535)
    yield draw.integers(0, 65536, (17, 23))
    yield np.where(np.arange(12 * 9).reshape(12, 9) == 50, 700, 0)


@pytest.mark.parametrize("image", [image.astype(np.uint16) for image in images()])
def test_a_round_trip_agrees_with_the_slow_encoder(image):
    payload = encode(image)
    assert payload == slow_encode(image)
    np.testing.assert_array_equal(decode(payload, image.shape[1], image.shape[0]), image)


def test_a_cut_or_wrong_stream_is_refused():
    image = np.full((30, 40), 900, np.uint16)
    payload = encode(image)
    with pytest.raises(ValueError, match="truncated"):
        decode(payload[: len(payload) // 2], 40, 30)
    with pytest.raises(ValueError, match="truncated"):
        decode(b"", 40, 30)
    with pytest.raises(ValueError, match="damaged"):
        decode(payload, 10, 10)
    with pytest.raises(ValueError, match="empty run"):
        decode(bytes(64), 40, 30)


@pytest.mark.parametrize("width, height", [(2**14, 2**13), (2**32 - 1, 1), (2**32 - 1, 2**32 - 1)])
def test_a_few_bytes_for_more_pixels_than_a_camera_has_are_refused(width, height):
    missing = encode(np.zeros((8, 8), np.uint16))
    with pytest.raises(ValueError, match=f"damaged RVL depth of {width} x {height} px"):
        decode(missing, width, height)
    assert decode(encode(np.zeros((2**10, 2**12), np.uint16)), 2**12, 2**10).size == 2**22


def test_a_real_image_of_rtabmap(data):
    sqlite3 = pytest.importorskip("sqlite3")
    path = data("logs/rtabmap/corridor_v0.23.8_86_nodes.db")
    base = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    (blob,) = base.execute("SELECT depth FROM Data LIMIT 1").fetchone()
    base.close()
    assert blob[:8] == b"DEPTHRVL"
    width, height = np.frombuffer(blob, "<u4", 2, 8).tolist()
    depth = decode(blob[16:], width, height)
    assert 500 < np.median(depth[depth > 0]) < 10000
    assert encode(depth) == blob[16:]
