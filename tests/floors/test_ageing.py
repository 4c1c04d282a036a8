import itertools

import jax
import numpy as np
import pytest

from ebjax.floors.ageing import floors_of
from ebjax.floors.laying import floor_of
from ebjax.floors.plan import make_plan
from ebjax.floors.surface import FloorConfig

CORRIDOR = make_plan([np.array([[0.0, 0.0], [6.0, 0.0]])], 1.6, 1.0)


def texels(atlas):
    return np.asarray(atlas.texture.texels, np.float32)


@pytest.mark.slow
def test_a_floor_that_does_not_age_is_laid_once():
    config = FloorConfig(family="concrete", texel_m=0.02)
    floor = floors_of(CORRIDOR, config, key=jax.random.key(0))
    assert floor(0) is floor(5)
    assert np.all(texels(floor(0)) == texels(floor_of(CORRIDOR, config, key=jax.random.key(0))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_marks_come_and_stay(seed):
    config = FloorConfig(family="concrete", texel_m=0.02, ageing_per_m2=0.4)
    floor = floors_of(CORRIDOR, config, key=jax.random.key(seed))
    passes = [texels(floor(number)) for number in range(5)]
    assert np.all(passes[0] == texels(floor_of(CORRIDOR, config, key=jax.random.key(seed))))
    marked = [np.abs(later - passes[0]).max(1) > 0.01 for later in passes]
    shares = [each.mean() for each in marked]
    assert all(np.diff(shares) >= 0) and 0.001 < shares[4] < 0.1
    for before, after in itertools.pairwise(marked):
        assert (before & ~after).sum() <= 0.05 * before.sum(), "a mark may be painted over, not vanish"


@pytest.mark.slow
def test_a_pass_is_the_same_whatever_was_asked_for_before():
    config = FloorConfig(family="concrete", texel_m=0.02, ageing_per_m2=0.4)
    one, other = (floors_of(CORRIDOR, config, key=jax.random.key(0)) for _ in range(2))
    inorder = {number: texels(one(number)) for number in range(6)}
    for number in (5, 2, 3, 0, 4):
        assert np.all(texels(other(number)) == inorder[number])
    assert all(np.any(inorder[number] != inorder[number - 1]) for number in range(1, 6))
