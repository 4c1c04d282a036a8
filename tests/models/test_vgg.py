import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.models import vgg
from ebjax.models.catalogue import restore
from ebjax.models.layers import imagenet
from ebjax.models.seeded import seeded_state

NAMES = ("vgg16", "vgg19")


@pytest.fixture(params=NAMES, scope="module")
def state(request):
    return request.param, seeded_state(request.param, 3, head=False)


def test_converted_weights_are_used_where_torchvision_has_them(state):
    name, published = state
    model = restore(name, vgg.convert({**published, "classifier.0.weight": np.zeros((4096, 25088), np.float16)}))
    images = jnp.asarray(np.random.default_rng(0).uniform(size=(1, 33, 40, 3)), jnp.float32)
    first = model(images, "conv1_1")
    window = np.asarray(imagenet(images))[0, 4:7, 9:12]
    want = np.einsum("hwi,oihw->o", window, published["features.0.weight"]) + published["features.0.bias"]
    np.testing.assert_allclose(first[0, 5, 10], want, atol=1e-5)
    last = {"vgg16": ("conv5_3", "features.28"), "vgg19": ("conv5_4", "features.34")}[name]
    kernel = np.asarray(getattr(model, last[0]).kernel[...])
    np.testing.assert_array_equal(kernel[1, 2], published[f"{last[1]}.weight"][:, :, 1, 2].T)
    assert model(images).shape == (1, 1, 1, 512)


def test_recognised_in_any_order_and_not_mistaken(state):
    name, published = state
    backwards = dict(reversed(published.items()))
    found = {other: getattr(vgg, f"recognise_{other}")(backwards) for other in NAMES}
    assert found == {other: other == name for other in NAMES}
    batch_norm = {**published, "features.1.running_mean": np.zeros(64)}
    assert not any(getattr(vgg, f"recognise_{other}")(batch_norm) for other in NAMES)
    with pytest.raises(ValueError, match=r"unexpected key 'features\.0\.scale'"):
        vgg.convert({**published, "features.0.scale": np.ones(64)})


def test_adaptive_average_covers_the_map():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(1, 5, 10, 2)), jnp.float32)
    got = vgg.adaptive_avg_pool(x, 7)
    assert got.shape == (1, 7, 7, 2) and got.dtype == jnp.float32
    np.testing.assert_allclose(got[0, 1, 2], x[0, 0:2, 2:5].mean((0, 1)), atol=1e-6)
    np.testing.assert_allclose(got[0, 6, 6], x[0, 4:5, 8:10].mean((0, 1)), atol=1e-6)
    np.testing.assert_allclose(vgg.adaptive_avg_pool(x, 1)[:, 0, 0], x.mean((1, 2)), atol=1e-6)


def test_agrees_with_timm(state):
    timm, torch = pytest.importorskip("timm"), pytest.importorskip("torch")
    name, published = state
    oracle = timm.create_model(name, num_classes=0, global_pool="").features.eval()
    oracle.load_state_dict({key.removeprefix("features."): torch.tensor(a) for key, a in published.items()})
    images = np.random.default_rng(1).uniform(size=(2, 61, 90, 3)).astype(np.float32)
    x = imagenet(jnp.asarray(images))
    with torch.no_grad():
        want = oracle(torch.tensor(np.moveaxis(np.asarray(x), -1, 1))).numpy()
    got = restore(name, vgg.convert(published))(jnp.asarray(images), "pool5")
    np.testing.assert_allclose(np.moveaxis(np.asarray(got), -1, 1), want, atol=1e-4 * np.abs(want).max())


def test_stand_in_has_the_published_shape():
    images = jnp.zeros((1, 64, 96, 3), jnp.float32)
    assert nnx.eval_shape(lambda: vgg.vgg19(rngs=nnx.Rngs(0))(images)).shape == (1, 2, 3, 512)
    names = nnx.eval_shape(lambda: vgg.vgg19(rngs=nnx.Rngs(0))).layer_names()
    assert names[-3:] == ["conv5_4", "relu5_4", "pool5"]
