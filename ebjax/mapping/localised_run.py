"""A recorded run localised in a map that stays as it is: where the robot was, frame by frame, and when it was lost."""

import csv
import json
from pathlib import Path

import numpy as np

from ebjax.geometry.camera import Camera
from ebjax.io.atomic import whole_folder
from ebjax.io.trajectory import write_tum
from ebjax.mapping.agreement import check_map, made_with
from ebjax.mapping.still_map import open_still_map
from ebjax.slam.config import PipelineConfig
from ebjax.slam.drive import frames_of
from ebjax.slam.localise import Localiser, Whereabouts
from ebjax.slam.recording import Recording
from ebjax.slam.walker import Remember
from ebjax.slam.world import matrices
from ebjax.views.run_view import RunView
from ebjax.viz.ticker import ticker

COLUMNS = ("frame", "name", "time_s", "state", "x_m", "y_m", "heading_rad", "sigma_m", "sigma_deg", "nearest", "ms")


def localise_run(
    path: Path,
    recording: Recording,
    camera: Camera,
    view: RunView,
    config: PipelineConfig,
    out: Path,
    *,
    start: tuple[float, float, float] | None = None,
    remember: Remember | None = None,
) -> list[str]:
    """Writes where the robot was into a folder; returns what was found, a line each.

    Args:
      path: of the map.
      recording: of the run.
      camera: of the run, as it is given.
      view: the floor it looks at, as it is given.
      config: of the engine.
      out: the folder.
      start: about where it starts: x (m), y (m), heading (degrees).
      remember: as of `Mapper`.

    Raises:
      ValueError, OSError: the map cannot be read, or was made with another camera, view or network.
    """
    at = None if start is None else (start[0], start[1], float(np.radians(start[2])))
    with open_still_map(path) as still:
        notes = (*still.notes, *check_map(still.file.path, still.file.facts, made_with(config, camera, view)))
        localiser = Localiser(
            still.camera, config, still, still.poses, view=still.view, recording=recording, remember=remember, start=at
        )
        told: list[Whereabouts] = []
        found = 0
        with ticker(len(recording)) as ticking:
            for frame in frames_of(recording, config):
                told.append(localiser.add(frame))
                found += sum(closure.kept for closure in told[-1].closures)
                ticking.update(told[-1].frame, len(localiser.walk.keyframes), found, told[-1].milliseconds)
    with whole_folder(out) as folder:
        _write(folder, told, recording)
    return [*notes, *summary(told), f"{out}: trajectory.tum, whereabouts.csv, metrics.json"]


def _write(folder: Path, told: list[Whereabouts], recording: Recording) -> None:
    known = [where for where in told if where.map_from_base is not None]
    poses = np.array([where.map_from_base for where in known]).reshape(-1, 3)
    write_tum(folder / "trajectory.tum", np.array([w.stamp_s for w in known]), matrices(poses), "base_link in the map")
    with open(folder / "whereabouts.csv", "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for where in told:
            name = recording.names[where.frame] if recording.names else str(where.frame)
            rows.writerow([where.frame, name, f"{where.stamp_s:.6f}", where.state, *_numbers(where), _nearest(where),
                           f"{where.milliseconds:.1f}"])  # fmt: skip
    (folder / "metrics.json").write_text(json.dumps(metrics(told), indent=2) + "\n")


def _numbers(where: Whereabouts) -> list[str]:
    if where.map_from_base is None or where.covariance is None:
        return [""] * 5
    sigma = np.sqrt(np.diagonal(where.covariance))
    spread = float(np.hypot(*sigma[:2])), float(np.degrees(sigma[2]))
    return [f"{value:.6f}" for value in (*where.map_from_base, *spread)]


def _nearest(where: Whereabouts) -> str:
    return "" if where.nearest is None else str(where.nearest)


def metrics(told: list[Whereabouts]) -> dict:
    """Counts: frames found, the first of them, how often it was lost afterwards, milliseconds a keyframe."""
    found = np.array([where.state == "found" for where in told])
    times = [where.milliseconds for where in told if where.keyframe is not None]
    return {
        "frames": len(told),
        "found": int(found.sum()),
        "first_found": int(np.argmax(found)) if found.any() else None,
        "lost_again": int((found[:-1] & ~found[1:]).sum()),
        "ms_a_keyframe": {"p50": float(np.median(times)), "p99": float(np.percentile(times, 99))} if times else None,
    }


def summary(told: list[Whereabouts]) -> list[str]:
    """The same in words."""
    said = metrics(told)
    if said["first_found"] is None:
        return [f"never found in {said['frames']} frames: no two views that agree are known to the map"]
    return [
        f"found at frame {said['first_found']}; {said['found']} of {said['frames']} frames found, lost again "
        f"{said['lost_again']} times"
    ]
