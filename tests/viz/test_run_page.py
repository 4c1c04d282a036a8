import re

import pytest

from ebjax.viz.report import report
from ebjax.viz.run_page import Pictures, answer, run_page

METRICS = {
    "frames": 91,
    "keyframes": 90,
    "depth": True,
    "broken_frames": {},
    "candidates": 239,
    "closures_kept": 17,
    "closures_opposing": 16,
    "corrected_by_m": 0.934,
    "reasons": {"… inliers, fewer than 20": 222, "kept": 17},
    "nothing_kept": None,
    "best_refused": None,
    "mirrored": None,
    "map": None,
    "motion": None,
    "ate_rmse_m": {"before": 0.47462, "after": 0.0006},
    "closures_against_truth": {"checked": 17, "within_5cm_1deg": 17, "position_error_m": {"max": 0.0014}},
    "recall_at_1_1m": 0.9667,
    "ms_per_frame": 12.3,
    "peak_memory_mb": 900.0,
    "seconds": {"frames": 6.125, "motion": 2.25, "pose graph": 0.5, "total": 10.0},
}
NOTHING = METRICS | {
    "closures_kept": 0,
    "closures_opposing": 0,
    "nothing_kept": "no loop closure: of 9 candidates 9: too few matches agree",
    "mirrored": None,
    "best_refused": "the best candidate, a.jpg and b.jpg: 12 of 80 matches agree; 12 inliers, fewer than 20",
}
FIGURE = {"png": b"png", "caption": "two images"}


def page(metrics, closures=(FIGURE,), refused=(), rows=(), files=()):
    pictures = Pictures(b"path", b"floor", b"pairs", list(closures), list(refused))
    made = [["command", "python -m ebjax.slam run.bag"], ["version", "ebjax 1"]]
    return run_page("run", metrics, pictures, list(rows), made, list(files))


def titles(page):
    return [section["title"] for section in page["sections"]]


def test_the_answer_is_a_sentence_with_its_number():
    assert answer(METRICS) == (
        "The path was 0.4746 m off the truth (root mean square), and is 0.0006 m off now, with 17 loop closures, 16 of "
        "them between views from opposite sides."
    )
    without = {key: value for key, value in METRICS.items() if key != "ate_rmse_m"}
    assert answer(without).startswith("The path was corrected by up to 0.93 m, with 17 loop closures")
    joined = NOTHING | {"nothing_kept": None, "best_refused": None, "map": {"closures": 1}}
    assert answer(joined).endswith("and 1 loop closure to earlier runs in its map.")


def test_where_nothing_is_kept_it_says_why_and_what_the_best_lacked():
    said = answer(NOTHING)
    assert said.startswith("No loop closure: of 9 candidates 9: too few matches agree. The best candidate, ")
    assert "fewer than 20. The trajectory is the odometry, 0.0006 m off the truth" in said
    assert "The best candidate" in titles(page(NOTHING, closures=(), refused=(FIGURE,)))
    nobody = NOTHING | {"best_refused": None, "ate_rmse_m": None}
    assert answer(nobody).endswith("too few matches agree. The trajectory is the odometry.")
    assert "Loop closures" not in titles(page(nobody, closures=()))


def test_a_floor_that_mirrors_is_named():
    mirrored = "the floor mirrors the room; closures are those of medians"
    said = answer(METRICS | {"mirrored": mirrored})
    assert said.endswith("opposite sides. The floor mirrors the room; closures are those of medians.")
    said = answer(NOTHING | {"mirrored": mirrored, "ate_rmse_m": None})
    assert said.endswith("12 inliers, fewer than 20. The trajectory is what images and odometry say.")


def test_the_page_opens_with_the_path_and_explains_its_terms():
    made = page(METRICS, refused=(FIGURE,))
    assert made["figures"][0]["png"] == b"path" and made["text"] == answer(METRICS)
    text = report(made)
    assert "candidates checked" in text and "verified" not in text
    assert text.index("ATE rmse: root mean square") < text.index("A loop closure says that") < text.index("python -m")
    assert "walls" not in text and "walls that a view shows" in report(page(METRICS | {"depth": False}))


def test_times_add_up_to_the_total():
    (table,) = (section["table"] for section in page(METRICS)["sections"] if section["title"] == "Time")
    *stages, (_, total) = table["rows"]
    assert sum(seconds for _, seconds in stages) == pytest.approx(total) == 10.0
    assert all(seconds >= 0 for _, seconds in stages)


@pytest.mark.parametrize("truth", [True, False])
def test_closures_have_their_errors_where_the_truth_is_known(truth):
    rows = [["a.jpg", "b.jpg", "opposite", 187, 200, 4.0012, -0.02262, -178.231] + [0.0003, 0.0071] * truth]
    text = report(page(METRICS, rows=rows))
    assert ("error, m" in text) == truth
    table = text.partition("All loop closures")[2].partition("</table>")[0]
    cells = re.findall(r'<td class="number">(.*?)</td>', table)
    assert cells == ["187", "200", "4.001", "-0.023", "-178.23"] + ["0.0003", "0.007"] * truth


def test_only_files_that_are_there_are_linked():
    text = report(page(METRICS, files=["trajectory.tum", "config.yaml", "something.else"]))
    assert re.findall(r'href="(.*?)"', text) == ["trajectory.tum", "config.yaml"]
