"""Measurements and information of a g2o file's edges in the terms of `ebjax.posegraph.graph`.

A sensor's offset P, base_from_sensor, is worked in, which changes no residual: of a prior, log(Z^-1 X P) is
Ad(P^-1) log((Z P^-1)^-1 X); of a point, P^-1 (X^-1 l) - z is R_P^T (X^-1 l - P z); an edge between two sensors is one
between the poses, Pi Z Pj^-1, turned by Ad(Pj^-1).
"""

import numpy as np
from jaxtyping import Float

from ebjax.posegraph.g2o_lines import Lines, Measured
from ebjax.posegraph.g2o_tags import POINTS, TORO
from ebjax.posegraph.graph import definite, negative
from ebjax.posegraph.matrices import adjoints, from_matrices, to_matrices

CONVENTIONS = ("auto", "g2o", "gtsam")


def rotation_scale(convention: str, planar: bool, beyond_poses: bool) -> float:
    """Rotation vector by what a file's information is of: 1 the same, 0.5 the quaternion's vector part.

    "g2o" is the latter, "gtsam" the former. "auto" goes by what only g2o's own programs write: priors and landmarks.

    Raises:
      ValueError: unknown convention.
    """
    if convention not in CONVENTIONS:
        raise ValueError(f"information {convention!r} is unknown; choose one of {', '.join(CONVENTIONS)}")
    quaternion = convention == "g2o" or (convention == "auto" and beyond_poses)
    return 0.5 if quaternion and not planar else 1.0


def file_poses(values: Float[np.ndarray, "K m"], layout: str) -> Float[np.ndarray, "K P"]:
    """A file's numbers as poses: x y theta, or wxyz_xyz with unit quaternions."""
    if layout == "xyt":
        return values
    if layout == "xy":
        return np.pad(values, ((0, 0), (0, 1)))
    if layout == "quat":
        q = values[:, [6, 3, 4, 5]]
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
    elif layout == "euler":
        from scipy.spatial.transform import Rotation

        q = Rotation.from_euler("ZYX", values[:, [5, 4, 3]]).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    else:
        q = np.tile(np.eye(4)[0], (len(values), 1))
    return np.concatenate([q, values[:, :3]], 1)


def note_norms(found: Lines, layout: str, values: Float[np.ndarray, "K m"], lines: list[int]) -> None:
    """Notes quaternions that are not of unit length."""
    if layout == "quat":
        off = np.abs(np.linalg.norm(values[:, 3:7], axis=1) - 1) > 1e-3
        if off.any():
            more = f" and {off.sum() - 1} more lines" if off.sum() > 1 else ""
            found.notes.append(
                f"line {lines[int(np.argmax(off))]}{more}: the quaternion is not of unit length; made so"
            )


def numbers_of(found: Lines, scale: float) -> tuple[Float[np.ndarray, "E P"], Float[np.ndarray, "E d d"]]:
    """Measurements as poses and information in the order of `ebjax.geometry.lie`, of all edges.

    `scale` is `rotation_scale`.

    Raises:
      ValueError: information with a negative eigenvalue, or an offset that the file does not hold; names the line.
    """
    width, dim = (3, 3) if found.planar else (7, 6)
    measured, information = np.zeros((len(found.edges), width)), np.zeros((len(found.edges), dim, dim))
    by_layout: dict[tuple[str, bool], list[int]] = {}
    for k, edge in enumerate(found.edges):
        by_layout.setdefault((edge.form.layout, edge.tag in TORO), []).append(k)
    for (layout, toro), rows in by_layout.items():
        edges = [found.edges[k] for k in rows]
        lines = [e.line for e in edges]
        values, upper = np.array([e.values for e in edges]), np.array([e.information for e in edges])
        note_norms(found, layout, values, lines)
        measured[rows] = file_poses(values, layout)
        matrices = _toro(upper, found, lines) if toro else _symmetric(upper)
        if layout == "euler":
            order = [3, 4, 5, 0, 1, 2]
            matrices = matrices[:, order][:, :, order]
            if not np.array_equal(matrices[:, :3, :3], matrices[:, 3:, 3:]):
                found.notes.append("information of EDGE3 is read as TORO and gtsam mean it: the rotation stands first")
        if layout == "quat" and scale != 1:
            by = np.repeat([1.0, scale], 3)
            matrices = matrices * by[:, None] * by
        size = matrices.shape[-1]
        information[np.ix_(rows, range(size), range(size))] = _semidefinite(matrices, found, lines)
    for k, edge in enumerate(found.edges):
        offsets = _offsets(edge, found)
        if offsets is not None:
            measured[k], information[k] = _without_offsets(edge, measured[k], information[k], offsets)
    return measured, information


