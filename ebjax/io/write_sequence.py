"""Writes a run as the TUM-layout folder that `read_sequence` reads, whole or not at all."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16

from ebjax.io.atomic import resumed_folder, whole_file, whole_folder
from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.trajectory import write_tum

Frame = tuple[UInt8[np.ndarray, "H W 3"], UInt16[np.ndarray, "H W"]]


def write_sequence(
    out: str | Path,
    timestamps: Float[np.ndarray, " N"],
    odom_from_base: Float[np.ndarray, "N 4 4"],
    world_from_base: Float[np.ndarray, "N 4 4"],
    camera: CameraFile,
    frame: Callable[[int], Frame],
    *,
    quality: int = 95,
    threads: int = 2,
    resume: bool = False,
    progress: Callable[[Iterable[None], int], Iterable[None]] = lambda items, total: items,
    finish: Callable[[Path], None] = lambda folder: None,
) -> None:
    """Asks for the frames in parallel and writes them as they come.

    Args:
      out: the folder.
      timestamps: of the frames, s; they name the files.
      odom_from_base: odometry at the frames, m.
      world_from_base: ground truth at the frames, m.
      camera: what camera.json is to say.
      frame: index -> (RGB, depth in file units); called from several threads.
      quality: of the JPEGs, 1 to 100.
      threads: frames made at a time.
      resume: keep the frames of a writing that is interrupted in `.NAME.partial`, and go on from them.
      progress: wraps the frames as they are finished (iterable, total).
      finish: adds to the folder, before it appears under its name, what else belongs to the run.
    """
    names = [f"{t:.6f}" for t in timestamps]
    with resumed_folder(out) if resume else whole_folder(out) as folder:

        def write(i: int) -> None:
            colour, deep = folder / "rgb" / f"{names[i]}.jpg", folder / "depth" / f"{names[i]}.png"
            if deep.exists():  # written last
                return
            rgb, depth = frame(i)
            bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
            _encode(colour, bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
            _encode(deep, depth, [cv2.IMWRITE_PNG_COMPRESSION, 1])

        with ThreadPoolExecutor(threads) as pool:
            try:
                for _ in progress(pool.map(write, range(len(names))), len(names)):
                    pass
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        for kind, suffix in (("rgb", "jpg"), ("depth", "png")):
            (folder / f"{kind}.txt").write_text("".join(f"{n} {kind}/{n}.{suffix}\n" for n in names))
        write_tum(folder / "odometry.txt", timestamps, odom_from_base)
        write_tum(folder / "groundtruth.txt", timestamps, world_from_base)
        write_camera(folder / "camera.json", camera)
        finish(folder)


def _encode(path: Path, image: np.ndarray, options: list[int]) -> None:
    done, content = cv2.imencode(path.suffix, image, options)
    assert done, path
    with whole_file(path, "wb") as file:
        file.write(content.tobytes())
