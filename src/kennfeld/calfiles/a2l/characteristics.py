"""Characteristics and their axes, and shared breakpoints, parsed from their A2L blocks."""

from collections.abc import Mapping
from typing import Any

from kennfeld.calfiles.a2l.objects import AxisDescr, AxisPts, Characteristic
from kennfeld.calfiles.a2l.syntax import A2lBlock, A2lError, Cursor, parse_integer, parse_number, unquote

TYPES = ("VALUE", "CURVE", "MAP", "CUBOID", "CUBE_4", "CUBE_5", "VAL_BLK", "ASCII")
AXIS_KINDS = ("STD_AXIS", "COM_AXIS", "FIX_AXIS", "RES_AXIS", "CURVE_AXIS")
_WORDS = """
BYTE_ORDER CALIBRATION_ACCESS DEPOSIT DISPLAY_IDENTIFIER ECU_ADDRESS_EXTENSION FORMAT MAX_GRAD MODEL_LINK MONOTONY
PHYS_UNIT REF_MEMORY_SEGMENT STEP_SIZE
"""
_SHARED_OPTIONS = dict.fromkeys(_WORDS.split(), 1)
_SHARED_OPTIONS |= {"EXTENDED_LIMITS": 2, "MAX_REFRESH": 2, "READ_ONLY": 0, "SYMBOL_LINK": 2}
_CHARACTERISTIC_OPTIONS = _SHARED_OPTIONS | {"MATRIX_DIM": -1}
_CHARACTERISTIC_OPTIONS |= dict.fromkeys(("BIT_MASK", "COMPARISON_QUANTITY", "ENCODING", "NUMBER"), 1)
_AXIS_OPTIONS = _SHARED_OPTIONS | {"AXIS_PTS_REF": 1, "CURVE_AXIS_REF": 1, "FIX_AXIS_PAR": 3, "FIX_AXIS_PAR_DIST": 3}

Options = Mapping[str, list[str]]


def parse_axis_pts(block: A2lBlock, *, typedef: bool = False) -> AxisPts:
    """Return an AXIS_PTS, or a TYPEDEF_AXIS: breakpoints at address 0. Raises `A2lError`."""
    cursor = Cursor(block)
    return AxisPts(
        name=cursor.word("name"),
        description=cursor.text("description"),
        address=0 if typedef else cursor.whole("address"),
        input_quantity=cursor.word("input quantity"),
        record_layout=_layout(cursor),
        conversion=cursor.word("conversion"),
        max_axis_points=cursor.whole("number of axis points"),
        **_limits(cursor),
        **_shared_attributes(cursor.options(_SHARED_OPTIONS)),
        line=block.line,
    )


def parse_characteristic(block: A2lBlock, *, typedef: bool = False) -> Characteristic:
    """Return a CHARACTERISTIC, or a TYPEDEF_CHARACTERISTIC: one at address 0. Raises `A2lError`."""
    cursor = Cursor(block)
    required: dict[str, Any] = {
        "name": cursor.word("name"),
        "description": cursor.text("description"),
        "type": _known(cursor.word("type"), TYPES, "the unknown type"),
        "address": 0 if typedef else cursor.whole("address"),
        "record_layout": _layout(cursor),
        "conversion": cursor.word("conversion"),
        **_limits(cursor),
    }
    options = cursor.options(_CHARACTERISTIC_OPTIONS)
    sizes = parse_sizes(options)
    inputs = (word for inner in block.inner("DEPENDENT_CHARACTERISTIC") for word in inner.tokens[1:])
    return Characteristic(
        **required,
        **_shared_attributes(options),
        axes=tuple(map(_parse_axis_descr, block.inner("AXIS_DESCR"))),
        number=_integer_option(options, "NUMBER") or 0,
        # ASAP2 1.6 writes three sizes, zeros and ones for what is not there
        matrix_dim=tuple(size or 1 for size in sizes) if any(sizes) else (),
        bit_mask=_integer_option(options, "BIT_MASK"),
        encoding=options.get("ENCODING", [""])[0],
        dependent_on=tuple(map(unquote, inputs)),
        virtual=any(block.inner("VIRTUAL_CHARACTERISTIC")),
        line=block.line,
    )


