"""What MATLAB variables say as parameters, for scripts (.m) and data files (.mat) alike.

A number is a scalar, a vector or matrix a value block, a text a text. A struct with `x` (and `y`, ...) and `values`, a
row for each x, is a curve or map. Other people's names of these fields are understood too: `Value` and `Data`, the
fields of a Simulink.LookupTable, `Breakpoints`, whatever their case.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Scalar, Text, TextKind, parameter

__all__ = ["INFO", "StructValue", "UnreadableObject", "Value", "holds_samples", "parameters_of"]

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
_MOST_DIMENSIONS = 4
_FEW = 4096  # values; a matrix that a person calibrates has no more


@dataclass(frozen=True)
class UnreadableObject:
    """A variable that only MATLAB can read, with the name of its class."""

    kind: str


@dataclass
class StructValue:
    """A struct: its fields by name."""

    fields: dict[str, "Value"] = field(default_factory=dict)

    def folded(self) -> dict[str, str]:
        """Each field without regard to case and underscores."""
        return {_fold(name): name for name in reversed(self.fields)}

    def get(self, names: Iterable[str]) -> "Value | None":
        """The first field of some names, given folded, that the struct has."""
        known = self.folded()
        return next((self.fields[known[name]] for name in names if name in known), None)


Value = Float | str | StructValue | UnreadableObject | list[Any]  # a list is a cell array, or an array of structs


def _fold(name: str) -> str:
    return name.replace("_", "").casefold()


def parameters_of(
    variables: Mapping[str, Value], notes: Findings, lines: Mapping[str, int] | None = None
) -> ParameterSet:
    """The parameters of all variables in their order; what none is made of is remarked.

    `lines` gives the line in which a variable begins, where there are lines. Of several variants the first counts.
    """
    reader = _StructReader(notes, lines or {})
    info = variables.get(INFO)
    reader.info = info.fields if isinstance(info, StructValue) else {}
    for name, value in variables.items():
        if name != INFO:
            reader.take(name, value, reader.lines.get(name, 0))
    reader.tell_left_aside()
    return reader.parameters()


def holds_samples(variables: Mapping[str, Value]) -> str:
    """The name of what shows that variables are recorded samples; empty where they can be a calibration."""
    if INFO in variables or any(_is_table(value) for value in variables.values()):
        return ""
    return next(filter(None, (_samples(name, value, 0) for name, value in variables.items())), "")


def _samples(name: str, value: Value, depth: int) -> str:
    if isinstance(value, UnreadableObject):
        return name if value.kind.casefold() in ("timeseries", "timetable", "dataset") else ""
    if isinstance(value, np.ndarray):
        flat = value.ravel()
        rising = value.size > 1 and bool(np.all(flat[1:] > flat[:-1]))
        is_time = _fold(name.rpartition(".")[2]) in _TIMES and rising
        return name if value.size > _FEW or is_time else ""
    if not isinstance(value, StructValue) or depth > 5:
        return ""
    if {"time", "signals"} <= value.folded().keys():
        return name
    return next(filter(None, (_samples(f"{name}.{key}", inner, depth + 1) for key, inner in value.fields.items())), "")


def _is_table(value: Value) -> bool:
    if not isinstance(value, StructValue):
        return False
    known = value.folded().keys()
    axes = any(set(names) & known for names in _AXES) or "breakpoints" in known
    return bool(axes and set(_VALUES) & known) or any(_is_table(inner) for inner in value.fields.values())


@dataclass
class _StructReader:
    notes: Findings
    lines: Mapping[str, int]
    info: dict[str, Value] = field(default_factory=dict)
    things: dict[tuple[str, str], Parameter | Text] = field(default_factory=dict)
    groups: dict[str, tuple[str, Axis]] = field(default_factory=dict)
    unknown: dict[str, None] = field(default_factory=dict)  # fields that say nothing to a calibration

    def parameters(self) -> ParameterSet:
        first = {name: (name, variant) for name, variant in reversed(self.things)}
        chosen = [thing for key, thing in self.things.items() if first[key[0]] == key]
        return ParameterSet(
            [thing for thing in chosen if isinstance(thing, Parameter)],
            [thing for thing in chosen if isinstance(thing, Text)],
            [axis for _, axis in self.groups.values()],
            [thing for key, thing in self.things.items() if first[key[0]] != key],
        )

    def tell_left_aside(self) -> None:
        if self.unknown:
            names = list(self.unknown)
            said = ", ".join(names[:8]) + (" and others" if len(names) > 8 else "")
            self.notes.remark(0, "", f"the fields {said} say nothing about values; left aside")

    def take(self, name: str, value: Value, line: int, depth: int = 0) -> None:
        """Make a parameter of a variable, or of each field of a struct that only groups them."""
        if isinstance(value, StructValue):
            self._struct(name, value, line, depth)
        elif isinstance(value, str):
            self._text(name, value, self.info.get(name), line)
        elif isinstance(value, np.ndarray):
            self._plain(name, value, self._labels(name, self.info.get(name)), line)
        elif isinstance(value, UnreadableObject):
            message = f"is a {value.kind or 'object'}, which only MATLAB itself can read; left aside"
            self.notes.remark(
                line, name, message, "Save its numbers, such as p.Value, as plain variables or in a script."
            )
        else:
            self.notes.remark(line, name, "is a cell array, which no parameter is made of; left aside")

    def _plain(self, name: str, value: Float, labels: dict[str, Any], line: int) -> None:
        values = value.ravel() if value.ndim == 2 and 1 in value.shape else value
        if values.size == 0:
            self.notes.remark(line, name, "is empty; left aside")
        elif values.size == 1:
            self._hold(Scalar(name, float(values.ravel()[0]), **labels), line)
        elif values.ndim > _MOST_DIMENSIONS:
            message = f"has {values.ndim} dimensions, a value block at most {_MOST_DIMENSIONS}; left aside"
            self.notes.remark(line, name, message)
        else:
            self._hold(Block(name, values, **labels), line)

    def _text(self, name: str, text: str, more: Value | None, line: int) -> None:
        said = _text(more.get(["kind"])) if isinstance(more, StructValue) else ""
        kind: TextKind = next((known for known in _TEXT_KINDS if known == said), "text")
        self._hold(Text(name, text, kind=kind, **self._labels(name, more)), line)

    def _hold(self, thing: Parameter | Text, line: int) -> None:
        key = (thing.name, thing.variant)
        same = [known for (name, _), known in self.things.items() if name == thing.name] if thing.variant else []
        if key in self.things or any(isinstance(known, Text) != isinstance(thing, Text) for known in same):
            self.notes.error(line, thing.name, f"{thing.name} is given twice", "Keep one of the two.")
        self.things[key] = thing

    def _struct(self, variable: str, struct: StructValue, line: int, depth: int) -> None:
        known = struct.folded()
        name = _text(struct.get(["name"])) or variable
        if _text(struct.get(["kind"])) == "axis":
            self._spare_axis(name, struct, line)
        elif isinstance(struct.get(["text"]), str):
            self._text(name, _text(struct.get(["text"])), struct, line)
        elif set(_VALUES) & known.keys() or {"x", "y"} <= known.keys():
            self._table(name, struct, line)
        elif depth > 20 or not struct.fields:
            self.notes.remark(line, variable, "is a struct without values; left aside")
        else:
            for inner, value in struct.fields.items():
                self.take(f"{variable}.{inner}", value, line, depth + 1)

    def _labels(self, name: str, more: Value | None) -> dict[str, Any]:
        if not isinstance(more, StructValue):
            return {}
        functions = more.get(["functions"])
        listed = functions if isinstance(functions, list) else [functions] if functions else []
        return {
            "unit": _text(more.get(_UNITS)),
            "description": _text(more.get(_DESCRIPTIONS)),
            "functions": tuple(one for one in listed if isinstance(one, str)),
            "display_name": _text(more.get(["displayname"])),
            "variant": _text(more.get(["variant"])),
        }

    def _table(self, name: str, struct: StructValue, line: int) -> None:
        labels = self._labels(name, struct)
        values, points = _parts(struct)
        self._note_unknown(struct)
        if values is None or any(axis is None for axis in points):
            broken = next((letter for letter, axis in zip(_LETTERS, points, strict=False) if axis is None), "")
            wrong = "values" if values is None else broken
            self.notes.error(line, name, f"{name}.{wrong} holds no numbers", "Assign numbers in brackets.")
        elif not points:
            self._sized(name, values, struct, labels, line)
        else:
            axes = [self._axis(name, struct, at, cast(Any, axis), line) for at, axis in enumerate(points)]
            known = [axis for axis in axes if axis is not None]
            if len(known) == len(axes):
                self._over_axes(name, values, known, labels, line)

    def _note_unknown(self, struct: StructValue) -> None:
        known = _KNOWN | set(_VALUES) | {name for names in _AXES for name in names}
        known |= {f"{letter}{word}" for letter in _LETTERS for word in ("name", "unit", "input")}
        self.unknown |= {name: None for folded, name in struct.folded().items() if folded not in known}

    def _sized(self, name: str, values: Float, struct: StructValue, labels: dict[str, Any], line: int) -> None:
        """A struct with values alone; `size` tells a block from a scalar, and shapes that MATLAB has no place for."""
        size = struct.get(["size"])
        if not isinstance(size, np.ndarray):
            self._plain(name, values, labels, line)
            return
        shape = tuple(int(number) for number in size.ravel() if np.isfinite(number) and 0 < number < 2**31)
        if (
            len(shape) != size.size
            or not 0 < len(shape) <= _MOST_DIMENSIONS
            or np.prod(shape, dtype=object) != values.size
        ):
            message = f"{name}.size does not fit its {count_noun(values.size, 'value')}"
            self.notes.error(line, name, message)
            return
        self._hold(Block(name, values.reshape(shape, order="F"), **labels), line)

    def _over_axes(self, name: str, values: Float, axes: list[Axis], labels: dict[str, Any], line: int) -> None:
        shape = tuple(map(len, axes))
        found = values.shape + (1,) * (len(shape) - values.ndim)
        if (len(shape) == 1 and values.size == shape[0]) or _without_ones(found) == _without_ones(shape):
            self._hold(parameter(name, values.reshape(shape, order="F"), axes, **labels), line)
        elif len(shape) == 2 and found == shape[::-1]:
            message = f"has a row for each of the {shape[1]} y breakpoints; it is read turned"
            self.notes.remark(line, name, message, "Transpose the values: a row for each x.")
            self._hold(parameter(name, values.T, axes, **labels), line)
        else:
            wanted, given = (" x ".join(map(str, sizes)) for sizes in (shape, values.shape))
            self.notes.error(line, name, f"has values of size {given}, its axes ask for {wanted}")

    def _axis(self, name: str, struct: StructValue, at: int, points: Float, line: int) -> Axis | None:
        letter = _LETTERS[at]
        said = {word: _text(struct.get([letter + word])) for word in ("name", "unit", "input")}
        axis = self._checked(f"{name}.{letter}", points.ravel(), said["input"], said["unit"], said["name"], line)
        if axis is None or not axis.name:
            return axis
        user, known = self.groups.setdefault(axis.name, (name, axis))
        if not np.array_equal(known.breakpoints, axis.breakpoints):
            message = f"{name}.{letter} has other breakpoints than the group axis {axis.name} has in {user}"
            self.notes.error(line, name, message, "A group axis is the same everywhere.")
            return None
        return axis

    def _checked(self, path: str, points: Float, quantity: str, unit: str, name: str, line: int) -> Axis | None:
        falling = np.flatnonzero(~(points[1:] > points[:-1]))
        if not points.size or not np.isfinite(points).all():
            message = "has no breakpoints" if not points.size else "has breakpoints that are not finite"
        elif falling.size:
            at = int(falling[0])
            message = f"does not increase: breakpoint {at + 2} is {points[at + 1]:g} after {points[at]:g}"
        else:
            return Axis(points, quantity, unit, name)
        self.notes.error(line, path.rpartition(".")[0], f"{path} {message}")
        return None

    def _spare_axis(self, name: str, struct: StructValue, line: int) -> None:
        points = _numbers(struct.get(["x"]))
        said = {word: _text(struct.get(["x" + word])) for word in ("unit", "input")}
        axis = self._checked(
            f"{name}.x", np.zeros(0) if points is None else points.ravel(), said["input"], said["unit"], name, line
        )
        if axis is not None:
            _, known = self.groups.setdefault(name, (name, axis))
            if not np.array_equal(known.breakpoints, axis.breakpoints):
                self.notes.error(line, name, f"the group axis {name} has other breakpoints in a table")


def _parts(struct: StructValue) -> tuple[Float | None, list[Float | None]]:
    """The values of a table and its axes, in whichever fields they are."""
    known = struct.folded().keys()
    if not set(_VALUES) & known:  # x and y, or x, y and z
        letters = "xyz" if "z" in known else "xy"
        *axes, values = (_numbers(struct.get([letter])) for letter in letters)
        return values, axes
    values = _numbers(struct.get(_VALUES))
    listed = struct.get(["breakpoints"])
    if listed is not None:
        given = listed if isinstance(listed, list) else [listed]
        return values, [_numbers(one) for one in given[:_MOST_DIMENSIONS]]
    axes = []
    for names in _AXES:
        if not set(names) & known:
            break
        axes.append(_numbers(struct.get(names)))
    return values, axes


def _numbers(value: "Value | None") -> Float | None:
    """The numbers of a value, or of the field that holds them in a struct."""
    for _ in range(5):
        if not isinstance(value, StructValue):
            break
        value = value.get(_VALUES)
    return value if isinstance(value, np.ndarray) and value.size else None


def _text(value: "Value | None") -> str:
    return value if isinstance(value, str) else ""


def _without_ones(sizes: tuple[int, ...]) -> tuple[int, ...]:
    kept = len(sizes)
    while kept > 1 and sizes[kept - 1] == 1:
        kept -= 1
    return sizes[:kept]
