"""One HTML page that stands alone: styles and images inside, no script, readable offline, on paper and in the dark.

The page is a plain dict, so that whoever has results can describe them without importing anything:
`{"title": str, "text": str, "figures": [figure], "sections": [section]}`, where `text` and `figures` are the answer,
which comes first; `section = {"title": str, "text": str, "table": table, "figures": [figure], "files": [[name, what]]}`
with links to the files; `table = {"columns": [str], "rows": [[value]], "decimals": [int or None]}`; and
`figure = {"png": bytes, "caption": str}`. Everything but the title may be left out.
"""

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from urllib.parse import quote

STYLE = """
:root { color-scheme: light dark; --line: #d5d9dd; --soft: #556; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .3rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
p, li { max-width: 46rem; } .answer { font-size: 1.15rem; } figcaption { color: var(--soft); font-size: .9rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .95rem; }
th, td { text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number, th.number { text-align: right; white-space: nowrap; }
.wide { overflow-x: auto; } figure { margin: 1rem 0; } img { max-width: 100%; height: auto; background: #fff; }
@media (prefers-color-scheme: dark) { :root { --line: #3a3f45; --soft: #abb; } }
@media print {
  :root { color-scheme: light; --line: #bbb; --soft: #333; }
  body { font-size: 10pt; max-width: none; margin: 0; padding: 0; background: #fff; color: #000; }
  h2, h2 + p { break-after: avoid; } h2 { margin-top: 1rem; } p { orphans: 3; widows: 3; }
  figure, tr, li { break-inside: avoid; } figcaption { break-before: avoid; } thead { display: table-header-group; }
  img { max-height: 20cm; } .wide { overflow: visible; } a { color: inherit; text-decoration: none; }
}
"""
MOST_DECIMALS, DIGITS = 4, 4
"""Numbers of a column share their decimals: as many as show DIGITS of the largest, but not more than that."""


def report(page: Mapping[str, Any]) -> str:
    """Renders the page as HTML text.

    Args:
      page: as the module describes; None in a table is shown as a dash.

    Raises:
      ValueError: a key that no page, section, table or figure has.
    """
    _check(page, "page", {"title", "text", "figures", "sections"})
    title = html.escape(str(page["title"]))
    body = [f"<h1>{title}</h1>", _text(page.get("text"), ' class="answer"')]
    body += [_figure(figure) for figure in page.get("figures", ())]
    for section in page.get("sections", ()):
        _check(section, "section", {"title", "text", "table", "figures", "files"})
        body += ["<section>", f"<h2>{html.escape(str(section['title']))}</h2>", _text(section.get("text"))]
        if section.get("table"):
            body.append(_table(section["table"]))
        body += [_figure(figure) for figure in section.get("figures", ())]
        body += [_files(section.get("files", ())), "</section>"]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"<title>{title}</title><style>{STYLE}</style>"
    lines = "\n".join(part for part in body if part)
    return f'<!doctype html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{lines}\n</body>\n</html>\n'


def _check(part: Mapping[str, Any], name: str, known: set[str]) -> None:
    if unknown := sorted(set(part) - known):
        raise ValueError(f"unknown key {unknown[0]!r} in a report's {name}; known: {', '.join(sorted(known))}")


def _text(text: str | None, kind: str = "") -> str:
    return "".join(f"<p{kind}>{html.escape(part)}</p>" for part in (text or "").split("\n\n") if part)


def _files(files: Sequence[Sequence[str]]) -> str:
    rows = (f'<li><a href="{quote(name)}">{html.escape(name)}</a>: {html.escape(what)}</li>' for name, what in files)
    return f"<ul>{''.join(rows)}</ul>" if files else ""


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool | str) and hasattr(value, "__float__")


def _is_count(value: Any) -> bool:
    return hasattr(value, "__index__")


def _cell(value: Any, decimals: int) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not _is_number(value):
        return html.escape(str(value))
    number = float(value)
    if not math.isfinite(number):
        return "–"
    return f"{number:,.{0 if _is_count(value) else decimals}f}"


def _decimals(values: Iterable[Any]) -> int:
    """How many show `DIGITS` of the largest number of a column that is no count."""
    numbers = [float(value) for value in values if _is_number(value) and not _is_count(value)]
    largest = max((abs(number) for number in numbers if math.isfinite(number)), default=0.0)
    return min(MOST_DECIMALS, max(0, DIGITS - 1 - math.floor(math.log10(largest)))) if largest else 1


def _row(tag: str, cells: Sequence[Any], numeric: list[bool], decimals: Sequence[int]) -> str:
    classes = (' class="number"' if is_number else "" for is_number in numeric)
    columns = zip(classes, cells, decimals, strict=True)
    return f"<tr>{''.join(f'<{tag}{kind}>{_cell(value, places)}</{tag}>' for kind, value, places in columns)}</tr>"


def _table(table: Mapping[str, Any]) -> str:
    _check(table, "table", {"columns", "rows", "decimals"})
    columns, rows = list(table["columns"]), [list(row) for row in table["rows"]]
    numeric = [bool(rows) and all(row[i] is None or _is_number(row[i]) for row in rows) for i in range(len(columns))]
    asked = table.get("decimals", [None] * len(columns))
    decimals = [_decimals(row[i] for row in rows) if own is None else own for i, own in enumerate(asked)]
    lines = "\n".join(_row("td", row, numeric, decimals) for row in rows)
    head = _row("th", columns, numeric, decimals)
    return f'<div class="wide"><table>\n<thead>{head}</thead>\n<tbody>{lines}</tbody>\n</table></div>'


def _figure(figure: Mapping[str, Any]) -> str:
    _check(figure, "figure", {"png", "caption"})
    caption = html.escape(str(figure.get("caption", "")))
    data = base64.b64encode(figure["png"]).decode("ascii")
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
