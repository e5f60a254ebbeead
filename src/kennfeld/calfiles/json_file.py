"""`parameters.json`: the values a run leaves, one entry a parameter, a row for each x.

    {"b1": {"kind": "scalar", "unit": "", "value": 1.0},
     "MapX": {"kind": "map", "unit": "Nm", "x": [1, 2], "y": [0, 9], "values": [[1, 2], [3, 4]]},
     "Model": {"kind": "rbf", "unit": "", "inputs": ["n"], "offset": 1, "slopes": [0],
               "weights": [2], "centres": [[3]], "widths": [[0.5]]}}

`description`, `functions`, `display_name` and `variant`, and `x_name`, `x_unit`, `x_input` of each axis, are left out
where empty, `extrapolation` of a table where it is "clip"; `others` lists further variants as entries of their own. A
group axis that no table uses is an entry of kind "axis". Numbers that are not finite are null.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult
from kennfeld.errors import ArgumentError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Text, TextKind, parameter
from kennfeld.rbf import RBF, Expansion

__all__ = ["write_json"]

_TABLES = {"scalar": "", "curve": "x", "map": "xy", "cube": "xyzw"}
_PARTS = ("offset", "slopes", "weights", "centres", "widths")
_TEXTS: tuple[TextKind, ...] = ("text", "enumeration", "boolean")
_KINDS = (*_TABLES, "block", "rbf", *_TEXTS, "axis")
_ATTRIBUTES = ("name", "unit", "input")
_LABELS = ("description", "display_name", "variant")


def recognises_json(text: str) -> bool:
    """Whether a text begins like a JSON object."""
    return text.lstrip().startswith("{")


def write_json(parameters: ParameterSet, file: str) -> str:
    """The text of a `parameters.json`; bounds and locks stay with the project.

    Raises `InputError` where two entries would have the same name.
    """
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    others: dict[str, list[dict[str, Any]]] = {}
    for thing in parameters.others:
        others.setdefault(thing.name, []).append(_entry_of(thing))
    entries = [
        (thing.name, _entry_of(thing) | ({"others": others[thing.name]} if thing.name in others else {}))
        for thing in parameters.chosen
    ]
    entries += [(axis.name, _axis_entry(axis)) for axis in parameters.axes if axis.name not in used]
    notes, seen = Findings(file), set[str]()
    for name, _ in entries:
        if name in seen:
            notes.error(0, name, "is given twice", "Rename one of the two.")
        seen.add(name)
    notes.settle()
    return "{" + ",".join(f"\n {_compact(name)}: {_laid_out(entry)}" for name, entry in entries) + "\n}\n"


def _entry_of(thing: Parameter | Text) -> dict[str, Any]:
    return _text_entry(thing) if isinstance(thing, Text) else _entry(thing)


def _labels_of(thing: Parameter | Text) -> dict[str, Any]:
    labels = {key: getattr(thing, key) for key in _LABELS if getattr(thing, key)}
    return labels | ({"functions": list(thing.functions)} if thing.functions else {})


def _entry(member: Parameter) -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": member.kind, "unit": member.unit} | _labels_of(member)
    if isinstance(member, RBF):
        parts = {part: getattr(member.expansion, part) for part in _PARTS}
        return entry | {"inputs": list(member.inputs)} | {name: np.asarray(a).tolist() for name, a in parts.items()}
    for letter, axis in zip("xyzw", member.axes, strict=False):
        entry |= {f"{letter}_{key}": getattr(axis, key) for key in _ATTRIBUTES if getattr(axis, key)}
        entry[letter] = axis.breakpoints.tolist()
    if member.axes and member.extrapolation != "clip":
        entry["extrapolation"] = member.extrapolation
    entry["value" if member.kind == "scalar" else "values"] = _nullable(member.values)
    return entry


def _text_entry(text: Text) -> dict[str, Any]:
    unit = {"unit": text.unit} if text.unit else {}
    return {"kind": text.kind, "text": text.text} | unit | _labels_of(text)


def _axis_entry(axis: Axis) -> dict[str, Any]:
    own = {"kind": "axis", "unit": axis.unit} | ({"input": axis.input} if axis.input else {})
    return own | {"x": axis.breakpoints.tolist()}


def _nullable(values: Float) -> Any:
    if np.isfinite(values).all():
        return values.tolist()
    made = values.astype(object)
    made[~np.isfinite(values)] = None
    return made.tolist()


def _laid_out(entry: dict[str, Any]) -> str:
    """One line an entry, but one line a row of a table of several dimensions: files that people compare."""
    values = entry.get("values")
    if not values or not isinstance(values[0], list):
        return _compact(entry)
    head = _compact({key: value for key, value in entry.items() if key != "values"})
    rows = ",\n  ".join(map(_compact, values))
    return f'{head[:-1]}, "values": [\n  {rows}]}}'


def _compact(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def read_json(source: CalibrationSource) -> ReadResult:
    """The parameters of a `parameters.json`; null is read as NaN.

    Raises `InputError` with every finding and its path, like `MapX.values[3]`.
    """
    notes = Findings(source.name)
    entries = _loaded(source.text, notes)
    reader = _JsonReader(notes)
    if entries and not any(isinstance(entry, _Pairs) and "kind" in entry for _, entry in entries):
        remedy = 'Each entry needs a kind and values: {"K": {"kind": "scalar", "unit": "", "value": 1.0}}'
        notes.error(0, "", "is JSON, but holds no parameters", remedy)
        entries = []
    for name, entry in entries:
        reader.take(name, entry)
    members = reader.agreed()
    remarks = notes.settle()
    return ReadResult("JSON", ParameterSet(members, reader.texts, reader.axes.values(), reader.others), remarks)


def _loaded(text: str, notes: Findings) -> list[tuple[str, Any]]:
    """The entries in their order, each key of which a finding could be told twice."""
    try:
        pairs = json.loads(text.removeprefix("\ufeff"), object_pairs_hook=_Pairs, parse_int=float)
    except json.JSONDecodeError as error:
        line = text.split("\n")[error.lineno - 1] if error.lineno <= text.count("\n") + 1 else ""
        notes.error(error.lineno, "", f"is no valid JSON: {error.msg}", "The file may be cut off.", line)
        return []
    except RecursionError:
        notes.error(0, "", "nests its lists too deeply")
        return []
    assert isinstance(pairs, _Pairs)
    for name in pairs.repeated():
        notes.error(0, name, "is given twice", "Keep one of the two.")
    return list(pairs.items())


class _Pairs(dict[str, Any]):
    """A JSON object that remembers the keys it was given more than once."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self._given = [key for key, _ in pairs]

    def repeated(self) -> list[str]:
        if len(self) == len(self._given):
            return []
        seen = set[str]()
        return [key for key in self._given if key in seen or seen.add(key)]  # type: ignore[func-returns-value]


