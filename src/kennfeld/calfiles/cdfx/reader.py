"""Reads CDFX 2.0, the calibration data format of ASAM: one SW-INSTANCE per label, with values in physical units.

A map is stored in groups, one per y, with x running fastest. A common axis (COM_AXIS) is an instance of its own, to
which tables refer by name: a group axis here. A table axis may also be a curve (CURVE_AXIS) or a list of pairs
(RES_AXIS) that map an input to a position between columns. Such an axis is resolved to breakpoints if that gives the
same lookup, or if the file states them.
"""

import re
from math import prod

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels, count_noun, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.cdfx.elements import Instance, Values, array_size, instances, values_of
from kennfeld.calfiles.content import describe_fall, drop_trailing_ones, in_rising_order, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, Key, ReadResult, build_set
from kennfeld.calfiles.xml_tree import TreeElement, parse_xml
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameters import Block, Parameter, parameter
from kennfeld.domain.texts import Text, TextKind

_VERSION = re.compile(r"CDF(\d)(\d)")
_SCALARS = ("VALUE", "BOOLEAN", "DEPENDENT_VALUE", "DEPEDNDENT_VALUE")  # so misspelt in the demo file of ASAM
_WORDS: dict[str, TextKind] = {"ASCII": "text", "BOOLEAN": "boolean"}  # categories whose text is no enumeration
_BLOCKS = ("VAL_BLK", "VALUE_ARRAY", "BOOLEAN_ARRAY")
_TABLES = {"CURVE": 1, "CURVE_AXIS": 1, "MAP": 2, "CUBOID": 3, "CUBE_4": 4}
_MAX_DIMENSIONS = 4
_CORRECT = "Correct its breakpoints."


