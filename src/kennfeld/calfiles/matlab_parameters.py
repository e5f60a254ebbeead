"""Converts MATLAB variables to parameters, for scripts (.m) and data files (.mat) alike.

A number is a scalar, a vector or matrix a value block, a text a text. A struct with `x` (and `y`, ...) and `values`,
one row per x, is a curve or map. Common other names of these fields are supported regardless of case: `Value` and
`Data`, the fields of a Simulink.LookupTable, `Breakpoints`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings, build_set, drop_trailing_ones
from kennfeld.formatting import count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Scalar, Text, TextKind, parameter

INFO = "kennfeld_info"  # the struct that says more about variables which are plain numbers
_LETTERS = "xyzw"
_VALUES = ("values", "value", "data", "table", "tabledata")
_AXES = tuple(
    (
        letter,
        f"{letter}axis",
        f"{letter}breakpoints",
        f"breakpoints{number}",
        f"bp{number}",
        f"{letter}values",
        f"{letter}data",
    )
    for number, letter in enumerate(_LETTERS, 1)
)
_UNITS = ("unit", "units", "docunits")
_DESCRIPTIONS = ("description", "desc", "comment")
_KNOWN = {"name", "text", "functions", "displayname", "variant", "kind", "size", "breakpoints", *_UNITS, *_DESCRIPTIONS}
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
        return {_fold_name(name): name for name in reversed(self.fields)}

    def get(self, names: Iterable[str]) -> "Value | None":
        """Return the first field of some names, given folded, that the struct has."""
        known = self.folded()
        return next((self.fields[known[name]] for name in names if name in known), None)


Value = Float | str | StructValue | UnreadableObject | list[Any]  # a list is a cell array, or an array of structs


def _fold_name(name: str) -> str:
    return name.replace("_", "").casefold()


def parameters_of(
    variables: Mapping[str, Value], findings: Findings, lines: Mapping[str, int] | None = None
) -> ParameterSet:
    """Convert all variables to parameters, in order; those that cannot be converted are reported.

    `lines` gives the line in which a variable begins, where there are lines. Of several variants the first counts.
    """
    reader = _StructReader(findings, lines or {})
    info = variables.get(INFO)
    reader.info = info.fields if isinstance(info, StructValue) else {}
    for name, value in variables.items():
        if name != INFO:
            reader.take(name, value, reader.lines.get(name, 0))
    reader.report_unknown_fields()
    return reader.parameters()


def holds_samples(variables: Mapping[str, Value]) -> str:
    """Return the name of a variable that shows recorded samples; empty if it can be a calibration."""
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
    return next(
        filter(None, (_sample_name(f"{name}.{key}", inner, depth + 1) for key, inner in value.fields.items())), ""
    )


def _is_table(value: Value) -> bool:
    if not isinstance(value, StructValue):
        return False
    known = value.folded().keys()
    axes = any(set(names) & known for names in _AXES) or "breakpoints" in known
    return bool(axes and set(_VALUES) & known) or any(_is_table(inner) for inner in value.fields.values())


@dataclass
class _StructReader:
    findings: Findings
    lines: Mapping[str, int]
    info: dict[str, Value] = field(default_factory=dict)
    items: dict[tuple[str, str], Parameter | Text] = field(default_factory=dict)
    groups: dict[str, tuple[str, Axis]] = field(default_factory=dict)
    unknown: dict[str, None] = field(default_factory=dict)  # fields that say nothing to a calibration

    def parameters(self) -> ParameterSet:
        return build_set(self.items, [axis for _, axis in self.groups.values()])

    def report_unknown_fields(self) -> None:
        if self.unknown:
            names = list(self.unknown)
            said = ", ".join(names[:8]) + (" and others" if len(names) > 8 else "")
            self.findings.warning(0, "", f"unknown fields skipped: {said}")

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
            self.findings.warning(
                line, name, message, "Save its numbers, such as p.Value, as plain variables or in a script."
            )
        else:
            self.findings.warning(line, name, "is a cell array, which cannot be a parameter; skipped")

    def _plain(self, name: str, value: Float, labels: dict[str, Any], line: int) -> None:
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
        said = _text_or_empty(more.get(["kind"])) if isinstance(more, StructValue) else ""
        kind: TextKind = next((known for known in _TEXT_KINDS if known == said), "text")
        self._hold(Text(name, text, kind=kind, **self._labels(name, more)), line)

    def _hold(self, item: Parameter | Text, line: int) -> None:
        key = (item.name, item.variant)
        same = [known for (name, _), known in self.items.items() if name == item.name] if item.variant else []
        if key in self.items or any(isinstance(known, Text) != isinstance(item, Text) for known in same):
            self.findings.error(line, item.name, f"{item.name} is defined twice", "Keep one of the two.")
        self.items[key] = item

    def _struct(self, variable: str, struct: StructValue, line: int, depth: int) -> None:
        known = struct.folded()
        name = _text_or_empty(struct.get(["name"])) or variable
        if _text_or_empty(struct.get(["kind"])) == "axis":
            self._spare_axis(name, struct, line)
        elif isinstance(struct.get(["text"]), str):
            self._text(name, _text_or_empty(struct.get(["text"])), struct, line)
        elif set(_VALUES) & known.keys() or {"x", "y"} <= known.keys():
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
            "unit": _text_or_empty(more.get(_UNITS)),
            "description": _text_or_empty(more.get(_DESCRIPTIONS)),
            "functions": tuple(one for one in listed if isinstance(one, str)),
            "display_name": _text_or_empty(more.get(["displayname"])),
            "variant": _text_or_empty(more.get(["variant"])),
        }

    def _table(self, name: str, struct: StructValue, line: int) -> None:
        labels = self._labels(name, struct)
        values, points = _table_parts(struct)
        self._collect_unknown(struct)
        if values is None or any(axis is None for axis in points):
            broken = next((letter for letter, axis in zip(_LETTERS, points, strict=False) if axis is None), "")
            wrong = "values" if values is None else broken
            self.findings.error(line, name, f"{name}.{wrong} contains no numbers", "Assign numbers in brackets.")
        elif not points:
            self._sized(name, values, struct, labels, line)
        else:
            axes = [self._axis(name, struct, at, cast(Any, axis), line) for at, axis in enumerate(points)]
            known = [axis for axis in axes if axis is not None]
            if len(known) == len(axes):
                self._over_axes(name, values, known, labels, line)

    def _collect_unknown(self, struct: StructValue) -> None:
        known = _KNOWN | set(_VALUES) | {name for names in _AXES for name in names}
        known |= {f"{letter}{word}" for letter in _LETTERS for word in ("name", "unit", "input")}
        self.unknown |= {name: None for folded, name in struct.folded().items() if folded not in known}

    def _sized(self, name: str, values: Float, struct: StructValue, labels: dict[str, Any], line: int) -> None:
        """Add a struct with only values; `size` distinguishes blocks from scalars and keeps shapes MATLAB drops."""
        size = struct.get(["size"])
        if not isinstance(size, np.ndarray):
            self._plain(name, values, labels, line)
            return
        shape = tuple(int(number) for number in size.ravel() if np.isfinite(number) and 0 < number < 2**31)
        if (
            len(shape) != size.size
            or not 0 < len(shape) <= _MAX_DIMENSIONS
            or np.prod(shape, dtype=object) != values.size
        ):
            message = f"{name}.size does not match its {count_noun(values.size, 'value')}"
            self.findings.error(line, name, message)
            return
        self._hold(Block(name, values.reshape(shape, order="F"), **labels), line)

    def _over_axes(self, name: str, values: Float, axes: list[Axis], labels: dict[str, Any], line: int) -> None:
        shape = tuple(map(len, axes))
        found = values.shape + (1,) * (len(shape) - values.ndim)
        if (len(shape) == 1 and values.size == shape[0]) or drop_trailing_ones(found) == drop_trailing_ones(shape):
            self._hold(parameter(name, values.reshape(shape, order="F"), axes, **labels), line)
        elif len(shape) == 2 and found == shape[::-1]:
            message = f"has one row per y breakpoint ({shape[1]}); read transposed"
            self.findings.warning(line, name, message, "Transpose the values: one row per x breakpoint.")
            self._hold(parameter(name, values.T, axes, **labels), line)
        else:
            wanted, given = (" x ".join(map(str, sizes)) for sizes in (shape, values.shape))
            self.findings.error(line, name, f"has values of size {given}, but its axes require {wanted}")

    def _axis(self, name: str, struct: StructValue, at: int, points: Float, line: int) -> Axis | None:
        letter = _LETTERS[at]
        said = {word: _text_or_empty(struct.get([letter + word])) for word in ("name", "unit", "input")}
        axis = self._checked(f"{name}.{letter}", points.ravel(), said["input"], said["unit"], said["name"], line)
        if axis is None or not axis.name:
            return axis
        user, known = self.groups.setdefault(axis.name, (name, axis))
        if not np.array_equal(known.breakpoints, axis.breakpoints):
            message = f"{name}.{letter} has other breakpoints than the group axis {axis.name} has in {user}"
            self.findings.error(line, name, message, "A group axis must be the same everywhere.")
            return None
        return axis

    def _checked(self, path: str, points: Float, quantity: str, unit: str, name: str, line: int) -> Axis | None:
        falling = np.flatnonzero(~(points[1:] > points[:-1]))
        if not points.size or not np.isfinite(points).all():
            message = "has no breakpoints" if not points.size else "has non-finite breakpoints"
        elif falling.size:
            at = int(falling[0])
            message = f"is not strictly increasing: breakpoint {at + 2} is {points[at + 1]:g} after {points[at]:g}"
        else:
            return Axis(points, quantity, unit, name)
        self.findings.error(line, path.rpartition(".")[0], f"{path} {message}")
        return None

    def _spare_axis(self, name: str, struct: StructValue, line: int) -> None:
        points = _numbers(struct.get(["x"]))
        said = {word: _text_or_empty(struct.get(["x" + word])) for word in ("unit", "input")}
        axis = self._checked(
            f"{name}.x", np.zeros(0) if points is None else points.ravel(), said["input"], said["unit"], name, line
        )
        if axis is not None:
            _, known = self.groups.setdefault(name, (name, axis))
            if not np.array_equal(known.breakpoints, axis.breakpoints):
                self.findings.error(line, name, f"the group axis {name} has other breakpoints in a table")


def _table_parts(struct: StructValue) -> tuple[Float | None, list[Float | None]]:
    """Return the values of a table and its axes, in whichever fields they are."""
    known = struct.folded().keys()
    if not set(_VALUES) & known:  # x and y, or x, y and z
        letters = "xyz" if "z" in known else "xy"
        *axes, values = (_numbers(struct.get([letter])) for letter in letters)
        return values, axes
    values = _numbers(struct.get(_VALUES))
    listed = struct.get(["breakpoints"])
    if listed is not None:
        given = listed if isinstance(listed, list) else [listed]
        return values, [_numbers(one) for one in given[:_MAX_DIMENSIONS]]
    axes = []
    for names in _AXES:
        if not set(names) & known:
            break
        axes.append(_numbers(struct.get(names)))
    return values, axes


def _numbers(value: "Value | None") -> Float | None:
    """Return the numbers of a value, or of the field that holds them in a struct."""
    for _ in range(5):
        if not isinstance(value, StructValue):
            break
        value = value.get(_VALUES)
    return value if isinstance(value, np.ndarray) and value.size else None


def _text_or_empty(value: "Value | None") -> str:
    return value if isinstance(value, str) else ""
