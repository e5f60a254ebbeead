"""Reads CDFX 2.0, the calibration data format of ASAM: one SW-INSTANCE per label, with values in physical units.

A map is stored in groups, one per y, with x running fastest. A common axis (COM_AXIS) is an instance of its own, to
which tables refer by name: a group axis here. A table axis may also be a curve (CURVE_AXIS) or a list of pairs
(RES_AXIS) that map an input to a position between columns. Such an axis is resolved to breakpoints if that gives the
same lookup, or if the file states them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import prod

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.cdfx.elements import Instance, Values, array_size, instances, values_of
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult, build_set, drop_trailing_ones
from kennfeld.calfiles.xml_tree import Element, collection_paused, parse_xml
from kennfeld.formatting import count_labels, count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Text, TextKind, parameter

_ROOT = re.compile(r"<(?:[\w.-]+:)?MSRSW[\s/>]")
_VERSION = re.compile(r"CDF(\d)(\d)")
_PROLOG = 20_000  # characters before the root: declaration, document type, comments
_SCALARS = ("VALUE", "BOOLEAN", "DEPENDENT_VALUE", "DEPEDNDENT_VALUE")  # so misspelt in the demo file of ASAM
_WORDS: dict[str, TextKind] = {"ASCII": "text", "BOOLEAN": "boolean"}  # categories whose text is no enumeration
_BLOCKS = ("VAL_BLK", "VALUE_ARRAY", "BOOLEAN_ARRAY")
_TABLES = {"CURVE": 1, "CURVE_AXIS": 1, "MAP": 2, "CUBOID": 3, "CUBE_4": 4}
_DIRECTIONS = ("x", "y", "z", "fourth")
_MAX_DIMENSIONS = 4


def recognises_cdfx(text: str) -> bool:
    """Check whether a text is XML whose root is that of CDFX."""
    return text.lstrip("\ufeff \n\t").startswith("<") and _ROOT.search(text[:_PROLOG]) is not None


def read_cdfx(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CDFX file, with or without variants; the first variant of a label is used.

    Raises `InputError` with all findings; text tables, axes that cannot be resolved and histories are skipped
    with a remark. Entities are refused.
    """
    with collection_paused():
        return _read(source, Findings(source.name))


def _read(source: CalibrationSource, findings: Findings) -> ReadResult:
    root = parse_xml(source.raw, findings, "V")
    if root is None:
        findings.finish()
        raise AssertionError("a document that is not read has a finding")
    reader = _CdfxReader(findings)
    found = instances(root, findings)
    if not found and not _contains_tag(root, "SW-INSTANCE-TREE"):
        findings.error(root.line, "", "has no SW-INSTANCE-TREE, which contains the labels", "Export it as CDF 2.0.")
    for instance in found:
        if instance.category in ("COM_AXIS", "RES_AXIS", "CURVE_AXIS"):
            reader.take_axis(instance)
    for instance in found:
        if instance.category not in ("COM_AXIS", "RES_AXIS"):
            reader.take(instance)
    reader.warn_about_numeric_booleans()
    remarks = findings.finish()
    version = _VERSION.fullmatch(root.line_of("CATEGORY").strip())
    kind = f"CDFX {version[1]}.{version[2]}" if version else "CDFX"
    return ReadResult(kind, reader.parameters(), remarks)


def _contains_tag(root: Element, tag: str) -> bool:
    waiting = [root]
    while waiting:
        element = waiting.pop()
        if element.tag == tag:
            return True
        waiting += element.children
    return False


@dataclass(frozen=True)
class _Positions:
    """An axis that maps inputs to positions between columns: `inputs[k]` is at `positions[k]`."""

    inputs: Float
    positions: Float
    unit: str

    def breakpoints(self, columns: int) -> Float | None:
        """Return the inputs of columns 0, 1, ...; None if interpolation between them differs.

        Interpolation of a curve and then between columns bends at the curve's own breakpoints too, so these must lie
        on columns.
        """
        if not np.array_equal(self.positions, np.arange(columns)) or np.any(np.diff(self.inputs) <= 0):
            return None
        return self.inputs


