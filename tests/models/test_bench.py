import pytest

from ebjax.models import __main__ as command
from ebjax.models.bench import SIZES, Row, bench, markdown
from ebjax.models.torch_networks import NETWORKS


def test_table_shows_ratios_and_errors():
    row = Row("vgg16", (224, 224, 3), 1, 200.0, {"exact": 220.0, "winograd": 150.0}, {"winograd": 2e-6})
    *_, line = markdown([row])
    assert line == "| vgg16 | 224x224x3 | 1 | 200.0 | 220.0 (1.10x) | 150.0 (0.75x, 2e-06) |"
    assert SIZES.keys() == NETWORKS.keys()


def test_bad_options_are_one_line():
    with pytest.raises(ValueError, match="no network 'vgg99' to time; there are floornet, vgg16"):
        command.show_bench(command.BenchConfig(networks=("vgg99",)))
    with pytest.raises(ValueError, match="at least 1"):
        command.show_bench(command.BenchConfig(batches=(0,)))


def test_without_torch_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(ValueError, match=r"pip install \"ebjax\[torch\]\""):
        next(bench("vgg16", (1,), 1))


def test_the_smallest_case_runs():
    pytest.importorskip("torch")
    (row,) = bench("netvlad-head", (2,), 1)
    assert row.batch == 2 and row.torch_ms > 0 and row.ours_ms.keys() == {"exact", "winograd", "bfloat16"}
