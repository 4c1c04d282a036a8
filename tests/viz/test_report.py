import base64
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from ebjax.viz.report import report

PNG = b"\x89PNG\r\n\x1a\nnot really"
PAGE = {
    "title": "run <1> & more",
    "text": "First.\n\nSecond.",
    "figures": [{"png": b"the answer", "caption": "opens the page"}],
    "sections": [
        {
            "title": "Numbers",
            "table": {
                "columns": ["what", "before", "after"],
                "rows": [["ATE rmse, m", 0.82123, np.float64(0.02)], ["frames", 1720, None], ["x", float("nan"), 3]],
            },
        },
        {"title": "Files", "files": [["a run.csv", "rows & columns"]]},
        {"title": "Map", "text": "Seen from above.", "figures": [{"png": PNG, "caption": 'floor "map"'}]},
    ],
}


class Tags(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.open, self.seen = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_well_formed_and_stands_alone():
    text = report(PAGE)
    tags = Tags(text)
    assert not tags.open
    assert not re.search(r"https?:|<script|<link|url\(|@import", text)
    sources = [attributes["src"] for tag, attributes in tags.seen if tag == "img"]
    assert [base64.b64decode(s.removeprefix("data:image/png;base64,")) for s in sources] == [b"the answer", PNG]


def test_text_is_escaped_and_numbers_are_short():
    text = report(PAGE)
    assert "run &lt;1&gt; &amp; more" in text and "<1>" not in text and "&quot;map&quot;" in text
    assert '<p class="answer">First.</p><p class="answer">Second.</p>' in text
    for cell in ("0.8212", "0.0200", "1,720", "–"):
        assert f'<td class="number">{cell}</td>' in text
    assert "nan" not in text


def test_an_empty_page_is_a_page_and_a_typo_is_an_error():
    assert "<h1>empty</h1>" in report({"title": "empty"})
    with pytest.raises(ValueError, match="'tabel' in a report's section"):
        report({"title": "t", "sections": [{"title": "s", "tabel": {}}]})


def column(rows, **table):
    text = report({"title": "t", "sections": [{"title": "s", "table": {"columns": ["x"], "rows": rows, **table}}]})
    return re.findall(r'<td class="number">(.*?)</td>', text)


def test_numbers_of_a_column_have_the_same_decimals():
    assert column([[0.5], [-12.34567], [3.0]]) == ["0.50", "-12.35", "3.00"]
    assert column([[0.00012], [0.00004]]) == ["0.0001", "0.0000"]
    assert column([[12345.6], [1.5]]) == ["12,346", "2"]
    assert column([[0.5], [None]], decimals=[3]) == ["0.500", "–"]
    assert column([[17], [200]]) == ["17", "200"]


def test_the_answer_comes_first_and_files_are_linked():
    text = report(PAGE)
    assert text.index("First.") < text.index("opens the page") < text.index("<h2>")
    assert '<a href="a%20run.csv">a run.csv</a>: rows &amp; columns' in text


def test_paper_is_white_and_keeps_figures_whole():
    style = report(PAGE).partition("@media print")[2]
    assert "background: #fff" in style and "break-inside: avoid" in style and "table-header-group" in style
