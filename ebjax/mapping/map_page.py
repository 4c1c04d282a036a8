"""The report.html of a map that is written out: its floor, sessions and loop closures."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ebjax import __version__
from ebjax.mapping.contents import CLOSURE, Contents, contents_lines, session_line
from ebjax.viz.report import report
from ebjax.viz.run_page import FILES


def map_page(path: Path, contents: Contents, floor: bytes | None, files: list[str]) -> str:
    """The page as HTML.

    Args:
      path: of the map.
      contents: of it.
      floor: a picture of the floor, if there is one.
      files: names of the other files of the folder.
    """
    closures = np.flatnonzero(contents.of_kind(CLOSURE) & contents.edges.kept)
    edges, known = contents.edges, contents.keyframes
    turn = np.degrees(np.arctan2(np.sin(edges.i_from_j[:, 2]), np.cos(edges.i_from_j[:, 2])))
    table = [
        [
            f"{known.session[i]}: {known.name[i]}",
            f"{known.session[j]}: {known.name[j]}",
            "opposite" if edges.opposing[k] else "same",
            *map(float, (*edges.i_from_j[k, :2], turn[k])),
        ]
        for k, (i, j) in zip(closures, contents.ends(np.isin(np.arange(len(edges)), closures)).tolist(), strict=True)
    ]
    caption = "Every floor view laid where the map says it was seen, with the keyframes' path and the loop closures."
    text = (
        "A loop closure says that two keyframes, each named by its session and its image, saw the same floor. x, y and "
        "turn say how the robot stood at the earlier one, as seen from the later one (x ahead, y to the left)."
    )
    columns = ["later", "earlier", "side", "x, m", "y, m", "turn, deg"]
    rows = {"columns": columns, "rows": table, "decimals": [None, None, None, 3, 3, 2]}
    tracks = [[name, "poses of a session's frames in the map"] for name in files if name.startswith("trajectory")]
    linked = [*tracks, *([name, FILES[name]] for name in FILES if name in files and not name.startswith("trajectory"))]
    sections = [
        {"title": "Sessions", "text": "\n\n".join(session_line(contents, one) for one in contents.sessions)},
        {"title": "Loop closures", "text": text, "table": rows},
        {"title": "Files beside this one", "files": linked},
    ]
    shown = [] if floor is None else [{"png": floor, "caption": caption}]
    said = (
        f"{contents_lines(path, contents)[0]}. Written by ebjax {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC."
    )
    return report({"title": f"The map {path.name}", "text": said, "figures": shown, "sections": sections})
