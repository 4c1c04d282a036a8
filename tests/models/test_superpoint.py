import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from ebjax.models.catalogue import recognise, restore
from ebjax.models.seeded import seeded_state
from ebjax.models.superpoint import (
    CONVENTIONS,
    cell_from_pixel,
    convert_v1,
    convert_v6,
    detect,
    detect_maps,
    keypoint_mask,
    score_map,
)

SIZE = (83, 97)  # eight does not divide it


def published_v6(seed=0):
    random = np.random.default_rng(seed)
    widths = {f"backbone.{n}.{k}": w for n, w in enumerate((64, 64, 128, 128)) for k in (0, 1)}
    channels, state = 1, {}
    heads = {"detector.0": (128, 256), "detector.1": (256, 65), "descriptor.0": (128, 256), "descriptor.1": (256, 256)}
    for name, (before, width) in {**{n: (None, w) for n, w in widths.items()}, **heads}.items():
        before = channels if before is None else before
        size = 1 if name.endswith("or.1") else 3
        state[f"{name}.conv.weight"] = (
            random.standard_normal((width, before, size, size)) * (2 / before / size**2) ** 0.5
        )
        state[f"{name}.conv.bias"] = random.uniform(-0.1, 0.1, width)
        for part, (low, high) in {"weight": (0.6, 1.4), "bias": (-0.2, 0.2), "running_mean": (-0.2, 0.2)}.items():
            state[f"{name}.bn.{part}"] = random.uniform(low, high, width)
        state[f"{name}.bn.running_var"] = random.uniform(0.5, 1.5, width)
        state[f"{name}.bn.num_batches_tracked"] = np.array(1)
        channels = width
    return {key: array.astype(np.float32) for key, array in state.items()}


def block(state, name, x, *, rectify=True):
    """What rpautrat's code does: convolution, ReLU, batch normalisation; NCHW."""
    weight = state[f"{name}.conv.weight"]
    x = lax.conv(x, jnp.asarray(weight), (1, 1), "SAME", precision="highest")
    x = x + state[f"{name}.conv.bias"][None, :, None, None]
    x = jnp.maximum(x, 0) if rectify else x
    gamma, beta, mean, var = (
        state[f"{name}.bn.{part}"][None, :, None, None] for part in ("weight", "bias", "running_mean", "running_var")
    )
    return (x - mean) / jnp.sqrt(var + 1e-3) * gamma + beta


@pytest.fixture(scope="module")
def grey():
    return jnp.asarray(np.random.default_rng(1).random((*SIZE, 1)), jnp.float32)


@pytest.fixture(scope="module")
def network():
    return restore("superpoint", convert_v1(seeded_state("superpoint", 5)))


@pytest.fixture(scope="module")
def maps(network, grey):
    logits, coarse = network(grey[None])
    return logits[0], coarse[0]


def test_v6_is_convolution_then_relu_then_normalisation(grey):
    state = published_v6()
    assert recognise(state) == "superpoint-v6"
    x = grey[None, ..., 0][:, None]
    for n in range(4):
        for k in (0, 1):
            x = block(state, f"backbone.{n}.{k}", x)
        if n < 3:
            x = lax.reduce_window(x, -jnp.inf, lax.max, (1, 1, 2, 2), (1, 1, 2, 2), "VALID")
    logits = block(state, "detector.1", block(state, "detector.0", x), rectify=False)[0].transpose(1, 2, 0)
    coarse = block(state, "descriptor.1", block(state, "descriptor.0", x), rectify=False)[0].transpose(1, 2, 0)
    coarse = coarse / jnp.linalg.norm(coarse, axis=-1, keepdims=True)
    ours = restore("superpoint-v6", convert_v6(state))(grey[None])
    np.testing.assert_allclose(ours[0][0], logits, atol=1e-4 * float(jnp.abs(logits).max()))
    np.testing.assert_allclose(ours[1][0], coarse, atol=1e-5)


