"""The default descriptor: what it makes of views and of what they do not show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.rootsift_vlad import look, project_all, unite, window

SIZE = 96


@pytest.fixture(scope="module")
def kept(floor_texture):
    """Eight views of random floor; the last two see less of it than the others."""
    seen = np.ones((8, SIZE, SIZE), bool)
    seen[:, :16] = False
    seen[6:, :, :40] = False
    rgb = np.stack([np.repeat(floor_texture((SIZE, SIZE), k)[..., None], 3, 2) for k in range(8)])
    image = np.zeros((4, 4, 3), np.uint8)
    views = [jax.jit(look)(jnp.asarray(one), jnp.asarray(mask), image) for one, mask in zip(rgb, seen, strict=True)]
    return {name: np.stack([np.asarray(view[name]) for view in views]) for name in views[0]}


def test_vectors_are_unit_and_of_both_orientations(kept):
    vectors = np.asarray(unite(kept).vectors)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    assert vectors.shape[::2] == (8, 2) and np.abs(vectors[..., 0] - vectors[..., 1]).max() > 0.05


def test_a_view_and_the_same_view_turned_have_the_same_two_vectors(kept, floor_texture):
    rgb = np.repeat(floor_texture((SIZE, SIZE), 0)[..., None], 3, 2)
    seen, image = jnp.ones((SIZE, SIZE), bool), np.zeros((4, 4, 3), np.uint8)
    views = [rgb, rgb[::-1, ::-1], *(np.repeat(floor_texture((SIZE, SIZE), k)[..., None], 3, 2) for k in range(1, 20))]
    looked = [jax.jit(look)(jnp.asarray(np.ascontiguousarray(one)), seen, image) for one in views]
    vectors = np.asarray(unite({n: np.stack([np.asarray(v[n]) for v in looked]) for n in looked[0]}).vectors)
    others = vectors[0, :, 1] @ vectors[2:, :, 0].T
    assert vectors[0, :, 1] @ vectors[1, :, 0] > 0.7 > 0.2 > others.max()


def test_cells_that_one_view_does_not_see_are_zero_there(kept):
    maps, space = project_all(kept["map"], kept["cells"])
    rows, columns = window(kept["cells"].any(0))
    hidden = ~kept["cells"][:, rows, columns]
    assert hidden[7].sum() > hidden[0].sum() > 0
    assert not np.asarray(maps)[hidden].any()
    np.testing.assert_array_equal(np.asarray(space.mask) > 0, kept["cells"].any(0)[rows, columns])


def test_the_border_without_support_changes_nothing(kept):
    inner = np.zeros(kept["cells"].shape[1:], bool)
    inner[2:-2, 3:-3] = True
    rows, columns = window(inner)
    assert (rows, columns) == (slice(2, -2 % len(inner)), slice(3, -3 % inner.shape[1]))
    cells = np.broadcast_to(inner, kept["cells"].shape)
    whole = unite({"map": kept["map"], "cells": cells})
    part = unite({"map": kept["map"][:, rows, columns], "cells": cells[:, rows, columns]})
    np.testing.assert_array_equal(whole.vectors, part.vectors)


def test_window_stays_symmetric():
    mask = np.zeros((6, 7), bool)
    mask[1, 3] = True
    assert window(mask) == (slice(1, 5), slice(3, 4))


def test_nothing_seen_says_what_to_do(kept):
    with pytest.raises(ValueError, match="look at more floor"):
        unite({"map": kept["map"], "cells": np.zeros_like(kept["cells"])})
