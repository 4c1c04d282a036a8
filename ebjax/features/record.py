"""What a comparison of two images says, as plain values for a JSON file, with the meaning of its coordinates."""

from typing import Any

import numpy as np

from ebjax.features.measure import LoopMeasurement, lift, measure_depth, measure_floor
from ebjax.features.pair import Comparison, PlaneView
from ebjax.geometry.camera import Camera

MIN_DEPTHS = 5
RAW, FLOOR, TURNED = "raw", "floor", "floor + pi"


def number_list(array: Any) -> Any:
    """Nested lists of floats, for JSON."""
    return np.asarray(array, np.float64).tolist()


def unit(homography: np.ndarray) -> np.ndarray:
    """Scales a homography to h33 = 1."""
    return homography / homography[2, 2]


def image_b_from_a(comparison: Comparison, view: PlaneView) -> np.ndarray:
    """The motion as a homography, px of a to px of b."""
    plane_from_image = view.plane_from_view @ np.linalg.inv(view.image_from_view)
    return unit(np.linalg.inv(plane_from_image) @ np.linalg.inv(comparison.a_from_b) @ plane_from_image)


def matched_points(comparison: Comparison) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, y) px of the matches in a and in b, and which agree."""
    matched = comparison.matched
    rows = np.flatnonzero(np.asarray(matched.matched))
    points = (
        np.asarray(pixels, np.float64)[np.asarray(index)[rows]]
        for pixels, index in zip(comparison.pixels, (matched.query, matched.reference), strict=True)
    )
    return *points, np.asarray(matched.inliers)[rows]


def describe(
    name: str, kind: str, model: str, comparison: Comparison, view: PlaneView, size: int, contradicts: str | None = None
) -> dict[str, Any]:
    """One line of the table with its homographies, for transform.json; what contradicts an input is not believed."""
    believed = comparison.believed and contradicts is None
    record: dict[str, Any] = {"extractor": name, "input": kind, "model": model}
    record |= {"inliers": comparison.inliers, "total": comparison.total, "believed": believed}
    record |= {"contradicts": contradicts, "guided_inliers": int(comparison.matched.count) if believed else None}
    if not comparison.inliers:
        return record
    record["image_b_from_a"] = number_list(image_b_from_a(comparison, view))
    if kind != RAW:
        turned = np.array([[-1.0, 0, size], [0, -1.0, size], [0, 0, 1]])
        turn, plane_b_from_a = kind == TURNED and not view.metric, np.linalg.inv(comparison.a_from_b)
        record["floor_b_from_a"] = number_list(unit(turned @ plane_b_from_a if turn else plane_b_from_a))
    return record


def measure(comparison: Comparison, camera: Camera, depths: tuple[np.ndarray, np.ndarray] | None) -> dict[str, Any]:
    """a_from_b on the metric floor and, with depth, from 3D points, of a comparison that is believed."""
    matched = comparison.matched
    q, r, inliers = matched.query, matched.reference, np.asarray(matched.inliers)
    record = {"a_from_b": motion(measure_floor(comparison.plane[0][q], comparison.plane[1][r], inliers))}
    if depths is None:
        return record
    lifted = [
        lift(p, d.astype(p.dtype), camera)
        for p, d in zip((comparison.pixels[0][q], comparison.pixels[1][r]), depths, strict=True)
    ]
    (points_a, range_a), (points_b, range_b) = (map(np.asarray, one) for one in lifted)
    deep = inliers & (range_a > 0) & (range_b > 0)
    count = int(deep.sum())
    found = motion(measure_depth(points_a, points_b, deep, np.maximum(range_a, range_b)))
    return record | {"a_from_b_depth": found if count >= MIN_DEPTHS else None, "inliers_with_depth": count}


def motion(found: LoopMeasurement) -> dict[str, Any]:
    """A measurement for transform.json."""
    x, y, theta = (float(v) for v in found.i_from_j)
    covariance = number_list(found.covariance)
    return {"x_m": x, "y_m": y, "theta_rad": theta, "covariance": covariance, "residual_m": float(found.residual_m)}


def summary(record: dict[str, Any]) -> list[str]:
    """Says which line of the table is kept and what it measured."""
    if not record["believed"]:
        return ["no common floor found: no input has more matches in agreement than chance would show"]
    extractor, kind, model, guided = (record[key] for key in ("extractor", "input", "model", "guided_inliers"))
    lines = [f"best: {extractor}, {kind}, {model}, {guided} guided inliers"]
    if kind == RAW:
        lines.append("only the raw images agree, as those of two places that look alike do; a floor view would tell")
    for key, way in (("a_from_b", "metric floor"), ("a_from_b_depth", "depth")):
        found = record.get(key)
        if found is not None:
            sigma = np.sqrt(np.diag(found["covariance"]))
            lines.append(
                f"a_from_b by {way}: x {found['x_m']:.4f} m, y {found['y_m']:.4f} m, "
                f"theta {np.degrees(found['theta_rad']):.3f} deg (sigma {sigma[0]:.4f} m, {sigma[1]:.4f} m, "
                f"{np.degrees(sigma[2]):.3f} deg)"
            )
    if "inliers_with_depth" in record and record["a_from_b_depth"] is None:
        lines.append(f"a_from_b by depth: none, only {record['inliers_with_depth']} inliers have depth in both images")
    return lines


def conventions(size: int, margin: float, view: PlaneView | None, quad: np.ndarray | None) -> dict[str, Any]:
    """What the coordinates in transform.json mean."""
    meaning: dict[str, Any] = {
        "image_b_from_a": "(x, y, 1) px of A -> px of B; the centre of the top-left pixel is (0, 0); up to scale",
        "size": size,
        "margin": margin if quad is not None else 0.0,
        "quad": None if quad is None else number_list(quad),
    }
    if view is None:
        return meaning
    if view.metric:
        meaning["floor_b_from_a"] = "(x, y, 1) m on the floor in A's base (x forward, y left) -> in B's base"
        meaning["a_from_b"] = "p_a = R(theta) p_b + (x, y); covariance of (x, y, theta) in its right tangent; m, rad"
    else:
        meaning["floor_b_from_a"] = (
            f"(u, v, 1) of A's floor view -> of B's, continuous; the quad's corners are (0, 0), ({size}, 0), "
            f"({size}, {size}), (0, {size}); for the input {TURNED!r} B's view is turned by pi: "
            f"(u, v) -> ({size} - u, {size} - v)"
        )
    return meaning
