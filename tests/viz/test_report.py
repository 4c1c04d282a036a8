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
    "sections": [
        {
            "title": "Numbers",
            "table": {
                "columns": ["what", "before", "after"],
                "rows": [["ATE rmse, m", 0.82123, np.float64(0.02)], ["frames", 1720, None], ["x", float("nan"), 3]],
            },
        },
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
    assert [base64.b64decode(s.removeprefix("data:image/png;base64,")) for s in sources] == [PNG]


def test_text_is_escaped_and_numbers_are_short():
    text = report(PAGE)
    assert "run &lt;1&gt; &amp; more" in text and "<1>" not in text and "&quot;map&quot;" in text
    assert "<p>First.</p><p>Second.</p>" in text
    for cell in ("0.8212", "0.02", "1,720", "–"):
        assert f'<td class="number">{cell}</td>' in text
    assert "nan" not in text


def test_an_empty_page_is_a_page_and_a_typo_is_an_error():
    assert "<h1>empty</h1>" in report({"title": "empty"})
    with pytest.raises(ValueError, match="'tabel' in a report's section"):
        report({"title": "t", "sections": [{"title": "s", "tabel": {}}]})
