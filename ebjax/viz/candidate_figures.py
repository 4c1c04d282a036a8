"""A candidate in pictures: its two images with what matches, and its two floor views as they are and turned by pi."""

from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from ebjax.geometry.camera import raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.io.sequence import Sequence
from ebjax.slam.recording import Load
from ebjax.slam.run import Run
from ebjax.views.tilted import tilted
from ebjax.viz import figures

View = tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]
"""A floor view, and which of its pixels show floor."""
NO_FLOOR = "#eceff1"


def candidate_figures(sequence: Sequence, load: Load, result: Run, k: int) -> list[dict[str, Any]]:
    """Pictures of candidate k with captions, {"png", "caption"}: of its images where they can be read, of its views."""
    candidates = result.candidates
    i, j = int(candidates.i[k]), int(candidates.j[k])
    later, earlier = (f"{sequence.names[frame]} (frame {frame})" for frame in (i, j))
    inliers, total = candidates.inliers[k], candidates.total[k]
    said = f"{later} and, earlier, {earlier}: {inliers} of {total} matches agree; {result.reasons[k]}."
    found, images = [], (load(i), load(j))
    if images[0] is not None and images[1] is not None:
        turned = " The image on the right is turned by pi (half a turn)." if candidates.opposing[k] else ""
        png = _matched(result, k, (images[0][0], images[1][0]))
        how = " Lines join matches that agree, crosses are matches that do not."
        found.append({"png": png, "caption": f"{said}{turned}{how}"})
    rows = np.searchsorted(result.keyframes, [i, j]).tolist()
    views = [(result.seen(row), result.floor(row) & np.asarray(result.view.seen)) for row in rows]
    png = floor_views(views[0], views[1], (i, j), opposing=bool(candidates.opposing[k]))
    side = "turned by pi, which lays the same floor the same way" if candidates.opposing[k] else "as it is"
    text = f"The same two frames from above, as the descriptor sees them: the earlier one is compared {side}."
    return [*found, {"png": png, "caption": text + " What is no floor is blank."}]


def _matched(result: Run, k: int, images: tuple[np.ndarray, np.ndarray]) -> bytes:
    """The raw images of a candidate with its matches, the earlier one turned by pi where the view is opposing."""
    candidates, points, verified = result.candidates, [], result.verified(k)
    for frame, rows in ((candidates.i[k], verified.query), (candidates.j[k], verified.reference)):
        keypoints = result.keypoints(int(frame))[rows]
        seen_by = result.view, result.camera
        if result.lean is not None and result.lean.used:
            seen_by = tilted(*seen_by, result.lean.level_from_base[frame])
        ideal = apply(seen_by[0].image_from_view, np.asarray(keypoints, np.float64))
        points.append(np.asarray(raw_from_ideal(seen_by[1], ideal)))
    used = np.asarray(verified.matched)
    agree, turn = np.asarray(verified.inliers)[used], bool(candidates.opposing[k])
    return figures.matches(*images, points[0][used], points[1][used], agree, turn_second=turn)


def floor_views(later: View, earlier: View, frames: tuple[int, int], *, opposing: bool) -> bytes:
    """Draws two floor views side by side, and the earlier one turned by pi where the robot came the other way."""
    i, j = frames
    shown = [(f"frame {i}, as it is", *later), (f"frame {j}, as it is", *earlier)]
    if opposing:
        shown.append((f"frame {j}, turned by pi", earlier[0][::-1, ::-1], earlier[1][::-1, ::-1]))
    height, width = later[1].shape
    figure = figures.new_figure(3.0 * len(shown), 3.0 * height / width + 0.3)
    for axes, (title, view, floor) in zip(figure.subplots(1, len(shown)), shown, strict=True):
        axes.set_facecolor(NO_FLOOR)
        axes.imshow(np.dstack([view, 255 * floor.astype(np.uint8)]), interpolation="antialiased")
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9)
    return figures.painted(figure)
