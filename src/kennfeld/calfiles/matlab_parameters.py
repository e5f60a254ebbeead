"""Converts MATLAB variables to parameters, for scripts (.m) and data files (.mat) alike.

A number is a scalar, a vector or matrix a value block, a text a text. A struct with `x` (and `y`, ...) and `values`,
one row per x, is a curve or map. Common other names of these fields are supported regardless of case: `Value` and
`Data`, the fields of a Simulink.LookupTable, `Breakpoints`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import field
from itertools import takewhile
from math import prod
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun, join_names, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import describe_fall, drop_trailing_ones, in_rising_order, turn
from kennfeld.calfiles.format import FileFindings, Item, Key, build_set
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Scalar, parameter
from kennfeld.domain.texts import Text, TextKind

INFO = "kennfeld_info"  # the struct that says more about variables which are plain numbers
_VALUES = ("values", "value", "data", "table", "tabledata")
_AXES = tuple(
    (x, f"{x}axis", f"{x}breakpoints", f"breakpoints{number}", f"bp{number}", f"{x}values", f"{x}data")
    for number, x in enumerate(AXIS_LETTERS, 1)
)
_UNITS = ("unit", "units", "docunits")
_DESCRIPTIONS = ("description", "desc", "comment")
_KNOWN = {"name", "text", "functions", "displayname", "variant", "kind", "size", "breakpoints", *_UNITS, *_DESCRIPTIONS}
_KNOWN |= {*_VALUES, *(name for names in _AXES for name in names)}
_KNOWN |= {f"{letter}{word}" for letter in AXIS_LETTERS for word in ("name", "unit", "input")}
_TEXT_KINDS: tuple[TextKind, ...] = ("enumeration", "boolean")
_TIMES = frozenset({"t", "time", "zeit", "timestamp", "timestamps", "tout"})
_MAX_DIMENSIONS = 4
_MAX_MATRIX_VALUES = 4096  # values; a matrix that a person calibrates has no more


@dataclass(frozen=True)
class UnreadableObject:
    """A variable that only MATLAB can read, with the name of its class."""

    kind: str


@dataclass
class StructValue:
    """A struct: its fields by name."""

    fields: dict[str, "Value"] = field(default_factory=dict)

    def folded(self) -> dict[str, str]:
        """Return each field without regard to case and underscores."""
        # from the last to the first, so that of names that fold to one the first counts
        return {_fold_name(name): name for name in reversed(self.fields)}

    def get(self, names: Iterable[str]) -> "Value | None":
        """Return the first field of some names, given folded, that the struct has."""
        known = self.folded()
        return next((self.fields[known[name]] for name in names if name in known), None)


Value = Float | str | StructValue | UnreadableObject | list[Any]  # a list is a cell array, or an array of structs


def _fold_name(name: str) -> str:
    return name.replace("_", "").casefold()


def parameters_of(
    variables: Mapping[str, Value], findings: FileFindings, lines: Mapping[str, int] | None = None
) -> ParameterSet:
    """Convert all variables to parameters, in order; those that cannot be converted are reported.

    `lines` gives the line in which a variable begins, if there are lines. Of several variants the first counts.
    """
    info = variables.get(INFO)
    reader = _StructReader(findings, info.fields if isinstance(info, StructValue) else {})
    for name, value in variables.items():
        if name != INFO:
            reader.take(name, value, (lines or {}).get(name, 0))
    if reader.unknown:
        findings.warning(0, "", f"unknown fields skipped: {join_names(reader.unknown)}")
    return build_set(reader.items, [axis for _, axis in reader.groups.values()])


def holds_samples(variables: Mapping[str, Value]) -> str:
    """Return the name of a variable that shows recorded samples; empty if it can be a calibration."""
    # recordings have no breakpoints
    if INFO in variables or any(_is_table(value) for value in variables.values()):
        return ""
    return next(filter(None, (_sample_name(name, value, 0) for name, value in variables.items())), "")


def _sample_name(name: str, value: Value, depth: int) -> str:
    if isinstance(value, UnreadableObject):
        return name if value.kind.casefold() in ("timeseries", "timetable", "dataset") else ""
    if isinstance(value, np.ndarray):
        flat = value.ravel()
        rising = value.size > 1 and bool(np.all(flat[1:] > flat[:-1]))
        is_time = _fold_name(name.rpartition(".")[2]) in _TIMES and rising
        return name if value.size > _MAX_MATRIX_VALUES or is_time else ""
    if not isinstance(value, StructValue) or depth > 5:
        return ""
    if {"time", "signals"} <= value.folded().keys():
        return name
    inner = (_sample_name(f"{name}.{key}", part, depth + 1) for key, part in value.fields.items())
    return next(filter(None, inner), "")


def _is_table(value: Value) -> bool:
    if not isinstance(value, StructValue):
        return False
    known = value.folded().keys()
    axes = any(set(names) & known for names in _AXES) or "breakpoints" in known
    return bool(axes and set(_VALUES) & known) or any(_is_table(inner) for inner in value.fields.values())


@dataclass
class _StructReader:
    findings: FileFindings
    info: dict[str, Value]
    items: dict[Key, Item] = field(default_factory=dict)
    groups: dict[str, tuple[str, Axis]] = field(default_factory=dict)
    unknown: dict[str, None] = field(default_factory=dict)  # fields that say nothing to a calibration

    def take(self, name: str, value: Value, line: int, depth: int = 0) -> None:
        """Make a parameter of a variable, or of each field of a struct that only groups them."""
        if isinstance(value, StructValue):
            self._struct(name, value, line, depth)
        elif isinstance(value, str):
            self._text(name, value, self.info.get(name), line)
        elif isinstance(value, np.ndarray):
            self._plain(name, value, self._labels(name, self.info.get(name)), line)
        elif isinstance(value, UnreadableObject):
            message = f"is a {value.kind or 'object'}, which only MATLAB can read; skipped"
            remedy = "Save its numbers, such as p.Value, as plain variables or in a script."
            self.findings.warning(line, name, message, remedy)
        else:
            self.findings.warning(line, name, "is a cell array, which cannot be a parameter; skipped")

    def _plain(self, name: str, value: Float, labels: dict[str, Any], line: int) -> None:
        # a vector is a matrix with one row or column in MATLAB
        values = value.ravel() if value.ndim == 2 and 1 in value.shape else value
        if values.size == 0:
            self.findings.warning(line, name, "is empty; skipped")
        elif values.size == 1:
            self._hold(Scalar(name, float(values.ravel()[0]), **labels), line)
        elif values.ndim > _MAX_DIMENSIONS:
            message = f"has {values.ndim} dimensions, but a value block has at most {_MAX_DIMENSIONS}; skipped"
            self.findings.warning(line, name, message)
        else:
            self._hold(Block(name, values, **labels), line)

    def _text(self, name: str, text: str, more: Value | None, line: int) -> None:
        word = _text_of(more, "kind") if isinstance(more, StructValue) else ""
        kind: TextKind = next((known for known in _TEXT_KINDS if known == word), "text")
        self._hold(Text(name, text, kind=kind, **self._labels(name, more)), line)

    def _hold(self, item: Item, line: int) -> None:
        key = (item.name, item.variant)
        same = [known for (name, _), known in self.items.items() if name == item.name] if item.variant else []
        if key in self.items or any(isinstance(known, Text) != isinstance(item, Text) for known in same):
            self.findings.error(line, item.name, f"{item.name} is defined twice", "Keep one of the two.")
        self.items[key] = item

    def _struct(self, variable: str, struct: StructValue, line: int, depth: int) -> None:
        known = struct.folded().keys()
        name = _text_of(struct, "name") or variable
        if _text_of(struct, "kind") == "axis":
            self._spare_axis(name, struct, line)
        elif isinstance(struct.get(["text"]), str):
            self._text(name, _text_of(struct, "text"), struct, line)
        # x and y alone are a curve, with y as its values
        elif set(_VALUES) & known or {"x", "y"} <= known:
            self._table(name, struct, line)
        elif depth > 20 or not struct.fields:
            self.findings.warning(line, variable, "is a struct without values; skipped")
        else:
            for inner, value in struct.fields.items():
                self.take(f"{variable}.{inner}", value, line, depth + 1)

    def _labels(self, name: str, more: Value | None) -> dict[str, Any]:
        if not isinstance(more, StructValue):
            return {}
        functions = more.get(["functions"])
        listed = functions if isinstance(functions, list) else [functions] if functions else []
        return {
            "unit": _text_of(more, *_UNITS),
            "description": _text_of(more, *_DESCRIPTIONS),
            "functions": tuple(function for function in listed if isinstance(function, str)),
            "display_name": _text_of(more, "displayname"),
            "variant": _text_of(more, "variant"),
        }

    def _table(self, name: str, struct: StructValue, line: int) -> None:
        labels = self._labels(name, struct)
        values, points = _table_parts(struct)
        self.unknown |= {field: None for folded, field in struct.folded().items() if folded not in _KNOWN}
        numbers = [axis for axis in points if axis is not None]
        if values is None or len(numbers) < len(points):
            broken = [letter for letter, axis in zip(AXIS_LETTERS, points, strict=False) if axis is None]
            part = "values" if values is None else broken[0]
            self.findings.error(line, name, f"{name}.{part} contains no numbers", "Assign numbers in brackets.")
        elif not points:
            self._sized(name, values, struct, labels, line)
        else:
            axes = [
                self._axis(name, struct, letter, axis, line)
                for letter, axis in zip(AXIS_LETTERS, numbers, strict=False)
            ]
            known = [axis for axis in axes if axis is not None]
            if len(known) == len(axes):
                self._over_axes(name, values, known, labels, line)

    def _sized(self, name: str, values: Float, struct: StructValue, labels: dict[str, Any], line: int) -> None:
        """Add a struct with only values; `size` distinguishes blocks from scalars and keeps shapes MATLAB drops."""
        size = struct.get(["size"])
        if not isinstance(size, np.ndarray):
            self._plain(name, values, labels, line)
            return
        shape = tuple(int(number) for number in size.ravel() if np.isfinite(number) and 0 < number < 2**31)
        if len(shape) == size.size and 0 < len(shape) <= _MAX_DIMENSIONS and prod(shape) == values.size:
            self._hold(Block(name, values.reshape(shape, order="F"), **labels), line)
        else:
            message = f"{name}.size does not match its {count_noun(values.size, 'value')}"
            self.findings.error(line, name, message)

    def _over_axes(self, name: str, values: Float, axes: list[Axis], labels: dict[str, Any], line: int) -> None:
        shape = tuple(map(len, axes))
        # MATLAB drops trailing sizes of 1
        padded = values.shape + (1,) * (len(shape) - values.ndim)
        if (len(shape) == 1 and values.size == shape[0]) or drop_trailing_ones(padded) == drop_trailing_ones(shape):
            self._hold(parameter(name, turn(values.reshape(shape, order="F"), axes), axes, **labels), line)
        elif len(shape) == 2 and padded == shape[::-1]:
            message = f"has one row per y breakpoint ({shape[1]}); read transposed"
            self.findings.warning(line, name, message, "Transpose the values: one row per x breakpoint.")
            self._hold(parameter(name, turn(values.T, axes), axes, **labels), line)
        else:
            required, size = (size_text(sizes) for sizes in (shape, values.shape))
            self.findings.error(line, name, f"has values of size {size}, but its axes require {required}")

    def _axis(self, name: str, struct: StructValue, letter: str, points: Float, line: int) -> Axis | None:
        axis = self._checked_axis(name, struct, letter, points, _text_of(struct, f"{letter}name"), line)
        if axis is None or not axis.name:
            return axis
        user, known = self.groups.setdefault(axis.name, (name, axis))
        if np.array_equal(known.breakpoints, axis.breakpoints):
            return axis
        message = f"{name}.{letter} has other breakpoints than the group axis {axis.name} has in {user}"
        self.findings.error(line, name, message, "A group axis must be the same everywhere.")
        return None

    def _checked_axis(
        self, owner: str, struct: StructValue, letter: str, points: Float, name: str, line: int
    ) -> Axis | None:
        points, falls = in_rising_order(points.ravel())
        if not points.size or not np.isfinite(points).all():
            message = "has no breakpoints" if not points.size else "has non-finite breakpoints"
            self.findings.error(line, owner, f"{owner}.{letter} {message}")
            return None
        if fall := describe_fall(points):
            message = f"{owner}.{letter} neither rises nor falls: {fall}; skipped"
            self.findings.warning(line, owner, message, "Correct its breakpoints.")
            return None
        quantity, unit = (_text_of(struct, f"{letter}{key}") for key in ("input", "unit"))
        return Axis(points, quantity, unit, name, falling=falls)

    def _spare_axis(self, name: str, struct: StructValue, line: int) -> None:
        points = _numbers(struct.get(["x"]))
        axis = self._checked_axis(name, struct, "x", np.zeros(0) if points is None else points, name, line)
        if axis is not None:
            _, known = self.groups.setdefault(name, (name, axis))
            if not np.array_equal(known.breakpoints, axis.breakpoints):
                self.findings.error(line, name, f"the group axis {name} has other breakpoints in a table")


def _table_parts(struct: StructValue) -> tuple[Float | None, list[Float | None]]:
    """Return the values of a table and its axes, in whichever fields they are."""
    known = set(struct.folded())
    if not known.intersection(_VALUES):  # x and y, or x, y and z
        letters = "xyz" if "z" in known else "xy"
        *axes, values = (_numbers(struct.get([letter])) for letter in letters)
        return values, axes
    values = _numbers(struct.get(_VALUES))
    breakpoints = struct.get(["breakpoints"])
    if breakpoints is not None:
        listed = breakpoints if isinstance(breakpoints, list) else [breakpoints]
        return values, list(map(_numbers, listed[:_MAX_DIMENSIONS]))
    # y counts only beside x, and z beside both
    return values, [_numbers(struct.get(names)) for names in takewhile(known.intersection, _AXES)]


def _numbers(value: "Value | None") -> Float | None:
    """Return the numbers of a value, or of the field that holds them in a struct."""
    for _ in range(5):
        if not isinstance(value, StructValue):
            break
        value = value.get(_VALUES)
    return value if isinstance(value, np.ndarray) and value.size else None


def _text_of(struct: StructValue, *names: str) -> str:
    """Return the text in the first field of some names, given folded; empty for anything else."""
    value = struct.get(names)
    return value if isinstance(value, str) else ""
