"""Text as programs and systems write it, its lines counted as an editor does."""

import gzip

import pytest

from ebjax.io.text import data_lines, floats, read_text

TEXT = "# list\n1.0 rgb/ä b.png\n\n2.0 rgb/c\u2028d.png\n"
LINES = [(2, "1.0 rgb/ä b.png"), (4, "2.0 rgb/c\u2028d.png")]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("packed", [False, True])
def test_bytes(tmp_path, end, encoding, packed):
    content = TEXT.replace("\n", end).encode(encoding)
    (tmp_path / "rgb.txt").write_bytes(gzip.compress(content) if packed else content)
    assert data_lines(tmp_path / "rgb.txt") == LINES


def test_a_mark_goes_before_a_comment_too(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xef\xbb\xbf# comment\n1\n")
    assert data_lines(tmp_path / "a.txt") == [(2, "1")]


def test_utf_16_in_the_other_order(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xfe\xff" + TEXT.encode("utf-16-be"))
    assert data_lines(tmp_path / "a.txt") == LINES


@pytest.mark.parametrize(
    "content, words",
    [
        ("1 2\r\n# Höhe\n".encode("latin-1"), "line 2 is not UTF-8; save the file as UTF-8"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\xff", "not a text file; give a text table"),
        (b"\xff\xfe1", "not a text file"),
        (gzip.compress(b"1 2\n" * 99, mtime=0)[:-12], "damaged gzip file; copy it again"),
    ],
)
def test_what_is_no_text_is_refused(tmp_path, content, words):
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(ValueError, match=f"a.txt: {words}"):
        read_text(tmp_path / "a.txt")
    if "UTF-8" in words:
        (tmp_path / "a.txt").write_text(content.decode("latin-1"), encoding="utf-8")
        assert "Höhe" in read_text(tmp_path / "a.txt")


@pytest.mark.parametrize("field", ["1_000", "1,5", "", "1e", "0x10"])
def test_what_is_no_number_is_refused(field):
    with pytest.raises(ValueError, match=f"a.txt line 3: '{field}' is not a number"):
        floats("a.txt", 3, ["1", field])
