"""Checks of descriptors and extractors of your own: what the engine relies on, each broken promise with its reason.

    from ebjax.testing import check_descriptor, check_extractor

    check_descriptor(MINE)
    check_extractor("my_package.mine:MINE")

Our own pass the same checks. They look at random textures, in float32, with JAX as it is set.
"""

from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ebjax.features.extractor import Extractor, extractor
from ebjax.features.matching import Features, mutual_nearest
from ebjax.places.descriptor import Descriptor, descriptor, unite_vectors

Views = Float[np.ndarray, "N H W 3"]
VIEWS = 4
ALIKE, TURNED_COSINE = 1e-3, 0.93
"""What rounding may change; the least cosine of a turned view."""
UNTOUCHED, MATCHED = 0.5, 0.3
"""The least share of features that stay where something else is changed, and that are found again in a turned view."""
NEAR_PX = 2.0


def check_descriptor(mine: Descriptor | str, *, size: int = 112) -> None:
    """Checks a global descriptor.

    Args:
      mine: a `Descriptor`, or a name as `--descriptor` takes it.
      size: of the square views that it is shown, px.

    Raises:
      AssertionError: says which promise is broken and how: shape, dtype, NaN, mask, norm, R_pi, chance.
    """
    chosen = descriptor(mine) if isinstance(mine, str) else mine
    look = _host(chosen.look, chosen.jitted, "look")
    views, seen = textures(VIEWS, size), _seen(size)
    images = np.round(textures(2 * VIEWS, size // 2, seed=7) * 255).astype(np.uint8)
    shown = np.where(seen[..., None], views, 0).astype(np.float32)
    turned, turned_seen = shown[:, ::-1, ::-1].copy(), seen[::-1, ::-1].copy()

    kept = [look(view, seen, image) for view, image in zip(shown, images[:VIEWS], strict=True)]
    kept += [look(view, turned_seen, image) for view, image in zip(turned, images[VIEWS:], strict=True)]
    odd = [
        look(np.full_like(shown[0], 0.5), seen, images[0]),
        look(shown[0], np.ones_like(seen), images[0]),
        look(np.zeros_like(shown[0]), np.zeros_like(seen), images[0]),
    ]
    if chosen.unite is unite_vectors and not {"vector", "turned"} <= kept[0].keys():
        _fail("shape", f"look gives {', '.join(kept[0])}; give 'vector' and 'turned', or a `unite` that makes vectors")
    _same_arrays([*kept, *odd], "look")
    _finite([*kept, *odd], "look")
    _untouched(kept[0], look(np.where(seen[..., None], views[0], 1).astype(np.float32), seen, images[0]), "look")

    stacked = {name: np.stack([one[name] for one in kept]) for name in kept[0]}
    places = chosen.unite(stacked, seed=1)
    vectors = np.asarray(places.vectors)
    if vectors.ndim != 3 or vectors.shape[::2] != (2 * VIEWS, 2):
        _fail("shape", f"unite gives vectors of shape {vectors.shape}; give (views, length, 2), as it is and turned")
    if vectors.dtype != np.float32:
        _fail("dtype", f"unite gives vectors of {vectors.dtype}; give float32, as the views are")
    _finite([{"vectors": vectors}], "unite")
    norms = np.linalg.norm(vectors, axis=1)
    if np.abs(norms[:, 0] - 1).max() > ALIKE:
        _fail("norm", f"the vectors are {norms[:, 0].min():.4g} to {norms[:, 0].max():.4g} long; give unit vectors")
    # What of a vector does not turn with the floor has no part in the turned one.
    rows = vectors[:, :, 1].any(0)
    there, here = _units(vectors[:VIEWS, rows, 1]), _units(vectors[VIEWS:, rows, 0])
    if rows.all() and np.abs(norms[:, 1] - 1).max() > ALIKE:
        _fail("norm", f"the turned vectors are {norms[:, 1].min():.4g} to {norms[:, 1].max():.4g} long")
    scores = there @ here.T
    if (least := float(np.diag(scores).min())) < TURNED_COSINE:
        _fail("R_pi", f"the turned vector of a view has a cosine of {least:.3f} with the vector of the turned view")
    if (np.argmax(scores, 1) != np.arange(VIEWS)).any():
        _fail("R_pi", "another view is more alike to a turned view than it is itself")
    if not np.array_equal(np.asarray(chosen.unite(stacked, seed=1).vectors), vectors):
        _fail("chance", "unite gives other vectors when it is asked again with the same seed")


def check_extractor(mine: Extractor | str, *, size: int = 200) -> None:
    """Checks a local feature.

    Args:
      mine: an `Extractor`, or a name as `--extractor` takes it.
      size: of the square views that it is shown, px.

    Raises:
      AssertionError: says which promise is broken and how: shape, dtype, NaN, mask, norm, R_pi.
    """
    chosen = extractor(mine) if isinstance(mine, str) else mine
    find = _host(lambda view, seen: vars(_features(chosen.extract(view, seen))), chosen.jitted, "extract")
    turn = _host(lambda view, seen: vars(_features(chosen.turned(view, seen))), chosen.jitted, "turn")
    (view,), seen = textures(1, size, seed=3), _seen(size)
    shown = np.where(seen[..., None], view, 0).astype(np.float32)
    found = find(shown, seen)
    odd = [find(np.full_like(shown, 0.5), seen), find(shown, np.ones_like(seen)), find(shown, np.zeros_like(seen))]
    rows = len(found["valid"])
    for name, shape in (("keypoints", (rows, 2)), ("descriptors", (rows, -1)), ("valid", (rows,))):
        own = found[name].shape
        if len(own) != len(shape) or any(a not in (b, -1) for a, b in zip(shape, own, strict=True)):
            _fail("shape", f"extract gives {name} of shape {own}; give one row a keypoint")
    _same_arrays([found, *odd], "extract")
    for name, dtype in (("keypoints", np.float32), ("descriptors", np.float32), ("valid", np.bool_)):
        if found[name].dtype != dtype:
            _fail("dtype", f"extract gives {name} of {found[name].dtype}; give {np.dtype(dtype)}")
    _finite([found, *odd], "extract")
    valid = found["valid"]
    if valid.sum() < 20:
        _fail(
            "R_pi", f"extract finds {valid.sum()} features in a view full of texture; at least 20 are needed to check"
        )
    points = found["keypoints"][valid]
    column, row = np.rint(points).astype(int).T
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    if not inside.all():
        _fail("mask", f"extract gives a keypoint at {points[~inside][0]}, outside of the view")
    if not seen[row, column].all():
        _fail("mask", f"extract gives a keypoint at {points[~seen[row, column]][0]}, where nothing is seen")
    painted = find(np.where(seen[..., None], view, 1).astype(np.float32), seen)
    if (share := _found_again(found, painted)) < UNTOUCHED:
        _fail("mask", f"{share:.0%} of the features stay when what is not seen is painted white; {UNTOUCHED:.0%} must")
    if odd[2]["valid"].any():
        _fail("mask", "extract finds features where nothing is seen")
    norms = np.linalg.norm(found["descriptors"][valid], axis=1)
    if np.abs(norms - 1).max() > 5e-3:
        _fail("norm", f"the descriptors are {norms.min():.4g} to {norms.max():.4g} long; give unit vectors")
    # Those of the turned view, told of the view as it is, must be those found in the turned view.
    told, there = turn(shown, seen), find(shown[::-1, ::-1].copy(), seen[::-1, ::-1].copy())
    _finite([told], "turn")
    share = _found_again(told, {**there, "keypoints": (size - 1) - there["keypoints"]})
    if share < MATCHED:
        _fail("R_pi", f"{share:.0%} of the features of a turned view are where `turn` says; {MATCHED:.0%} must be")


def textures(count: int, size: int, seed: int = 0) -> Views:
    """Views of smooth noise of several scales, RGB in [0, 1], float32."""
    rng, views = np.random.default_rng(seed), []
    for _ in range(count):
        layers = (s * cv2.GaussianBlur(rng.standard_normal((size, size, 3)), (0, 0), s) for s in (1.5, 4.0))
        noise = sum(layers)
        views.append(np.clip(0.5 + 0.18 * noise / np.std(noise), 0, 1))
    return np.stack(views).astype(np.float32)


def _seen(size: int) -> Bool[np.ndarray, "H W"]:
    """All but a corner."""
    seen = np.ones((size, size), bool)
    seen[: 3 * size // 8, : 3 * size // 8] = False
    return seen


def _host(function: Callable[..., Any], jitted: bool, name: str) -> Callable[..., dict[str, np.ndarray]]:
    """The function as the engine calls it, giving host arrays by name."""
    called = jax.jit(function) if jitted else function

    def on_host(*arrays: np.ndarray) -> dict[str, np.ndarray]:
        try:
            given = called(*map(jnp.asarray, arrays))
        except jax.errors.JAXTypeError as fault:
            _fail("jitted", f"{name} cannot be called inside a jitted program; give jitted=False ({_line(fault)})")
        if not isinstance(given, Mapping):
            _fail("shape", f"{name} gives a {type(given).__name__}; give arrays by name")
        return {key: np.asarray(array) for key, array in given.items()}

    return on_host


def _features(found: Any) -> Features:
    if not isinstance(found, Features):
        _fail("shape", f"extract gives a {type(found).__name__}; give ebjax.Features")
    return found


def _same_arrays(several: list[dict[str, np.ndarray]], name: str) -> None:
    """The same names, shapes and dtypes, whatever is shown."""
    for one in several[1:]:
        if one.keys() != several[0].keys():
            _fail("shape", f"{name} gives {', '.join(several[0])} of one view and {', '.join(one)} of another")
        for key, first in several[0].items():
            if one[key].shape != first.shape:
                _fail("shape", f"{name} gives {key!r} of shape {first.shape}, of another view {one[key].shape}")
            if one[key].dtype != first.dtype:
                _fail("dtype", f"{name} gives {key!r} of {first.dtype}, of another view {one[key].dtype}")
    for key, first in several[0].items():
        if first.dtype == np.float64:
            _fail("dtype", f"{name} gives {key!r} of float64 from views of float32; keep their dtype")


def _finite(several: list[dict[str, np.ndarray]], name: str) -> None:
    for key, array in ((key, one[key]) for one in several for key in one):
        if not np.isfinite(array).all():
            _fail("NaN", f"{name} gives {key!r} with values that are not finite; flat and hidden views come too")


def _untouched(one: dict[str, np.ndarray], painted: dict[str, np.ndarray], name: str) -> None:
    for key, array in one.items():
        if np.abs(np.asarray(painted[key], float) - np.asarray(array, float)).max(initial=0) > ALIKE:
            _fail("mask", f"{name} gives another {key!r} when what is not seen is painted white; it must not matter")


def _found_again(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    """The share of matches of two feature sets that lie at the same place."""
    a, b = (Features(**{key: jnp.asarray(array) for key, array in found.items()}) for found in (one, other))
    matches = mutual_nearest(a, b, keep=len(one["valid"]))
    rows = np.asarray(matches.valid)
    ends = (one["keypoints"][np.asarray(matches.query)], other["keypoints"][np.asarray(matches.reference)])
    return float((np.linalg.norm(ends[0] - ends[1], axis=1)[rows] < NEAR_PX).sum() / max(one["valid"].sum(), 1))


def _units(vectors: np.ndarray) -> np.ndarray:
    units: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    return units


def _line(fault: BaseException) -> str:
    return str(fault).strip().splitlines()[0]


def _fail(promise: str, how: str) -> NoReturn:
    raise AssertionError(f"{promise}: {how}")
