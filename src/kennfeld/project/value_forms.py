"""Forms of particular values: arrays, ranges, locks, targets, initial files and the criteria of a step."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Fix
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import endings
from kennfeld.calfiles.label_list import ENDING as LABEL_LIST
from kennfeld.calfiles.label_list import VALUES as CHANGED_VALUES
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.domain.table_parts import Range
from kennfeld.project.forms import (
    INFINITE,
    EntryForm,
    FilesForm,
    Form,
    NumberForm,
    TableOfForm,
    TextForm,
    TextsForm,
)
from kennfeld.project.section import Section, as_finite, as_number, show
from kennfeld.project.simulation_files import SIMULATIONS

DIRECTIONS = ("x", "y", "z", "w")
FREE = "free"  # in place of breakpoints
Lock = bool | Literal["no-data"] | tuple[Range, ...]

_NUMBERS = {"type": "array", "items": {"type": "number"}}


class ArrayForm(Form):
    """A finite number, or nested lists of finite numbers."""

    label = "number or list of numbers"

    def read(self, section: Section, key: str) -> Float | None:
        values = as_array(section.values[key])
        if isinstance(values, str):
            section.report(key, values)
            return None
        if np.all(np.isfinite(values)):
            return values
        first = tuple(np.argwhere(~np.isfinite(values))[0])
        number = f" number {_describe_index(first)}" if first else ""
        section.report(key, f"value{number} must be finite, got {values[first]:g}")
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"type": ["number", "string", "array"]}


@dataclass(frozen=True)
class Around:
    """Bounds at a distance from the initial value, the larger one of `relative * |value|` and `absolute`."""

    relative: float = key("share of the magnitude of the initial value", 0.0, above=0, default_text="none")
    absolute: float = key("distance, in the unit of the parameter", 0.0, above=0, default_text="none")

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield that no distance is given."""
        if not present:
            yield "", "must have a distance from the initial value", "Write bounds = { relative = 0.1 }."

    def bounds(self, values: Float) -> tuple[Float, Float]:
        """Return the lower and upper bounds of initial values, in their shape."""
        distance = np.maximum(self.relative * np.abs(values), self.absolute)
        return values - distance, values + distance


_AROUND = EntryForm(Around)


class BoundsForm(Form):
    """A lower and an upper bound, each a number or nested lists of numbers, which may be infinite; or `Around`."""

    label = "`[lower, upper]` or table"

    def read(self, section: Section, key: str) -> tuple[Float, Float] | Around | None:
        pair = section.values[key]
        if isinstance(pair, dict):
            return _AROUND.read(section, key)  # type: ignore[no-any-return]
        if not isinstance(pair, list) or len(pair) != 2:
            section.report(key, "must be a lower and an upper bound", "Write bounds = [lower, upper].")
            return None
        sides: list[Float] = []
        for word, value in zip(("lower", "upper"), pair, strict=True):
            side = as_array(value)
            if isinstance(side, str):
                section.report(key, f"{word} bound: {side}")
            elif np.isnan(side).any():
                section.report(key, f"{word} bound: must be a number, got nan", "Write inf or -inf for no bound.")
            else:
                sides.append(side)
        return (sides[0], sides[1]) if len(sides) == 2 and _are_ordered(section, key, *sides) else None

    def write(self, value: tuple[Float, Float] | Around) -> Any:
        return _AROUND.write(value) if isinstance(value, Around) else super().write(value)

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [{"type": "array", "minItems": 2, "maxItems": 2}, _AROUND.json_schema()]}


def _are_ordered(section: Section, key: str, lower: Float, upper: Float) -> bool:
    """Report a lower bound above its upper bound. `parameter_tables` checks the shapes against the table."""
    if lower.ndim and upper.ndim and lower.shape != upper.shape:
        shapes = f"{list(lower.shape)} and {list(upper.shape)}"
        section.report(key, f"lower and upper bounds have different shapes, {shapes}")
        return False
    if not np.any(lower > upper):
        return True
    low, high = np.broadcast_arrays(lower, upper)
    first = tuple(np.argwhere(low > high)[0])
    at = f" at value {_describe_index(first)}" if first else ""
    ordered = [np.minimum(low, high).tolist(), np.maximum(low, high).tolist()]
    fixes = [replace(Fix.set((*section.keys, key), ordered), title="Swap them")]
    section.report(key, f"lower bound {low[first]:g} exceeds upper bound {high[first]:g}{at}", "Swap them.", fixes)
    return False


