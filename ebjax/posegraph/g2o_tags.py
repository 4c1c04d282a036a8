"""The lines of g2o, RTAB-Map and TORO: what a tag's numbers are. Tags are compared in upper case.

A vertex is `tag id numbers`; an edge is `tag ids parameters measurement information`, the information as the upper
triangle of a matrix of as many rows as the measurement has degrees of freedom. Parameters are ids of PARAMS lines.
"""

from typing import NamedTuple

SIZES = {"xyt": (3, 6), "quat": (7, 21), "euler": (6, 21), "xy": (2, 3), "xyz": (3, 6)}
"""Numbers of a measurement and of its information: x y theta, x y z qx qy qz qw, x y z roll pitch yaw, points."""

PLANAR = ("xyt", "xy")
POINTS = ("xy", "xyz")

VERTICES = {
    "VERTEX_SE2": "xyt",
    "VERTEX_SE3:QUAT": "quat",
    "VERTEX_XY": "xy",
    "VERTEX_POINT_XY": "xy",
    "VERTEX_TRACKXYZ": "xyz",
    "VERTEX_POINT_XYZ": "xyz",
    "VERTEX_POINTXYZ": "xyz",
    "VERTEX_XYZ": "xyz",
    "VERTEX": "xyt",
    "VERTEX2": "xyt",
    "VERTEX3": "euler",
}


class Edge(NamedTuple):
    """How many vertices an edge names, how many parameters after them, and what it measures.

    Of `ends` 1 it is a prior. `optional` parameters are missing in what some programs write.
    """

    ends: int
    layout: str
    parameters: int = 0
    optional: bool = False


EDGES = {
    "EDGE_SE2": Edge(2, "xyt"),
    "EDGE_SE3:QUAT": Edge(2, "quat"),
    "EDGE_SE3": Edge(2, "quat"),
    "EDGE_SE2_OFFSET": Edge(2, "xyt", 2),
    "EDGE_SE3_OFFSET": Edge(2, "quat", 2),
    "EDGE_PRIOR_SE2": Edge(1, "xyt", 1, True),
    "EDGE_SE2_PRIOR": Edge(1, "xyt", 1, True),
    "EDGE_SE3_PRIOR": Edge(1, "quat", 1, True),
    "EDGE_SE3_PRIOR:QUAT": Edge(1, "quat", 1, True),
    "EDGE_PRIOR_SE2_XY": Edge(1, "xy", 1, True),
    "EDGE_SE3_XYZ_PRIOR": Edge(1, "xyz", 1, True),
    "EDGE_PRIOR_XY": Edge(1, "xy", 1, True),
    "EDGE_POINTXY_PRIOR": Edge(1, "xy", 1, True),
    "EDGE_POINTXYZ_PRIOR": Edge(1, "xyz", 1, True),
    "EDGE_PRIOR_XYZ": Edge(1, "xyz", 1, True),
    "EDGE_SE2_XY": Edge(2, "xy"),
    "EDGE_SE2_POINTXY_OFFSET": Edge(2, "xy", 1),
    "EDGE_SE2_POINT_XY": Edge(2, "xy", 1, True),
    "EDGE_SE3_TRACKXYZ": Edge(2, "xyz", 1, True),
    "EDGE_POINTXY": Edge(2, "xy"),
    "EDGE_POINTXYZ": Edge(2, "xyz"),
    "EDGE": Edge(2, "xyt"),
    "EDGE2": Edge(2, "xyt"),
    "EDGE3": Edge(2, "euler"),
}

TORO = ("EDGE", "EDGE2")
OFFSETS = {"PARAMS_SE2OFFSET": "xyt", "PARAMS_SE2_OFFSET": "xyt", "PARAMS_SE3OFFSET": "quat"}
SENSOR_DATA = ("ROBOTLASER1", "ROBOTLASER2", "RAWLASER", "RAWLASER1", "VERTEX_TAG", "VERTEX_ELLIPSE")
PREFIXES = ("TUTORIAL_", "ONLINE_")

_REMEDIES = {
    "SWITCH": "it makes an edge switchable; export without switches (RTAB-Map: Optimizer/Robust false), take --robust",
    "MAXMIX": "it makes an edge a mixture; export plain edges and take --robust",
    "BEARING": "it measures a bearing alone; export landmarks as positions, EDGE_SE2_XY",
    "CALIB": "it estimates a calibration; export with the calibration applied",
    "PROJECT": "it belongs to bundle adjustment; export the poses with EDGE_SE3:QUAT",
    "CAM": "it belongs to bundle adjustment; export the poses with EDGE_SE3:QUAT",
    "SIM3": "its poses have a scale; export VERTEX_SE3:QUAT and EDGE_SE3:QUAT",
}


def plain(tag: str) -> str:
    """The tag in upper case, without what g2o's tutorial and its online solver put in front."""
    tag = tag.upper()
    for prefix in PREFIXES:
        tag = tag.removeprefix(prefix)
    return tag


def not_supported(tag: str) -> str:
    """What to say of a tag that is not in the tables."""
    for word, remedy in _REMEDIES.items():
        if word in tag.upper():
            return f"{tag} is not supported: {remedy}"
    return f"{tag} is not supported; convert it to one of {', '.join([*VERTICES, *EDGES])}, or delete it"
