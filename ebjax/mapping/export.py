"""A map's file, or a run, for other programs: trajectories, pose graph, closures, nav2's map, nerfstudio, hloc."""

import contextlib
import csv
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from ebjax.io.atomic import whole_folder
from ebjax.io.camera_file import CameraFile
from ebjax.io.hloc_pairs import write_pairs
from ebjax.io.map_file.reader import MapReader
from ebjax.io.nerfstudio import write_transforms
from ebjax.io.sequence import Sequence as LogSequence
from ebjax.io.trajectory import write_tum
from ebjax.mapping.contents import CLOSURE, Contents, plural, read_contents
from ebjax.mapping.looked_by import camera_file
from ebjax.mapping.map_page import map_page
from ebjax.posegraph.g2o import format_g2o
from ebjax.slam.map import FloorMap, mosaic
from ebjax.slam.packed import floor_of, view_of
from ebjax.slam.run import Run
from ebjax.slam.world import matrices
from ebjax.viz import figures
from ebjax.viz.motion import entries
from ebjax.viz.nav2_map import write_nav2_map
from ebjax.viz.occupancy import UNKNOWN, floor_only, occupancy

COLUMNS = (
    *("session_i", "i", "session_j", "j", "name_i", "name_j", "time_i_s", "time_j_s", "direction", "distance"),
    *("inliers", "matches", "x_m", "y_m", "theta_rad", "cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt"),
    *("kept", "reason"),
)


class Exported(NamedTuple):
    """Names of the files that were written, and what a user should know, a line each."""

    files: tuple[str, ...]
    notes: tuple[str, ...]


def export_map(kept: MapReader, out: Path, metres_per_px: float) -> Exported:
    """Writes what a map holds at this moment, also while another process goes on with it.

    Args:
      kept: an open map.
      out: a folder; other files in it are left alone.
      metres_per_px: of the floor map.

    Raises:
      ValueError: a damaged keyframe, or a map without keyframes.
      OSError: a file cannot be written.
    """
    contents = read_contents(kept)
    if not len(contents.keyframes):
        raise ValueError(f"{kept.path}: holds no keyframe yet; export it when a run has come some way")
    notes: list[str] = list(kept.notes)
    with whole_folder(out) as folder:
        _write_tracks(folder, contents)
        (folder / "pose_graph.g2o").write_text(format_g2o(contents.graph(), contents.keyframes.id))
        write_closures(folder / "loop_closures.csv", contents)
        floor = _write_floor(folder, kept, contents, metres_per_px, notes)
        with _noted(notes, folder, out):
            write_transforms(folder / "transforms.json", *_photographs(contents, out))
        with _noted(notes, folder, out):
            _write_pairs(folder / "pairs.txt", contents, notes)
        files = sorted(file.name for file in folder.iterdir())
        (folder / "report.html").write_text(map_page(kept.path, contents, floor, files), encoding="utf-8")
        return Exported(tuple(sorted(file.name for file in folder.iterdir())), tuple(notes))


def export_run(
    folder: Path, out: Path, sequence: LogSequence, result: Run, floor: FloorMap, cells: Int8[np.ndarray, "H W"]
) -> Exported:
    """Writes of a run what other programs take: nav2_map.yaml and .png, transforms.json, pairs.txt.

    Args:
      folder: to write into.
      out: where the folder will be in the end.
      sequence: what was run.
      result: of the pipeline.
      floor: the run's floor map.
      cells: which of its pixels are free.
    """
    frames, camera, before = result.keyframes, camera_file(result.camera), set(folder.iterdir())
    notes: list[str] = []
    write_nav2_map(folder / "nav2_map.yaml", cells, floor.extent, floor.metres_per_px)
    names = [sequence.names[frame] for frame in frames]
    closures = np.stack([result.candidates.i, result.candidates.j], 1)[result.kept]
    with _noted(notes, folder, out):
        write_pairs(folder / "pairs.txt", names, np.searchsorted(frames, closures), successive=True)
    if sequence.files:
        images = [relative(sequence.files[frame], out) for frame in frames]
        with _noted(notes, folder, out):
            write_transforms(folder / "transforms.json", camera, matrices(result.poses[frames]), images)
    else:
        notes.append("no transforms.json: it names image files; `python -m ebjax.logs LOG --out DIR` writes them")
    return Exported(tuple(sorted(file.name for file in set(folder.iterdir()) - before)), tuple(notes))


