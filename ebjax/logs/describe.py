"""The facts of a log as short lines, what they are of on the left."""

from collections.abc import Callable
from datetime import UTC, datetime

from ebjax.logs.part_facts import Facts

WIDTH = 10
EARLIEST_S = 946684800
"""1 January 2000: earlier times are not those of a calendar, but of a simulation or since a start."""
DAY_S = 86400


def lines(facts: Facts) -> list[str]:
    """The lines to print, of `log_facts` or `bag_facts`."""
    said = [f"{facts['path']}: {facts['kind']}"]
    for name, words in WORDS.items():
        if facts.get(name) is not None:
            said.append(_row(name, words(facts[name])))
        elif name in facts and name not in facts.get("missing", {}) and name != "truth":
            said.append(_row(name, "none"))
    for name, rows in (("contents", _columns(facts["contents"])), ("notes", facts["notes"])):
        said += [_row("" if k else name, line) for k, line in enumerate(rows)]
    if "missing" in facts:
        said += _end(facts)
    return said


def _end(facts: Facts) -> list[str]:
    absent = list(facts["missing"].items())
    said = [_row("" if k else "missing", f"{name}: {sentence}") for k, (name, sentence) in enumerate(absent)]
    if facts["refused"]:
        return [*said, _row("not ready", facts["refused"])]
    if facts["ready"]:
        words = "it runs without" if absent else "nothing is missing"
        said.append(f"{words}: {facts['run']}")
    return said


def _row(name: str, words: str) -> str:
    return f"{name:{WIDTH}}{words}"


def _columns(rows: list[str]) -> list[str]:
    """Topics with types and counts, one under the other; other lines as they are."""
    cells = [row.split("  ") for row in rows]
    if not cells or len(cells[0]) < 2 or len({len(row) for row in cells}) > 1:
        return rows
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]


def _messages(facts: Facts) -> str:
    return ", ".join([f"{facts['count']}", *_times(facts)]) + _from(facts)


def _images(facts: Facts) -> str:
    size = f"{facts['width']}x{facts['height']}" if facts["width"] else f"none can be decoded: {facts['broken']}"
    said = ", ".join([f"{facts['count']}", size, *_times(facts)]) + _from(facts)
    return f"{said}; broken: {facts['broken']}" if facts["width"] and facts["broken"] else said


def _depth(facts: Facts) -> str:
    return f"{_images(facts)}; {_share(facts['paired'], facts['images'])} have one"


def _camera(facts: Facts) -> str:
    across, down = facts["field_of_view_deg"]
    focal = f"fx {facts['fx']:.1f} fy {facts['fy']:.1f} cx {facts['cx']:.1f} cy {facts['cy']:.1f}"
    lens = facts["distortion_model"]
    if facts["D"]:
        lens += f" [{', '.join(f'{value:.4g}' for value in facts['D'])}]"
    size = f"{facts['width']}x{facts['height']}"
    return f"{size}, {focal} px, {lens}, sees {across:.1f} x {down:.1f} deg" + _from(facts)


def _mount(facts: Facts) -> str:
    angles = ", ".join(f"{name} {_rounded(facts[f'{name}_deg'], 1)}" for name in ("pitch", "roll", "yaw"))
    height, x, y = (_rounded(facts[f"{name}_m"], 3) for name in ("height", "x", "y"))
    return f"height {height} m, {angles} deg, x {x} y {y} m"


def _poses(facts: Facts) -> str:
    said = [f"{facts['count']}", *_times(facts), f"{facts['distance_m']:.1f} m driven"]
    words = f"; {_share(facts['covered'], facts['images'])} have a pose"
    if facts["clock_ahead_s"] is not None:
        behind = "before" if facts["clock_ahead_s"] < 0 else "after"
        words += f": its clock starts {_duration(abs(facts['clock_ahead_s']))} {behind} the images'"
    return ", ".join(said) + _from(facts) + words


def _times(facts: Facts) -> list[str]:
    """When it starts, how long it lasts, rate, and largest gap."""
    if facts["first_s"] is None:
        return []
    said = [f"from {_moment(facts['first_s'])}"]
    if facts["span_s"]:
        said.append(f"{_duration(facts['span_s'])} long")
    if facts.get("rate_hz"):
        said.append(f"{facts['rate_hz']:.3g}/s, largest gap {_duration(facts['largest_gap_s'])}")
    return said


def _from(facts: Facts) -> str:
    """What it was read from, where that is not the log itself."""
    return f" ({facts['source']})" if facts.get("source") else ""


def _moment(time_s: float) -> str:
    if not EARLIEST_S < time_s < 4 * EARLIEST_S:
        return f"{time_s:.3f} s"
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC ({time_s:.3f} s)"


def _duration(time_s: float) -> str:
    if time_s >= DAY_S:
        return f"{time_s / DAY_S:.1f} days"
    return f"{time_s:.0f} s" if time_s >= 1000 else f"{time_s:.3g} s"


def _rounded(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}"  # -0.0 becomes 0.0


def _share(count: int, total: int) -> str:
    return "all images" if count == total else f"{count} of {total} images"


WORDS: dict[str, Callable[[Facts], str]] = {
    "messages": _messages,
    "images": _images,
    "depth": _depth,
    "camera": _camera,
    "mount": _mount,
    "odometry": _poses,
    "truth": _poses,
}
"""What is said of a log's parts, in this order."""