class _JsonReader:
    def __init__(self, notes: Findings) -> None:
        self.notes = notes
        self.members: list[Parameter] = []
        self.texts: list[Text] = []
        self.others: list[Parameter | Text] = []
        self.axes: dict[str, Axis] = {}

    def take(self, name: str, entry: Any) -> None:
        if not isinstance(entry, _Pairs):
            return self._wrong(name, "is no object with a kind and values")
        for key in entry.repeated():
            self._wrong(f"{name}.{key}", "is given twice")
        kind = entry.get("kind")
        if kind not in _KINDS:
            guess = nearest(kind, _KINDS) if isinstance(kind, str) else ""
            return self._wrong(f"{name}.kind", f"{kind!r} is no kind of parameter", guess or ", ".join(_KINDS))
        self._unknown_keys(name, kind, entry)
        if kind in _TEXTS:
            text, unit = self._string(name, entry, "text"), self._string(name, entry, "unit")
            self.texts.append(Text(name, text, kind=kind, unit=unit, **self._labels(name, entry)))
        elif kind == "axis":
            self._spare_axis(name, entry)
        elif kind == "rbf":
            self._rbf(name, entry)
        else:
            self._table(name, kind, entry)
        self._take_others(name, entry)
        return None

    def _take_others(self, name: str, entry: _Pairs) -> None:
        """Further variants of an entry."""
        given = entry.get("others", [])
        if not isinstance(given, list):
            return self._wrong(f"{name}.others", f"{_shown(given)} is no list of entries")
        inner = _JsonReader(self.notes)
        for other in given:
            inner.take(name, other)
        found: list[Parameter | Text] = [*inner.members, *inner.texts]
        variants = [str(entry.get("variant", "")), *(thing.variant for thing in found)]
        twice = sorted({one for one in variants if variants.count(one) > 1})
        for variant in twice:
            self._wrong(f"{name}.others", f"the variant {variant!r} is given twice", "Keep one of the two.")
        self.others += found if not twice else []
        return None

    def _labels(self, name: str, entry: _Pairs) -> dict[str, Any]:
        labels: dict[str, Any] = {key: self._string(name, entry, key) for key in _LABELS}
        functions = entry.get("functions", [])
        if isinstance(functions, list) and all(isinstance(one, str) for one in functions):
            return labels | {"functions": tuple(functions)}
        self._wrong(f"{name}.functions", f"{_shown(functions)} is no list of names")
        return labels

    def _wrong(self, path: str, message: str, remedy: str = "") -> None:
        self.notes.error(0, "", f"{path}: {message}", remedy)

    def _unknown_keys(self, name: str, kind: str, entry: _Pairs) -> None:
        special: dict[str, set[str]] = {text: {"text"} for text in _TEXTS}
        special |= {"axis": {"x", "input"}, "rbf": {"inputs", *_PARTS}}
        known = {"kind", "unit", "functions", "others", *_LABELS} | special.get(kind, set())
        if kind not in (*_TEXTS, "axis", "rbf"):
            letters = _TABLES.get(kind, "")
            known |= {"value" if kind == "scalar" else "values", *letters}
            known |= {f"{letter}_{key}" for letter in letters for key in _ATTRIBUTES}
            known |= {"extrapolation"} if letters else set()
        for key in entry:
            if key not in known:
                self._wrong(f"{name}.{key}", f"is no key of a {kind}", nearest(key, known))

    def _string(self, name: str, entry: _Pairs, key: str) -> str:
        value = entry.get(key, "")
        if isinstance(value, str):
            return value
        self._wrong(f"{name}.{key}", f"{_shown(value)} is no text")
        return ""

    def _spare_axis(self, name: str, entry: _Pairs) -> None:
        points = self._points(name, entry, "x")
        if points is not None:
            unit, quantity = self._string(name, entry, "unit"), self._string(name, entry, "input")
            self.axes[name] = Axis(points, quantity, unit, name)

    def _table(self, name: str, kind: str, entry: _Pairs) -> None:
        letters = _TABLES.get(kind, "")
        letters = letters if kind != "cube" or "w" in entry else "xyz"
        axes = [self._axis(name, entry, letter) for letter in letters]
        attributes = self._labels(name, entry) | {"unit": self._string(name, entry, "unit")}
        if letters and "extrapolation" in entry:
            attributes["extrapolation"] = self._extrapolation(name, entry)
        own = [axis for axis in axes if axis is not None]
        shape = [len(axis) for axis in own]
        key = "value" if kind == "scalar" else "values"
        if key not in entry:
            return self._wrong(f"{name}.{key}", "is missing")
        if len(own) < len(axes):
            return None
        if kind == "block":
            shape = _shape_of(entry[key])
            if not 1 <= len(shape) <= 4:
                return self._wrong(f"{name}.{key}", f"a value block has one to four dimensions, not {len(shape)}")
        values = list(self._numbers(entry[key], shape, f"{name}.{key}"))
        if len(values) == int(np.prod(shape)):
            self._build(name, kind, np.array(values, dtype=np.float64).reshape(shape), own, attributes)
        return None

    def _extrapolation(self, name: str, entry: _Pairs) -> str:
        given = entry["extrapolation"]
        if given in ("clip", "linear"):
            return str(given)
        self._wrong(f"{name}.extrapolation", f"{_shown(given)} must be clip or linear")
        return "clip"

    def _build(self, name: str, kind: str, values: Float, axes: list[Axis], attributes: dict[str, Any]) -> None:
        try:
            made = Block(name, values, **attributes) if kind == "block" else parameter(name, values, axes, **attributes)
        except ArgumentError as error:
            self._wrong(name, str(error))
        else:
            self.members.append(made)

    def _rbf(self, name: str, entry: _Pairs) -> None:
        missing = [key for key in ("inputs", *_PARTS) if key not in entry]
        for key in missing:
            self._wrong(f"{name}.{key}", "is missing")
        if missing:
            return
        inputs, centres = (len(entry[k]) if isinstance(entry[k], list) else 0 for k in ("inputs", "weights"))
        parts = {}
        for key, shape in zip(_PARTS, ([], [inputs], [centres], [centres, inputs], [centres, inputs]), strict=True):
            numbers = list(self._numbers(entry[key], shape, f"{name}.{key}"))
            if len(numbers) < int(np.prod(shape)):
                return
            parts[key] = np.array(numbers, dtype=np.float64).reshape(shape)
        attributes = self._labels(name, entry) | {"unit": self._string(name, entry, "unit")}
        try:
            expansion = Expansion(float(parts.pop("offset")), *parts.values())
            self.members.append(RBF(name, expansion, list(map(str, entry["inputs"])), **attributes))
        except ArgumentError as error:
            self._wrong(name, str(error))

    def _axis(self, name: str, entry: _Pairs, letter: str) -> Axis | None:
        points = self._points(name, entry, letter)
        given = {key: self._string(name, entry, f"{letter}_{key}") for key in _ATTRIBUTES}
        return None if points is None else Axis(points, given["input"], given["unit"], given["name"])

    def _points(self, name: str, entry: _Pairs, letter: str) -> Float | None:
        path, given = f"{name}.{letter}", entry.get(letter)
        if not isinstance(given, list) or not given:
            message = "is missing" if letter not in entry else f"{_shown(given)} is no list of breakpoints"
            self._wrong(path, message)
            return None
        points = np.array(list(self._numbers(given, [len(given)], path)), dtype=np.float64)
        if len(points) < len(given):
            return None
        wrong = _wrong_points(points)
        if wrong:
            self._wrong(f"{path}[{wrong[0]}]", wrong[1])
        return None if wrong else points

    def _numbers(self, given: Any, shape: list[int], path: str) -> Iterator[float]:
        """The numbers of a nested list in order; what is no number or has another length is noted and skipped."""
        if not shape:
            number = _number(given)
            if number is None:
                return self._wrong(path, f"{_shown(given)} is no number")
            yield number
        elif not isinstance(given, list):
            self._wrong(path, f"{_shown(given)} is no list of {shape[0]}")
        elif len(given) != shape[0]:
            self._wrong(path, f"has {len(given)} entries, not {shape[0]}")
        else:
            for index, inner in enumerate(given):
                yield from self._numbers(inner, shape[1:], f"{path}[{index}]")
        return None

    def agreed(self) -> list[Parameter]:
        """The tables; a group axis with different breakpoints in two of them is noted."""
        first: dict[str, tuple[str, Axis]] = {name: (name, axis) for name, axis in self.axes.items()}
        for member in self.members:
            for letter, axis in zip("xyzw", member.axes, strict=False):
                user, known = first.setdefault(axis.name, (member.name, axis)) if axis.name else ("", axis)
                if not np.array_equal(known.breakpoints, axis.breakpoints):
                    self._wrong(f"{member.name}.{letter}", f"group axis {axis.name} has other breakpoints in {user}")
        return self.members


def _wrong_points(points: Float) -> tuple[int, str] | None:
    """Where an axis is wrong, and how."""
    for at in np.flatnonzero(~np.isfinite(points)):
        return int(at), "is no finite number"
    for at in np.flatnonzero(points[1:] <= points[:-1]):
        return int(at) + 1, f"the axis does not increase: {points[at + 1]:g} follows {points[at]:g}"
    return None


def _number(given: Any) -> float | None:
    if given is None:
        return float("nan")
    return given if isinstance(given, float) else None


def _shape_of(given: Any) -> list[int]:
    shape: list[int] = []
    while isinstance(given, list):
        shape.append(len(given))
        given = given[0] if given else None
    return shape


def _shown(value: Any) -> str:
    """A value as an error shows it; a list is only named, it may be long or deep."""
    if isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "an object"
    return "null" if value is None else repr(value)[:60]
