import gzip

import numpy as np
import pytest

from ebjax.io.logs.image_list import read_image_list

NANOSECONDS = ["1403636579763555584", "1403636579813555456", "1403636580000000000"]


def listed(tmp_path, text, name="rgb.txt"):
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_image_list(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        "# timestamp filename\n1.5 rgb/a.png\n2.25 rgb/b 1.png\n",
        "timestamp,filename\n1.5,rgb/a.png\n2.25,rgb/b 1.png\n",
        "1.5;rgb/a.png\r\n2.25;rgb/b 1.png\r\n",
        "1.5\trgb/a.png\n\n2.25\trgb/b 1.png",
        '"timestamp","file"\n"1.5","rgb/a.png"\n"2.25","rgb/b 1.png"\n',
        b"\xef\xbb\xbf1.5 rgb/a.png\n2.25 rgb/b 1.png\n",
        gzip.compress(b"1.5 rgb/a.png\n2.25 rgb/b 1.png\n", mtime=0),
        "1,5 rgb/a.png\n2,25 rgb/b 1.png\n",
    ],
    ids=["tum", "csv", "semicolons", "tabs", "quotes", "mark", "gzip", "decimal commas"],
)
def test_a_time_and_a_name_a_line(tmp_path, text):
    found = listed(tmp_path, text)
    assert found.names == ("rgb/a.png", "rgb/b 1.png") and found.beside is None
    np.testing.assert_array_equal(found.timestamps, [1.5, 2.25])
    assert len(found.notes) == (isinstance(text, str) and text.startswith("1,"))


@pytest.mark.parametrize(
    "header, scale, notes",
    [
        ("#timestamp [ns],filename\n", 1, "as its header says"),
        ("# timestamp_ns file\n", 1, "as its header says"),
        ("", 1, "by their size"),
        ("# time (us)\n", 1000, "as its header says"),
    ],
)
def test_nanoseconds_become_seconds_and_it_is_said(tmp_path, header, scale, notes):
    rows = "".join(f"{int(stamp) // scale},{stamp}.png\n" for stamp in NANOSECONDS)
    found = listed(tmp_path, header + rows)
    unit = "nanoseconds" if scale == 1 else "microseconds"
    assert found.notes == (f"{tmp_path / 'rgb.txt'}: stamps are {unit} ({notes}), read as seconds",)
    np.testing.assert_array_equal(found.timestamps, [int(stamp) // scale / (1e9 / scale) for stamp in NANOSECONDS])


@pytest.mark.parametrize("times, seconds", [(["0", "50000000"], [0, 0.05]), (["100", "200"], [1e-7, 2e-7])])
def test_a_header_decides_where_the_size_says_nothing(tmp_path, times, seconds):
    rows = "".join(f"{stamp} {stamp}.png\n" for stamp in times)
    np.testing.assert_array_equal(listed(tmp_path, f"#timestamp [ns]\n{rows}").timestamps, seconds)
    assert listed(tmp_path, f"#timestamp [s]\n{rows}").notes == listed(tmp_path, rows).notes == ()


@pytest.mark.parametrize("between", [" ", "\t", ", "])
def test_four_columns_are_an_association(tmp_path, between):
    rows = [("1.5", "rgb/a 1.png", "1.51", "depth/a 1.png"), ("2.5", "rgb/b 2.png", "2.49", "depth/b 2.png")]
    found = listed(tmp_path, "".join(between.join(row) + "\n" for row in rows))
    assert found.names == ("rgb/a 1.png", "rgb/b 2.png") and found.beside.names == ("depth/a 1.png", "depth/b 2.png")
    np.testing.assert_array_equal(found.timestamps, [1.5, 2.5])
    np.testing.assert_array_equal(found.beside.timestamps, [1.51, 2.49])


@pytest.mark.parametrize(
    "text, words",
    [
        ("1.0\n", r"line 1: '1\.0' is not `timestamp file`"),
        ("1.0 a.png 1.0 b.png\n2.0 c.png\n", r"line 2: '2\.0 c\.png' is not `timestamp file timestamp file`"),
        ("1.0 a.png\nx b.png\n", "line 2: 'x' is not a number"),
        ("2.0 a.png\n1.0 b.png\n", "line 2: timestamp 1.000000 is earlier"),
        ("1.0 a.png 2.0 b.png\n2.0 c.png 1.0 d.png\n", "line 2: timestamp 1.000000 is earlier"),
    ],
)
def test_wrong_lines_are_named(tmp_path, text, words):
    with pytest.raises(ValueError, match=rf"rgb\.txt {words}"):
        listed(tmp_path, text)
