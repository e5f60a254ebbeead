"""Record layouts, conversions, tables and instances of types, parsed from their A2L blocks.

An instance (ASAP2 1.70 and 1.71) of a characteristic type is a label; of a structure, one label for each component,
joined by dots. An array of scalars is a value block; another array is one label per element: `name[0]`, `name[1][2]`.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any

from kennfeld.calfiles.a2l.objects import (
    AxisDescr,
    AxisPts,
    Characteristic,
    Component,
    CompuMethod,
    CompuTab,
    CompuVtab,
    RecordLayout,
)
from kennfeld.calfiles.a2l.syntax import A2lBlock, A2lError, Cursor, is_text, parse_integer, parse_number
from kennfeld.calfiles.format import Findings

_KEYWORD = re.compile(
    r"(FNC_VALUES|IDENTIFICATION|RESERVED"
    r"|(?:AXIS_PTS|AXIS_RESCALE|NO_AXIS_PTS|NO_RESCALE|SRC_ADDR|RIP_ADDR|SHIFT_OP|OFFSET|DIST_OP)(?=_[WXYZ45]$))"
    r"(?:_([WXYZ45]))?"
)
_FIXED = re.compile(r"FIX_NO_AXIS_PTS_([XYZ45])")
_ALIGNMENT = re.compile(r"ALIGNMENT_(BYTE|WORD|LONG|INT64|FLOAT16_IEEE|FLOAT32_IEEE|FLOAT64_IEEE)")
_FLAGS = ("STATIC_RECORD_LAYOUT", "STATIC_ADDRESS_OFFSETS")
_MAX_PARTS = 1000  # parts

_OPTIONS = {
    "DISPLAY_IDENTIFIER": 1,
    "ADDRESS_TYPE": 1,
    "CALIBRATION_ACCESS": 1,
    "ECU_ADDRESS_EXTENSION": 1,
    "LAYOUT": 1,
    "MATRIX_DIM": -1,
    "MAX_REFRESH": 2,
    "MODEL_LINK": 1,
    "READ_ONLY": 0,
    "READ_WRITE": 0,
    "SYMBOL_LINK": 2,
    "SYMBOL_TYPE_LINK": 1,
}
_MAX_NESTING = 16  # structures within each other
_MAX_INSTANCES = 100_000  # labels made of instances

_OF_METHOD = {
    "COEFFS": 6,
    "COEFFS_LINEAR": 2,
    "COMPU_TAB_REF": 1,
    "REF_UNIT": 1,
    "STATUS_STRING_REF": 1,
}
_MAX_ROWS = 100_000  # of a conversion table


def record_layout(block: A2lBlock) -> RecordLayout:
    """Return a RECORD_LAYOUT with its parts in the order of their positions. Raises `A2lError`."""
    cursor = Cursor(block)
    name = cursor.word("name")
    components: list[Component] = []
    fixed: dict[str, int] = {}
    alignments: dict[str, int] = {}
    flags: list[str] = []
    unknown: list[str] = []
    while cursor.left():
        text = is_text(cursor.tokens[cursor.at])
        keyword = cursor.word("keyword")
        if text:
            unknown.append(keyword[:40])
        elif match := _KEYWORD.fullmatch(keyword):
            components.append(_parse_component(cursor, match[1], match[2] or ""))
        elif match := _FIXED.fullmatch(keyword):
            fixed[match[1]] = cursor.whole(keyword)
        elif match := _ALIGNMENT.fullmatch(keyword):
            alignments[match[1]] = _parse_alignment(cursor, keyword)
        elif keyword in _FLAGS:
            flags.append(keyword)
        else:
            unknown.append(keyword[:40])
        if len(components) + len(unknown) > _MAX_PARTS:
            raise A2lError(f"has more than {_MAX_PARTS} parts")
    ordered = tuple(sorted(components, key=lambda component: component.position))
    return RecordLayout(name, ordered, fixed, alignments, _FLAGS[0] in flags, _FLAGS[1] in flags, tuple(unknown))


def _parse_alignment(cursor: Cursor, keyword: str) -> int:
    border = cursor.whole(keyword)
    if not 1 <= border <= 64:
        raise A2lError(f"has {keyword} {border}, which must be 1 to 64 bytes")
    return border


def _parse_component(cursor: Cursor, kind: str, direction: str) -> Component:
    position, data_type = cursor.whole("position"), cursor.word("data type")
    mode, addressing, pairs = "", "DIRECT", 0
    if kind == "AXIS_RESCALE":
        pairs = cursor.whole("number of pairs")
    if kind in ("FNC_VALUES", "AXIS_PTS", "AXIS_RESCALE"):
        mode, addressing = cursor.word("index mode"), cursor.word("addressing")
    return Component(kind, direction, position, data_type, mode, addressing, pairs)


@dataclass(frozen=True)
class _TypeUse:
    """A type used by an instance, or by a component of a structure."""

    name: str
    type: str
    address: int
    description: str
    sizes: tuple[int, ...]
    display: str
    read_only: bool
    line: int


@dataclass(frozen=True)
class _Structure:
    size: int
    components: tuple[_TypeUse, ...]


class Instances:
    """The instances of a module."""

    def __init__(
        self,
        module: A2lBlock,
        findings: Findings,
        characteristic: Callable[[A2lBlock], Characteristic],
        axis: Callable[[A2lBlock], AxisPts],
        functions: Mapping[str, Sequence[str]],
    ) -> None:
        self.module, self.findings, self.functions = module, findings, functions
        self.characteristics = self._types("TYPEDEF_CHARACTERISTIC", characteristic)
        self.axes = self._types("TYPEDEF_AXIS", axis)
        self.structures = self._types("TYPEDEF_STRUCTURE", _parse_structure)
        self.measured = {_name(block) for block in module.inner("TYPEDEF_MEASUREMENT")}
        self.blobs = {_name(block) for block in module.inner("TYPEDEF_BLOB")}
        self.made: dict[str, Characteristic] = {}
        self.made_axes: dict[str, AxisPts] = {}

    def expanded(self) -> tuple[dict[str, Characteristic], dict[str, AxisPts]]:
        """Return the labels and breakpoints of all instances; unsupported ones are skipped with a warning."""
        for block in self.module.inner("INSTANCE"):
            try:
                if any(block.inner("OVERWRITE")):
                    raise A2lError("overwrites parts of its type, which is not supported")
                self._expand(_parse_type_use(block, absolute=True), 0, "")
            except A2lError as error:
                self.findings.warning(block.line, _name(block), f"INSTANCE {error}; skipped")
        return self.made, self.made_axes

    def _types(self, keyword: str, make: Callable[[A2lBlock], object]) -> dict[str, object]:
        result: dict[str, object] = {}
        for block in self.module.inner(keyword):
            try:
                result.setdefault(_name(block), make(block))
            except A2lError as error:
                self.findings.warning(block.line, _name(block), f"{keyword} {error}; skipped")
        return result

    def _expand(self, use: _TypeUse, depth: int, outer: str) -> None:
        if depth > _MAX_NESTING:
            raise A2lError(f"has structures nested more than {_MAX_NESTING} levels deep")
        if use.type in self.measured | self.blobs:
            return  # nothing to calibrate
        result = self.characteristics.get(use.type)
        if isinstance(result, Characteristic) and result.type == "VALUE" and use.sizes:
            self._take(replace(result, type="VAL_BLK", matrix_dim=use.sizes), use, outer)
            return
        for element in self._elements(use):
            self._expand_one(element, depth, outer)

    def _expand_one(self, use: _TypeUse, depth: int, outer: str) -> None:
        found = self.characteristics.get(use.type) or self.axes.get(use.type) or self.structures.get(use.type)
        if isinstance(found, Characteristic | AxisPts):
            self._take(found, use, outer)
        elif isinstance(found, _Structure):
            for inner in found.components:
                name, address = f"{use.name}.{inner.name}", use.address + inner.address
                read_only = inner.read_only or use.read_only
                self._expand(replace(inner, name=name, address=address, read_only=read_only), depth + 1, use.name)
        else:
            raise A2lError(f"is of the type {use.type[:60]}, which is not defined")

    def _elements(self, use: _TypeUse) -> Iterator[_TypeUse]:
        """Yield the element of each index, the first one running fastest; the instance itself if it is no array."""
        if not use.sizes:
            yield use
            return
        if prod(use.sizes) > _MAX_INSTANCES:
            raise A2lError(f"has {prod(use.sizes)} elements, more than {_MAX_INSTANCES}")
        step = self._stride(use.type)
        for at, index in enumerate(product(*(range(size) for size in reversed(use.sizes)))):
            subscript = "".join(f"[{i}]" for i in index)
            yield replace(use, name=use.name + subscript, address=use.address + at * step, sizes=())

    def _stride(self, name: str) -> int:
        found = self.structures.get(name)
        if isinstance(found, _Structure):
            return found.size
        result = self.characteristics.get(name)
        if isinstance(result, Characteristic) and result.type == "ASCII":
            return max(1, *result.shape, 1)
        raise A2lError(f"is an array of {name[:60]}, whose element size is not stated")

    def _take(self, made: Characteristic | AxisPts, use: _TypeUse, outer: str) -> None:
        if len(self.made) + len(self.made_axes) >= _MAX_INSTANCES:
            raise A2lError(f"defines more than {_MAX_INSTANCES} labels")
        if use.name in self.made or use.name in self.made_axes:
            raise A2lError(f"defines the label {use.name[:80]} twice")
        functions = self.functions.get(use.name, ())
        common: dict[str, Any] = {
            "name": use.name,
            "address": use.address,
            "description": use.description or made.description,
            "display_identifier": use.display,
            "read_only": made.read_only or use.read_only,
            "functions": tuple(functions),
            "line": use.line,
        }
        if isinstance(made, AxisPts):
            self.made_axes[use.name] = replace(made, **common)
        else:
            self.made[use.name] = replace(
                made, axes=tuple(_resolve_references(axis, outer) for axis in made.axes), **common
            )


def _resolve_references(axis: AxisDescr, outer: str) -> AxisDescr:
    """Return the axis with references to components of the same structure (THIS.name) turned into labels."""

    def label(name: str) -> str:
        return f"{outer}.{name.removeprefix('THIS.')}" if name.startswith("THIS.") and outer else name

    return replace(axis, axis_pts_ref=label(axis.axis_pts_ref), curve_axis_ref=label(axis.curve_axis_ref))


def _name(block: A2lBlock) -> str:
    return (block.tokens[0] if block.tokens else block.keyword)[:120]


def _parse_type_use(block: A2lBlock, *, absolute: bool) -> _TypeUse:
    """Return an INSTANCE, or a STRUCTURE_COMPONENT, which has an offset for its address and no description."""
    cursor = Cursor(block)
    name = cursor.word("name")
    description = cursor.text("description") if absolute else ""
    kind, address = cursor.word("type"), cursor.whole("address")
    options = cursor.options(_OPTIONS)
    sizes = tuple(size or 1 for word in options.get("MATRIX_DIM", []) if (size := parse_integer(word)) is not None)
    if any(size < 0 for size in sizes) or len(sizes) > 5:
        raise A2lError("has an invalid MATRIX_DIM")
    if options.get("ADDRESS_TYPE", ["DIRECT"]) != ["DIRECT"]:
        raise A2lError("is accessed through a pointer, which an image does not resolve")
    display = options.get("DISPLAY_IDENTIFIER", [""])[0]
    read_only = "READ_ONLY" in options
    return _TypeUse(name, kind, address, description, sizes, display, read_only, block.line)


def _parse_structure(block: A2lBlock) -> _Structure:
    cursor = Cursor(block)
    cursor.word("name")
    cursor.text("description")
    size = cursor.whole("size")
    return _Structure(
        size, tuple(_parse_type_use(inner, absolute=False) for inner in block.inner("STRUCTURE_COMPONENT"))
    )


def compu_method(block: A2lBlock) -> CompuMethod:
    """Return a COMPU_METHOD. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, kind = cursor.word("name"), cursor.text("description"), cursor.word("kind")
    cursor.text("format")
    unit = cursor.text("unit")
    options = cursor.options(_OF_METHOD)
    coeffs = [parse_number(word) for word in options.get("COEFFS_LINEAR" if kind == "LINEAR" else "COEFFS", [])]
    wanted = {"LINEAR": 2, "RAT_FUNC": 6}.get(kind, len(coeffs))
    if len(coeffs) != wanted or any(value is None or abs(value) > 1e300 for value in coeffs):
        raise A2lError(f"is {kind} without {wanted} finite coefficients")
    formulas = [_parse_formula_block(inner) for inner in block.inner("FORMULA")]
    forwards, inverse = formulas[0] if formulas else ("", "")
    table = options.get("COMPU_TAB_REF", [""])[0]
    found = tuple(value for value in coeffs if value is not None)
    return CompuMethod(name, kind, unit.strip(), found, table, forwards, inverse, block.line)


