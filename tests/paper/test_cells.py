import json

import pytest

from ebjax.paper.cells import Cells


def counted(values):
    """A measurement, and how often it was made."""
    calls = []

    def measure():
        calls.append(1)
        return values

    return measure, calls


def test_a_cell_is_measured_once(tmp_path):
    measure, calls = counted({"recall": 0.5, "none": None})
    for _ in range(2):
        cells = Cells(tmp_path)
        assert cells.values("table 1 raw + flip", {"seed": 0}, measure) == {"recall": 0.5, "none": None}
    assert len(calls) == 1 and (cells.measured, cells.reused) == (0, 1)


def test_the_order_of_a_cell_is_kept(tmp_path):
    points = {"2": 1, "10": 2, "1": 3}
    for _ in range(2):
        assert list(Cells(tmp_path).values("cell", {}, lambda: points)) == ["2", "10", "1"]


def test_other_settings_are_measured_again(tmp_path):
    measure, calls = counted({"a": 1})
    Cells(tmp_path).values("cell", {"seed": 0}, measure)
    cells = Cells(tmp_path)
    cells.values("cell", {"seed": 1}, measure)
    assert len(calls) == 2 and cells.damaged == []


@pytest.mark.parametrize(
    "spoil", [lambda t: t[: len(t) // 2], lambda t: t.replace("0.5", "0.9"), lambda t: "", lambda t: "[]"]
)
def test_a_damaged_cell_is_noticed(tmp_path, spoil):
    measure, calls = counted({"recall": 0.5})
    Cells(tmp_path).values("cell", {}, measure)
    (file,) = tmp_path.glob("*.json")
    file.write_text(spoil(file.read_text()))
    cells = Cells(tmp_path)
    assert cells.values("cell", {}, measure) == {"recall": 0.5}
    assert len(calls) == 2 and cells.damaged == [file]
    assert json.loads(file.read_text())["values"] == {"recall": 0.5}


def test_what_fails_leaves_nothing(tmp_path):
    def fail():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Cells(tmp_path).values("cell", {}, fail)
    with pytest.raises(ValueError, match="JSON compliant"):
        Cells(tmp_path).values("cell", {}, lambda: {"nan": float("nan")})
    assert not list(tmp_path.iterdir())


def test_pictures_are_kept_and_checked(tmp_path):
    measure, calls = counted(b"\x89PNG")
    path = tmp_path / "out.png"
    for _ in range(2):
        assert Cells(tmp_path / "cells").picture(path, {"a": 1}, measure) == path
    assert len(calls) == 1
    path.write_bytes(b"\x89PN")
    cells = Cells(tmp_path / "cells")
    cells.picture(path, {"a": 1}, measure)
    assert len(calls) == 2 and cells.damaged == [path] and path.read_bytes() == b"\x89PNG"
    path.unlink()
    Cells(tmp_path / "cells").picture(path, {"a": 1}, measure)
    Cells(tmp_path / "cells").picture(path, {"a": 2}, measure)
    assert len(calls) == 4
