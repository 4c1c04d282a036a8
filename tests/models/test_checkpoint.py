import os
import pickle
import zipfile
from collections import OrderedDict

import numpy as np
import pytest
from safetensors.numpy import save_file

from ebjax.models.checkpoint import read_checkpoint, taking

STATE = OrderedDict(
    {
        "a.weight": np.arange(24, dtype=np.float32).reshape(2, 3, 2, 2),
        "a.bias": np.array([1.5, -2.0]),
        "a.transposed": np.arange(6, dtype=np.float32).reshape(3, 2).T,
        "a.num_batches_tracked": np.array(7),
    }
)


class Hostile:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


def same(found, expected=STATE):
    assert list(found) == list(expected)
    for key, array in expected.items():
        assert found[key].dtype == array.dtype
        np.testing.assert_array_equal(found[key], array)


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize("wrapper", [None, "state_dict", "model"])
def test_reads_both_formats_of_torch(write_torch, tmp_path, stream, wrapper):
    content = (
        STATE if wrapper is None else {"epoch": 3, "best_score": np.float64(0.5), wrapper: STATE, "log": [1, (2,)]}
    )
    write_torch(tmp_path / "x.pth", content, stream=stream)
    same(read_checkpoint(tmp_path / "x.pth"))


@pytest.mark.parametrize("stream", [False, True])
def test_agrees_with_torch_itself(tmp_path, stream):
    torch = pytest.importorskip("torch")
    state = OrderedDict((key, torch.from_numpy(array.copy())) for key, array in STATE.items())
    state["view"] = torch.arange(10.0)[3:7]
    state["parameter"] = torch.nn.Parameter(torch.ones(2))
    state["bfloat"] = torch.tensor([1.0, 2.5], dtype=torch.bfloat16)
    wrapped = {
        "state_dict": state,
        "optimizer": torch.optim.SGD([torch.ones(1)]).state_dict(),
        "recalls": {1: np.ones(2)},
    }
    torch.save(wrapped, tmp_path / "x.pth", _use_new_zipfile_serialization=not stream)
    found = read_checkpoint(tmp_path / "x.pth")
    for key, tensor in state.items():
        np.testing.assert_array_equal(found[key].astype(np.float64), tensor.detach().double().numpy())


def test_every_key_has_to_be_taken():
    with taking({**STATE, "other.weight": np.zeros(2)}, "other.") as take:
        for key in ("a.weight", "a.bias", "a.transposed"):
            np.testing.assert_array_equal(take(key), STATE[key])
    with pytest.raises(ValueError, match=r"^key 'b\.bias' is missing in the checkpoint"), taking(STATE) as take:
        take("b.bias")
    with pytest.raises(ValueError, match=r"^unexpected key 'a\.transposed' in the checkpoint"), taking(STATE) as take:
        take("a.weight"), take("a.bias")


def test_reads_a_real_one(data):
    found = read_checkpoint(data("reference") / "alike-t.pth")
    assert len(found) == 59
    assert all(np.isfinite(array).all() for array in found.values())


@pytest.mark.parametrize("stream", [False, True])
def test_hostile_pickle_is_refused_by_name(write_torch, tmp_path, stream):
    trace = tmp_path / "trace"
    write_torch(tmp_path / "x.pth", {"state_dict": STATE, "extra": Hostile(trace)}, stream=stream)
    with pytest.raises(ValueError, match=r"x\.pth: .*posix\.system.*refused") as error:
        read_checkpoint(tmp_path / "x.pth")
    assert "\n" not in str(error.value)
    assert not trace.exists()


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_plain_pickle_runs_nothing(tmp_path, protocol):
    trace = tmp_path / "trace"
    (tmp_path / "x.pth").write_bytes(pickle.dumps(Hostile(trace), protocol))
    with pytest.raises(ValueError, match="not a whole checkpoint"):
        read_checkpoint(tmp_path / "x.pth")
    assert not trace.exists()


def test_nothing_allowed_can_be_turned_into_a_call(tmp_path):
    """BUILD, NEWOBJ and the like on what may be mentioned do nothing or are refused."""
    for program in (
        b"\x80\x02ctorch._utils\n_rebuild_parameter\n(cos\nsystem\nX\x02\x00\x00\x00lstR.",
        b"\x80\x02ccollections\nOrderedDict\n)\x81.",
        b"\x80\x02(X\x02\x00\x00\x00lsios\nsystem\n.",
        b"\x80\x02X\x02\x00\x00\x00lsR.",
        b"\x80\x02\x82\x01.",
    ):
        (tmp_path / "x.pth").write_bytes(program)
        with pytest.raises(ValueError, match="not a whole checkpoint"):
            read_checkpoint(tmp_path / "x.pth")


