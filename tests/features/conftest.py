"""One textured floor seen by two robots that face each other, with depth; all of it known."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.geometry.camera import Camera, camera_over_floor, image_from_floor

A_FROM_B = np.array([3.55, 0.12, np.pi - 0.06])
PX_PER_M = 250
SUPERSAMPLE = 3


def planar(x, y, theta):
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


def texture(seed):
    """Blotches and specks in [0, 1], 5 x 4 m of floor."""
    noise = np.random.default_rng(seed)
    shape = (4 * PX_PER_M, 5 * PX_PER_M)
    layers = [s * gaussian_filter(noise.standard_normal(shape), s, mode="wrap") for s in (2.0, 5.0, 15.0)]
    floor = sum(layers)
    return np.clip(0.5 + 0.12 * floor / floor.std(), 0, 1).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Scene:
    camera: Camera
    images: tuple[np.ndarray, np.ndarray]  # uint8 RGB
    depths: tuple[np.ndarray, np.ndarray]  # m
    image_b_from_a: np.ndarray

    def write(self, folder):
        for name, image, depth in zip("ab", self.images, self.depths, strict=True):
            cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
            cv2.imwrite(str(folder / f"depth_{name}.png"), np.rint(depth * 1000).astype(np.uint16))
        k = np.asarray(self.camera.intrinsics)
        values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "depth_scale": 1000.0}
        values |= {"width": self.camera.width, "height": self.camera.height}
        values["T_base_camera"] = np.asarray(self.camera.base_from_camera).tolist()
        (folder / "camera.json").write_text(json.dumps(values))


def make_scene(seed=0, noise_seed=0, noise=0.01, depth_noise=0.002):
    camera = camera_over_floor(380.0, 380.0, 239.5, 179.5, 480, 360, 0.54, np.radians(24.0), 0.0, 0.2)
    image_from_base = np.asarray(image_from_floor(camera))
    floor, random = texture(seed), np.random.default_rng(noise_seed)
    canvas_from_a = np.array([[PX_PER_M, 0, 0.7 * PX_PER_M], [0, PX_PER_M, 2.0 * PX_PER_M], [0, 0, 1.0]])
    fine = np.array([[SUPERSAMPLE, 0, 1.0], [0, SUPERSAMPLE, 1.0], [0, 0, 1]])
    images, depths, homographies = [], [], []
    for a_from_base in (np.eye(3), planar(*A_FROM_B)):
        image_from_a = image_from_base @ np.linalg.inv(a_from_base)
        size = (SUPERSAMPLE * camera.width, SUPERSAMPLE * camera.height)
        big = cv2.warpPerspective(floor, fine @ image_from_a @ np.linalg.inv(canvas_from_a), size)
        grey = cv2.resize(big, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        grey = np.clip(grey + noise * random.standard_normal(grey.shape), 0, 1)
        images.append(np.repeat(np.rint(255 * grey).astype(np.uint8)[..., None], 3, 2))
        v, u = np.mgrid[: camera.height, : camera.width]
        w = np.einsum("ij,jhw->ihw", np.linalg.inv(image_from_base), np.stack([u, v, np.ones_like(u)]))[2]
        depth = np.where(w > 1e-3, 1 / np.maximum(w, 1e-3), 0)  # image_from_floor has w = depth
        depth = depth + depth_noise * depth**2 * random.standard_normal(depth.shape)
        depths.append(np.where((depth > 0) & (depth < 8), depth, 0).astype(np.float32))
        homographies.append(image_from_a)
    return Scene(camera, tuple(images), tuple(depths), homographies[1] @ np.linalg.inv(homographies[0]))


@pytest.fixture(scope="session")
def scene():
    """Makes a scene; the motion is `A_FROM_B`."""
    return make_scene


@pytest.fixture(scope="session")
def a_from_b():
    """x m, y m, heading rad."""
    return A_FROM_B