def _parse_formula_block(block: A2lBlock) -> tuple[str, str]:
    cursor = Cursor(block)
    return cursor.text("formula"), cursor.options({"FORMULA_INV": 1}).get("FORMULA_INV", [""])[0]


def compu_tab(block: A2lBlock) -> CompuTab:
    """Return a COMPU_TAB, its pairs by rising raw numbers. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, _, count = cursor.word("name"), cursor.text("description"), cursor.word("kind"), cursor.whole("size")
    pairs = [(cursor.number("raw number"), cursor.number("number")) for _ in _rows(count, cursor, 2)]
    options = cursor.options({"DEFAULT_VALUE": 1, "DEFAULT_VALUE_NUMERIC": 1})
    default = next((parse_number(given[0]) for key, given in options.items() if key == "DEFAULT_VALUE_NUMERIC"), None)
    pairs.sort()
    return CompuTab(name, tuple(one for one, _ in pairs), tuple(other for _, other in pairs), default)


def compu_vtab(block: A2lBlock) -> CompuVtab:
    """Return a COMPU_VTAB: a word for each of some raw numbers. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, _, count = cursor.word("name"), cursor.text("description"), cursor.word("kind"), cursor.whole("size")
    pairs = [(cursor.number("raw number"), cursor.word("text")) for _ in _rows(count, cursor, 2)]
    return CompuVtab(name, tuple((raw, raw, text) for raw, text in pairs), _default_text(cursor))


def compu_vtab_range(block: A2lBlock) -> CompuVtab:
    """Return a COMPU_VTAB_RANGE: words for ranges of raw numbers. Raises `A2lError`."""
    cursor = Cursor(block)
    name, _, count = cursor.word("name"), cursor.text("description"), cursor.whole("size")
    rows = [
        (cursor.number("least number"), cursor.number("largest number"), cursor.word("text"))
        for _ in _rows(count, cursor, 3)
    ]
    return CompuVtab(name, tuple(rows), _default_text(cursor))


def _rows(count: int, cursor: Cursor, width: int) -> Iterator[int]:
    if not 0 <= count <= _MAX_ROWS or count * width > cursor.left():
        raise A2lError(f"states {count} rows, but has fewer")
    return iter(range(count))


def _default_text(cursor: Cursor) -> str | None:
    return cursor.options({"DEFAULT_VALUE": 1}).get("DEFAULT_VALUE", [None])[0] or None