@pytest.mark.parametrize("stream", [False, True])
def test_every_truncation_and_many_flips_are_one_line(write_torch, tmp_path, stream):
    write_torch(tmp_path / "whole.pth", {"model": STATE}, stream=stream)
    whole = (tmp_path / "whole.pth").read_bytes()
    broken = tmp_path / "broken.pth"
    for length in range(0, len(whole), 61):
        broken.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"broken\.pth") as error:
            read_checkpoint(broken)
        assert "\n" not in str(error.value)
    rng = np.random.default_rng(0)
    for _ in range(100):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        broken.write_bytes(damaged)
        try:
            read_checkpoint(broken)
        except ValueError as error:
            assert "broken.pth" in str(error) and "\n" not in str(error)


def test_view_beyond_its_data(write_torch, tmp_path):
    write_torch(tmp_path / "x.pth", STATE)
    with zipfile.ZipFile(tmp_path / "x.pth") as old, zipfile.ZipFile(tmp_path / "y.pth", "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name)[: -4 if name.endswith("/0") else None])
    with pytest.raises(ValueError, match="beyond its data"):
        read_checkpoint(tmp_path / "y.pth")


def test_safetensors(tmp_path):
    state = {key: np.ascontiguousarray(array) for key, array in STATE.items()}
    save_file(state, tmp_path / "x.safetensors")
    found = read_checkpoint(tmp_path / "x.safetensors")
    same({key: found[key] for key in state}, state)


def mat_struct(state):
    def cell(items):
        array = np.empty((1, len(items)), object)
        array[0, :] = items or [[]]
        return array

    layers = [{"type": "conv", "weights": cell([state[f"layers.0.weights.{n}"] for n in (0, 1)])}, {"type": "relu"}]
    return {
        "layers": cell(layers),
        "meta": {"normalization": {"averageImage": state["meta.normalization.averageImage"]}},
    }


MAT = {
    "meta.normalization.averageImage": np.full((4, 5, 3), 100, np.float32),
    "layers.0.weights.0": np.arange(54, dtype=np.float32).reshape(3, 3, 2, 3),
    "layers.0.weights.1": np.ones((1, 3), np.float32),
}


@pytest.mark.parametrize("compress", [False, True])
def test_matlab_version_5(tmp_path, compress):
    from scipy.io import savemat

    savemat(tmp_path / "x.mat", {"net": mat_struct(MAT)}, do_compression=compress)
    same(read_checkpoint(tmp_path / "x.mat"), MAT)
    whole = (tmp_path / "x.mat").read_bytes()
    for length in range(0, len(whole) - 9, 67):
        (tmp_path / "broken.mat").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"broken\.mat"):
            read_checkpoint(tmp_path / "broken.mat")


def test_matlab_version_7(tmp_path):
    import h5py

    with h5py.File(tmp_path / "x.mat", "w", userblock_size=512) as file:
        values = [file.create_dataset(f"#refs#/w{n}", data=MAT[f"layers.0.weights.{n}"].T) for n in (0, 1)]
        conv, relu = file.create_group("#refs#/conv"), file.create_group("#refs#/relu")
        conv["weights"] = np.array([[value.ref] for value in values], h5py.ref_dtype)
        relu["type"] = np.zeros(2, np.uint64)
        file["net/layers"] = np.array([[conv.ref], [relu.ref]], h5py.ref_dtype)
        file["net/meta/normalization/averageImage"] = MAT["meta.normalization.averageImage"].T
    with open(tmp_path / "x.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    same(read_checkpoint(tmp_path / "x.mat"), MAT)


def test_other_files(write_torch, tmp_path):
    (tmp_path / "x.pth").write_text("<html>404</html>" * 100)
    with pytest.raises(ValueError, match="neither torch's, nor MATLAB's"):
        read_checkpoint(tmp_path / "x.pth")
    with zipfile.ZipFile(tmp_path / "y.pth", "w") as file:
        file.writestr("a.npy", b"1")
    with pytest.raises(ValueError, match="not one of torch's"):
        read_checkpoint(tmp_path / "y.pth")
    write_torch(tmp_path / "z.pth", {"a": 1})
    with pytest.raises(ValueError, match="'a' in it is not a tensor"):
        read_checkpoint(tmp_path / "z.pth")
    with pytest.raises(FileNotFoundError):
        read_checkpoint(tmp_path / "absent.pth")
