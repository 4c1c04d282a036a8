import jax.numpy as jnp
import numpy as np

from ebjax.features.extractor import extractor
from ebjax.models import eye as module
from ebjax.models.eye import open_eye
from ebjax.places.descriptor import descriptor


def test_places_and_features_of_one_view_need_one_pass(monkeypatch):
    calls, eye, run = [], open_eye(None), module._look
    monkeypatch.setattr(module, "_look", lambda *args: calls.append(1) or run(*args))
    view = jnp.asarray(np.random.default_rng(0).uniform(size=(64, 64, 3)), jnp.float32)
    seen = jnp.ones((64, 64), bool)
    place, local = descriptor("floornet"), extractor("floornet")
    kept = place.look(view, seen, None)
    found = local.extract(view, seen)
    assert len(calls) == 1 and eye.path == place.weights == local.weights
    again = place.look(view + 0, seen, None)
    assert len(calls) == 2
    np.testing.assert_array_equal(kept["map"], again["map"])
    buffer, field = np.array(view), np.array(seen)
    first = np.asarray(eye(buffer, field).places)
    buffer[:] = buffer[::-1]
    assert np.abs(np.asarray(eye(buffer, field).places) - first).max() > 0.01
    assert found.descriptors.shape[1] == 64 and bool(found.valid.any())