@contextlib.contextmanager
def _noted(notes: list[str], folder: Path, out: Path) -> Iterator[None]:
    """What an exporter refuses becomes a note, which names the file where it would have been."""
    try:
        yield
    except ValueError as fault:
        notes.append(f"not written: {str(fault).replace(str(folder), str(out))}")


def relative(image: Path, out: Path) -> str:
    """An image as a file in `out` names it."""
    return os.path.relpath(image.resolve(), out.resolve())


def _write_tracks(folder: Path, contents: Contents) -> None:
    for session in contents.sessions:
        name = "trajectory.tum" if len(contents.sessions) == 1 else f"trajectory_{session.id}.tum"
        track = contents.track(session.id)
        if len(track.frame):
            said = f"base_link in the map; session {session.id}, {session.name}"
            write_tum(folder / name, track.stamp_s, matrices(track.poses), " ".join(said.split()))


def write_closures(path: Path, contents: Contents) -> None:
    """Every candidate of every session: where, how alike, what was measured, and whether and why it counts."""
    edges, known = contents.edges, contents.keyframes
    mine = contents.of_kind(CLOSURE)
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for k, (i, j) in zip(np.flatnonzero(mine).tolist(), contents.ends(mine).tolist(), strict=True):
            rows.writerow([
                known.session[i], known.frame[i], known.session[j], known.frame[j], known.name[i], known.name[j],
                f"{known.stamp_s[i]:.6f}", f"{known.stamp_s[j]:.6f}", "opposing" if edges.opposing[k] else "same",
                f"{edges.distance[k]:.6f}", edges.inliers[k], edges.matches[k],
                *(f"{value:.7f}" for value in edges.i_from_j[k]), *entries(edges.covariance[k]),
                int(edges.kept[k]), edges.reason[k],
            ])  # fmt: skip


def _write_floor(
    folder: Path, kept: MapReader, contents: Contents, metres_per_px: float, notes: list[str]
) -> bytes | None:
    """The picture of the floor and nav2's map of it; returns the picture."""
    known = contents.keyframes
    rows = np.flatnonzero(np.isin(known.session, list(contents.looked)))
    if not len(rows):
        notes.append(f"{kept.path}: says of no session which floor its views show; no floor_map.png, no nav2_map.yaml")
        return None
    looked = [contents.looked[session] for session in known.session[rows].tolist()]
    seen = np.logical_or.reduce([one.seen for one in contents.looked.values()])
    views = Views(kept, known.id[rows], seen.shape)
    masks = (floor & one.seen for floor, one in zip(views.floors(), looked, strict=True))
    shown = np.stack([one.floor_from_view for one in looked])
    floor = mosaic(views.images(), seen, shown, known.pose[rows], masks=masks, metres_per_px=metres_per_px)
    cells = _cells(views, contents, rows, floor)
    write_nav2_map(folder / "nav2_map.yaml", cells, floor.extent, floor.metres_per_px)
    if views.without_image:
        notes.append(f"{kept.path}: {plural(views.without_image, 'keyframe')} without a floor view (--no-views)")
    if views.without_image == len(rows):
        return None
    closures = contents.ends(contents.of_kind(CLOSURE) & contents.edges.kept)
    clear = floor_only(floor, cells)
    png = figures.floor_map(clear.image, clear.extent, *_drawn(contents, closures))
    (folder / "floor_map.png").write_bytes(png)
    return png


class Views:
    """Floor views and masks of keyframes, each read when it is asked for.

    Attributes:
      without_image: keyframes whose view is not kept, among those that `images` gave.
    """

    def __init__(self, kept: MapReader, numbers: Int[np.ndarray, " n"], shape: tuple[int, ...]):
        self._kept, self._numbers, self._shape = kept, numbers.tolist(), shape
        self.without_image = 0

    def images(self) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """The views, RGB; black where none is kept."""
        for number in self._numbers:
            arrays = self._kept.arrays(number)
            self.without_image += "view" not in arrays
            yield view_of(arrays) if "view" in arrays else np.zeros((*self._shape, 3), np.uint8)

    def floors(self, rows: Sequence[int] | None = None) -> Iterator[Bool[np.ndarray, "h w"]]:
        """What of each view is floor."""
        for number in self._numbers if rows is None else (self._numbers[row] for row in rows):
            yield floor_of(self._kept.arrays(number))

    def has_depth(self, rows: Sequence[int]) -> bool:
        """Whether depth was measured of some of them: the first that has features says so."""
        for row in rows:
            range_m = self._kept.arrays(self._numbers[row]).get("features.range_m", np.zeros(0))
            if len(range_m):
                return bool((range_m > 0).any())
        return False


