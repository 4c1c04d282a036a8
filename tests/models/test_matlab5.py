"""The reader of MATLAB's version 5 against SciPy's, on random nested values."""

import struct

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from ebjax.models.matlab5 import Cells, Structs, read_variable

TYPES = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "c16")


def _cell(items):
    cell = np.empty((1, len(items)), object)
    for k, item in enumerate(items):
        cell[0, k] = item
    return cell


def _value(draw, depth=0):
    """An array of any type and shape, or a cell array or struct of values."""
    kind = draw.choice(["array", "array", "cell", "struct"]) if depth < 4 else "array"
    if kind == "array":
        shape = draw.integers(0, 5, draw.integers(2, 5))
        return draw.integers(0, 100, shape).astype(str(draw.choice(TYPES)))
    parts = [_value(draw, depth + 1) for _ in range(draw.integers(1, 4))]
    return _cell(parts) if kind == "cell" else {f"field_{'x' * k}": part for k, part in enumerate(parts)}


def _same(found, expected):
    """`expected` is what SciPy reads."""
    if expected.dtype.names is not None:
        assert isinstance(found, Structs) and len(found.parts) == expected.size
        for part, row in zip(found.parts, expected.reshape(-1, order="F"), strict=True):
            assert tuple(part) == expected.dtype.names
            for name in part:
                _same(part[name], row[name])
    elif expected.dtype == object:
        assert isinstance(found, Cells) and len(found.parts) == expected.size
        for part, other in zip(found.parts, expected.reshape(-1, order="F"), strict=True):
            _same(part, other)
    else:
        assert found.shape == expected.shape and found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("seed", range(60))
def test_agrees_with_scipy(tmp_path, seed):
    draw, path = np.random.default_rng(seed), tmp_path / "x.mat"
    others = {"other": np.ones((2, 3)), "words": "text"} if seed % 2 else {}
    savemat(path, {**others, "net": _value(draw)}, do_compression=seed % 3 == 0)
    _same(read_variable(path, "net"), loadmat(path)["net"])


def test_classes_that_hold_no_numbers_are_none(tmp_path):
    from scipy.sparse import csc_matrix

    savemat(tmp_path / "x.mat", {"net": {"words": "text", "sparse": csc_matrix(np.eye(3)), "kept": np.ones((1, 2))}})
    (net,) = read_variable(tmp_path / "x.mat", "net").parts
    assert net["words"] is None and net["sparse"] is None
    np.testing.assert_array_equal(net["kept"], np.ones((1, 2)))
    with pytest.raises(ValueError, match="no variable 'other'"):
        read_variable(tmp_path / "x.mat", "other")


def test_big_endian(tmp_path):
    def element(kind, content):
        return struct.pack(">2I", kind, len(content)) + content + bytes(-len(content) % 8)

    parts = element(6, struct.pack(">2I", 7, 0)) + element(5, struct.pack(">2i", 1, 3)) + element(1, b"net")
    parts += element(7, struct.pack(">3f", 1.5, -2, 3))
    (tmp_path / "x.mat").write_bytes(b"MATLAB 5.0".ljust(124) + b"\1\0MI" + element(14, parts))
    found = read_variable(tmp_path / "x.mat", "net")
    np.testing.assert_array_equal(found, np.array([[1.5, -2, 3]], np.float32))
    assert found.dtype == np.float32


def test_damage_is_a_value_error(tmp_path):
    savemat(tmp_path / "x.mat", {"net": {"layers": _cell([np.ones((3, 3)), {"a": np.zeros((2, 2), np.int8)}])}})
    whole = (tmp_path / "x.mat").read_bytes()
    draw = np.random.default_rng(0)
    for place in range(128, len(whole) - 4, 8):
        place += int(draw.choice([0, 4]))
        for value in (0, 14, 2**32 - 1, int(draw.integers(2**32))):
            (tmp_path / "y.mat").write_bytes(whole[:place] + struct.pack("<I", value) + whole[place + 4 :])
            try:
                read_variable(tmp_path / "y.mat", "net")
            except ValueError as error:
                assert "\n" not in str(error)
