"""Record layouts, conversions and tables, parsed from their A2L blocks."""

import re

from kennfeld.calfiles.a2l.objects import Component, CompuMethod, CompuTab, CompuVtab, RecordLayout
from kennfeld.calfiles.a2l.syntax import A2lBlock, A2lError, Cursor, is_text, parse_number

# FNC_VALUES, IDENTIFICATION and RESERVED have no direction, all others must have one
_KEYWORD = re.compile(
    r"(FNC_VALUES|IDENTIFICATION|RESERVED"
    r"|(?:AXIS_PTS|AXIS_RESCALE|NO_AXIS_PTS|NO_RESCALE|SRC_ADDR|RIP_ADDR|SHIFT_OP|OFFSET|DIST_OP)(?=_[WXYZ45]$))"
    r"(?:_([WXYZ45]))?"
)
_FIXED = re.compile(r"FIX_NO_AXIS_PTS_([XYZ45])")
_ALIGNMENT = re.compile(r"ALIGNMENT_(BYTE|WORD|LONG|INT64|FLOAT16_IEEE|FLOAT32_IEEE|FLOAT64_IEEE)")
_FLAGS = ("STATIC_RECORD_LAYOUT", "STATIC_ADDRESS_OFFSETS")
_MAX_PARTS = 1000  # parts

_METHOD_OPTIONS = {"COEFFS": 6, "COEFFS_LINEAR": 2, "COMPU_TAB_REF": 1, "REF_UNIT": 1, "STATUS_STRING_REF": 1}
_MAX_ROWS = 100_000  # of a conversion table


def parse_record_layout(block: A2lBlock) -> RecordLayout:
    """Return a RECORD_LAYOUT with its parts in the order of their positions. Raises `A2lError`."""
    cursor = Cursor(block)
    name = cursor.word("name")
    components: list[Component] = []
    fixed: dict[str, int] = {}
    alignments: dict[str, int] = {}
    flags: list[str] = []
    unknown: list[str] = []
    while cursor.left():
        is_word = not is_text(cursor.tokens[cursor.at])
        keyword = cursor.word("keyword")
        if is_word and (match := _KEYWORD.fullmatch(keyword)):
            components.append(_parse_component(cursor, match[1], match[2] or ""))
        elif is_word and (match := _FIXED.fullmatch(keyword)):
            fixed[match[1]] = cursor.whole(keyword)
        elif is_word and (match := _ALIGNMENT.fullmatch(keyword)):
            alignments[match[1]] = cursor.whole(keyword)
            if not 1 <= alignments[match[1]] <= 64:
                raise A2lError(f"has {keyword} {alignments[match[1]]}, which must be 1 to 64 bytes")
        elif is_word and keyword in _FLAGS:
            flags.append(keyword)
        else:
            unknown.append(keyword[:40])
        if len(components) + len(unknown) > _MAX_PARTS:
            raise A2lError(f"has more than {_MAX_PARTS} parts")
    # the positions count, in whichever order a file lists them
    ordered = tuple(sorted(components, key=lambda component: component.position))
    return RecordLayout(name, ordered, fixed, alignments, _FLAGS[0] in flags, _FLAGS[1] in flags, tuple(unknown))


def _parse_component(cursor: Cursor, kind: str, direction: str) -> Component:
    position, data_type = cursor.whole("position"), cursor.word("data type")
    mode, addressing, pairs = "", "DIRECT", 0
    if kind == "AXIS_RESCALE":
        pairs = cursor.whole("number of pairs")
    if kind in ("FNC_VALUES", "AXIS_PTS", "AXIS_RESCALE"):
        mode, addressing = cursor.word("index mode"), cursor.word("addressing")
    return Component(kind, direction, position, data_type, mode, addressing, pairs)


def parse_compu_method(block: A2lBlock) -> CompuMethod:
    """Return a COMPU_METHOD. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, kind = cursor.word("name"), cursor.text("description"), cursor.word("kind")
    cursor.text("format")
    unit = cursor.text("unit")
    options = cursor.options(_METHOD_OPTIONS)
    words = options.get("COEFFS_LINEAR" if kind == "LINEAR" else "COEFFS", [])
    coeffs = tuple(value for word in words if (value := parse_number(word)) is not None and abs(value) <= 1e300)
    count = {"LINEAR": 2, "RAT_FUNC": 6}.get(kind, len(words))
    # words that are not finite numbers are missing among the coefficients
    if not len(coeffs) == len(words) == count:
        raise A2lError(f"is {kind} without {count} finite coefficients")
    formulas = [_parse_formula_block(inner) for inner in block.inner("FORMULA")]
    forwards, inverse = formulas[0] if formulas else ("", "")
    return CompuMethod(name, kind, unit.strip(), coeffs, options.get("COMPU_TAB_REF", [""])[0], forwards, inverse)


def _parse_formula_block(block: A2lBlock) -> tuple[str, str]:
    cursor = Cursor(block)
    return cursor.text("formula"), cursor.options({"FORMULA_INV": 1}).get("FORMULA_INV", [""])[0]


def parse_compu_tab(block: A2lBlock) -> CompuTab:
    """Return a COMPU_TAB, its pairs by rising raw numbers. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, _ = cursor.word("name"), cursor.text("description"), cursor.word("kind")
    pairs = sorted((cursor.number("raw number"), cursor.number("number")) for _ in _rows(cursor, 2))
    options = cursor.options({"DEFAULT_VALUE": 1, "DEFAULT_VALUE_NUMERIC": 1})
    # DEFAULT_VALUE is a text here
    default = parse_number(options.get("DEFAULT_VALUE_NUMERIC", [""])[0])
    return CompuTab(name, tuple(raw for raw, _ in pairs), tuple(number for _, number in pairs), default)


def parse_compu_vtab(block: A2lBlock) -> CompuVtab:
    """Return a COMPU_VTAB, a word for each raw number, or a COMPU_VTAB_RANGE, for ranges of them. Raises `A2lError`."""
    has_ranges = block.keyword == "COMPU_VTAB_RANGE"
    cursor = Cursor(block)
    name, _ = cursor.word("name"), cursor.text("description")
    if not has_ranges:
        cursor.word("kind")
    rows = []
    for _ in _rows(cursor, 3 if has_ranges else 2):
        least = cursor.number("least number" if has_ranges else "raw number")
        rows.append((least, cursor.number("largest number") if has_ranges else least, cursor.word("text")))
    default = cursor.options({"DEFAULT_VALUE": 1}).get("DEFAULT_VALUE", [None])[0] or None
    return CompuVtab(name, tuple(rows), default)


def _rows(cursor: Cursor, width: int) -> range:
    count = cursor.whole("size")
    # checked before any row is read, as a damaged count may be any number
    if not 0 <= count <= _MAX_ROWS or count * width > cursor.left():
        raise A2lError(f"states {count} rows, but has fewer")
    return range(count)