def _parse_axis_descr(block: A2lBlock) -> AxisDescr:
    cursor = Cursor(block)
    required: dict[str, Any] = {
        "attribute": _known(cursor.word("kind"), AXIS_KINDS, "an axis of the unknown kind"),
        "input_quantity": cursor.word("input quantity"),
        "conversion": cursor.word("conversion"),
        "max_axis_points": cursor.whole("number of axis points"),
        **_limits(cursor),
    }
    options = cursor.options(_AXIS_OPTIONS)
    cursors = map(Cursor, block.inner("FIX_AXIS_PAR_LIST"))
    return AxisDescr(
        **required,
        **_shared_attributes(options),
        axis_pts_ref=options.get("AXIS_PTS_REF", [""])[0],
        curve_axis_ref=options.get("CURVE_AXIS_REF", [""])[0],
        fixed_spacing=_fixed_spacing(options),
        fixed_points=tuple(inner.number("axis point") for inner in cursors for _ in range(inner.left())),
    )


def _known(word: str, words: tuple[str, ...], message: str) -> str:
    if word not in words:
        raise A2lError(f"has {message} {word[:40]!r}")
    return word


def _layout(cursor: Cursor) -> str:
    layout = cursor.word("record layout")
    cursor.number("largest difference")
    return layout


def _limits(cursor: Cursor) -> dict[str, Any]:
    return {"lower": cursor.number("lower limit"), "upper": cursor.number("upper limit")}


def _fixed_spacing(options: Options) -> tuple[float, float, int] | None:
    """Return offset, distance and number of the points of a fixed axis, if it states them."""
    if "FIX_AXIS_PAR" in options:
        first, second, third = options["FIX_AXIS_PAR"]
        offset, shift, count = parse_number(first), parse_integer(second), parse_integer(third)
        # a damaged shift would overflow 2^shift
        if offset is None or shift is None or count is None or not -64 <= shift <= 64:
            raise A2lError("has an invalid FIX_AXIS_PAR: must be offset, shift and number")
        # FIX_AXIS_PAR states the distance as a power of 2
        return offset, 2.0**shift, count
    if "FIX_AXIS_PAR_DIST" in options:
        first, second, third = options["FIX_AXIS_PAR_DIST"]
        offset, distance, count = parse_number(first), parse_number(second), parse_integer(third)
        if offset is None or distance is None or count is None:
            raise A2lError("has an invalid FIX_AXIS_PAR_DIST: must be offset, distance and number")
        return offset, distance, count
    return None


def _shared_attributes(options: Options) -> dict[str, Any]:
    limits = [parse_number(word) for word in options.get("EXTENDED_LIMITS", [])]
    return {
        "byte_order": options.get("BYTE_ORDER", [""])[0],
        "deposit": options.get("DEPOSIT", [""])[0],
        "phys_unit": options.get("PHYS_UNIT", [""])[0],
        "display_identifier": options.get("DISPLAY_IDENTIFIER", [""])[0],
        "extended_limits": (limits[0], limits[1]) if limits and None not in limits else None,
        "read_only": "READ_ONLY" in options or options.get("CALIBRATION_ACCESS") == ["NO_CALIBRATION"],
    }


def _integer_option(options: Options, keyword: str) -> int | None:
    if keyword not in options:
        return None
    word = options[keyword][0]
    value = parse_integer(word)
    if value is None:
        raise A2lError(f"has {word[:40]!r} after {keyword}, which must be an integer")
    return value


def parse_sizes(options: Options) -> tuple[int, ...]:
    """Return the sizes of a MATRIX_DIM. Raises `A2lError`."""
    sizes = tuple(size for word in options.get("MATRIX_DIM", []) if (size := parse_integer(word)) is not None)
    if any(size < 0 for size in sizes) or len(sizes) > 5:
        raise A2lError(f"has an invalid MATRIX_DIM: {' '.join(map(str, sizes))[:60]}")
    return sizes