def _cells(views: Views, contents: Contents, rows: Int[np.ndarray, " n"], floor: FloorMap) -> np.ndarray:
    """Free and occupied cells; where several sessions saw a cell, the last of them says what is there."""
    sessions = contents.keyframes.session[rows]
    cells = np.full(floor.image.shape[:2], UNKNOWN, np.int8)
    for session in np.unique(sessions).tolist():
        mine = np.flatnonzero(sessions == session)
        looked = contents.looked[session]
        floors = views.floors(mine.tolist()) if views.has_depth(mine.tolist()) else None
        poses = contents.keyframes.pose[rows[mine]]
        pose = looked.camera.base_from_camera
        found = occupancy(floors, looked.seen, looked.floor_from_view, pose, poses, floor)
        cells = np.where(found == UNKNOWN, cells, found)
    return cells


def _drawn(
    contents: Contents, closures: Int[np.ndarray, "K 2"]
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "K 2"]]:
    """The keyframes' path, broken between sessions, and the rows of it that closures join."""
    known = contents.keyframes
    order = np.argsort(known.session, kind="stable")
    broken = np.flatnonzero(np.diff(known.session[order])) + 1
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order)) + np.searchsorted(broken, np.arange(len(order)), side="right")
    path = np.full((len(order) + len(broken), 2), np.nan)
    path[place] = known.pose[:, :2]
    return path, place[closures]


def _photographs(contents: Contents, out: Path) -> tuple[CameraFile, Float[np.ndarray, "N 4 4"], list[str]]:
    """The camera, the robot's poses under it and the image files of all keyframes.

    Raises:
      ValueError: the images are no files, or not there.
    """
    known, logs = contents.keyframes, {one.id: Path(one.name) for one in contents.sessions}
    every = [logs[session] / name for session, name in zip(known.session.tolist(), known.name, strict=True)]
    rows = sorted({file: row for row, file in reversed(list(enumerate(every)))}.values())  # each image once
    files, sessions = [every[row] for row in rows], known.session[rows].tolist()
    if missing := [file for file in files if not file.is_file()]:
        raise ValueError(f"{out / 'transforms.json'}: needs images that are files, and there is no {missing[0]}")
    if not set(sessions) <= set(contents.looked):
        raise ValueError(f"{out / 'transforms.json'}: the map does not say what the camera of each session is")
    camera = contents.looked[sessions[0]].camera
    mounts = {
        k: one.camera.base_from_camera @ np.linalg.inv(camera.base_from_camera) for k, one in contents.looked.items()
    }
    poses = matrices(known.pose[rows]) @ np.stack([mounts[session] for session in sessions])
    return camera, poses, [relative(file, out) for file in files]


def _write_pairs(path: Path, contents: Contents, notes: list[str]) -> None:
    """Pairs of images, named from their log, or of several logs from the folder that has them all."""
    known, names = contents.keyframes, list(contents.keyframes.name)
    logs = {one.id: one.name for one in contents.sessions}
    if len(set(logs.values())) > 1 and all(map(os.path.isabs, logs.values())):
        folder = os.path.commonpath(list(logs.values()))
        files = zip(known.session.tolist(), names, strict=True)
        names = [os.path.relpath(os.path.join(logs[session], name), folder) for session, name in files]
        notes.append(f"pairs.txt: names are of images in {folder}")
    # A log that was driven twice has each image once.
    images = [(logs[session], name) for session, name in zip(known.session.tolist(), names, strict=True)]
    first = {image: row for row, image in reversed(list(enumerate(images)))}
    row_of = np.array([first[image] for image in images])
    follows = np.concatenate([np.stack([rows[:-1], rows[1:]], 1) for rows in map(contents.rows, logs)])
    closures = contents.ends(contents.of_kind(CLOSURE) & contents.edges.kept)
    pairs = row_of[np.concatenate([closures, follows])]
    write_pairs(path, names, pairs[pairs[:, 0] != pairs[:, 1]])
