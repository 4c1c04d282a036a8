"""Files that are no videos, told from their first bytes, and MP4s without an index."""

import re
from pathlib import Path

BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
PICTURES = (b"heic", b"heix", b"mif1", b"msf1", b"avif")
SOUNDS = (b"ID3", b"fLaC", b"\xff\xfb", b"\xff\xf3", b"#!AMR")
GIVE = "give MP4, MOV, MKV, WEBM or AVI"


def refuse_what_is_no_video(path: Path) -> None:
    """Looks at a file before a decoder does, which would complain on standard error.

    Raises:
      ValueError: no file, empty, a text, an audio file, a picture, or an MP4 cut off before its index; names it.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'a folder, not a video' if path.is_dir() else 'no such file'}; {GIVE}")
    with path.open("rb") as file:
        head = file.read(65536)
    if not head:
        raise ValueError(f"{path}: the file is empty; copy it again")
    if is_text(head):
        raise ValueError(f"{path}: a text, not a video; {GIVE}")
    if _is_sound(head):
        raise ValueError(f"{path}: an audio file, without pictures; {GIVE}")
    if head[4:8] == b"ftyp" and head[8:12] in PICTURES:
        raise ValueError(f"{path}: a picture, not a video; convert it to JPEG and give its folder")
    if head[4:8] in BOXES:
        _check_mp4(path)


def _is_sound(head: bytes) -> bool:
    if head[:4] == b"OggS":
        return b"theora" not in head and b"OVP8" not in head
    return head.startswith(SOUNDS) or (head[:4] == b"RIFF" and head[8:12] == b"WAVE")


def is_text(head: bytes) -> bool:
    """Tells whether a file that begins so holds text: UTF-8 that may be cut in its last letter, no control letters."""
    text = head.decode("utf-8", "replace")
    return "�" not in text[:-1] and not re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text)


def _check_mp4(path: Path) -> None:
    """An MP4 keeps its index in a moov atom, which most cameras write when they stop recording."""
    index = _moov(path)
    if index is None:
        raise ValueError(
            f"{path}: cut off: its index (moov atom) is missing, as when a recording is not stopped or a copy breaks "
            "off; copy it again, or mend it with untrunc and a whole video of the same camera"
        )
    if re.search(rb"hdlr.{8}vide", index, re.DOTALL) or b"cmov" in index:
        return
    sound = re.search(rb"hdlr.{8}soun", index, re.DOTALL)
    raise ValueError(f"{path}: {'an audio file, without pictures' if sound else 'no video in it'}; {GIVE}")


def _moov(path: Path) -> bytes | None:
    """The index of an MP4; None where the file ends before it does."""
    end = path.stat().st_size
    position = 0
    with path.open("rb") as file:
        while position + 8 <= end:
            file.seek(position)
            head = file.read(16)
            size = int.from_bytes(head[:4], "big")
            if size == 1:
                size = int.from_bytes(head[8:16], "big")
            elif size == 0:
                size = end - position
            if size < 8:
                return None
            if head[4:8] == b"moov":
                file.seek(position)
                return file.read(size) if position + size <= end else None
            position += size
    return None
