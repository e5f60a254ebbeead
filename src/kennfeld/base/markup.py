"""HTML elements with escaped text, and number formats of reports and notebooks."""

import html
import math
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import visible

MISSING = "–"

Child: TypeAlias = "str | Iterable[Child] | None"

_VOID = frozenset({"meta", "br", "input"})


def round_digits(values: Any, digits: int = 5) -> list[Any]:
    """Round numbers to significant digits, as nested lists with None for NaN and infinity.

    >>> round_digits([1 / 3, float("nan"), 123456.7])
    [0.33333, None, 123460.0]
    >>> round_digits(float("nan")) is None
    True
    """
    numbers: Float = np.asarray(values, dtype=np.float64)
    known = np.isfinite(numbers)
    size = np.abs(np.where(known & (numbers != 0), numbers, 1.0))
    power = digits - 1 - np.floor(np.log10(size))
    # one of them is 1, as powers of ten below 1 are not exact
    up, down = 10.0 ** np.clip(power, 0, 300), 10.0 ** np.clip(-power, 0, 300)
    result = np.round(np.where(known, numbers, 0.0) / down * up) / up * down
    if known.all():
        return result.tolist()  # type: ignore[no-any-return]
    listed = np.array(result, dtype=object)
    listed[~known] = None
    return listed.tolist()  # type: ignore[no-any-return]


def decimal(value: float | None, digits: int = 4) -> str:
    """Format a number with significant digits.

    >>> decimal(76.38123), decimal(123456.7), decimal(0.00001234), decimal(float("nan")), decimal(2812)
    ('76.38', '123457', '1.234e-05', '–', '2812')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0 or 1e-4 <= abs(value) < 1e7:
        whole = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
        text = f"{value:.{max(whole, 0)}f}"
        return text if float(value) != int(value) or "." not in text else f"{int(value)}"
    return f"{value:.{digits - 1}e}"


def full_decimal(value: float | None) -> str:
    """Format a recorded number, without trailing zeros.

    >>> full_decimal(2554.1), full_decimal(48.0)
    ('2554.1', '48')
    """
    if value is not None and math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return MISSING if value is None or math.isnan(value) else f"{value:.7g}"


def quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """Format a number with its unit: `1.83 Nm`."""
    plain = "" if unit in ("", "-", "1") else f" {unit}"
    return decimal(value, digits) + plain


def percent(share: float | None) -> str:
    """Format a share in percent.

    >>> percent(0.9761), percent(0.9989), percent(0.0034), percent(float("inf"))
    ('98 %', '99.9 %', '0.34 %', '–')
    """
    if share is None or not math.isfinite(share):
        return MISSING
    value = 100 * share
    if 99 <= abs(value) < 100:
        return f"{math.copysign(min(abs(value), 99.9), value):.1f} %"  # never 100 % of an incomplete share
    return f"{value:.0f} %" if abs(value) >= 9.95 or value == 0 else f"{value:.2g} %"


def change(before: float, after: float) -> str:
    """Format the change of an error in percent, with its sign.

    >>> change(2.0, 1.0), change(2.0, 3.0), change(0.0, 1.0)
    ('-50 %', '+50 %', '–')
    """
    if not (math.isfinite(before) and before > 0):
        return MISSING
    text = percent(after / before - 1.0)
    return text if text.startswith(("-", MISSING)) else f"+{text}"


class Html(str):
    """Markup, which is not escaped again."""

    __slots__ = ()


def element(tag: str, /, *children: Child, **attributes: str | float | bool | None) -> Html:
    r"""Return an element; `class_` is written `class`, `data_x` is `data-x`, None omits a child or an attribute.

    Characters that cannot be seen are escaped as on a terminal: HTML allows no control characters.

    >>> element("b", "Speed\x1b")
    '<b>Speed\\u001b</b>'
    >>> element("p", "a < b", class_="note")
    '<p class="note">a &lt; b</p>'
    """
    start = tag
    for key, value in attributes.items():
        if value is not None and value is not False:
            start += f" {key.rstrip('_').replace('_', '-')}"
            start += "" if value is True else f'="{_text(str(value))}"'
    return Html(f"<{start}>" if tag in _VOID else f"<{start}>{_escape(children)}</{tag}>")


def _escape(child: Child) -> str:
    if child is None or isinstance(child, Html):
        return child or ""
    return _text(child) if isinstance(child, str) else "".join(map(_escape, child))


def _text(text: str) -> str:
    return html.escape(visible(text))


def note(text: str) -> Html:
    """Return an explanatory paragraph."""
    return element("p", text, class_="note")


def table(heading: Iterable[str], rows: Iterable[Iterable[str]], *, words: int = 1, class_: str | None = None) -> Html:
    """Return a table; the first `words` columns hold text, the others numbers."""
    head = element("thead", _row("th", heading, words))
    body = element("tbody", [_row("td", row, words) for row in rows])
    return element("div", element("table", head, body, class_=class_), class_="scroll")


def _row(tag: str, cells: Iterable[str], words: int) -> Html:
    return element("tr", [element(tag, cell, class_=None if i < words else "number") for i, cell in enumerate(cells)])


def details(summary: Child, *children: Child, open_: bool = False, **more: str) -> Html:
    """Return a collapsible part."""
    inner = element("div", *children, class_="inner")
    return element("details", element("summary", summary), inner, open=open_, **more)
