import hashlib

import numpy as np
import pytest

from ebjax.models.catalogue import MODELS, load_network, require_weights
from ebjax.models.convert import convert_checkpoint
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import save_weights


@pytest.fixture(scope="module")
def published():
    return seeded_state("d2net", 4)


@pytest.mark.parametrize("stream", [False, True])
def test_checkpoint_becomes_weights_and_a_network(write_torch, published, tmp_path, stream):
    path = tmp_path / "d2_tf.pth"
    write_torch(path, {"model": published}, stream=stream)
    name, arrays, origin = convert_checkpoint(path)
    assert name == "d2net" and {array.dtype for array in arrays.values()} == {np.dtype(np.float32)}
    assert origin == {"source": "d2_tf.pth", "source_sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    save_weights(tmp_path / "d2net.safetensors", name, arrays, origin)
    assert load_network(tmp_path / "d2net.safetensors")[0] == "d2net"
    require_weights(tmp_path / "d2net.safetensors", "d2net")
    with pytest.raises(ValueError, match=r"weights of d2net, not of vgg16"):
        require_weights(tmp_path / "d2net.safetensors", "vgg16")


def test_half_and_double_precision_become_single(write_torch, published, tmp_path):
    wide = {key: array.astype(np.float64 if "bias" in key else np.float16) for key, array in published.items()}
    write_torch(tmp_path / "x.pth", wide)
    assert {array.dtype for array in convert_checkpoint(tmp_path / "x.pth")[1].values()} == {np.dtype(np.float32)}


def test_wrong_contents_are_one_line(write_torch, published, tmp_path):
    path, key = tmp_path / "x.pth", "dense_feature_extraction.model.5"
    for change, message in (
        ({f"{key}.weight": None}, r"conv2_1\.kernel is missing"),
        ({f"{key}.bias": np.zeros(9, np.float32)}, r"conv2_1\.bias: shape \(9,\)"),
        ({f"{key}.bias": np.full(128, np.nan, np.float32)}, "not finite"),
    ):
        state = {k: array for k, array in {**published, **change}.items() if array is not None}
        write_torch(path, state)
        with pytest.raises(ValueError, match=rf"x\.pth: .*{message}") as error:
            convert_checkpoint(path)
        assert "\n" not in str(error.value)
    write_torch(path, {"layer.weight": np.ones(3, np.float32)})
    with pytest.raises(ValueError, match=r"x\.pth: no known network has the keys layer\.weight"):
        convert_checkpoint(path)


@pytest.mark.parametrize("name", MODELS)
def test_no_network_gives_results_without_weights(name):
    with pytest.raises(ValueError, match=rf"{name} needs weights: .*python -m ebjax\.models convert"):
        require_weights(None, name)


def test_unknown_names_are_refused(tmp_path):
    with pytest.raises(ValueError, match="no network 'vgg17'; there are vgg16"):
        require_weights(None, "vgg17")
    save_weights(tmp_path / "x.safetensors", "vgg17", {"a": np.zeros(1)})
    with pytest.raises(ValueError, match=r"x\.safetensors: no network 'vgg17'"):
        load_network(tmp_path / "x.safetensors")
