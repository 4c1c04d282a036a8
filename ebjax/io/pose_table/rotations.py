"""Quaternions, angles and matrices of a table as rotations: their lengths checked, their order and unit found."""

import numpy as np
from jaxtyping import Float

from ebjax.io.pose_table.evidence import angle_unit, looks_w_first, w_stands_first
from ebjax.io.pose_table.layout import Layout
from ebjax.io.poses import poses_from, quaternion_from_angles, rigid_fault, rotation_from_quaternion

# No robot drives a million kilometres.
MOST = 1e9
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# Parts of wxyz in the order of the columns.
W_FIRST, W_LAST = [0, 1, 2, 3], [1, 2, 3, 0]
W_LAST_LINE, W_FIRST_LINE = "`# timestamp tx ty tz qx qy qz qw`", "`# timestamp tx ty tz qw qx qy qz`"


def poses_of(
    path: str, numbers: list[int], layout: Layout, values: Float[np.ndarray, "N C"]
) -> tuple[Float[np.ndarray, "N 4 4"], list[str]]:
    """Turns the numbers of a layout's `pose` columns into poses, and says what was converted or guessed.

    Args:
      path: of the file, for messages.
      numbers: of the rows' lines, for messages.
      layout: of the columns.
      values: finite.

    Raises:
      ValueError: what is no rotation, or cannot be told from something else; names file and line.
    """
    far = np.flatnonzero((np.abs(values) > MOST).any(axis=1))
    if far.size:
        raise ValueError(
            f"{path} line {numbers[far[0]]}: a number over {MOST:g} is no part of a pose; correct the line"
        )
    if layout.matrix:
        return _matrices(path, numbers, values), []
    parts = len(layout.position)
    positions = np.zeros((len(values), 3))
    positions[:, :parts] = values[:, :parts] * METRES[layout.position_unit]
    says = [f"positions are in {layout.position_unit} (header), read as metres"] * (layout.position_unit != "m")
    if layout.quaternion:
        quaternion, more = _quaternions(path, numbers, layout, values[:, parts:], positions)
        return poses_from(rotation_from_quaternion(quaternion), positions), says + more
    roll_pitch_yaw, more = _angles(path, layout, values[:, parts:], positions)
    return poses_from(rotation_from_quaternion(quaternion_from_angles(roll_pitch_yaw)), positions), says + more


def _matrices(path: str, numbers: list[int], values: Float[np.ndarray, "N C"]) -> Float[np.ndarray, "N 4 4"]:
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, : values.shape[1] // 4] = values.reshape(len(values), -1, 4)
    gram = poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    suspect = (np.abs(gram - np.eye(3)[None]).max(axis=(1, 2)) > 1e-2) | (np.linalg.det(poses) < 0)
    suspect |= np.abs(poses[:, 3] - [[0.0, 0.0, 0.0, 1.0]]).max(axis=1) > 1e-9
    for number, pose in ((numbers[k], poses[k]) for k in np.flatnonzero(suspect)):
        if fault := rigid_fault(pose, tolerance=1e-2):
            raise ValueError(f"{path} line {number}: not a pose, {fault}; correct or remove the line")
    return poses


def _quaternions(
    path: str,
    numbers: list[int],
    layout: Layout,
    quaternion: Float[np.ndarray, "N 4"],
    positions: Float[np.ndarray, "N 3"],
) -> tuple[Float[np.ndarray, "N 4"], list[str]]:
    """Checks quaternions (wxyz by the layout) and the order of their parts."""
    off = np.abs(np.linalg.norm(quaternion, axis=1) - 1)
    if (off > 0.05).any():
        number = numbers[np.flatnonzero(off > 0.05)[0]]
        remedy = "correct the line" if layout.named else f"correct the line, or name the columns, such as {W_LAST_LINE}"
        raise ValueError(
            f"{path} line {number}: the quaternion's length is {1 + off[off > 0.05][0]:.3g} or less, not 1; "
            f"its order is {'as the header says' if layout.named else 'qx qy qz qw'}; {remedy}"
        )
    says = [f"quaternions up to {off.max():.1%} off length 1 are normalised"] * bool(off.max() > 1e-3)
    in_file = sorted(range(4), key=lambda part: layout.quaternion[part])
    as_written = quaternion[:, in_file]
    first = w_stands_first(as_written, positions) if in_file in (W_LAST, W_FIRST) else None
    if layout.named:
        if first is not None and first != (in_file == W_FIRST):
            says.append(
                f"its header puts w {'last' if first else 'first'}, but read with w {'first' if first else 'last'} the "
                "moving frame turns with its path; correct the header if it is wrong"
            )
        return quaternion, says
    if in_file == W_FIRST:
        if first is False:
            raise ValueError(
                f"{path}: its quaternions should be written qw qx qy qz, but only read as qx qy qz qw the moving "
                "frame turns with its path; name the columns in the first line, every other column by any other "
                f"name, such as {W_LAST_LINE}"
            )
        return quaternion, says
    if first is None and looks_w_first(as_written):
        raise ValueError(
            f"{path}: its quaternions are near 1 0 0 0: no rotation if they are written qw qx qy qz, half a turn about "
            "x if qx qy qz qw, and the path does not tell. Say which in the first line: "
            f"{W_FIRST_LINE} or {W_LAST_LINE}"
        )
    if not first:
        return quaternion, says
    says.append(
        "its quaternions are read as qw qx qy qz: so the moving frame turns with its path, as qx qy qz qw it does not. "
        f"If that is wrong, make {W_LAST_LINE} its first line"
    )
    return as_written, says


def _angles(
    path: str, layout: Layout, angles: Float[np.ndarray, "N A"], positions: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "N 3"], list[str]]:
    """Returns roll, pitch and yaw in radians."""
    says = []
    unit = layout.angle_unit
    what = "roll, pitch and yaw" if angles.shape[1] == 3 else "the heading"
    if not unit:
        unit, why = _unit_of(path, layout, angles, positions)
        if layout.named or layout.time or unit == "rad":
            says.append(f"{what} is read in {dict(rad='radians', deg='degrees')[unit]} ({why})")
    if angles.shape[1] == 3:
        says.append("roll, pitch and yaw make the rotation Rz(yaw) Ry(pitch) Rx(roll)")
    radians = np.zeros((len(angles), 3))
    radians[:, 3 - angles.shape[1] :] = np.deg2rad(angles) if unit == "deg" else angles
    return radians, says


def _unit_of(
    path: str, layout: Layout, angles: Float[np.ndarray, "N A"], positions: Float[np.ndarray, "N 3"]
) -> tuple[str, str]:
    unit = angle_unit(positions, angles[:, -1])
    if unit:
        return unit, "so it turns with the path"
    if not layout.named and layout.time:
        raise ValueError(
            f"{path}: 4 columns, and whether the last is a heading the path does not tell (x y z alone is no pose); "
            "name the columns in the first line, `# timestamp x y theta_rad` or `# timestamp x y theta_deg`"
        )
    if np.abs(angles).max(initial=0) > 2 * np.pi + 1e-3:
        return "deg", "by their size"
    if layout.named:
        return "rad", "the header names no unit"
    return "deg", "as `x y theta_deg`"
