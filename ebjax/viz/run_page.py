"""The report of a run as a page for `viz.report`: the answer and the path, then what it rests on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ebjax.viz.motion import motion_lines

Figure = dict[str, Any]
FILES = {
    "trajectory.tum": "the corrected pose of every frame",
    "loop_closures.csv": "every candidate that was checked: what was measured, kept or not, and why",
    "steps.csv": "every measured step between keyframes",
    "pose_graph.g2o": "the pose graph after loop closing",
    "metrics.json": "all numbers of this report",
    "config.yaml": "all settings; run again with --config config.yaml",
    "floor_map.png": "the map of the floor",
    "nav2_map.yaml": "free and occupied cells for ROS's map_server, with nav2_map.png",
    "transforms.json": "camera poses for nerfstudio",
    "pairs.txt": "pairs of images for hloc",
    "rtabmap.db": "the RTAB-Map database with the closures as user links",
}
"""What a run's folder may hold, for its links."""
STAGES = {
    "frames": "the frames one by one",
    "motion": "how the robot moved, thought over",
    "medians": "the run once more, by medians of its views",
    "believe": "which closures to believe",
    "pose graph": "the corrected path",
}


@dataclass(frozen=True)
class Pictures:
    """PNGs, and figures {"png", "caption"}.

    Attributes:
      trajectory: before and after.
      floor_map: the floor.
      candidates: pairs of frames.
      closures: some of the kept ones.
      refused: some of those that were not believed; of a run without closures, the best one.
    """

    trajectory: bytes
    floor_map: bytes
    candidates: bytes
    closures: list[Figure]
    refused: list[Figure]


def run_page(
    name: str,
    metrics: Mapping[str, Any],
    pictures: Pictures,
    closures: Sequence[list[Any]],
    made: Sequence[list[str]],
    files: Sequence[str],
) -> dict[str, Any]:
    """Puts a run's results in reading order.

    Args:
      name: of the sequence.
      metrics: what metrics.json holds.
      pictures: see there.
      closures: rows of the kept closures' table, with two columns of errors where the truth is known.
      made: how the run was made, rows of a name and a value.
      files: names of those in its folder.
    """
    sections: list[dict[str, Any]] = [{"title": "In numbers", "table": _numbers(metrics)}]
    if pictures.refused and not pictures.closures:
        text = "The one with most matches that agree, and what it lacked."
        sections.append({"title": "The best candidate", "text": text, "figures": pictures.refused})
    if pictures.closures:
        text = (
            "A loop closure says that two frames saw the same floor, and how the robot stood at the one as seen from "
            "the other. Some of them, spread along the path:"
        )
        sections.append({"title": "Loop closures", "text": text, "figures": pictures.closures})
        sections.append({"title": "All loop closures", **_closures(closures)})
    if pictures.refused and pictures.closures:
        text = "Pairs of frames that look alike from above and were not believed, with the reason."
        sections.append({"title": "Candidates not believed", "text": text, "figures": pictures.refused})
    text = "Every floor view laid where the corrected path says it was seen, with the path and the closures."
    if not metrics["depth"]:
        text += " Without depth, walls that a view shows are laid on the floor too."
    sections.append({"title": "Map of the floor", "figures": [{"png": pictures.floor_map, "caption": text}]})
    if motion := metrics.get("motion"):
        text = "A step is the motion from one keyframe to the next, measured where the floor in both views matches. "
        text += " ".join(map(sentence, (*motion_lines(metrics), *motion["warnings"])))
        sections.append({"title": "Steps", "text": text, "table": _motion(motion)})
    sections.append(_candidates(metrics, pictures.candidates))
    sections.append({"title": "Time", "table": _times(metrics["seconds"])})
    sections.append({"title": "How this was made", "table": {"columns": ["", ""], "rows": list(made)}})
    linked = [[file, FILES[file]] for file in FILES if file in files]
    sections.append({"title": "Files beside this one", "files": linked})
    caption = "The path from above before and after loop closing"
    if metrics.get("ate_rmse_m"):
        caption += ", moved and turned to fit the true path best; below, how far each frame is off it"
    opening = {"png": pictures.trajectory, "caption": f"{caption}."}
    return {"title": f"Loop closing of {name}", "text": answer(metrics), "figures": [opening], "sections": sections}


def answer(metrics: Mapping[str, Any]) -> str:
    """What was found, in one or two plain sentences."""
    kept, joined = metrics["closures_kept"], (metrics.get("map") or {}).get("closures", 0)
    if not kept and not joined:
        alone = "the odometry" if metrics.get("motion") is None else "what the steps and the odometry say"
        if metrics["mirrored"]:
            alone = "what images and odometry say"
        why = " ".join(
            map(sentence, filter(None, (metrics[key] for key in ("nothing_kept", "mirrored", "best_refused"))))
        )
        error = metrics.get("ate_rmse_m")
        off = f", {error['after']:.4f} m off the truth (root mean square)" if error else ""
        return f"{why} The trajectory is {alone}{off}."
    floor = f" {sentence(metrics['mirrored'])}" if metrics["mirrored"] else ""
    found = f"{_count(kept)}, {metrics['closures_opposing']} of them between views from opposite sides"
    if joined:
        found += f", and {_count(joined)} to earlier runs in its map"
    if error := metrics.get("ate_rmse_m"):
        off = f"{error['before']:.4f} m off the truth (root mean square), and is {error['after']:.4f} m off now"
        return f"The path was {off}, with {found}.{floor}"
    return f"The path was corrected by up to {metrics['corrected_by_m']:.2f} m, with {found}.{floor}"