def _describe_index(index: Sequence[Any]) -> str:
    return ", ".join(str(int(i) + 1) for i in index)


class BreakpointsForm(Form):
    """Strictly increasing numbers, or "free"."""

    label = '`[...]` or `"free"`'

    def read(self, section: Section, key: str) -> tuple[float, ...] | str | None:
        value = section.values[key]
        if value == FREE:
            return FREE
        points = as_array(value)
        if isinstance(points, str):
            section.report(key, points)
        elif points.ndim != 1 or not np.all(np.isfinite(points)):
            section.report(key, "must be a list of finite numbers")
        elif (falling := np.flatnonzero(np.diff(points) <= 0)).size:
            at = int(falling[0])
            second, first = (f"breakpoint {i + 1} ({points[i]:g})" for i in (at + 1, at))
            message = f"must increase strictly: {second} does not exceed {first}"
            fix = Fix.set((*section.keys, key), np.unique(points).tolist())
            section.report(key, message, "Sort them and remove duplicates.", [replace(fix, title="Sort them")])
        else:
            return tuple(points.tolist())
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [_NUMBERS | {"minItems": 1}, {"const": FREE}]}


@dataclass(frozen=True)
class PairForm(Form):
    """Two numbers, which may be infinite; the second is larger, or may be equal.

    `message` and `remedy` report anything else; the message ends with the value if `shows`.
    """

    message: str
    remedy: str
    may_be_equal: bool = False
    shows: bool = False
    label = "`[lower, upper]`"

    def read(self, section: Section, key: str) -> tuple[float, float] | None:
        value, ends = section.values[key], _ends(section, key)
        if len(ends) == 2 and (ends[0] < ends[1] or (self.may_be_equal and ends[0] == ends[1])):
            return ends[0], ends[1]
        message = f"{self.message}, got {value!r}" if self.shows else self.message
        section.report(key, message, self.remedy.format(key=key))
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"type": "array", "items": INFINITE, "minItems": 2, "maxItems": 2}


class LimitPairForm(PairForm):
    """Two limits of slopes or curvatures, the lower one first."""

    def __init__(self) -> None:
        remedy = "Write {key} = [0, inf]; a limit of 0 makes the table monotonic."
        super().__init__("must be a range of two numbers", remedy, may_be_equal=True, shows=True)

    def read(self, section: Section, key: str) -> tuple[float, float] | None:
        ends = _ends(section, key)
        if len(ends) == 2 and ends[0] > ends[1]:
            fixes = [replace(Fix.set((*section.keys, key), ends[::-1]), title="Swap them")]
            section.report(key, f"lower limit {ends[0]:g} exceeds upper limit {ends[1]:g}", "Swap them.", fixes)
            return None
        return super().read(section, key)


def _ends(section: Section, key: str) -> list[float]:
    value = section.values[key]
    return [as_infinite(end) for end in value] if isinstance(value, list) else []


@dataclass(frozen=True)
class CoordinatesForm(Form):
    """A coordinate, or a list with one per axis; `may_be_infinite` allows the ends of an axis."""

    may_be_infinite: bool = False
    label = "number or list of numbers"

    def read(self, section: Section, key: str) -> tuple[float, ...] | None:
        value = section.values[key]
        numbers = [as_infinite(x) for x in (value if isinstance(value, list) else [value])]
        if all(math.isfinite(x) or (self.may_be_infinite and not math.isnan(x)) for x in numbers):
            return tuple(numbers)
        section.report(key, f"must be a list of coordinates, got {value!r}", "Write at = [x, y], one per axis.")
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [INFINITE if self.may_be_infinite else {"type": "number"}, {"type": "array"}]}


AXIS_RANGE = PairForm("must be the first and the last axis value", "Write {key} = [first, last].", may_be_equal=True)