class _CdfxReader:
    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        self.items: dict[tuple[str, str], Parameter | Text] = {}  # by name and variant
        self.kinds: dict[str, type] = {}  # of the first variant of each label
        self.groups: dict[str, Axis] = {}
        self.positions: dict[str, _Positions] = {}
        self.broken: set[str] = set()  # axes with a finding of their own
        self.numbered: list[str] = []  # booleans that are given as numbers
        self.taken: dict[tuple[str, str], tuple[int, object]] = {}  # each name and variant: its line, what it holds

    def parameters(self) -> ParameterSet:
        return build_set(self.items, self.groups.values())

    def warn_about_numeric_booleans(self) -> None:
        """Remark on booleans that are given as numbers, whose category is not kept."""
        if self.numbered:
            names = count_labels(list(dict.fromkeys(self.numbered)))
            message = f"BOOLEAN with a number, read as a number and written as VALUE or VAL_BLK: {names}"
            self.findings.warning(0, "", message)

    def take_axis(self, instance: Instance) -> None:
        """Keep an axis that tables refer to."""
        # A CURVE_AXIS is a parameter too, whose findings are noted where it is taken.
        findings = Findings("") if instance.category == "CURVE_AXIS" else self.findings
        values = values_of(instance.value, instance.name, findings)
        if instance.variant and (instance.name in self.groups or instance.name in self.positions):
            if instance.category != "CURVE_AXIS":  # which is a curve in each of its variants
                self._skip(instance, f"is the axis in another variant ({instance.variant})")
            return
        if values is not None and values.texts:
            if instance.category == "COM_AXIS":
                self._skip(instance, "contains text instead of breakpoints")
        elif instance.category == "COM_AXIS":
            self._take_group(instance, values)
        elif values is not None and (found := self._positions(instance, values)):
            self.positions[instance.name] = found
        if instance.category == "RES_AXIS":
            message = "RES_AXIS only provides breakpoints of tables; skipped as a parameter"
            self.findings.warning(instance.line, instance.name, message)

    def _take_group(self, instance: Instance, values: Values | None) -> None:
        points = None if values is None else np.array(values.numbers)
        wrong = "has no breakpoints" if points is None else _points_fault(points)
        if wrong or points is None:
            self.broken.add(instance.name)
            if values is not None or _is_empty(instance.value):
                self._wrong(instance, f"COM_AXIS {wrong}")
            return
        axis = Axis(points, unit=instance.unit, name=instance.name)
        if self._is_new(instance, axis):
            self.groups[instance.name] = axis

    def _positions(self, instance: Instance, values: Values) -> _Positions | None:
        if instance.category == "RES_AXIS":
            if len(values.shape) != 2 or values.shape[1] != 2:
                return None
            inputs, positions = np.array(values.numbers).reshape(-1, 2).T
            return _Positions(inputs, positions, instance.unit)
        axis = values_of(instance.axes[0], instance.name, Findings("")) if len(instance.axes) == 1 else None
        if axis is None or len(axis.numbers) != len(values.numbers):
            return None
        unit = instance.axes[0].line_of("UNIT-DISPLAY-NAME")
        return _Positions(np.array(axis.numbers), np.array(values.numbers), unit)

    def take(self, instance: Instance) -> None:
        """Check an instance and add it."""
        category = instance.category
        if instance.value is None:
            self._skip(instance, "contains no values")
            return
        if category not in (*_SCALARS, *_BLOCKS, *_TABLES, "ASCII"):
            message = f"has the unsupported category {category[:40]}" if category else "has no CATEGORY"
            self._skip(instance, message)
            return
        values = values_of(instance.value, instance.name, self.findings)
        if values is None:
            if _is_empty(instance.value):
                self._wrong(instance, f"{category} has no SW-VALUES-PHYS")
        elif category == "ASCII" or (category in _SCALARS and values.texts):
            self._take_text(instance, values)
        elif values.texts:
            self._skip(instance, f"{category} contains text and cannot be calibrated")
        else:
            self._take_member(instance, values)

    def _take_text(self, instance: Instance, values: Values) -> None:
        if values.numbers or len(values.texts) > 1:
            found = count_noun(len(values.numbers) + len(values.texts), "value")
            self._wrong(instance, f"{instance.category} has {found} instead of one text")
            return
        kind = _WORDS.get(instance.category, "enumeration")
        text = Text(instance.name, "".join(values.texts), kind=kind, unit=instance.unit, **instance.labels)
        self._hold(instance, text)

    def _take_member(self, instance: Instance, values: Values) -> None:
        makers: dict[str, Callable[[Instance, Values], Parameter | None]] = dict.fromkeys(_SCALARS, self._scalar)
        makers |= dict.fromkeys(_BLOCKS, self._block)
        member = makers.get(instance.category, self._table)(instance, values)
        if instance.category.startswith("BOOLEAN") and member is not None:
            self.numbered.append(instance.name)
        if member is not None:
            self._hold(instance, member)

    def _hold(self, instance: Instance, item: Parameter | Text) -> None:
        first = self.kinds.setdefault(instance.name, type(item))
        if first is not type(item) and Text in (first, type(item)):
            self._skip(instance, "is a text in one variant and a number in another")
        elif self._is_new(instance, item):
            self.items[instance.name, instance.variant] = item

    def _is_new(self, instance: Instance, made: object) -> bool:
        """Check whether a name occurs for the first time; a repetition must be equal."""
        line, first = self.taken.setdefault((instance.name, instance.variant), (instance.line, made))
        if first is not made and first != made:
            message = f"{instance.name} is already defined in line {line}, with different content"
            self._wrong(instance, message, "Keep one of the two.")
        return first is made

    def _scalar(self, instance: Instance, values: Values) -> Parameter | None:
        if len(values.numbers) != 1:
            self._wrong(instance, f"{instance.category} has {count_noun(len(values.numbers), 'value')}, not one")
            return None
        if instance.category.startswith("DEP"):
            message = "is a dependent value: its number is read, the formula for it is in the A2L file"
            self.findings.warning(instance.line, instance.name, message)
        return parameter(instance.name, values.numbers[0], unit=instance.unit, **instance.labels)

    def _block(self, instance: Instance, values: Values) -> Parameter | None:
        assert instance.value is not None
        stated, shape = array_size(instance.value), values.shape[::-1]
        if len(shape) == 1:
            shape = drop_trailing_ones(stated) if prod(stated) == shape[0] and stated else shape
        elif stated and drop_trailing_ones(stated) != drop_trailing_ones(shape):
            said, found = (" x ".join(map(str, sizes)) for sizes in (stated, shape))
            self._wrong(instance, f"SW-ARRAYSIZE states {said} values, but the groups contain {found}")
            return None
        if not values.numbers or (len(values.shape) == 1 and stated and prod(stated) != len(values.numbers)):
            asked = f", but SW-ARRAYSIZE states {' x '.join(map(str, stated))}" if stated else ""
            self._wrong(instance, f"{instance.category} has {count_noun(len(values.numbers), 'value')}{asked}")
            return None
        if len(shape) > _MAX_DIMENSIONS:
            self._skip(instance, f"has {len(shape)} dimensions, but a value block has at most {_MAX_DIMENSIONS}")
            return None
        array = values.shaped(shape)
        assert array is not None
        return Block(instance.name, array, unit=instance.unit, **instance.labels)

    def _table(self, instance: Instance, values: Values) -> Parameter | None:
        wanted = _TABLES[instance.category]
        if len(instance.axes) != wanted:
            found = count_noun(len(instance.axes), "SW-AXIS-CONT")
            self._wrong(instance, f"{instance.category} has {found}, but needs {wanted}")
            return None
        sizes = values.shape[::-1] if len(values.shape) == wanted else (0,) * wanted
        found_axes = [self._axis(instance, direction, size) for direction, size in enumerate(sizes)]
        axes = [axis for axis in found_axes if axis is not None]
        if len(axes) < wanted:
            return None
        array = values.shaped(tuple(map(len, axes)))
        if array is None:
            has = " x ".join(map(str, values.shape[::-1]))
            asked = " x ".join(str(len(axis)) for axis in axes)
            self._wrong(instance, f"{instance.category} has {has} values, but its axes require {asked}")
            return None
        return parameter(instance.name, array, axes, unit=instance.unit, **instance.labels)

    def _axis(self, instance: Instance, direction: int, size: int) -> Axis | None:
        cont = instance.axes[direction]
        reference = cont.line_of("SW-INSTANCE-REF").strip()
        category = cont.line_of("CATEGORY").strip().upper()
        given = values_of(cont, instance.name, self.findings)
        if given is not None and given.texts:
            self._skip(instance, f"has text on its {_DIRECTIONS[direction]} axis")
            return None
        points = None if given is None else np.array(given.numbers)
        if category in ("RES_AXIS", "CURVE_AXIS") or reference in self.positions:
            return self._resolved(instance, direction, reference, points, size)
        if reference:
            return self._referred(instance, direction, reference, points)
        if points is None:
            if _is_empty(cont):
                self._wrong(instance, f"has no {_DIRECTIONS[direction]} breakpoints")
            return None
        fault = _points_fault(points)
        if fault:
            remedy = "Each breakpoint must be greater than the previous one." if points.size else ""
            self.findings.error(cont.line, instance.name, f"the {_DIRECTIONS[direction]} axis {fault}", remedy)
            return None
        return Axis(points, unit=cont.line_of("UNIT-DISPLAY-NAME"))

    def _referred(self, instance: Instance, direction: int, reference: str, points: Float | None) -> Axis | None:
        cont, letter = instance.axes[direction], _DIRECTIONS[direction]
        if reference in self.broken:
            return None
        if reference not in self.groups and (points is None or _points_fault(points)):
            message = f"refers to the {letter} axis {reference}, which is not in this file"
            self._skip(instance, message, "Export the axis too.")
            return None
        if reference not in self.groups and points is not None:
            unit = cont.line_of("UNIT-DISPLAY-NAME")
            self.groups[reference] = Axis(points, unit=unit, name=reference)
        group = self.groups[reference]
        unit = cont.line_of("UNIT-DISPLAY-NAME") if cont.first("UNIT-DISPLAY-NAME") else group.unit
        if points is None or np.array_equal(points, group.breakpoints):
            return group.changed(unit=unit)
        fault = _points_fault(points)
        if fault:
            self.findings.error(cont.line, instance.name, f"the {letter} axis {fault}")
            return None
        message = f"has other {letter} breakpoints than the group axis {reference}; kept as an axis of its own"
        self.findings.warning(cont.line, instance.name, message)
        return Axis(points, unit=unit)

    def _resolved(
        self, instance: Instance, direction: int, reference: str, points: Float | None, size: int
    ) -> Axis | None:
        cont = instance.axes[direction]
        known = self.positions.get(reference)
        unit = cont.line_of("UNIT-DISPLAY-NAME") or (known.unit if known else "")
        if points is None and known is not None:
            points = known.breakpoints(size)
        if points is None or _points_fault(points):
            kind = cont.line_of("CATEGORY").strip() or "axis"
            message = f"has breakpoints that cannot be derived from the {kind} {reference}"
            self._skip(instance, message)
            return None
        return Axis(points, unit=unit)

    def _skip(self, instance: Instance, message: str, remedy: str = "") -> None:
        self.findings.warning(instance.line, instance.name, f"{message}; skipped", remedy)

    def _wrong(self, instance: Instance, message: str, remedy: str = "") -> None:
        self.findings.error(instance.line, instance.name, message, remedy)


def _is_empty(holder: Element | None) -> bool:
    """Check whether values are missing; wrong ones have findings of their own."""
    return holder is None or holder.first("SW-VALUES-PHYS") is None


def _points_fault(points: Float) -> str:
    """Return what is wrong with breakpoints, or an empty text."""
    if not points.size:
        return "has no breakpoints"
    falling = np.flatnonzero(points[1:] <= points[:-1])
    if not falling.size:
        return ""
    at = int(falling[0])
    return (
        f"is not strictly increasing: breakpoint {at + 2} ({points[at + 1]:g}) does not exceed "
        f"breakpoint {at + 1} ({points[at]:g})"
    )
