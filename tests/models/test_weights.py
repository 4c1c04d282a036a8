import numpy as np
import pytest
from flax import nnx
from safetensors.numpy import save_file

from ebjax.models.layers import Stack
from ebjax.models.weights import flat_arrays, kernel_from_torch, load_into, load_weights, save_weights


@pytest.fixture
def stack():
    return Stack((1, 1), rngs=nnx.Rngs(0))


@pytest.fixture
def arrays(stack):
    return {key: np.asarray(array) + 1 for key, array in flat_arrays(stack).items()}


def test_written_read_and_set(stack, arrays, tmp_path):
    save_weights(tmp_path / "new" / "x.safetensors", "vgg16", arrays, {"source": "here"})
    name, found = load_weights(tmp_path / "new" / "x.safetensors")
    assert name == "vgg16" and found.keys() == arrays.keys() == {
        f"conv{n}_1.{part}" for n in (1, 2) for part in ("kernel", "bias")
    }
    abstract = nnx.eval_shape(lambda: Stack((1, 1), rngs=nnx.Rngs(0)))
    for module in (stack, abstract):
        load_into(module, found)
        assert all(np.array_equal(array, arrays[key]) for key, array in flat_arrays(module).items())
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.safetensors"]


def test_strided_arrays_are_written_as_they_look(tmp_path):
    turned = np.arange(6, dtype=np.float32).reshape(2, 3).T
    save_weights(tmp_path / "x.safetensors", "any", {"a": turned})
    np.testing.assert_array_equal(load_weights(tmp_path / "x.safetensors")[1]["a"], turned)


def test_wrong_arrays_are_named(stack, arrays):
    with pytest.raises(ValueError, match=r"conv1_1\.bias is missing"):
        load_into(stack, {key: array for key, array in arrays.items() if key != "conv1_1.bias"})
    with pytest.raises(ValueError, match="extra is not in the network"):
        load_into(stack, {**arrays, "extra": np.zeros(1)})
    with pytest.raises(ValueError, match=r"conv2_1\.bias: shape \(7,\), the network's is \(128,\)"):
        load_into(stack, {**arrays, "conv2_1.bias": np.zeros(7)})
    with pytest.raises(ValueError, match="and 1 more are missing"):
        load_into(stack, {})


def test_wrong_files_are_named_and_nothing_is_left(arrays, tmp_path):
    path = tmp_path / "x.safetensors"
    save_weights(path, "vgg16", arrays)
    whole = path.read_bytes()
    for length in (0, 5, 100, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"x\.safetensors: not a whole safetensors file"):
            load_weights(path)
    save_file(arrays, path)
    with pytest.raises(ValueError, match=r"not weights of ebjax; make them with .*convert"):
        load_weights(path)
    with pytest.raises(FileNotFoundError):
        load_weights(tmp_path / "absent")
    with pytest.raises(IsADirectoryError):
        save_weights(tmp_path, "vgg16", arrays)
    assert [file.name for file in tmp_path.iterdir()] == ["x.safetensors"]


def test_kernel_layouts():
    kernel = np.arange(120.0).reshape(2, 3, 4, 5)
    assert kernel_from_torch(kernel)[1, 2, 0, 1] == kernel[1, 0, 1, 2]
    np.testing.assert_array_equal(kernel_from_torch(kernel[0, 0]), kernel[0, 0].T)
    np.testing.assert_array_equal(kernel_from_torch(np.ones(3)), np.ones(3))