def _symmetric(upper: Float[np.ndarray, "K m"]) -> Float[np.ndarray, "K d d"]:
    d = {m: d for d, m in ((2, 3), (3, 6), (6, 21))}[upper.shape[1]]
    out = np.zeros((len(upper), d, d))
    out[(slice(None), *np.triu_indices(d))] = upper
    return out + np.triu(out, 1).swapaxes(1, 2)


def _toro(upper, found, lines):
    """TORO's I11 I12 I22 I33 I13 I23, or row by row as RTAB-Map writes EDGE2, if only that can be right."""
    toro, by_row = _symmetric(upper[:, [0, 1, 4, 2, 5, 3]]), _symmetric(upper)
    if negative(toro).any() and not negative(by_row).any():
        found.notes.append(
            f"line {lines[0]}: information of EDGE2 is read row by row; in TORO's order it is not definite"
        )
        return by_row
    return toro


def _semidefinite(matrices, found, lines):
    if definite(matrices):
        return matrices
    bad = negative(matrices)
    if bad.any():
        more = f" (and in {bad.sum() - 1} more edges)" if bad.sum() > 1 else ""
        raise ValueError(
            f"{found.name}:{lines[int(np.argmax(bad))]}: information matrix is not positive definite{more}: it has a "
            "negative eigenvalue; give an inverse covariance, zeros where nothing was measured"
        )
    values, vectors = np.linalg.eigh(matrices)
    low = values[:, 0] < -1e-12 * np.maximum(values[:, -1], 0)
    if low.any():
        more = f" and {low.sum() - 1} more lines" if low.sum() > 1 else ""
        found.notes.append(
            f"line {lines[int(np.argmax(low))]}{more}: a negative eigenvalue, by rounding, is taken as zero"
        )
        clipped = (vectors * np.maximum(values, 0)[:, None, :]) @ vectors.swapaxes(1, 2)
        matrices = np.where(low[:, None, None], clipped, matrices)
    return matrices


def _offsets(edge: Measured, found: Lines) -> list[np.ndarray] | None:
    """The edge's sensor offsets as matrices; None where they change nothing."""
    if edge.parameters is None:
        return None
    out = []
    for p in edge.parameters:
        if p in found.offsets:
            vertex = found.offsets[p]
            out.append(to_matrices(file_poses(np.array([vertex.values]), vertex.layout))[0])
        elif (own := edge.form.ends == 1 and p == edge.ends[0]) or p == 0:
            if not own and not any("PARAMS" in note for note in found.notes):
                found.notes.append(f"line {edge.line}: no PARAMS line for 0; taken as no offset")
            out.append(np.eye(3 if found.planar else 4))
        else:
            tag = "PARAMS_SE2OFFSET" if found.planar else "PARAMS_SE3OFFSET"
            raise ValueError(f"{found.name}:{edge.line}: {edge.tag} takes the offset {p}; add a line {tag} {p} ...")
    position_of_pose = edge.form.ends == 1 and edge.form.layout in POINTS
    return None if position_of_pose or all(np.array_equal(m, np.eye(len(m))) for m in out) else out


def _without_offsets(edge, measured, information, offsets):
    z, last = to_matrices(measured[None])[0], np.linalg.inv(offsets[-1])
    if edge.form.layout in POINTS:
        z[:-1, -1:] = (offsets[0] @ z)[:-1, -1:]
        turn = np.eye(len(information))
        turn[: len(z) - 1, : len(z) - 1] = last[:-1, :-1]
    else:
        z = (offsets[0] @ z if edge.form.ends == 2 else z) @ last
        turn = adjoints(last[None])[0]
    return from_matrices(z[None])[0], turn.T @ information @ turn
