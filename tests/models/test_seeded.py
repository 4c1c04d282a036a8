import json

import numpy as np
import pytest

from ebjax.models.catalogue import recognise
from ebjax.models.seeded import MAKERS, digest, seeded_state

NAMES = {"netvlad_mat": "netvlad", "netvlad_wpca": "netvlad-nanne", "netvlad_nanne": "netvlad-nanne"}


@pytest.mark.parametrize("network", MAKERS)
def test_digests_are_those_published(network, data):
    known = json.loads((data("reference") / "weights_sha256.json").read_text())
    state = seeded_state(network, 13, head=False)
    assert digest(state) == known[f"{network} 13 head=False"]
    assert recognise(state) == NAMES.get(network, network)
    if network == "resnet50":
        assert digest(seeded_state(network, 13)) == known["resnet50 13 head=True"]


def test_seed_and_key_make_a_tensor_whatever_else_there_is():
    whole, headless = seeded_state("resnet50", 5), seeded_state("resnet50", 5, head=False)
    assert whole.keys() - headless.keys() == {"fc.weight", "fc.bias"}
    assert all(np.array_equal(whole[key], array) for key, array in headless.items())
    assert digest(headless) != digest(seeded_state("resnet50", 6, head=False))
    wpca, nanne = seeded_state("netvlad_wpca", 5), seeded_state("netvlad_nanne", 5)
    assert digest({key: wpca[key] for key in nanne}) == digest(nanne)
