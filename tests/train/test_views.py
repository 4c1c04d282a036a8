import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.homography import apply
from ebjax.geometry.warp import sample_bilinear
from ebjax.train.canvas import NAMES, SIDE_PX, make_canvas, make_canvases
from ebjax.train.views import sample_pairs


@pytest.fixture(scope="module")
def canvas():
    """A smooth pattern without lean: light and noise change it, places stay."""
    ticks = np.arange(SIDE_PX)
    wave = 0.3 + 0.1 * np.sin(ticks / 5)[:, None] + 0.1 * np.sin(ticks / 7 + 1)[None, :]
    return jnp.asarray(np.stack([wave, 0 * wave, 0 * wave], -1)[None], jnp.float32)


@pytest.mark.slow
def test_both_views_show_the_same_floor(canvas):
    pairs = sample_pairs(canvas, 6, 96, key=jax.random.key(0))
    assert pairs.first.shape == pairs.second.shape == (6, 96, 96) and pairs.first.dtype == jnp.float32
    ticks = jnp.arange(8.0, 88.0, dtype=jnp.float32)
    points = jnp.stack(jnp.meshgrid(ticks, ticks), -1).reshape(-1, 2)
    agree = []
    for first, second, warp in zip(pairs.first, pairs.second, pairs.second_from_first, strict=True):
        there = apply(warp, points)
        inside = np.asarray(((there > 4) & (there < 91)).all(1))
        ours, theirs = (sample_bilinear(v[..., None], at)[:, 0] for v, at in ((first, points), (second, there)))
        agree.append(np.corrcoef(np.asarray(ours)[inside], np.asarray(theirs)[inside])[0, 1])
    # Shadows and glare spoil some of them; a wrong warp all.
    assert np.median(agree) > 0.5


@pytest.mark.slow
def test_fields_of_view_are_opposite_and_narrow_at_the_feet(canvas):
    pairs = sample_pairs(canvas, 1, 96, key=jax.random.key(1))
    np.testing.assert_array_equal(pairs.seen_second, pairs.seen_first[::-1, ::-1])
    width = np.asarray(pairs.seen_first.sum(1))
    assert (np.diff(width) <= 0).all() and width[0] == 96


@pytest.mark.slow
def test_views_are_a_function_of_the_key(canvas):
    first, same, other = (sample_pairs(canvas, 2, 64, key=jax.random.key(k)).first for k in (3, 3, 4))
    assert bool((first == same).all()) and not bool((first == other).all())


@pytest.mark.slow
def test_a_pile_is_bright_from_one_side(canvas):
    leaning = canvas.at[..., 2].set(0.1)
    towards = sample_pairs(leaning, 4, 64, key=jax.random.key(5))
    assert bool(jnp.isfinite(towards.first).all())
    assert float(jnp.abs(towards.first - towards.second).mean()) > 0


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, NAMES.index("carpet")])
def test_a_canvas_is_a_function_of_seed_and_number(number):
    canvas = make_canvas(number, seed=2)
    assert canvas.shape == (SIDE_PX, SIDE_PX, 3) and canvas.dtype == np.float16
    np.testing.assert_array_equal(canvas, make_canvas(number, seed=2))
    assert np.abs(canvas.astype(np.float32) - make_canvas(number, seed=3)).max() > 0.01
    assert bool(np.abs(canvas[..., 1:]).max() > 0) == (NAMES[number] == "carpet")
    assert float(canvas[..., 0].astype(np.float32).std()) > 0.001


def test_canvases_stay_in_their_file(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        "ebjax.train.canvas.make_canvas", lambda number, seed: calls.append(number) or np.zeros((2, 2, 3), np.float16)
    )
    for _ in range(2):
        assert make_canvases(3, tmp_path / "canvases.npy", seed=1).shape == (3, 2, 2, 3)
    assert calls == [0, 1, 2]
