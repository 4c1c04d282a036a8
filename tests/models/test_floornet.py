import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.models.floornet import CELL, FloorNet, fitted, local_contrast, open_floornet, parity, turn_maps
from ebjax.models.layers import Buffer
from ebjax.models.weights import flat_arrays, save_weights


@pytest.fixture(scope="module")
def network():
    made = FloorNet(8, rngs=nnx.Rngs(0))
    made.score_head[...] = jax.random.normal(jax.random.key(1), made.score_head[...].shape, jnp.float32)
    return made


@pytest.fixture(scope="module")
def look(network):
    graph, state = nnx.split(network)
    return jax.jit(lambda grey, seen: nnx.merge(graph, state)(grey, seen))


def view(height, width, seed=0):
    rng = np.random.default_rng(seed)
    seen = np.ones((1, height, width), np.float32)
    seen[:, -height // 3 :, : width // 4] = 0
    return jnp.asarray(rng.uniform(size=(1, height, width)), jnp.float32), jnp.asarray(seen)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(64, 64), (40, 72), (72, 40)])
def test_turned_view_has_the_turned_maps(look, size):
    grey, seen = (values.astype(jnp.float64) for values in view(*size))
    expected = turn_maps(look(grey, seen))
    found = look(grey[:, ::-1, ::-1], seen[:, ::-1, ::-1])
    for name in ("places", "local", "score"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert ours.dtype == jnp.float64
        assert float(jnp.abs(ours - theirs).max()) <= 1e-13 * max(1.0, float(jnp.abs(theirs).max())), name


@pytest.mark.slow
def test_shapes_and_unit_descriptors(look):
    maps = look(*view(64, 48))
    assert maps.places.shape == (1, 8, 6, 8) and maps.local.shape == (1, 16, 12, 8) and maps.score.shape == (1, 16, 12)
    np.testing.assert_allclose(jnp.linalg.norm(maps.local, axis=-1), 1, atol=1e-5)
    assert float(jnp.linalg.norm(maps.places, axis=-1).max()) < 1


def test_maps_differ_from_place_to_place(look):
    maps = look(*view(64, 48))
    assert float(jnp.std(maps.places, axis=(1, 2)).min()) > 1e-4


def test_slow_light_hardly_changes_the_contrast():
    grey, seen = view(64, 64)
    ramp = jnp.linspace(0.5, 0.7, 64)[None, None, :]
    plain, lit = local_contrast(grey, seen), local_contrast(ramp * grey, seen)
    assert float(jnp.abs(plain - lit).mean()) < 0.05 * float(jnp.abs(plain).mean())
    assert float(jnp.abs(local_contrast(grey, seen) * (1 - seen)).max()) == 0


def test_sides_that_are_no_multiples_are_refused_and_fitted(look):
    grey, seen = view(61, 48)
    with pytest.raises(ValueError, match="multiples of 8"):
        look(grey, seen)
    ours, shown = fitted(grey[0], seen[0])
    assert ours.shape == shown.shape == (64, 48) and ours.shape[0] % CELL == 0
    turned, _ = fitted(grey[0, ::-1, ::-1], seen[0, ::-1, ::-1])
    np.testing.assert_allclose(turned[::-1, ::-1], ours, atol=1e-6)


def test_training_remembers_statistics_and_then_is_as_in_use(network):
    graph, params, rest = nnx.split(network, nnx.Param, ...)

    @jax.jit
    def train(rest, grey, seen):
        copy = nnx.merge(graph, params, rest, copy=True)
        maps = copy(grey, seen, training=True)
        return maps, nnx.state(copy, nnx.Not(nnx.Param))

    grey, seen = view(64, 64)
    for _ in range(150):
        maps, rest = train(rest, grey, seen)
    used = jax.jit(lambda rest: nnx.merge(graph, params, rest)(grey, seen))(rest)
    np.testing.assert_allclose(used.places, maps.places, atol=2e-3)
    assert nnx.state(network, Buffer)["stem1"]["mean"][...].sum() == 0  # the given network is left alone


def test_parity_is_half_and_half():
    np.testing.assert_array_equal(parity(6), [1, 1, 1, -1, -1, -1])


def test_weights_of_a_file_a_folder_or_another_network(network, tmp_path):
    own = tmp_path / "floornet.safetensors"
    save_weights(own, "floornet", {key: np.asarray(array) for key, array in flat_arrays(network).items()})
    for given in (own, tmp_path):
        path, found = open_floornet(given)
        assert path == own
        np.testing.assert_array_equal(found.place_head.even[...], network.place_head.even[...])
    other = tmp_path / "other.safetensors"
    save_weights(other, "alike", {"x": np.zeros(1, np.float32)})
    shipped, _ = open_floornet()
    assert open_floornet(other)[0] == shipped
    (tmp_path / "empty").mkdir()
    assert open_floornet(tmp_path / "empty")[0] == shipped
    with pytest.raises(FileNotFoundError):
        open_floornet(tmp_path / "none.safetensors")


def test_weights_that_do_not_fit_name_the_file(tmp_path):
    path = tmp_path / "floornet.safetensors"
    save_weights(path, "floornet", {"place_head.even": np.zeros((64, 4), np.float32)})
    with pytest.raises(ValueError, match=r"floornet\.safetensors: .* missing"):
        open_floornet(path)


def test_shipped_weights_are_small():
    path, network = open_floornet()
    assert path.stat().st_size <= 4e6
    assert sum(array.size for array in flat_arrays(network).values()) <= 2_000_000