class LockForm(Form):
    """True, false, "no-data", or a list of ranges."""

    blank = False
    label = '`true`, `"no-data"` or list of ranges'

    def read(self, section: Section, key: str) -> Lock | None:
        value = section.values[key]
        if isinstance(value, bool) or value == "no-data":
            return value  # type: ignore[no-any-return]
        if isinstance(value, list) and all(isinstance(part, dict) for part in value):
            parts = (section.inner(part, f"{key} {number}", key, number) for number, part in enumerate(value, 1))
            return tuple(self._range(part) for part in parts)
        remedy = 'Write true, "no-data" or a list of ranges, [{ x = [0, 10] }].'
        section.report(key, f"must be a lock, got {value!r}", remedy)
        return None

    def _range(self, section: Section) -> Range:
        if not section.values:
            section.report("", "the range is empty", "Write lock = true for the whole table.")
        present = [direction for direction in DIRECTIONS if direction in section.values]
        ends = {direction: AXIS_RANGE.read(section, direction) for direction in present}
        section.report_unknown(DIRECTIONS)
        return {direction: pair for direction, pair in ends.items() if pair is not None}

    def json_schema(self) -> dict[str, Any]:
        part = {
            "type": "object",
            "properties": dict.fromkeys(DIRECTIONS, AXIS_RANGE.json_schema()),
            "additionalProperties": False,
            "minProperties": 1,
        }
        return {"anyOf": [{"type": "boolean"}, {"const": "no-data"}, {"type": "array", "items": part}]}


@dataclass(frozen=True)
class TargetEntry:
    """Target of a criterion; a bare name is a channel, else a node."""

    kind: Literal["name", "channel", "node", "number"]
    name: str = ""
    value: float = 0.0


class TargetForm(Form):
    """A number, a name, or a table that names a channel or a node."""

    blank = TargetEntry("number", value=math.nan)
    label = "table, number or text"

    def read(self, section: Section, key: str) -> TargetEntry | None:
        value = section.values[key]
        number = as_finite(value)
        if number is not None:
            return TargetEntry("number", value=number)
        if isinstance(value, str) and value.strip():
            return TargetEntry("name", value)
        if not isinstance(value, dict):
            remedy = 'Write { channel = "..." }, { node = "..." }, a number or a name.'
            section.report(key, f"must be a channel, a node or a number, got {value!r}", remedy)
            return None
        inner = section.inner(value, key, key)
        names = {kind: TextForm().read(inner, kind) or "" for kind in ("channel", "node") if kind in value}
        inner.report_unknown(("channel", "node"))
        if len(names) != 1:
            inner.report("", "must be either a channel or a node", 'Write { channel = "..." } or { node = "..." }.')
        return TargetEntry("channel" if names.get("channel") else "node", names.get("channel") or names.get("node", ""))

    def write(self, value: TargetEntry) -> Any:
        plain = {"name": value.name, "number": value.value}
        return plain.get(value.kind, {value.kind: value.name})

    def json_schema(self) -> dict[str, Any]:
        names = {"type": "object", "additionalProperties": False, "minProperties": 1, "maxProperties": 1}
        names["properties"] = dict.fromkeys(("channel", "node"), TextForm().json_schema())
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": r"\S"}, names]}


@dataclass(frozen=True)
class ImageEntry:
    """An image of a control unit's memory in `initial`, and the A2L file that describes it."""

    hex: str = key(
        "image, Intel HEX or S-records", holds="image", missing='Write initial = { a2l = "ecu.a2l", hex = "ecu.hex" }.'
    )
    a2l: str = key("its A2L file", "", holds="A2L file")


class InitialForm(FilesForm):
    """A calibration file or an image, or a list of them."""

    def __init__(self) -> None:
        super().__init__(ImageEntry, "image", 'Write "start.dcm" or { a2l = "...", hex = "..." }.')