def _count(closures: int) -> str:
    return f"{closures} loop closure{'s' * (closures != 1)}"


def _numbers(metrics: Mapping[str, Any]) -> dict[str, Any]:
    rows: list[list[Any]] = []
    if error := metrics.get("ate_rmse_m"):
        said = "ATE rmse: root mean square distance from the true path, which is moved and turned to fit best (SE(2))"
        rows += [["error before", f"{error['before']:.4f} m", said], ["error after", f"{error['after']:.4f} m", "same"]]
    checked = "pairs of frames that look alike from above; their points were matched"
    opposing = "the robot faced the other way: the earlier view is turned by pi, half a turn"
    rows += [
        ["candidates checked", str(metrics["candidates"]), checked],
        ["loop closures kept", str(metrics["closures_kept"]), "candidates that are believed to show the same floor"],
        ["of these from opposite sides", str(metrics["closures_opposing"]), opposing],
    ]
    if truth := metrics.get("closures_against_truth"):
        within, worst = f"{truth['within_5cm_1deg']} of {truth['checked']}", truth["position_error_m"]["max"]
        rows.append(["closures that are right", within, "within 5 cm and 1 degree of the truth"])
        rows.append(["largest error of a closure", f"{worst:.4f} m", "of the position that it measured"])
    for key, radius in (("recall_at_1_1m", 1), ("recall_at_1_0.3m", 0.3)):
        if metrics.get(key) is not None:
            said = (
                f"of frames passed within {radius:g} m the other way, the share whose first candidate shows that floor"
            )
            rows.append([f"R@1 within {radius:g} m", f"{metrics[key]:.3f}", said])
    rows += [
        ["frames", str(metrics["frames"]), "images of the log"],
        ["keyframes", str(metrics["keyframes"]), "frames that were looked at: the robot had moved or turned enough"],
        ["time a frame", f"{metrics['ms_per_frame']:.1f} ms", "with compilation, where programs were not cached"],
        ["memory", f"{metrics['peak_memory_mb']:.0f} MB", "the most that was in use"],
    ]
    if broken := len(metrics["broken_frames"]):
        rows.append(["frames left out", str(broken), "their images cannot be read; see metrics.json"])
    # A value and its unit stay on one line.
    rows = [[name, value.replace(" ", "\N{NO-BREAK SPACE}"), said] for name, value, said in rows]
    return {"columns": ["", "value", "what it is"], "rows": rows}


def _closures(rows: Sequence[list[Any]]) -> dict[str, Any]:
    columns = ["frame", "earlier frame", "side", "agree", "matches", "x, m", "y, m", "turn, deg"]
    decimals: list[int | None] = [None] * 5 + [3, 3, 2]
    text = (
        "x, y and turn say how the robot stood at the earlier frame, as seen from the later one (x ahead, y to the "
        "left); agree counts the matches that one motion explains."
    )
    if rows and len(rows[0]) > len(columns):
        columns, decimals = [*columns, "error, m", "error, deg"], [*decimals, 4, 3]
        text += " Errors are against the truth."
    return {"text": text, "table": {"columns": columns, "rows": rows, "decimals": decimals}}


def _candidates(metrics: Mapping[str, Any], picture: bytes) -> dict[str, Any]:
    caption = "Each dot is a pair of frames that was checked, brighter where they look more alike; rings are closures."
    return {
        "title": "Candidates",
        "text": "What became of the candidates that were checked; dots stand for numbers that differ.",
        "table": {"columns": ["outcome", "candidates"], "rows": [list(row) for row in metrics["reasons"].items()]},
        "figures": [{"png": picture, "caption": f"{caption} A way out and back is a falling diagonal."}],
    }


def _times(seconds: Mapping[str, float]) -> dict[str, Any]:
    stages = {key: value for key, value in seconds.items() if key != "total"}
    rows = [[STAGES.get(key, key), float(value)] for key, value in stages.items()]
    rows.append(["loading programs and the log, and the rest", float(seconds["total"] - sum(stages.values()))])
    rows.append(["in all, before results were written", float(seconds["total"])])
    return {"columns": ["", "s"], "rows": rows, "decimals": [None, 1]}


def sentence(line: str) -> str:
    """The line with a capital and a full stop."""
    return f"{line[:1].upper()}{line[1:]}."


def _motion(motion: Mapping[str, Any]) -> dict[str, Any]:
    """What measured the steps, and why pairs were refused."""
    rows = [[name, motion[key]] for name, key in (
        ("steps", "steps"), ("measured on the floor", "measured"), ("by the whole image", "bridged"),
        ("by frames further apart", "spanned"), ("by nothing", "carried"))]  # fmt: skip
    rows += [[f"refused: {reason}", count] for reason, count in motion["refused"].items()]
    return {"columns": ["", "number"], "rows": rows}
