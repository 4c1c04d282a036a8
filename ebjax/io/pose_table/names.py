"""What the name of a column says: `p_RS_R_x [m]`, `field.pose.pose.orientation.w`, `t_nsec`, `theta_deg`, `qw`.

The last word is the part of a pose, the words before it the group; a unit stands in brackets or as the last word.
"""

import dataclasses
import re
from dataclasses import dataclass

UNITS: dict[str, dict[str, tuple[str, ...]]] = {
    "time": {
        "s": ("s", "sec", "secs", "second", "seconds"),
        "ms": ("ms", "msec", "msecs", "millisecond", "milliseconds", "millis"),
        "us": ("us", "µs", "μs", "usec", "usecs", "microsecond", "microseconds", "micros"),
        "ns": ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds", "nanos"),
    },
    "position": {
        "m": ("m", "meter", "meters", "metre", "metres"),
        "cm": ("cm", "centimeter", "centimeters", "centimetre", "centimetres"),
        "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    },
    "angle": {"rad": ("rad", "rads", "radian", "radians"), "deg": ("deg", "degs", "degree", "degrees", "°")},
}
GROUPS = {
    "position": "p pos position positions t trans translation translations loc location pose xyz",
    "quaternion": "q quat quaternion rot rotation orientation ori attitude",
    "other": "v vel velocity velocities linear angular twist a acc accel acceleration accelerometer g gyro gyroscope "
    "omega w b bias mag magnetometer cov covariance var variance std sigma err error rate gravity goal target scale "
    "force torque wrench",
}
KIND_OF_GROUP = {word: kind for kind, words in GROUPS.items() for word in words.split()}
CLOCK = frozenset("timestamp timestamps time times stamp ts t".split())
ANGLES = frozenset("roll pitch yaw heading theta th phi psi".split())
JOINED = re.compile(r"(p|t|pos|position|trans|translation|q|quat|quaternion|rot|rotation|ori|orientation)([xyzw])")
NAME = re.compile(r"(.*?)(?:\[([^\]]*)\]|\(([^)]*)\))?")


@dataclass(frozen=True)
class Name:
    """What a column holds.

    Attributes:
      text: the name as written, without a unit in brackets.
      kind: time, position, quaternion, angle, axis (of a position or a quaternion) or other.
      part: an axis, an angle, or what a time counts: a key of `UNITS`, or "" where no unit is in the name.
      group: the words before the part; the columns of one pose share them.
      unit: a key of `UNITS`, "" where none is named, or the text in square brackets where it is none.
    """

    text: str
    kind: str = "other"
    part: str = ""
    group: str = ""
    unit: str = ""


def meaning(text: str) -> Name:
    """Reads one name."""
    match = NAME.fullmatch(text.strip())
    assert match is not None
    label, square, round_ = match[1].strip(), match[2] or "", match[3] or ""
    words = re.findall(r"[a-z]+|\d+|[°µμ]\w*", re.sub(r"([a-z])([A-Z])", r"\1 \2", label).lower())
    found = (words and (_time(label, words) or _angle(label, words) or _axis(label, words))) or Name(label)
    units = UNITS.get("position" if found.kind == "axis" else found.kind)
    if units is None or not (square or round_).strip("-1"):
        return found
    named = [unit for word in (square or round_).lower().split("|") for unit in units if word in units[unit]]
    # What stands in round brackets may be a remark.
    return dataclasses.replace(found, unit=named[0] if named else square or found.unit)


def _unit(kind: str, words: list[str]) -> tuple[str, list[str]]:
    """Takes the unit off the end of words, if there is more."""
    unit = next((unit for unit, spelt in UNITS[kind].items() if words[-1] in spelt), "")
    return (unit, words[:-1]) if unit and len(words) > 1 else ("", words)


def _time(text: str, words: list[str]) -> Name | None:
    if any(KIND_OF_GROUP.get(word) == "other" for word in words[:-1]):
        return None
    unit, before = _unit("time", words)
    if unit and before[-1] in CLOCK | {"header"}:
        return Name(text, "time", unit, " ".join(before), unit)
    alone = next((unit for unit in ("s", "ns") if words[-1] in UNITS["time"][unit][1:]), "")
    if len(words) == 1 and alone:
        return Name(text, "time", alone, "", alone)
    return Name(text, "time", "", " ".join(words), "") if words[-1] in CLOCK else None


def _angle(text: str, words: list[str]) -> Name | None:
    unit, words = _unit("angle", words)
    if words[-1] not in ANGLES or any(KIND_OF_GROUP.get(word) == "other" for word in words):
        return None
    return Name(text, "angle", words[-1], " ".join(words[:-1]), unit)


def _axis(text: str, words: list[str]) -> Name | None:
    unit, words = _unit("position", words)
    if joined := JOINED.fullmatch(words[-1]):
        words = [*words[:-1], *joined.groups()]
    if words[-1] not in ("x", "y", "z", "w"):
        return None
    # A symbol stands before the letters of its frames, p_WS_W_x; the word nearest to the axis says most.
    before = [word for word in reversed(words[:-1]) if len(word) > 1] + [word for word in words[:-1] if len(word) == 1]
    kind = next((KIND_OF_GROUP[word] for word in before if word in KIND_OF_GROUP), "axis")
    if kind == "position" and words[-1] == "w":
        kind = "axis"
    return None if kind == "other" else Name(text, kind, words[-1], " ".join(words[:-1]), unit)
