"""What a lens and a tilt that changes every frame cost the floor view, and how well it samples.

All look at the same rectangle of floor, 1 cm a pixel. A call is so many frames, taps included; a ratio is the median
over turns of that to the pinhole's. PSNR is against 8 x 8 samples a pixel, of a picture of noise blurred by 2 px.
"""

import dataclasses
from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from ebjax.bench.turns import in_turn
from ebjax.geometry.camera import Camera, FloorView, camera_over_floor
from ebjax.geometry.lens import Lens, lens
from ebjax.views.floor_view import floor_view, view_taps
from ebjax.views.run_view import RunView, from_camera
from ebjax.views.tilted import tilted

FLOOR = FloorView(0.6, 2.4, -0.9, 0.9, 0.01)
LENSES = {
    "pinhole": (600.0, lens("pinhole", ())),
    "equidistant": (292.0, lens("equidistant", (0.045, 0.012, -0.02, 0.006))),
    "plumb_bob": (600.0, lens("plumb_bob", (0.15, -0.3, 0.0008, -0.0006, 0.16))),
    "omnidirectional": (500.0, lens("omnidirectional", (0.8, -0.1, 0.02, 0.0005, -0.0005))),
}
FINE = 4
"""2 x 2 samples a pixel of a view so many times finer are 8 x 8 a pixel."""


@dataclasses.dataclass(frozen=True)
class LensConfig:
    """Times the floor view through a pinhole and through lenses, under a tilt that changes every frame."""

    frames: int = 40
    """Of a turn."""
    turns: int = 7
    """How often each runs."""
    seed: int = 0
    """Of the picture and the tilts."""


def bench_lenses(config: LensConfig) -> None:
    """Prints a line a lens: ms a frame, its ratio to the pinhole's, PSNR."""
    if config.frames < 1 or config.turns < 1:
        raise ValueError(f"--frames is {config.frames}, --turns {config.turns}; give at least 1 of each")
    random = np.random.default_rng(config.seed)
    rgb, levels = picture(random), tilts(config.frames, random)
    seen = {name: (of := camera(*values), from_camera(of, FLOOR)) for name, values in LENSES.items()}
    calls = {name: partial(look_at_all, rgb, levels, view, of) for name, (of, view) in seen.items()}
    ms = {name: 1e3 * seconds / config.frames for name, seconds in in_turn(calls, config.turns).items()}
    print("| lens | ms a frame | of the pinhole's | PSNR dB |\n|---|---|---|---|")
    for name, times in ms.items():
        ratio = np.median(times / ms["pinhole"])
        print(f"| {name} | {np.median(times):.2f} | {ratio:.2f} | {psnr_db(rgb, *seen[name]):.1f} |")


def camera(focal_px: float, glass: Lens) -> Camera:
    """640 x 480, 0.6 m above the floor, looking 25 degrees down."""
    over = camera_over_floor(focal_px, focal_px, 319.5, 239.5, 640, 480, 0.6, np.radians(25.0))
    return dataclasses.replace(over, lens=glass)


@jax.jit
def look(
    rgb: UInt8[Array, "H W 3"], level_from_base: Float[Array, "4 4"], view: RunView, of: Camera
) -> Float[Array, "h w 3"]:
    """The floor view of one frame."""
    seen_by = tilted(view, of, level_from_base)
    return floor_view(rgb, view_taps(*seen_by))


def look_at_all(
    rgb: UInt8[np.ndarray, "H W 3"], levels: Float[np.ndarray, "N 4 4"], view: RunView, of: Camera
) -> Float[Array, "h w 3"]:
    """The floor view of a frame for every tilt; the last is returned."""
    for level in levels:
        shown = look(rgb, level, view, of)
    return shown


def tilts(frames: int, random: np.random.Generator) -> Float[np.ndarray, "N 4 4"]:
    """Nods by 0.7 degrees."""
    levels = np.tile(np.eye(4, dtype=np.float32), (frames, 1, 1))
    nod = np.radians(random.normal(0, 0.7, frames))
    levels[:, 0, 0] = levels[:, 2, 2] = np.cos(nod)
    levels[:, 0, 2], levels[:, 2, 0] = np.sin(nod), -np.sin(nod)
    return levels


def picture(random: np.random.Generator) -> UInt8[np.ndarray, "480 640 3"]:
    """Noise as a camera blurs it."""
    ticks = np.arange(-6, 7)
    bell = np.exp(-(ticks**2) / 8.0)
    noise = random.normal(size=(480, 640, 3))
    for axis in (0, 1):
        noise = np.apply_along_axis(lambda line: np.convolve(line, bell / bell.sum(), "same"), axis, noise)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)


def psnr_db(rgb: UInt8[np.ndarray, "H W 3"], of: Camera, view: RunView) -> float:
    """Of the floor view, where the image shows it."""
    fine = from_camera(of, dataclasses.replace(FLOOR, metres_per_px=FLOOR.metres_per_px / FINE))
    level, (height, width) = np.eye(4, dtype=np.float32), view.size
    exact = np.asarray(look(rgb, level, fine, of)).reshape(height, FINE, width, FINE, 3).mean((1, 3))
    error = (np.asarray(look(rgb, level, view, of)) - exact)[np.asarray(view.seen)]
    return float(-10 * np.log10(np.mean(error**2)))
