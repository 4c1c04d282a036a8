"""SIFT and ORB by OpenCV, as the paper compares them: host-side, orientation estimated, the same after a turn by pi.

Descriptors become unit float vectors whose dot product orders pairs as the original distance does: rootSIFT's
Hellinger root is not taken for plain SIFT, and ORB's bits become +-1 / 16, so that the dot product is 1 - Hamming /
128.
"""

from collections.abc import Sequence

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.features.extractor import Extractor, unturned
from ebjax.features.matching import Features
from ebjax.models.luma import luma

COUNT = 1000
CONTRAST = 0.01
"""Floors are faint: OpenCV's 0.04 leaves a dozen keypoints on polished stone."""


def strongest_rows(points: np.ndarray, responses: np.ndarray, descriptors: np.ndarray | None, size: int) -> Features:
    """COUNT rows, the strongest first, the rest not valid; `size` is the length of a descriptor."""
    places, rows = np.zeros((COUNT, 2), np.float32), np.zeros((COUNT, size), np.float32)
    best = np.argsort(-responses, kind="stable")[:COUNT]
    if len(best) and descriptors is not None:
        places[: len(best)], rows[: len(best)] = points[best], descriptors[best]
    return Features(jnp.asarray(places), jnp.asarray(rows), jnp.arange(COUNT) < len(best))


def grey_bytes(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> tuple[np.ndarray, np.ndarray]:
    """The grey view, and what of the field of view is not close to its border, as bytes."""
    image = np.clip(np.rint(np.asarray(luma(view)) * 255), 0, 255).astype(np.uint8)
    # Keypoints at the border of the field of view describe the border.
    return image, cv2.erode(np.asarray(seen).astype(np.uint8), np.ones((13, 13), np.uint8), borderValue=0)


def _rows(keypoints: Sequence[cv2.KeyPoint], descriptors: np.ndarray | None, size: int) -> Features:
    points = np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2)
    return strongest_rows(points, np.array([k.response for k in keypoints]), descriptors, size)


def extract_sift(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    """Lowe's SIFT, 128 unit-length numbers a keypoint."""
    detector = cv2.SIFT.create(nfeatures=COUNT, contrastThreshold=CONTRAST)
    keypoints, descriptors = detector.detectAndCompute(*grey_bytes(view, seen))
    if descriptors is not None:
        descriptors = descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-6)
    return _rows(keypoints, descriptors, 128)


def extract_orb(view: Float[Array, "H W 3"], seen: Bool[Array, "H W"]) -> Features:
    """ORB, 256 bits a keypoint as +-1 / 16."""
    detector = cv2.ORB.create(nfeatures=COUNT, edgeThreshold=15, fastThreshold=7)
    keypoints, descriptors = detector.detectAndCompute(*grey_bytes(view, seen))
    if descriptors is not None:
        descriptors = np.unpackbits(np.asarray(descriptors, np.uint8), axis=1).astype(np.float32) / 8 - 1 / 16
    return _rows(keypoints, descriptors, 256)


SIFT = Extractor(extract_sift, jitted=False, turn=unturned)
ORB = Extractor(extract_orb, jitted=False, turn=unturned)
