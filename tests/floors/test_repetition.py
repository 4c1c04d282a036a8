from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.surface import FAMILIES, FloorConfig, family, material

TEXEL_M, COLUMNS, ROWS, PATCH = 0.064, 1 << 14, 16, 47
# A strip of a kilometre is computed once: not worth optimising.
QUICK = {"xla_backend_optimization_level": 0}


def likeness(strip):
    """Normalised cross-correlation of a strip's first patch with every later one, layers together."""
    strip = strip - strip.mean(axis=(1, 2), keepdims=True)
    strip = (strip / strip.std(axis=(1, 2), keepdims=True)).reshape(-1, strip.shape[2])
    patch = strip[:, :PATCH] - strip[:, :PATCH].mean()
    length = COLUMNS + PATCH
    spectrum = (np.conj(np.fft.rfft(patch, length)) * np.fft.rfft(strip, length)).sum(axis=0)
    cross = np.fft.irfft(spectrum, length)[: COLUMNS - PATCH]
    sums, squares = (np.cumsum((strip**k).sum(axis=0, dtype=np.float64)) for k in (1, 2))
    total, square = (s[PATCH:] - s[:-PATCH] for s in (sums, squares))
    spread = np.sqrt(np.sum(patch**2) * (square - total**2 / patch.size))
    return cross[1:] / spread[:-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_no_floor_repeats_within_a_kilometre(name):
    texture = Path("photo.jpg") if name == "photograph" else None
    # Of few designs, one patch of tiles may look like another one by chance.
    floor = material(FloorConfig(family=name, texture=texture, texel_m=TEXEL_M))._replace(designs=24)
    photographs = jnp.asarray(np.random.default_rng(0).uniform(0.1, 0.9, (24, 16, 16, 3)).astype(np.float32))
    extra = (photographs,) if name == "photograph" else ()
    u, v = np.meshgrid(*((np.arange(n, dtype=np.float32) + 0.5) * np.float32(TEXEL_M) for n in (COLUMNS, ROWS)))

    def strip(points):
        layers = family(name).reflectance(points, floor, *extra, key=jax.random.key(1))
        return layers[..., jnp.array([0, -1])].transpose(2, 0, 1)

    program = jax.jit(strip, compiler_options=QUICK)
    for points in (np.stack([u, v], axis=-1), np.stack([v, u], axis=-1)):
        like = likeness(np.asarray(program(jnp.asarray(points))))
        found = PATCH + np.argmax(like[PATCH:])
        assert like[found] < 0.7, f"as at the origin after {found * TEXEL_M:.2f} m"
