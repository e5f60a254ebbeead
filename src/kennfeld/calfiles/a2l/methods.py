"""Conversions and their tables, as their blocks state them."""

from collections.abc import Iterator

from kennfeld.calfiles.a2l.blocks import Block
from kennfeld.calfiles.a2l.cursor import Cursor, UnusableError, number
from kennfeld.calfiles.a2l.objects import CompuMethod, CompuTab, CompuVtab

__all__ = ["compu_method", "compu_tab", "compu_vtab", "compu_vtab_range"]

_OF_METHOD = {
    "COEFFS": 6,
    "COEFFS_LINEAR": 2,
    "COMPU_TAB_REF": 1,
    "REF_UNIT": 1,
    "STATUS_STRING_REF": 1,
}
_MOST_ROWS = 100_000  # of a conversion table


def compu_method(block: Block) -> CompuMethod:
    """A COMPU_METHOD. Raises `UnusableError`."""
    cursor = Cursor(block)
    name, _, kind = cursor.word("name"), cursor.text("description"), cursor.word("kind")
    cursor.text("format")
    unit = cursor.text("unit")
    options = cursor.options(_OF_METHOD)
    coeffs = [number(word) for word in options.get("COEFFS_LINEAR" if kind == "LINEAR" else "COEFFS", [])]
    wanted = {"LINEAR": 2, "RAT_FUNC": 6}.get(kind, len(coeffs))
    if len(coeffs) != wanted or any(value is None or abs(value) > 1e300 for value in coeffs):
        raise UnusableError(f"is {kind} without {wanted} finite coefficients")
    formulas = [_formula(inner) for inner in block.inner("FORMULA")]
    forwards, inverse = formulas[0] if formulas else ("", "")
    table = options.get("COMPU_TAB_REF", [""])[0]
    found = tuple(value for value in coeffs if value is not None)
    return CompuMethod(name, kind, unit.strip(), found, table, forwards, inverse, block.line)


def _formula(block: Block) -> tuple[str, str]:
    cursor = Cursor(block)
    return cursor.text("formula"), cursor.options({"FORMULA_INV": 1}).get("FORMULA_INV", [""])[0]


def compu_tab(block: Block) -> CompuTab:
    """A COMPU_TAB, its pairs by rising raw numbers. Raises `UnusableError`."""
    cursor = Cursor(block)
    name, _, _, count = cursor.word("name"), cursor.text("description"), cursor.word("kind"), cursor.whole("size")
    pairs = [(cursor.number("raw number"), cursor.number("number")) for _ in _rows(count, cursor, 2)]
    options = cursor.options({"DEFAULT_VALUE": 1, "DEFAULT_VALUE_NUMERIC": 1})
    default = next((number(given[0]) for key, given in options.items() if key == "DEFAULT_VALUE_NUMERIC"), None)
    pairs.sort()
    return CompuTab(name, tuple(one for one, _ in pairs), tuple(other for _, other in pairs), default)


def compu_vtab(block: Block) -> CompuVtab:
    """A COMPU_VTAB: a word for each of some raw numbers. Raises `UnusableError`."""
    cursor = Cursor(block)
    name, _, _, count = cursor.word("name"), cursor.text("description"), cursor.word("kind"), cursor.whole("size")
    pairs = [(cursor.number("raw number"), cursor.word("text")) for _ in _rows(count, cursor, 2)]
    return CompuVtab(name, tuple((raw, raw, text) for raw, text in pairs), _default(cursor))


def compu_vtab_range(block: Block) -> CompuVtab:
    """A COMPU_VTAB_RANGE: words for ranges of raw numbers. Raises `UnusableError`."""
    cursor = Cursor(block)
    name, _, count = cursor.word("name"), cursor.text("description"), cursor.whole("size")
    rows = [
        (cursor.number("least number"), cursor.number("largest number"), cursor.word("text"))
        for _ in _rows(count, cursor, 3)
    ]
    return CompuVtab(name, tuple(rows), _default(cursor))


def _rows(count: int, cursor: Cursor, width: int) -> Iterator[int]:
    if not 0 <= count <= _MOST_ROWS or count * width > cursor.left():
        raise UnusableError(f"states {count} rows, which are not there")
    return iter(range(count))


def _default(cursor: Cursor) -> str | None:
    return cursor.options({"DEFAULT_VALUE": 1}).get("DEFAULT_VALUE", [None])[0] or None
