"""Tables of a bounded size: of long ones, the first and the last rows are shown."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import size_text
from kennfeld.base.markup import Child, Html, element, full_decimal
from kennfeld.notebook.pictures import Rgb, colour_scale, css, ink_on

MAX_ROWS = 20
MAX_COLUMNS = 16
GAP = "…"
_CELL = "padding:2px 8px;white-space:nowrap;"
_SMALL = "font-size:90%;opacity:.75;margin:2px 0"


def shown(count: int, most: int) -> list[int | None]:
    """Return the numbers of the rows to show, None for those that are left out.

    >>> shown(3, 4), shown(9, 4)
    ([0, 1, 2], [0, 1, None, 7, 8])
    """
    if count <= most:
        return list(range(count))
    # of an odd number, one more at the beginning
    first = -(-most // 2)
    return [*range(first), None, *range(count - (most - first), count)]


def caption(text: str) -> Html:
    """Return a line in small letters."""
    return element("div", text, style=_SMALL)


def block(title: Child, *children: Child) -> Html:
    """Return a value with its title."""
    return element("div", element("div", title, style="margin:4px 0"), *children, class_="kennfeld")


def text_table(heading: Sequence[str], rows: Sequence[Sequence[Child]], words: int = 1) -> Html:
    """Return a table with a heading; the first `words` columns hold text, the others numbers."""
    head = element("tr", [_head(name, "left" if i < words else "right") for i, name in enumerate(heading)])
    body = []
    for number in shown(len(rows), MAX_ROWS):
        row = [GAP] * len(heading) if number is None else rows[number]
        body.append(element("tr", [_cell(cell, "left" if i < words else "right") for i, cell in enumerate(row)]))
    table = element("table", element("thead", head), element("tbody", body), style="border-collapse:collapse")
    more = len(rows) - MAX_ROWS
    return Html(_scroll(table) + (caption(f"{more} of {len(rows)} rows are not shown") if more > 0 else ""))


def number_table(values: Float, rows: Sequence[str], columns: Sequence[str], corner: str) -> Html:
    """Show numbers on colours of their height, abbreviated if there are many.

    Args:
        values: Float[rows, columns].
        rows: a title for each row.
        columns: a title for each column.
        corner: title of the column of row titles.
    """
    colour = colour_scale(values)
    across, down = shown(values.shape[1], MAX_COLUMNS), shown(values.shape[0], MAX_ROWS)
    head = element("tr", _head(corner, "left"), [_head(GAP if j is None else columns[j], "right") for j in across])
    body = []
    for i in down:
        title = _head(GAP if i is None else rows[i], "right")
        numbers = [_number(None if i is None or j is None else float(values[i, j]), colour) for j in across]
        body.append(element("tr", title, numbers))
    table = element("table", element("thead", head), element("tbody", body), style="border-collapse:collapse")
    whole = None not in across and None not in down
    return Html(_scroll(table) + ("" if whole else caption(f"abbreviated: {size_text(values.shape)} values")))


def _number(value: float | None, colour: Callable[[float], Rgb]) -> Html:
    if value is None:
        return _cell(GAP, "right")
    if not np.isfinite(value):
        return _cell(full_decimal(value), "right")
    paper = colour(value)
    return _cell(f"{value:.5g}", "right", f"background:{css(paper)};color:{ink_on(paper)};")


def _head(text: str, side: str) -> Html:
    return element("th", text, style=f"{_CELL}text-align:{side}")


def _cell(content: Child, side: str, style: str = "") -> Html:
    return element("td", content, style=f"{_CELL}text-align:{side};{style}")


def _scroll(table: Html) -> Html:
    return element("div", table, style="overflow-x:auto;max-width:100%")


def lines(texts: Iterable[str]) -> Html:
    """Return a list of sentences."""
    return element("ul", [element("li", text) for text in texts], style="margin:4px 0")
