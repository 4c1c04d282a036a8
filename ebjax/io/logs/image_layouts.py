"""Where a folder keeps the list of its images: rgb.txt, an association, EuRoC's data.csv, KITTI's times.txt."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from ebjax.io.image_folder import list_images
from ebjax.io.image_header import read_header
from ebjax.io.logs.image_list import ImageList, read_image_list
from ebjax.io.logs.image_survey import spread
from ebjax.io.text import data_lines, floats

ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "associated.txt", "assoc.txt")
EUROC = (".", "cam0", "mav0/cam0")
KITTI = ("image_2", "image_0", "image_3", "image_1", "image_02", "image_00", "image_03", "image_01")
"""Colour and left first; the cameras of the raw recordings have two digits."""


@dataclass(frozen=True)
class Layout:
    """A folder's images and their times.

    Attributes:
      kind: of folder, in words.
      colour: the list, whose `path` is for messages.
      files: of the images.
      depth: of an association, its depth images; None without.
      depth_files: of these.
      calibration: where the layout keeps one; None without.
      notes: what the user should know of how it was read, a line each.
    """

    kind: str
    colour: ImageList
    files: tuple[Path, ...]
    depth: ImageList | None = None
    depth_files: tuple[Path, ...] = ()
    calibration: Path | None = None
    notes: tuple[str, ...] = ()


def there(path: Path) -> bool:
    """Whether a text file is there, plain or gzipped."""
    return path.is_file() or Path(f"{path}.gz").is_file()


def layout_reader(folder: Path) -> Callable[[], Layout] | None:
    """What reads a folder's list of images; None where it has none."""
    if there(folder / "rgb.txt"):
        return lambda: _tum(folder, folder / "rgb.txt")
    for name in ASSOCIATIONS:
        if there(folder / name):
            return lambda: _tum(folder, folder / name)
    for part in EUROC:
        if (folder / part / "data.csv").is_file() and (folder / part / "data").is_dir():
            return lambda: _euroc(folder / part)
    for part in KITTI:
        if (folder / part).is_dir() and any((folder / at / "times.txt").is_file() for at in (".", part)):
            return lambda: _kitti(folder, part)
    return None


def _tum(folder: Path, path: Path) -> Layout:
    listed = read_image_list(path)
    kind, notes = "folder in TUM layout", list(listed.notes)
    if listed.beside is None:
        files, moved = located(folder, listed)
        return Layout(kind, listed, files, notes=(*notes, *moved))
    found = [(one, *located(folder, one)) for one in (replace(listed, beside=None), listed.beside)]
    deep = _deep_column(path, [(one.names, files) for one, files, _ in found])
    (depth, depth_files, moved_too), (colour, files, moved) = found[deep], found[1 - deep]
    order = "colour and depth" if deep == 1 else "depth and colour"
    notes.append(f"{path}: its four columns are an association of {order} (associate.py), read as such")
    notes += [*moved, *moved_too]
    return Layout(kind, colour, files, depth, depth_files, notes=tuple(notes))


def _deep_column(path: Path, columns: list[tuple[tuple[str, ...], tuple[Path, ...]]]) -> int:
    """Which of two columns is depth: the one that is named so, or whose images have 16 bits."""
    named = ["depth" in names[0].lower() for names, _ in columns]
    if sum(named) != 1:
        headers = [read_header(files[0]) for _, files in columns]
        named = [header is not None and (header.bits > 8 or header.floats) for header in headers]
    if sum(named) != 1:
        raise ValueError(f"{path}: four columns, neither of depth; write colour into rgb.txt and depth into depth.txt")
    return named.index(True)


def _euroc(camera: Path) -> Layout:
    listed = read_image_list(camera / "data.csv")
    files, notes = located(camera / "data", listed)
    sensor = camera / "sensor.yaml"
    truth = camera.parent / "state_groundtruth_estimate0" / "data.csv"
    if truth.is_file():
        notes += (f"{truth}: left out, as its poses are the IMU's, not those of base_link; give groundtruth.txt",)
    calibration = sensor if sensor.is_file() else None
    return Layout("folder in EuRoC layout", listed, files, calibration=calibration, notes=(*listed.notes, *notes))


def _kitti(folder: Path, part: str) -> Layout:
    path = next(at for at in (folder / part / "times.txt", folder / "times.txt") if at.is_file())
    images = folder / part / "data" if (folder / part / "data").is_dir() else folder / part
    files = list_images(images)
    stamps = [floats(path, number, [line])[0] for number, line in data_lines(path)]
    if len(stamps) != len(files):
        raise ValueError(f"{path}: {len(stamps)} times for {len(files)} images in {images}; give one for each image")
    names = tuple(str(file.relative_to(folder)) for file in files)
    others = [name for name in KITTI if name != part and (folder / name).is_dir()]
    notes = (f"{folder}: the images of {part} are used; {', '.join(others)} are left out",) if others else ()
    calibration = folder / "calib.txt" if (folder / "calib.txt").is_file() else None
    listed = ImageList(path, names, np.array(stamps))
    return Layout("folder in KITTI layout", listed, tuple(files), calibration=calibration, notes=notes)


def located(folder: Path, listed: ImageList) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The files of a list, and a note where they do not lie where it says.

    A list that was written elsewhere names folders that are not here: as many leading ones are left out as it takes.

    Raises:
      ValueError: none of its images is there; names the first.
    """
    looked_at = [listed.names[row] for row in spread(len(listed.names), 12)]
    parts = [PurePosixPath(name.replace("\\", "/")).parts for name in looked_at]
    if not looked_at or any((folder / name).exists() for name in looked_at):
        return tuple(folder / name for name in listed.names), ()
    for left_out in range(min(map(len, parts))):
        for inside in (folder, folder / listed.path.stem):
            if all(inside.joinpath(*names[left_out:]).is_file() for names in parts):
                files = tuple(
                    inside.joinpath(*PurePosixPath(name.replace("\\", "/")).parts[left_out:]) for name in listed.names
                )
                return files, (f"{listed.path}: its images are not where it says; taken from {files[0].parent}",)
    raise ValueError(
        f"{listed.path}: none of {len(looked_at)} images looked at is there, first {folder / looked_at[0]}: "
        f"no such file; put them there, or correct the names, which count from {folder}"
    )
