"""The lenses that are known, by ROS's names, and how many coefficients each may have. Loads no JAX: readers use it."""

COUNTS = {
    "pinhole": (0,),
    "plumb_bob": (4, 5, 8, 12, 14),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "omnidirectional": (5,),
}
"""Coefficients in OpenCV's order: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]; equidistant k1 k2 k3 k4
(Kannala and Brandt); omnidirectional xi k1 k2 p1 p2 (Mei)."""


def no_lens_if_straight(model: str, coefficients: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """A lens that bends nothing is a pinhole; an equidistant one bends whatever its coefficients."""
    straight = model != "equidistant" and not any(coefficients)
    return ("pinhole", ()) if straight else (model, coefficients)


def lens_fault(model: str, coefficients: tuple[float, ...]) -> str | None:
    """What is wrong with a lens's name or its number of coefficients, or None."""
    if model not in COUNTS:
        return f"{model!r} is no known distortion model; known are {', '.join(COUNTS)}"
    if len(coefficients) not in COUNTS[model]:
        wanted = " or ".join(map(str, COUNTS[model]))
        return f"{len(coefficients)} coefficients of a {model} lens, which has {wanted}"
    return None
