"""The paper's own numbers stand beside ours: whole tables, under the sets of their names."""

import numpy as np
import pytest

from ebjax.features.extractor import EXTRACTORS
from ebjax.features.table import INPUTS as SEEN_AS
from ebjax.paper import page, published
from ebjax.paper.drift import REAL_D5
from ebjax.paper.retrieval import INPUTS, TURNED


def rows(lines):
    """Of the tables in lines: name -> cells, the heading as ""."""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return {name: row for name, *row in cells}


def recall(sets):
    """Table 1 or 2 as it is measured, one row."""
    of_metric = {
        f"{metric}{what}": value
        for metric in page.RECALLS
        for what, value in (("", 0.5), ("_by_chance", 0.1), ("_queries", 20), ("_radius_m", 2.0))
    }
    return {"ours": dict.fromkeys(sets, of_metric)}


def test_the_tables_are_whole():
    assert set(published.RECALL_OF_INPUTS) == {f"NetVLAD: {name}" for name in INPUTS}
    for table in (published.RECALL_OF_INPUTS, published.RECALL_OF_DESCRIPTORS):
        assert all(tuple(cells) == published.RECORDED for cells in table.values())
    turned = published.RECALL_OF_INPUTS[f"NetVLAD: {TURNED}"]
    assert turned == published.RECALL_OF_DESCRIPTORS["NetVLAD"]
    # The paper's claim: turning helps on every set.
    for name, floor in published.RECALL_OF_INPUTS["NetVLAD: floor"].items():
        assert turned[name] > floor
    names = {row.partition(": ")[0] for row in published.INLIERS}
    assert names <= set(EXTRACTORS)
    assert set(published.INLIERS) == {f"{name}: {seen_as}" for name in names for seen_as in SEEN_AS}
    assert all(inliers <= matches for inliers, matches in published.INLIERS.values())
    ratio = [published.ATE_M["RTAB-Map"][name] / published.ATE_M["Early Bird"][name] for name in published.SIMULATED]
    np.testing.assert_allclose([min(ratio), max(ratio)], [3.6, 8], atol=0.1)


@pytest.mark.parametrize("quoted", [published.RECALL_OF_INPUTS, published.RECALL_OF_DESCRIPTORS], ids=["1", "2"])
def test_recall_stands_under_the_sets_of_its_name(quoted):
    lines = list(page.recall_tables(recall(["W", "D5", "D1"]), ["W", "D5", "D1"], quoted))
    first = lines.index(f"**{page.RECALLS['paper_recall']}**")
    table = rows(lines[first : lines.index("", first + 2)])
    for name, cells in quoted.items():
        assert table[f"the paper's {name}"] == [page.DASH, f"{cells['D5']:.1f}", f"{cells['D1']:.1f}"]
    assert sum("the paper's" in line for line in lines) == len(quoted), "of its own metric alone"
    assert not any("the paper's" in line for line in page.recall_tables(recall(["W"]), ["W"], quoted))


def test_features_without_weights_are_quoted_too():
    cell = {"pairs": 2, "inliers": 30.0, "total": 40.0, "right": 1}
    table = rows(page.pair_table({"surf: floor": {"D1": cell}, "orb: floor": {"D1": cell}}))
    assert table["surf: floor"] == ["30 / 40, 1 of 2", "8.5 / 9"]
    assert table["orb: floor"] == ["30 / 40, 1 of 2", page.DASH]
    assert table["d2net: floor + pi"] == [page.DASH, "97.5 / 97.5"]


def test_trajectories_stand_under_the_plans_of_their_name():
    cell = {"ate_rmse_m": 0.5, "share_of_odometry": 0.5, "closures": 3, "false_closures": 0}
    table = rows(page.drift_table({"ours": {"S2": cell, "W": cell, REAL_D5: cell | {"ate_mean_m": 5.7}}}))
    assert table["the paper's Early Bird"] == ["0.38 m", page.DASH, "5.69 m"]
    assert table["the paper's RTAB-Map"] == ["2.86 m", page.DASH, "9.239 m"]
    assert "the paper's RTAB-Map" not in rows(page.drift_table({"ours": {"W": cell}}))