def read_cdfx(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CDFX file, with or without variants; the first variant of a label is used.

    Raises `InputError` with all findings; text tables, axes that cannot be resolved and histories are skipped
    with a warning. Entities are refused.
    """
    findings = FileFindings(source.name)
    root = parse_xml(source.raw, findings, "V")
    if root is None:
        findings.finish()
        raise AssertionError("a document that is not read has a finding")
    reader = _CdfxReader(findings)
    labels = instances(root, findings)
    if not labels and all(element.tag != "SW-INSTANCE-TREE" for element in root.walk()):
        findings.error(root.line, "", "has no SW-INSTANCE-TREE, which contains the labels", "Export it as CDF 2.0.")
    # axes first, as a table may stand before the axis it refers to
    for instance in labels:
        if instance.category in ("COM_AXIS", "RES_AXIS", "CURVE_AXIS"):
            reader.take_axis(instance)
    for instance in labels:
        if instance.category not in ("COM_AXIS", "RES_AXIS"):
            reader.take(instance)
    if reader.numeric_booleans:
        message = "BOOLEAN with a number, read as a number and written as VALUE or VAL_BLK"
        findings.warning(0, "", f"{message}: {count_labels(list(reader.numeric_booleans))}")
    warnings = findings.finish()
    version = _VERSION.fullmatch(root.line_of("CATEGORY").strip())
    kind = f"CDFX {version[1]}.{version[2]}" if version else "CDFX"
    return ReadResult(kind, build_set(reader.items, reader.groups.values()), warnings)


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
    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.items: dict[Key, Item] = {}
        self.kinds: dict[str, type] = {}  # of the first variant of each label
        self.groups: dict[str, Axis] = {}
        self.group_variants: dict[Key, Axis] = {}  # in further variants; without a name if the breakpoints are others
        self.positions: dict[str, _Positions] = {}
        self.broken: set[Key] = set()  # axes with a finding of their own; without a variant, in all of them
        self.numeric_booleans: dict[str, None] = {}
        self.taken: dict[Key, tuple[int, object]] = {}  # each name and variant: its line, what it holds

    def take_axis(self, instance: Instance) -> None:
        """Keep an axis that tables refer to."""
        # A CURVE_AXIS is a parameter too, whose findings are reported when it is taken.
        is_curve = instance.category == "CURVE_AXIS"
        values = values_of(instance.value, instance.name, FileFindings("") if is_curve else self.findings)
        # the first variant of an axis is the group axis
        if instance.variant and (instance.name in self.groups or instance.name in self.positions):
            if not is_curve:  # which is a curve in each of its variants
                self._take_other_variant(instance, values)
            return
        if values is not None and values.texts:
            if instance.category == "COM_AXIS":
                self._skip(instance, "contains text instead of breakpoints")
        elif instance.category == "COM_AXIS":
            self._take_group(instance, values)
        elif values is not None and (positions := _positions(instance, values)):
            self.positions[instance.name] = positions
        if instance.category == "RES_AXIS":
            message = "RES_AXIS only provides breakpoints of tables; skipped as a parameter"
            self.findings.warning(instance.line, instance.name, message)

    def _take_other_variant(self, instance: Instance, values: Values | None) -> None:
        """Keep an axis in a further variant for the tables of that variant."""
        message, group = f"is the axis in another variant ({instance.variant})", self.groups.get(instance.name)
        points, falls = in_rising_order(np.array([] if values is None else values.numbers))
        key = instance.name, instance.variant
        if group is None or _points_fault(points):
            self.broken.add(key)
            self._skip(instance, message)
            return
        same = np.array_equal(points, group.breakpoints)
        name = instance.name if same else ""
        self.group_variants.setdefault(key, Axis(points, unit=instance.unit, name=name, falling=falls))
        if not same:
            remedy = "Tables of that variant have it as an axis of their own."
            self.findings.warning(instance.line, instance.name, message, remedy)

    def _take_group(self, instance: Instance, values: Values | None) -> None:
        points, falls = (None, False) if values is None else in_rising_order(np.array(values.numbers))
        fault = "has no breakpoints" if points is None else _points_fault(points)
        if fault or points is None:
            self.broken.add((instance.name, ""))
            if points is not None and points.size:
                self._skip(instance, f"COM_AXIS {fault}", _CORRECT)
            elif values is not None or _is_empty(instance.value):
                self._wrong(instance, f"COM_AXIS {fault}")
            return
        axis = Axis(points, unit=instance.unit, name=instance.name, falling=falls)
        if self._is_new(instance, axis):
            self.groups[instance.name] = axis

    def take(self, instance: Instance) -> None:
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
            count = count_noun(len(values.numbers) + len(values.texts), "value")
            self._wrong(instance, f"{instance.category} has {count} instead of one text")
            return
        kind = _WORDS.get(instance.category, "enumeration")
        self._hold(instance, Text(instance.name, "".join(values.texts), kind=kind, **instance.labels))

    def _take_member(self, instance: Instance, values: Values) -> None:
        if instance.category in _SCALARS:
            member = self._scalar(instance, values)
        elif instance.category in _BLOCKS:
            member = self._block(instance, values)
        else:
            member = self._table(instance, values)
        if member is not None:
            self._hold(instance, member)
            if instance.category.startswith("BOOLEAN"):
                self.numeric_booleans[instance.name] = None

    def _hold(self, instance: Instance, item: Item) -> None:
        first = self.kinds.setdefault(instance.name, type(item))
        if first is not type(item) and Text in (first, type(item)):
            self._skip(instance, "is a text in one variant and a number in another")
        elif self._is_new(instance, item):
            self.items[instance.name, instance.variant] = item

    def _is_new(self, instance: Instance, item: object) -> bool:
        """Check whether a name occurs for the first time; a repetition must be equal."""
        line, first = self.taken.setdefault((instance.name, instance.variant), (instance.line, item))
        # axes are equal even if files store them in opposite orders
        turned = isinstance(first, Axis) and isinstance(item, Axis) and first.falling != item.falling
        if first is not item and (first != item or turned):
            message = f"{instance.name} is already defined in line {line}, with different content"
            self._wrong(instance, message, "Keep one of the two.")
        return first is item

    def _scalar(self, instance: Instance, values: Values) -> Parameter | None:
        if len(values.numbers) != 1:
            self._wrong(instance, f"{instance.category} has {count_noun(len(values.numbers), 'value')}, not one")
            return None
        if instance.category.startswith("DEP"):
            message = "is a dependent value: its number is read, the formula for it is in the A2L file"
            self.findings.warning(instance.line, instance.name, message)
        return parameter(instance.name, values.numbers[0], **instance.labels)

    def _block(self, instance: Instance, values: Values) -> Parameter | None:
        assert instance.value is not None
        stated, shape = array_size(instance.value), values.shape[::-1]
        if len(shape) == 1:
            # without groups, SW-ARRAYSIZE alone states the shape
            shape = drop_trailing_ones(stated) if prod(stated) == shape[0] and stated else shape
        elif stated and drop_trailing_ones(stated) != drop_trailing_ones(shape):
            size, actual = (size_text(sizes) for sizes in (stated, shape))
            self._wrong(instance, f"SW-ARRAYSIZE states {size} values, but the groups contain {actual}")
            return None
        if not values.numbers or (len(values.shape) == 1 and stated and prod(stated) != len(values.numbers)):
            stated_size = f", but SW-ARRAYSIZE states {' x '.join(map(str, stated))}" if stated else ""
            self._wrong(instance, f"{instance.category} has {count_noun(len(values.numbers), 'value')}{stated_size}")
            return None
        if len(shape) > _MAX_DIMENSIONS:
            self._skip(instance, f"has {len(shape)} dimensions, but a value block has at most {_MAX_DIMENSIONS}")
            return None
        array = values.shaped(shape)
        assert array is not None
        return Block(instance.name, array, **instance.labels)

    def _table(self, instance: Instance, values: Values) -> Parameter | None:
        dimensions = _TABLES[instance.category]
        if len(instance.axes) != dimensions:
            message = f"has {count_noun(len(instance.axes), 'SW-AXIS-CONT')}, but needs {dimensions}"
            self._wrong(instance, f"{instance.category} {message}")
            return None
        # groups are nested from the last axis to x
        sizes = values.shape[::-1] if len(values.shape) == dimensions else (0,) * dimensions
        candidates = [self._axis(instance, direction, size) for direction, size in enumerate(sizes)]
        axes = [axis for axis in candidates if axis is not None]
        if len(axes) < dimensions:
            return None
        array = values.shaped(tuple(map(len, axes)))
        if array is None:
            size = size_text(values.shape[::-1])
            required = size_text(map(len, axes))
            self._wrong(instance, f"{instance.category} has {size} values, but its axes require {required}")
            return None
        return parameter(instance.name, turn(array, axes), axes, **instance.labels)

    def _axis(self, instance: Instance, direction: int, size: int) -> Axis | None:
        """Return an axis of a table, which falls if the table does."""
        cont = instance.axes[direction]
        reference = cont.line_of("SW-INSTANCE-REF").strip()
        category = cont.line_of("CATEGORY").strip().upper()
        values = values_of(cont, instance.name, self.findings)
        letter = AXIS_LETTERS[direction]
        if values is not None and values.texts:
            self._skip(instance, f"has text on its {letter} axis")
            return None
        points = None if values is None else np.array(values.numbers)
        if category in ("RES_AXIS", "CURVE_AXIS") or reference in self.positions:
            return self._resolved(instance, direction, reference, points, size)
        points, falls = (None, False) if points is None else in_rising_order(points)
        if reference:
            return self._referred(instance, direction, reference, points, falls)
        if points is None:
            if _is_empty(cont):
                self._wrong(instance, f"has no {letter} breakpoints")
            return None
        fault = _points_fault(points)
        if fault:
            if points.size:
                self._skip(instance, f"the {letter} axis {fault}", _CORRECT)
            else:
                self.findings.error(cont.line, instance.name, f"the {letter} axis {fault}")
            return None
        return Axis(points, unit=cont.line_of("UNIT-DISPLAY-NAME"), falling=falls)

    def _referred(
        self, instance: Instance, direction: int, reference: str, points: Float | None, falls: bool
    ) -> Axis | None:
        """Return the group axis that a table refers to, in the order of the table's own breakpoints if it has any."""
        cont, letter = instance.axes[direction], AXIS_LETTERS[direction]
        if {(reference, ""), (reference, instance.variant)} & self.broken:
            return None
        if reference not in self.groups:
            if points is None or _points_fault(points):
                message = f"refers to the {letter} axis {reference}, which is not in this file"
                self._skip(instance, message, "Export the axis too.")
                return None
            # the table states the breakpoints of an axis that the file lacks
            unit = cont.line_of("UNIT-DISPLAY-NAME")
            self.groups[reference] = Axis(points, unit=unit, name=reference, falling=falls)
        group = self.group_variants.get((reference, instance.variant), self.groups[reference])
        unit = cont.line_of("UNIT-DISPLAY-NAME") if cont.first("UNIT-DISPLAY-NAME") else group.unit
        if points is None or np.array_equal(points, group.breakpoints):
            return group.changed(unit=unit, falling=group.falling if points is None else falls)
        fault = _points_fault(points)
        if fault:
            self._skip(instance, f"the {letter} axis {fault}", _CORRECT)
            return None
        message = f"has other {letter} breakpoints than the group axis {reference}; kept as an axis of its own"
        self.findings.warning(cont.line, instance.name, message)
        return Axis(points, unit=unit, falling=falls)

    def _resolved(
        self, instance: Instance, direction: int, reference: str, points: Float | None, size: int
    ) -> Axis | None:
        cont = instance.axes[direction]
        known = self.positions.get(reference)
        unit = cont.line_of("UNIT-DISPLAY-NAME") or (known.unit if known else "")
        if points is None and known is not None:
            points = known.breakpoints(size)
        points, falls = (None, False) if points is None else in_rising_order(points)
        if points is None or _points_fault(points):
            kind = cont.line_of("CATEGORY").strip() or "axis"
            self._skip(instance, f"has breakpoints that cannot be derived from the {kind} {reference}")
            return None
        return Axis(points, unit=unit, falling=falls)

    def _skip(self, instance: Instance, message: str, remedy: str = "") -> None:
        self.findings.warning(instance.line, instance.name, f"{message}; skipped", remedy)

    def _wrong(self, instance: Instance, message: str, remedy: str = "") -> None:
        self.findings.error(instance.line, instance.name, message, remedy)


def _is_empty(holder: TreeElement | None) -> bool:
    """Check whether values are missing; wrong ones have findings of their own."""
    return holder is None or holder.first("SW-VALUES-PHYS") is None


def _points_fault(points: Float) -> str:
    """Return what is wrong with breakpoints, or an empty text."""
    fall = describe_fall(points)
    if not points.size:
        return "has no breakpoints"
    return f"neither rises nor falls: {fall}" if fall else ""


def _positions(instance: Instance, values: Values) -> _Positions | None:
    if instance.category == "RES_AXIS":
        if len(values.shape) != 2 or values.shape[1] != 2:
            return None
        inputs, positions = np.array(values.numbers).reshape(-1, 2).T
        return _Positions(inputs, positions, instance.unit)
    axis = values_of(instance.axes[0], instance.name, FileFindings("")) if len(instance.axes) == 1 else None
    if axis is None or len(axis.numbers) != len(values.numbers):
        return None
    unit = instance.axes[0].line_of("UNIT-DISPLAY-NAME")
    return _Positions(np.array(axis.numbers), np.array(values.numbers), unit)
