import sys

import pytest

from ebjax.bench.networks import SIZES, NetworkConfig, Row, bench_networks, markdown, rows_of
from ebjax.models.torch_networks import NETWORKS


def test_table_shows_ratios_and_errors():
    row = Row("vgg16", (224, 224, 3), 1, 200.0, {"exact": 220.0, "winograd": 150.0}, {"winograd": 2e-6})
    *_, line = markdown([row])
    assert line == "| vgg16 | 224x224x3 | 1 | 200.0 | 220.0 (1.10x) | 150.0 (0.75x, 2e-06) |"
    assert SIZES.keys() == NETWORKS.keys()


def test_bad_options_are_one_line():
    with pytest.raises(ValueError, match="no network 'vgg99' to time; there are floornet, vgg16"):
        bench_networks(NetworkConfig(networks=("vgg99",)))
    with pytest.raises(ValueError, match="at least 1"):
        bench_networks(NetworkConfig(batches=(0,)))


def test_without_torch_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ValueError, match=r"pip install \"ebjax\[torch\]\""):
        next(rows_of("vgg16", (1,), 1))


def test_the_smallest_case_runs():
    pytest.importorskip("torch")
    (row,) = rows_of("netvlad-head", (2,), 1)
    assert row.batch == 2 and row.torch_ms > 0 and row.ours_ms.keys() == {"exact", "winograd", "bfloat16"}