class FormatsForm(TextsForm):
    """Formats of one kind, stored as file extensions."""

    kind = ""

    def endings(self) -> Sequence[str]:
        """Return the known extensions."""
        raise NotImplementedError

    def read(self, section: Section, key: str) -> tuple[str, ...] | None:
        words = super().read(section, key) or ()
        return tuple(ending for word in words if (ending := self._ending(section, key, word)))

    def _ending(self, section: Section, key: str, word: str) -> str:
        ending = f".{word.casefold().removeprefix('.')}"
        if ending in self.endings():
            return ending
        known = [known.removeprefix(".") for known in self.endings()]
        remedy = nearest(word, known) or f"Choose from {', '.join(known)}."
        own = section.values[key]
        others = [other for other in (own if isinstance(own, list) else [own]) if other != word]
        similar = most_similar(word, known)
        meant = [] if similar in ("", *others) else [Fix.set((*section.keys, key), [*others, similar])]
        fixes = [replace(fix, title=f"Write {similar}") for fix in meant]
        if others:
            fixes.append(replace(Fix.set((*section.keys, key), others), title=f"Remove {word}"))
        section.report(key, f"unknown {self.kind} format {word!r}", remedy, fixes)
        return ""

    def write(self, value: tuple[str, ...]) -> list[str]:
        return [ending.removeprefix(".") for ending in value]


class OutputForm(FormatsForm):
    """Calibration formats."""

    kind = "calibration"

    def endings(self) -> Sequence[str]:
        """Return the extensions of calibration files."""
        return endings()


class ResultsForm(FormatsForm):
    """Formats of further results: simulations, and the changed labels, as a list or with their values."""

    kind = "result"

    def endings(self) -> Sequence[str]:
        """Return the extensions of further results."""
        return (*SIMULATIONS, LABEL_LIST, CHANGED_VALUES)


class StepCriteriaForm(Form):
    """Nodes and numbers of criteria, or their weights."""

    label = "list, or table of numbers >= 0"

    def read(self, section: Section, key: str) -> tuple[str | int, ...] | dict[str | int, float] | None:
        value = section.values[key]
        if isinstance(value, dict):
            weights = TableOfForm(NumberForm(least=0)).read(section, key) or {}
            # keys of TOML are texts: a number of a criterion is written as "2"
            return {(int(name) if name.isdecimal() else name): weight for name, weight in weights.items()}
        items = value if isinstance(value, list) else [value]
        if all(isinstance(item, str | int) and not isinstance(item, bool) for item in items):
            return tuple(items)
        remedy = 'Write criteria = ["node", 2] or criteria = { node = 1.0 }.'
        section.report(key, f"must name criteria, got {value!r}", remedy)
        return None

    def write(self, value: tuple[str | int, ...] | Mapping[str | int, float]) -> Any:
        return super().write(
            {str(name): weight for name, weight in value.items()} if isinstance(value, Mapping) else value
        )

    def json_schema(self) -> dict[str, Any]:
        name = {"type": ["string", "integer"]}
        weights = {"type": "object", "additionalProperties": NumberForm(least=0).json_schema()}
        return {"anyOf": [name, {"type": "array", "items": name}, weights]}


def as_infinite(value: Any) -> float:
    """Return a number, which may be infinite or the text "inf"; NaN for anything else."""
    if _is_infinite(value):
        return float(value)
    number = as_number(value)
    return math.nan if number is None else number


def _is_infinite(value: Any) -> bool:
    return isinstance(value, str) and value.strip().casefold() in ("inf", "+inf", "-inf")


def as_array(value: Any) -> Float | str:
    """Return a number or nested lists of numbers as an array, or a message if they are not.

    The texts "inf" and "-inf" are numbers.

    >>> as_array([[1, 2], [3, "inf"]])
    array([[ 1.,  2.],
           [ 3., inf]])
    >>> as_array([[1, 2], [3]])
    'rows must have equal length, got 2 and 1'
    """
    if not isinstance(value, list):
        number = float(value) if _is_infinite(value) else as_number(value)
        return f"must be a number, got {show(value)}" if number is None else np.array(number)
    if not value:
        return "lists must not be empty"
    parts: list[Float] = []
    for item in value:
        part = as_array(item)
        if isinstance(part, str):
            return part
        parts.append(part)
    # in order of appearance, so that the message compares the first two that differ
    shapes = list(dict.fromkeys(part.shape for part in parts))
    if len(shapes) == 1:
        return np.stack(parts)
    if len({len(shape) for shape in shapes}) > 1:
        return "must not mix numbers and lists"
    return f"rows must have equal length, got {shapes[0][0]} and {shapes[1][0]}"