def test_v6_refuses_other_keys():
    state = published_v6()
    with pytest.raises(ValueError, match=r"unexpected key 'extra\.conv\.weight'"):
        convert_v6({**state, "extra.conv.weight": np.zeros(1)})
    with pytest.raises(ValueError, match=r"'detector\.1\.bn\.bias' is missing"):
        convert_v6({key: array for key, array in state.items() if key != "detector.1.bn.bias"})


def test_scores_are_probabilities_for_any_logits():
    random = np.random.default_rng(0).standard_normal((3, 4, 65)).astype(np.float32)
    for epsilon in (0.0, 1e-5):
        exponential = np.exp(random.astype(np.float64))
        share = exponential / (exponential.sum(-1, keepdims=True) + epsilon)
        scores = np.asarray(score_map(jnp.asarray(random), epsilon))
        assert scores.shape == (24, 32)
        np.testing.assert_allclose(scores[8 * 1 + 5, 8 * 2 + 3], share[1, 2, 8 * 5 + 3], rtol=1e-5)
        for far in (300.0, -300.0):  # the published sum overflows, or all but vanishes
            shifted = score_map(jnp.asarray(random + far, jnp.float32), epsilon)
            assert np.isfinite(shifted).all() and (shifted >= 0).all()
    gradient = jax.grad(lambda logits: (score_map(logits, 1e-5) ** 2).sum())(jnp.asarray(random))
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


@pytest.mark.parametrize("name", CONVENTIONS)
def test_detections_obey_their_convention(maps, name):
    convention = dataclasses.replace(CONVENTIONS[name], threshold=0.01)
    found = detect_maps(*maps, SIZE, convention, count=150)
    assert found.keypoints.shape == (150, 2) and found.descriptors.shape == (150, 256)
    valid = np.asarray(found.valid)
    points, scores = np.asarray(found.keypoints)[valid], np.asarray(found.scores)[valid]
    assert len(points) > 20 and (np.diff(scores) <= 0).all() and scores.min() >= 0.01
    apart = np.abs(points[:, None] - points[None]).max(-1) + 100 * np.eye(len(points))
    assert apart.min() > convention.radius
    reach = np.array(SIZE[::-1]) if name == "magicleap" else np.array([96, 80])
    assert (points >= 4).all() and (points < reach - 4).all()
    np.testing.assert_allclose(np.linalg.norm(np.asarray(found.descriptors)[valid], axis=1), 1, atol=1e-5)


def test_where_a_pixel_lies_among_the_cells():
    pixel = jnp.array([[3.5, 3.5], [92.5, 76.5]])  # centres of the first and a cell near the last of 12 x 10
    size, cells = (80, 96), (10, 12)
    exact = cell_from_pixel(pixel, "exact", cells, size)
    np.testing.assert_allclose(exact, [[0, 0], [11.125, 9.125]])
    for sampling, off in (("image", 0.1), ("corners", 0.6), ("cells", 0.5)):
        near = cell_from_pixel(pixel, sampling, cells, size)
        assert 1e-4 < np.abs(near - exact).max() < off


@pytest.mark.slow
def test_detection_runs_under_jit_and_vmap_and_trains(network, grey):
    convention = dataclasses.replace(CONVENTIONS["magicleap"], threshold=0.01)
    pair = jnp.stack([grey, grey[::-1]])
    together = jax.jit(jax.vmap(lambda image: detect(network, image, convention, count=60)))(pair)
    one = detect(network, pair[1], convention, count=60)
    rows = np.asarray(one.valid)
    np.testing.assert_array_equal(together.valid[1], rows)
    np.testing.assert_allclose(np.asarray(together.descriptors[1])[rows], np.asarray(one.descriptors)[rows], atol=1e-4)
    mask = keypoint_mask(score_map(network(grey[None])[0][0]), convention, SIZE)
    gradient = jax.grad(lambda x: (score_map(network(x[None])[0][0]) * mask[: 8 * 10, : 8 * 12]).sum())(grey)
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0
