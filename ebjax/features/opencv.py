"""SIFT and ORB by OpenCV, as the paper compares them: host-side, orientation estimated, the same after a turn by pi.

Descriptors become unit float vectors whose dot product orders pairs as the original distance does: rootSIFT's
Hellinger root is not taken for plain SIFT, and ORB's bits become +-1 / 16, so that the dot product is 1 - Hamming /
128.
"""

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features

COUNT = 1000
CONTRAST = 0.01
"""Floors are faint: OpenCV's 0.04 leaves a dozen keypoints on polished stone."""


def _padded(keypoints: list, descriptors: np.ndarray | None, dimension: int) -> Features:
    points = np.zeros((COUNT, 2), np.float32)
    rows = np.zeros((COUNT, dimension), np.float32)
    strongest = np.argsort([-k.response for k in keypoints], kind="stable")[:COUNT]
    if len(strongest) and descriptors is not None:
        points[: len(strongest)] = np.array([keypoints[k].pt for k in strongest], np.float32)
        rows[: len(strongest)] = descriptors[strongest]
    return Features(jnp.asarray(points), jnp.asarray(rows), jnp.arange(COUNT) < len(strongest))


def _bytes(grey: Float[np.ndarray, "H W"], seen: Bool[np.ndarray, "H W"]) -> tuple[np.ndarray, np.ndarray]:
    image = np.clip(np.rint(np.asarray(grey) * 255), 0, 255).astype(np.uint8)
    # Keypoints at the border of the field of view describe the border.
    return image, cv2.erode(np.asarray(seen).astype(np.uint8), np.ones((13, 13), np.uint8), borderValue=0)


def extract_sift(grey: Float[np.ndarray, "H W"], seen: Bool[np.ndarray, "H W"]) -> Features:
    """Lowe's SIFT, 128 unit-length numbers a keypoint."""
    keypoints, descriptors = cv2.SIFT.create(nfeatures=COUNT, contrastThreshold=CONTRAST).detectAndCompute(
        *_bytes(grey, seen)
    )
    if descriptors is not None:
        descriptors = descriptors / np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-6)
    return _padded(list(keypoints), descriptors, 128)


def extract_orb(grey: Float[np.ndarray, "H W"], seen: Bool[np.ndarray, "H W"]) -> Features:
    """ORB, 256 bits a keypoint as +-1 / 16."""
    detector = cv2.ORB.create(nfeatures=COUNT, edgeThreshold=15, fastThreshold=7)
    keypoints, descriptors = detector.detectAndCompute(*_bytes(grey, seen))
    if descriptors is not None:
        descriptors = np.unpackbits(np.asarray(descriptors, np.uint8), axis=1).astype(np.float32) / 8 - 1 / 16
    return _padded(list(keypoints), descriptors, 256)


def unturned(descriptors: Float[Array, "*n D"]) -> Float[Array, "*n D"]:
    """The descriptors as they are: they do not change with orientation."""
    return descriptors


SIFT = Extractor(extract_sift, unturned, jitted=False)
ORB = Extractor(extract_orb, unturned, jitted=False)
