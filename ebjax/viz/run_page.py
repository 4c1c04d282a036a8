"""The report of a run as a page for `viz.report`: numbers, trajectory, map, matches, rejected candidates."""

from collections.abc import Mapping
from typing import Any

from ebjax.viz.motion import motion_lines

Figure = dict[str, Any]


def run_page(
    name: str,
    metrics: Mapping[str, Any],
    figures: Mapping[str, bytes],
    best: list[Figure],
    rejected: list[Figure],
    closures: list[list[Any]],
) -> dict[str, Any]:
    """Puts a run's results in reading order.

    Args:
      name: of the sequence.
      metrics: what metrics.json holds.
      figures: PNGs "trajectory", "candidates", "floor_map".
      best: matches of kept closures, {"png", "caption"}.
      rejected: matches of candidates that were left out, with the reason as caption.
      closures: rows of the kept closures' table.
    """
    sections: list[dict[str, Any]] = [{"title": "Result", "table": _summary(metrics)}]
    error = metrics.get("ate_rmse_m")
    caption = "Odometry and the corrected path"
    if error:
        caption += f"; ATE rmse after SE(2) alignment {error['before']:.3f} m before, {error['after']:.3f} m after"
    sections.append({"title": "Trajectory", "figures": [{"png": figures["trajectory"], "caption": caption + "."}]})
    if "floor_map" in figures:
        text = "Every floor view laid where the corrected trajectory says it was seen."
        sections.append({"title": "Map of the floor", "figures": [{"png": figures["floor_map"], "caption": text}]})
    if motion := metrics.get("motion"):
        text = " ".join(map(_sentence, (*motion_lines(metrics), *motion["warnings"])))
        sections.append({"title": "Steps", "text": text, "table": _motion(motion)})
    if best:
        sections.append({"title": "Loop closures", "figures": best, "table": _closures(closures)})
    if rejected:
        text = "Candidates that look alike and were not believed, with the reason."
        sections.append({"title": "Rejected candidates", "text": text, "figures": rejected})
    sections.append(
        {
            "title": "Candidates",
            "table": {"columns": ["outcome", "candidates"], "rows": [list(r) for r in metrics["reasons"].items()]},
            "figures": [
                {"png": figures["candidates"], "caption": "Pairs of frames; an out-and-back run is a diagonal."}
            ],
        }
    )
    seconds = metrics["seconds"]
    sections.append(
        {"title": "Time", "table": {"columns": ["stage", "s"], "rows": [[k, float(v)] for k, v in seconds.items()]}}
    )
    return {"title": f"Loop closing on {name}", "text": _headline(metrics), "sections": sections}


def _headline(metrics: Mapping[str, Any]) -> str:
    kept = metrics["closures_kept"]
    if not kept:
        alone = "the odometry" if metrics.get("motion") is None else "what the steps and the odometry say"
        why = metrics.get("nothing_kept") or "no loop closure was found"
        return f"{_sentence(why)} The trajectory is {alone}."
    ways = f"{metrics['closures_opposing']} from opposing viewpoints"
    return f"{kept} loop closures were kept, {ways}, of {metrics['candidates']} verified candidates."


def _summary(metrics: Mapping[str, Any]) -> dict[str, Any]:
    rows: list[list[Any]] = []
    if error := metrics.get("ate_rmse_m"):
        rows += [["ATE rmse of odometry, m", error["before"]], ["ATE rmse after, m", error["after"]]]
    rows.append(["loop closures kept", str(metrics["closures_kept"])])
    if truth := metrics.get("closures_against_truth"):
        rows.append(["of these within 5 cm and 1 degree of the truth", str(truth["within_5cm_1deg"])])
        rows.append(["largest error of a closure, m", truth["position_error_m"]["max"]])
    for key, label in (("recall_at_1_1m", "R@1 m of the first candidate"), ("recall_at_1_0.3m", "R@0.3 m")):
        if metrics.get(key) is not None:
            rows.append([label, metrics[key]])
    rows += [["frames", str(metrics["frames"])], ["looked at", str(metrics["keyframes"])]]
    rows += [["frames that could not be read", str(len(metrics["broken_frames"]))]]
    rows += [["ms a frame", metrics["ms_per_frame"]], ["peak memory, MB", metrics["peak_memory_mb"]]]
    return {"columns": ["", "value"], "rows": rows}


def _sentence(line: str) -> str:
    return f"{line[:1].upper()}{line[1:]}."


def _motion(motion: Mapping[str, Any]) -> dict[str, Any]:
    """What measured the steps, and why pairs were refused."""
    rows = [[name, str(motion[key])] for name, key in (("steps", "steps"), ("measured on the floor", "measured"),
            ("by the whole image", "bridged"), ("by nothing", "carried"))]  # fmt: skip
    rows += [[f"refused: {reason}", str(count)] for reason, count in motion["refused"].items()]
    return {"columns": ["", "number"], "rows": rows}


def _closures(rows: list[list[Any]]) -> dict[str, Any]:
    columns = ["frame", "earlier frame", "seen from", "inliers", "matches", "x, m", "y, m", "heading, deg"]
    return {"columns": columns, "rows": rows}
