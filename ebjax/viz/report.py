"""One HTML page that stands alone: styles and images inside, no script, no link, readable offline and on paper.

The page is a plain dict, so that whoever has results can describe them without importing anything:
`{"title": str, "text": str, "sections": [{"title": str, "text": str, "table": table, "figures": [figure]}]}` with
`table = {"columns": [str], "rows": [[value]]}` and `figure = {"png": bytes, "caption": str}`. Everything but the title
may be left out.
"""

import base64
import html
import math
from collections.abc import Iterable, Mapping
from typing import Any

STYLE = """
:root { color-scheme: light dark; --line: #d5d9dd; --soft: #667; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .3rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
p { max-width: 46rem; } figcaption, .soft { color: var(--soft); font-size: .9rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .95rem; }
th, td { text-align: left; padding: .25rem 1.2rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number, th.number { text-align: right; }
.wide { overflow-x: auto; } figure { margin: 1rem 0; } img { max-width: 100%; height: auto; background: #fff; }
@media (prefers-color-scheme: dark) { :root { --line: #3a3f45; --soft: #9aa; } }
@media print { h2 { break-after: avoid; } figure, tr { break-inside: avoid; } }
"""


def report(page: Mapping[str, Any]) -> str:
    """Renders the page as HTML text.

    Args:
      page: as the module describes; numbers in tables are shown to four digits, None as a dash.

    Raises:
      ValueError: a key that no page, section, table or figure has.
    """
    _check(page, "page", {"title", "text", "sections"})
    title = html.escape(str(page["title"]))
    body = [f"<h1>{title}</h1>", _text(page.get("text"))]
    for section in page.get("sections", ()):
        _check(section, "section", {"title", "text", "table", "figures"})
        body += ["<section>", f"<h2>{html.escape(str(section['title']))}</h2>", _text(section.get("text"))]
        if section.get("table"):
            body.append(_table(section["table"]))
        body += [_figure(figure) for figure in section.get("figures", ())]
        body.append("</section>")
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"<title>{title}</title><style>{STYLE}</style>"
    lines = "\n".join(part for part in body if part)
    return f'<!doctype html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{lines}\n</body>\n</html>\n'


def _check(part: Mapping[str, Any], name: str, known: set[str]) -> None:
    if unknown := sorted(set(part) - known):
        raise ValueError(f"unknown key {unknown[0]!r} in a report's {name}; known: {', '.join(sorted(known))}")


def _text(text: str | None) -> str:
    return "".join(f"<p>{html.escape(paragraph)}</p>" for paragraph in (text or "").split("\n\n") if paragraph)


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool | str) and hasattr(value, "__float__")


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not _is_number(value):
        return html.escape(str(value))
    number = float(value)
    if not math.isfinite(number):
        return "–"
    return f"{number:,.0f}" if number == round(number) and not isinstance(value, float) else f"{number:.4g}"


def _row(tag: str, cells: Iterable[Any], numeric: list[bool]) -> str:
    classes = (' class="number"' if is_number else "" for is_number in numeric)
    cells = (f"<{tag}{kind}>{_cell(value)}</{tag}>" for kind, value in zip(classes, cells, strict=True))
    return f"<tr>{''.join(cells)}</tr>"


def _table(table: Mapping[str, Any]) -> str:
    _check(table, "table", {"columns", "rows"})
    columns, rows = list(table["columns"]), [list(row) for row in table["rows"]]
    numeric = [bool(rows) and all(row[i] is None or _is_number(row[i]) for row in rows) for i in range(len(columns))]
    lines = "\n".join(_row("td", row, numeric) for row in rows)
    return f'<div class="wide"><table>\n{_row("th", columns, numeric)}\n{lines}\n</table></div>'


def _figure(figure: Mapping[str, Any]) -> str:
    _check(figure, "figure", {"png", "caption"})
    caption = html.escape(str(figure.get("caption", "")))
    data = base64.b64encode(figure["png"]).decode("ascii")
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
