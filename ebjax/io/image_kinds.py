"""Files that take an image's place but are not read, told by their first bytes or their names, and what to do."""

import shlex
from pathlib import Path

RAW = ("dng", "cr2", "cr3", "nef", "arw", "orf", "rw2", "raf", "pef", "srw", "raw")
SUFFIXES = {
    **{suffix: "a camera's raw picture" for suffix in RAW},
    **dict.fromkeys(("heic", "heif"), "a HEIC image"),
    **dict.fromkeys(("jxl",), "a JPEG XL image"),
    **dict.fromkeys(("exr",), "an OpenEXR image"),
    **dict.fromkeys(("psd", "xcf", "svg", "pdf"), "a drawing program's file"),
}
"""Of files of images that are not read: suffix without its dot -> kind in words."""
STARTS = (
    (b"\x76\x2f\x31\x01", "an OpenEXR image"),
    (b"FUJIFILMCCD-RAW", SUFFIXES["raf"]),
    (b"IIRO", SUFFIXES["orf"]),
    (b"IIRS", SUFFIXES["orf"]),
    (b"IIU\0", SUFFIXES["rw2"]),
    (b"\xff\x0a", SUFFIXES["jxl"]),
    (b"\0\0\0\x0cJXL ", SUFFIXES["jxl"]),
    (b"8BPS", SUFFIXES["psd"]),
    (b"%PDF", SUFFIXES["pdf"]),
    (b"<svg", SUFFIXES["svg"]),
)
BOXES = {b"heic": "heic", b"heix": "heic", b"hevc": "heic", b"heim": "heic", b"mif1": "heic", b"crx ": "cr3"}
BOXES |= {b"avif": "avif", b"avis": "avif"}
OTHERS = (
    (b"version https://git-lfs", "a pointer of Git LFS, not the image; fetch the images with: git lfs pull"),
    (b"\x93NUMPY", "a NumPy array, not an image; write it as PNG, depth with 16 bits of millimetres: cv2.imwrite"),
    (b"<!DOCTYPE", "a web page, not an image; download the image itself"),
    (b"<html", "a web page, not an image; download the image itself"),
    (b"PK\x03\x04", "a zip archive, not an image; unpack it"),
    (b"\x1f\x8b", "a gzip file, not an image; unpack it"),
)


def conversion(path: Path) -> str:
    """The command that makes a PNG of a file, by ImageMagick."""
    return f"convert it to PNG, as by ImageMagick: magick {shlex.quote(str(path))} {shlex.quote(f'{path.stem}.png')}"


def unread_kind(path: Path, start: bytes) -> str | None:
    """Says what a file is that is not read, and the remedy; None where it may be an image.

    Args:
      path: its suffix tells raw pictures that are TIFF files too.
      start: its first 32 bytes at least.
    """
    for first, words in OTHERS:
        if start.startswith(first):
            return words
    kind = next((words for first, words in STARTS if start.startswith(first)), None)
    if start[4:8] == b"ftyp":
        box = BOXES.get(start[8:12])
        kind = "an AVIF image that this OpenCV cannot decode" if box == "avif" else SUFFIXES.get(box or "")
    elif start[:4] in (b"II*\0", b"MM\0*"):
        raw = start[8:10] == b"CR" or path.suffix.lower().lstrip(".") in RAW
        kind = SUFFIXES["raw"] if raw else None
    return None if kind is None else f"{kind}, which is not read; {conversion(path)}"
