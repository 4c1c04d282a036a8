import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.models import resnet
from ebjax.models.catalogue import recognise, restore
from ebjax.models.layers import imagenet
from ebjax.models.seeded import seeded_state


@pytest.fixture(scope="module")
def published():
    return seeded_state("resnet50", 3)


@pytest.fixture(scope="module")
def model(published):
    return restore("resnet50", resnet.convert(published))


@pytest.fixture(scope="module")
def images():
    return jnp.asarray(np.random.default_rng(1).uniform(size=(2, 61, 90, 3)), jnp.float32)


def forward(model, layer):
    graph, state = nnx.split(model)
    return jax.jit(lambda state, images: nnx.merge(graph, state)(images, layer)), state


def test_shapes(model, images):
    for layer, shape in {
        "conv1": (2, 31, 45, 64),
        "maxpool": (2, 16, 23, 64),
        "layer1": (2, 16, 23, 256),
        "layer4": (2, 2, 3, 2048),
        "gap": (2, 2048),
        "logits": (2, 1000),
    }.items():
        out = jax.eval_shape(*forward(model, layer), images)
        assert out.shape == shape and out.dtype == jnp.float32
    with pytest.raises(ValueError, match="no layer 'layer5'; there are conv1"):
        model(images, "layer5")


@pytest.mark.slow
def test_folding_changes_nothing(model, images):
    (run, state), (folded, folded_state) = (forward(network, "logits") for network in (model, resnet.fold(model)))
    want = run(state, images)
    np.testing.assert_allclose(folded(folded_state, images), want, atol=2e-5 * float(jnp.abs(want).max()))


def test_published_order_and_counters_do_not_matter(published):
    assert recognise(dict(reversed(published.items()))) == "resnet50"
    bare = {key: array for key, array in sorted(published.items()) if "num_batches" not in key}
    want, got = resnet.convert(published), resnet.convert(bare)
    assert len(bare) == 267 and want.keys() == got.keys()
    assert all(np.array_equal(want[key], got[key]) for key in want)


def test_other_depths_are_not_mistaken(published):
    deeper = {**published, "layer3.6.conv3.weight": published["layer3.5.conv3.weight"]}
    assert not resnet.recognise(deeper)
    with pytest.raises(ValueError, match=r"layer3\.5\.conv3\.kernel is missing"):
        arrays = resnet.convert(published)
        del arrays["layer3.5.conv3.kernel"]
        restore("resnet50", arrays)


def test_agrees_with_timm(published, model, images):
    timm, torch = pytest.importorskip("timm"), pytest.importorskip("torch")
    oracle = timm.create_model("resnet50").eval()
    oracle.load_state_dict({key: torch.tensor(array) for key, array in published.items()})
    with torch.no_grad():
        want = oracle(torch.tensor(np.moveaxis(np.asarray(imagenet(images)), -1, 1))).numpy()
    run, state = forward(model, "logits")
    np.testing.assert_allclose(run(state, images), want, atol=1e-4 * np.abs(want).max())


def test_every_parameter_has_a_gradient():
    small = resnet.Bottleneck(8, 4, stride=2, project=True, folded=False, precision="highest", rngs=nnx.Rngs(0))
    graph, trained, fixed = nnx.split(small, nnx.Param, ...)
    x = jnp.asarray(np.random.default_rng(0).normal(size=(1, 6, 6, 8)), jnp.float32)
    gradient = jax.grad(lambda state: jnp.sum(nnx.merge(graph, state, fixed)(x) ** 2))(trained)
    leaves = jax.tree.leaves(gradient)
    assert len(leaves) == 12 and all(jnp.abs(leaf).max() > 0 for leaf in leaves)
    assert len(jax.tree.leaves(fixed)) == 8
