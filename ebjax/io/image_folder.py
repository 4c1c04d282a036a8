"""Folders of images in natural order, and which of one folder show the places of another."""

import re
from pathlib import Path

from ebjax.io.image_kinds import SUFFIXES as UNREAD
from ebjax.io.image_kinds import conversion
from ebjax.io.json_text import read_json

SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm", ".jp2", ".avif"}


def natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """A key that sorts img2 before img10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], path.name


def list_images(folder: Path) -> list[Path]:
    """The images of a folder in natural order, without hidden ones; links that lead nowhere are among them.

    Raises:
      ValueError: no folder, or no image in it; names files of images that are not read, and how to convert them.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: not a folder; give a folder of images")
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")]
    files = [file for file in files if file.is_file() or (file.is_symlink() and not file.exists())]
    if not files:
        unread = unread_images(folder)
        raise ValueError(f"{folder}: no images in it; {unread or 'give a folder of JPEG or PNG files'}")
    return sorted(files, key=natural)


def unread_images(folder: Path) -> str:
    """Names a folder's files of images that are not read, and how to convert one; empty where it has none."""
    files = [file for file in folder.iterdir() if file.suffix.lower().lstrip(".") in UNREAD and file.is_file()]
    if not files:
        return ""
    first = min(files, key=natural)
    kind = UNREAD[first.suffix.lower().lstrip(".")]
    return f"{len(files)} such as {first.name}, {kind}, are not read: {conversion(first)}"


def read_truth(path: Path, queries: int, references: int) -> dict[int, list[int]]:
    """Reads which references are accepted for each query.

    Raises:
      ValueError: not such a JSON object, or a number beyond the images; names file and key.
    """
    values = read_json(path)
    if not isinstance(values, dict):
        raise ValueError(f"{path}: not a JSON object; write {{query number: [reference numbers]}}")
    truth = {}
    for key, row in values.items():
        if not key.isdecimal() or int(key) >= queries:
            raise ValueError(f"{path}: key {key!r} is not the number of a query, 0 to {queries - 1}; correct it")
        if not isinstance(row, list) or not all(type(n) is int and 0 <= n < references for n in row):
            raise ValueError(
                f"{path}: key {key!r} is not a list of reference numbers, 0 to {references - 1}; correct it"
            )
        truth[int(key)] = row
    return truth
