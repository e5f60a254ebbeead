"""Instances of types (ASAP2 1.70 and 1.71), expanded to labels.

An instance of a characteristic type is a label; of a structure, one label for each component, joined by dots. An array
of scalars is a value block; another array is one label per element: `name[0]`, `name[1][2]`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from math import prod
from typing import Any

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.characteristics import parse_axis_pts, parse_characteristic, parse_sizes
from kennfeld.calfiles.a2l.objects import AxisDescr, AxisPts, Characteristic
from kennfeld.calfiles.a2l.syntax import A2lBlock, A2lError, Cursor
from kennfeld.calfiles.format import FileFindings

_WORDS = "ADDRESS_TYPE CALIBRATION_ACCESS DISPLAY_IDENTIFIER ECU_ADDRESS_EXTENSION LAYOUT MODEL_LINK SYMBOL_TYPE_LINK"
_OPTIONS = dict.fromkeys(_WORDS.split(), 1)
_OPTIONS |= {"MATRIX_DIM": -1, "MAX_REFRESH": 2, "READ_ONLY": 0, "READ_WRITE": 0, "SYMBOL_LINK": 2}
_MAX_NESTING = 16  # structures within each other
_MAX_INSTANCES = 100_000  # labels made of instances


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
    """The labels and breakpoints of all instances of a module; unsupported ones are skipped with a warning."""

    def __init__(self, module: A2lBlock, findings: FileFindings, functions: Mapping[str, Sequence[str]]) -> None:
        self.functions = functions
        self.characteristics: dict[str, Characteristic] = {}
        self.axis_pts: dict[str, AxisPts] = {}
        self._types: dict[str, object] = {}
        makers: dict[str, Callable[[A2lBlock], object]] = {
            "TYPEDEF_CHARACTERISTIC": partial(parse_characteristic, typedef=True),
            "TYPEDEF_AXIS": partial(parse_axis_pts, typedef=True),
            "TYPEDEF_STRUCTURE": _parse_structure,
            "TYPEDEF_MEASUREMENT": lambda _: None,  # nothing to calibrate
            "TYPEDEF_BLOB": lambda _: None,
        }
        for keyword, make in makers.items():
            for block in module.inner(keyword):
                try:
                    self._types.setdefault(block.name, make(block))
                except A2lError as error:
                    findings.warning(block.line, block.name, f"{keyword} {error}; skipped")
        for block in module.inner("INSTANCE"):
            try:
                if any(block.inner("OVERWRITE")):
                    raise A2lError("overwrites parts of its type, which is not supported")
                self._expand(_parse_type_use(block, absolute=True), 0, "")
            except A2lError as error:
                findings.warning(block.line, block.name, f"INSTANCE {error}; skipped")

    def _expand(self, use: _TypeUse, depth: int, outer: str) -> None:
        if depth > _MAX_NESTING:
            raise A2lError(f"has structures nested more than {_MAX_NESTING} levels deep")
        if use.type not in self._types:
            raise A2lError(f"is of the type {use.type[:60]}, which is not defined")
        definition = self._types[use.type]
        if isinstance(definition, Characteristic) and definition.type == "VALUE" and use.sizes:
            definition, use = replace(definition, type="VAL_BLK", matrix_dim=use.sizes), replace(use, sizes=())
        for element in self._elements(use, definition) if definition is not None else ():
            if isinstance(definition, Characteristic | AxisPts):
                self._take(definition, element, outer)
            elif isinstance(definition, _Structure):
                for inner in definition.components:
                    name, address = f"{element.name}.{inner.name}", element.address + inner.address
                    read_only = inner.read_only or element.read_only
                    part = replace(inner, name=name, address=address, read_only=read_only)
                    self._expand(part, depth + 1, element.name)

    def _elements(self, use: _TypeUse, definition: object) -> Iterator[_TypeUse]:
        """Yield the element of each index, the first running fastest; the instance itself if it is not an array."""
        if not use.sizes:
            yield use
            return
        if prod(use.sizes) > _MAX_INSTANCES:
            raise A2lError(f"has {prod(use.sizes)} elements, more than {_MAX_INSTANCES}")
        if isinstance(definition, _Structure):
            stride = definition.size
        elif isinstance(definition, Characteristic) and definition.type == "ASCII":
            # a byte for each character
            stride = max(1, *definition.shape, 1)
        else:
            raise A2lError(f"is an array of {use.type[:60]}, whose element size is not stated")
        # as in C, the last subscript is x, which runs fastest
        for at, index in enumerate(product(*(range(size) for size in reversed(use.sizes)))):
            subscript = "".join(f"[{i}]" for i in index)
            yield replace(use, name=use.name + subscript, address=use.address + at * stride, sizes=())

    def _take(self, definition: Characteristic | AxisPts, use: _TypeUse, outer: str) -> None:
        if len(self.characteristics) + len(self.axis_pts) >= _MAX_INSTANCES:
            raise A2lError(f"defines more than {_MAX_INSTANCES} labels")
        if use.name in self.characteristics or use.name in self.axis_pts:
            raise A2lError(f"defines the label {use.name[:80]} twice")
        attributes: dict[str, Any] = {
            "name": use.name,
            "address": use.address,
            "description": use.description or definition.description,
            "display_identifier": use.display,
            "read_only": definition.read_only or use.read_only,
            "functions": tuple(self.functions.get(use.name, ())),
            "line": use.line,
        }
        if isinstance(definition, AxisPts):
            self.axis_pts[use.name] = replace(definition, **attributes)
        else:
            axes = tuple(_resolve_references(axis, outer) for axis in definition.axes)
            self.characteristics[use.name] = replace(definition, axes=axes, **attributes)


def _resolve_references(axis: AxisDescr, outer: str) -> AxisDescr:
    """Return the axis with references to components of the same structure (THIS.name) turned into labels."""

    def resolve(name: str) -> str:
        return f"{outer}.{name.removeprefix('THIS.')}" if name.startswith("THIS.") and outer else name

    return replace(axis, axis_pts_ref=resolve(axis.axis_pts_ref), curve_axis_ref=resolve(axis.curve_axis_ref))


def _parse_type_use(block: A2lBlock, *, absolute: bool) -> _TypeUse:
    """Return an INSTANCE, or a STRUCTURE_COMPONENT, which has an offset for its address and no description."""
    cursor = Cursor(block)
    name = cursor.word("name")
    description = cursor.text("description") if absolute else ""
    kind, address = cursor.word("type"), cursor.whole("address")
    options = cursor.options(_OPTIONS)
    sizes = tuple(size or 1 for size in parse_sizes(options))
    if options.get("ADDRESS_TYPE", ["DIRECT"]) != ["DIRECT"]:
        raise A2lError("is accessed through a pointer, which an image does not resolve")
    display = options.get("DISPLAY_IDENTIFIER", [""])[0]
    return _TypeUse(name, kind, address, description, sizes, display, "READ_ONLY" in options, block.line)


def _parse_structure(block: A2lBlock) -> _Structure:
    cursor = Cursor(block)
    cursor.word("name")
    cursor.text("description")
    size = cursor.whole("size")
    components = block.inner("STRUCTURE_COMPONENT")
    return _Structure(size, tuple(_parse_type_use(inner, absolute=False) for inner in components))
