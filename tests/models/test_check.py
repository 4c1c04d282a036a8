import json
import shutil

import numpy as np
import pytest

from ebjax.models.check import REFERENCES, check_folder
from ebjax.models.compare import Comparison, match_points
from ebjax.models.layers import imagenet
from ebjax.models.seeded import digest, seeded_state
from ebjax.models.vgg import convert, vgg16
from ebjax.models.weights import load_into


@pytest.mark.slow
@pytest.mark.parametrize("network", REFERENCES)
def test_every_reference_array_is_reproduced(network, data):
    folder = data("reference")
    files = {path.name: set(np.load(path).files) for path in folder.glob(f"{network}__*.npz")}
    found: dict[str, set] = {}
    for file, key, (error, tolerance) in check_folder(folder, networks=(network,)):
        assert error <= tolerance, f"{file} {key}: {error:.2e}, may be {tolerance:.2e}"
        found.setdefault(file, set()).add(key)
    assert len(files) == 3 and found == files


def test_every_reference_file_has_a_rule(data):
    prefixes = {path.stem.split("__")[0] for path in data("reference").glob("*__*.npz")}
    assert prefixes == REFERENCES.keys()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small folder of another seed and another image, by our own VGG."""
    import jax.numpy as jnp
    from flax import nnx

    folder = tmp_path_factory.mktemp("reference")
    image = np.random.default_rng(0).integers(0, 256, (40, 36, 3), np.uint8)
    np.savez(folder / "inputs.npz", street_rgb=image, street_gray=image[..., 0])
    state = seeded_state("vgg16", 21, head=False)
    model = nnx.eval_shape(lambda: vgg16(rngs=nnx.Rngs(0)))
    load_into(model, convert(state))
    x = imagenet(jnp.asarray(image, jnp.float32)[None] / 255)
    maps = {
        name: np.moveaxis(np.asarray(array[0]), -1, 0) for name, array in model.taps(x, ("conv2_2", "pool5")).items()
    }
    arrays = {"gap": maps.pop("pool5").mean((1, 2))}
    for name, array in maps.items():
        arrays |= {f"{name}__shape": np.array(array.shape), f"{name}__stride": np.array(3)}
        arrays |= {f"{name}__sub": array[:, ::3, ::3], f"{name}__rowmean": array.mean((0, 2))}
    np.savez(folder / "vgg16__street.npz", **arrays)
    (folder / "README.md").write_text("The weights come from a seed (seed **21**).")
    (folder / "weights_sha256.json").write_text(json.dumps({"vgg16 21 head=False": digest(state)}))
    return folder


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "folder")


def change(folder, **changes):
    path = folder / "vgg16__street.npz"
    with np.load(path) as file:
        arrays = {**file, **changes}
    np.savez(path, **arrays)


def test_another_seed_and_image(folder):
    rows = list(check_folder(folder))
    assert {key for _, key, _ in rows} == {"gap", *(f"conv2_2__{p}" for p in ("shape", "stride", "sub", "rowmean"))}
    assert all(error <= tolerance for *_, (error, tolerance) in rows)


def test_errors_are_seen(folder):
    with np.load(folder / "vgg16__street.npz") as file:
        sub = file["conv2_2__sub"].copy()
    sub[5, 2, 1] += 2e-4 * np.abs(sub).max()
    change(folder, conv2_2__sub=sub, gap=np.full(512, np.nan))
    off = {key for _, key, (error, tolerance) in check_folder(folder) if not error <= tolerance}
    assert off == {"conv2_2__sub", "gap"}
    assert any(error > tolerance for *_, (error, tolerance) in check_folder(folder, 22))


@pytest.mark.parametrize("name", ["mystery", "conv2_2__median", "conv9_9__shape"])
def test_no_array_is_skipped(folder, name):
    change(folder, **{name: np.zeros(3)})
    with pytest.raises(ValueError, match=rf"vgg16__street\.npz: .*{name.split('__')[0]}"):
        list(check_folder(folder))


def test_bad_folders_are_one_line(folder):
    with pytest.raises(ValueError, match="no files of resnet50"):
        list(check_folder(folder, networks=("resnet50",)))
    (folder / "weights_sha256.json").write_text(json.dumps({"vgg16 21 head=False": "0"}))
    with pytest.raises(ValueError, match="vgg16 of seed 21 has another digest"):
        list(check_folder(folder))
    (folder / "weights_sha256.json").unlink()
    (folder / "README.md").unlink()
    with pytest.raises(ValueError, match=r"README\.md: says no seed; give --seed"):
        list(check_folder(folder))
    shutil.copy(folder / "vgg16__street.npz", folder / "vgg16__field.npz")
    with pytest.raises(ValueError, match=r"no field_rgb, the image of vgg16__field\.npz"):
        list(check_folder(folder, 21))
    shutil.copy(folder / "vgg16__street.npz", folder / "vgg17__street.npz")
    with pytest.raises(ValueError, match=r"vgg17__street\.npz: not NETWORK__IMAGE\.npz of a known network"):
        list(check_folder(folder, 21))
    whole = (folder / "inputs.npz").read_bytes()
    (folder / "inputs.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"inputs\.npz: not a whole \.npz file"):
        list(check_folder(folder, 21, ("vgg16",)))
    with pytest.raises(NotADirectoryError):
        list(check_folder(folder / "absent"))


def test_comparison_of_another_shape_is_infinitely_wrong():
    comparison = Comparison({"a": np.array([1.0, -4.0])})
    comparison.array("a", np.array([1.0, -4.0 + 3e-4]))
    assert comparison.deviations["a"].error < comparison.deviations["a"].tolerance == 4e-4
    comparison.array("a", np.ones(3))
    assert comparison.deviations["a"].error == np.inf


def test_points_are_paired_one_to_one():
    reference = np.array([[0.0, 0.0], [0.01, 0.0], [5.0, 5.0]])
    got = np.array([[5.0, 5.015], [0.009, 0.0], [9.0, 9.0]])
    np.testing.assert_array_equal(match_points(reference, got, 0.02), [[0, 1], [2, 0]])
    assert match_points(reference, np.zeros((0, 2)), 0.02).shape == (0, 2)
