import jax.numpy as jnp
import numpy as np

from ebjax.slam.one_piece import ALIGNMENT, in_one_piece


def test_the_same_arrays_lie_behind_each_other_on_their_own():
    given = {"a": jnp.arange(7.0), "b": (np.array(3, np.int32), np.ones((3, 2), bool)), "c": np.zeros((0, 4), np.uint8)}
    found = in_one_piece(given)
    for one, two in ((found["a"], given["a"]), *zip(found["b"], given["b"], strict=True), (found["c"], given["c"])):
        assert isinstance(one, np.ndarray) and one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)
    places = [array.ctypes.data for array in (found["a"], *found["b"])]
    assert all(place % ALIGNMENT == 0 for place in places)
    assert np.diff(places).tolist() == [ALIGNMENT, ALIGNMENT]
    given["b"][1][:] = False
    assert found["b"][1].all()


def test_nothing_is_nothing():
    assert in_one_piece(()) == ()
