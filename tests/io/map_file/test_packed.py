"""Arrays come back bit for bit from a blob that is hardly larger, and no other bytes are taken for one."""

import numpy as np
import pytest

from ebjax.io.map_file.packed import ALIGNMENT, pack, unpack

DTYPES = ("?", "i1", "<i4", ">i4", "u1", "<u8", "f2", "<f4", ">f8", "c8", "S3", "U2")


@pytest.mark.parametrize("seed", range(20))
def test_any_arrays_come_back(seed):
    rng = np.random.default_rng(seed)
    arrays = {}
    for k in range(rng.integers(0, 6)):
        shape = tuple(rng.integers(0, 5, rng.integers(0, 4)).tolist())
        dtype = np.dtype(DTYPES[rng.integers(len(DTYPES))])
        content = rng.integers(0, 2 if dtype.kind in "?b" else 100, shape)
        arrays[f"array ä {k}"] = content.astype(dtype)[..., ::-1] if shape else content.astype(dtype)
    found = unpack(pack(arrays))
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype.newbyteorder("<") and found[name].flags.c_contiguous


def test_bits_alignment_and_size():
    arrays = {
        "odd": np.zeros(7, np.uint8),
        "exact": np.array([-0.0, np.nan, -np.inf, 5e-324]),
        "floor": np.ones((200, 200), bool),
        "map": np.random.default_rng(0).integers(-127, 128, (40, 40, 64)).astype(np.int8),
    }
    blob = pack(arrays)
    found = unpack(blob)
    assert found["exact"].tobytes() == arrays["exact"].tobytes()
    assert all(found[name].ctypes.data % ALIGNMENT == 0 for name in ("odd", "exact", "map"))
    assert len(blob) < arrays["map"].nbytes + 500, "a mask and the header take next to nothing"
    with pytest.raises(ValueError, match="read-only"):
        found["map"][0] = 1


@pytest.mark.parametrize("array", [np.array([None]), np.zeros(2, "datetime64[s]"), np.zeros(2, "V4")])
def test_types_that_are_not_plain_are_refused(array):
    with pytest.raises(ValueError, match=r"array 'odd' is of type .*; convert it to one of NumPy's plain types"):
        pack({"odd": array})


def test_other_bytes_are_refused_and_never_run_away():
    blob = pack({"a": np.arange(5), "b": np.ones(300, bool)})
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="not arrays as a map packs them"):
        unpack(b"")
    for cut in range(1, len(blob), 7):
        with pytest.raises(ValueError, match="not arrays"):
            unpack(blob[:-cut])
    for _ in range(300):
        changed = bytearray(blob)
        changed[rng.integers(len(blob))] ^= int(rng.integers(1, 256))
        try:
            assert isinstance(unpack(bytes(changed)), dict)
        except ValueError as fault:
            assert str(fault) == "not arrays as a map packs them"
