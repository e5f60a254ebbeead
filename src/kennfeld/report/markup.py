"""HTML as values: text is escaped where it enters, so that no name of a channel or a file can become markup."""

import html
from collections.abc import Iterable
from typing import TypeAlias

__all__ = ["Child", "Html", "details", "element", "table"]

Child: TypeAlias = "str | Iterable[Child] | None"

_VOID = frozenset({"meta", "br", "input"})


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


def element(tag: str, /, *children: Child, **attributes: str | int | bool | None) -> Html:
    """An element; `class_` stands for `class`, `data_x` for `data-x`, and None leaves a child or an attribute out.

    >>> element("p", "a < b", class_="note")
    '<p class="note">a &lt; b</p>'
    """
    given = "".join(_attribute(key, value) for key, value in attributes.items() if value not in (None, False))
    inside = "".join(_flat(children))
    return Html(f"<{tag}{given}>" if tag in _VOID else f"<{tag}{given}>{inside}</{tag}>")


def _attribute(key: str, value: str | int | bool | None) -> str:
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{html.escape(str(value))}"'


def _flat(children: Iterable[Child]) -> Iterable[str]:
    for child in children:
        if child is None:
            continue
        if isinstance(child, Html):
            yield child
        elif isinstance(child, str):
            yield html.escape(child)
        else:
            yield from _flat(child)


def table(heading: Iterable[str], rows: Iterable[Iterable[str]], *, words: int = 1, class_: str | None = None) -> Html:
    """A table; the first `words` columns hold words, the others numbers."""
    head = element(
        "tr", [element("th", cell, class_=None if i < words else "number") for i, cell in enumerate(heading)]
    )
    body = [
        element("tr", [element("td", cell, class_=None if i < words else "number") for i, cell in enumerate(row)])
        for row in rows
    ]
    whole = element("table", element("thead", head), element("tbody", body), class_=class_)
    return element("div", whole, class_="scroll")


def details(summary: Child, *children: Child, open_: bool = False, **more: str) -> Html:
    """A part that can be folded away."""
    return element(
        "details", element("summary", summary), element("div", *children, class_="inner"), open=open_, **more
    )
