"""Reads and writes `parameters.json`, the values of a run: one entry per parameter, one row per x.

    {"b1": {"kind": "scalar", "unit": "", "value": 1.0},
     "MapX": {"kind": "map", "unit": "Nm", "x": [1, 2], "y": [0, 9], "values": [[1, 2], [3, 4]]},
     "Model": {"kind": "rbf", "unit": "", "inputs": ["n"], "offset": 1, "slopes": [0],
               "weights": [2], "centres": [[3]], "widths": [[0.5]]}}

`description`, `functions`, `display_name` and `variant`, and `x_name`, `x_unit`, `x_input` of each axis, are omitted
if empty, `extrapolation` of a table if it is "clip"; `others` lists further variants as entries of their own. A group
axis that no table uses is an entry of kind "axis". Non-finite numbers are null.
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

_TABLES = {"scalar": "", "curve": "x", "map": "xy", "cube": "xyzw"}
_PARTS = ("offset", "slopes", "weights", "centres", "widths")
_TEXTS: tuple[TextKind, ...] = ("text", "enumeration", "boolean")
_KINDS = (*_TABLES, "block", "rbf", *_TEXTS, "axis")
_AXIS_ATTRIBUTES = ("name", "unit", "input")
_LABELS = ("description", "display_name", "variant")


def recognises_json(text: str) -> bool:
    """Check whether a text begins like a JSON object."""
    return text.lstrip().startswith("{")


def write_json(parameters: ParameterSet, file: str) -> str:
    """Return the text of a `parameters.json`; bounds and locks are not stored.

    Raises `InputError` if two entries would have the same name.
    """
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    others: dict[str, list[dict[str, Any]]] = {}
    for item in parameters.others:
        others.setdefault(item.name, []).append(_entry_of(item))
    entries = [
        (item.name, _entry_of(item) | ({"others": others[item.name]} if item.name in others else {}))
        for item in parameters.chosen
    ]
    entries += [(axis.name, _axis_entry(axis)) for axis in parameters.axes if axis.name not in used]
    findings, seen = Findings(file), set[str]()
    for name, _ in entries:
        if name in seen:
            findings.error(0, name, "is defined twice", "Rename one of the two.")
        seen.add(name)
    findings.finish()
    return "{" + ",".join(f"\n {_format_compact(name)}: {_format_entry(entry)}" for name, entry in entries) + "\n}\n"


def _entry_of(item: Parameter | Text) -> dict[str, Any]:
    return _text_entry(item) if isinstance(item, Text) else _entry(item)


def _labels_of(item: Parameter | Text) -> dict[str, Any]:
    labels = {key: getattr(item, key) for key in _LABELS if getattr(item, key)}
    return labels | ({"functions": list(item.functions)} if item.functions else {})


def _entry(member: Parameter) -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": member.kind, "unit": member.unit} | _labels_of(member)
    if isinstance(member, RBF):
        parts = {part: getattr(member.expansion, part) for part in _PARTS}
        return entry | {"inputs": list(member.inputs)} | {name: np.asarray(a).tolist() for name, a in parts.items()}
    for letter, axis in zip("xyzw", member.axes, strict=False):
        entry |= {f"{letter}_{key}": getattr(axis, key) for key in _AXIS_ATTRIBUTES if getattr(axis, key)}
        entry[letter] = axis.breakpoints.tolist()
    if member.axes and member.extrapolation != "clip":
        entry["extrapolation"] = member.extrapolation
    entry["value" if member.kind == "scalar" else "values"] = _finite_or_null(member.values)
    return entry


def _text_entry(text: Text) -> dict[str, Any]:
    unit = {"unit": text.unit} if text.unit else {}
    return {"kind": text.kind, "text": text.text} | unit | _labels_of(text)


def _axis_entry(axis: Axis) -> dict[str, Any]:
    own = {"kind": "axis", "unit": axis.unit} | ({"input": axis.input} if axis.input else {})
    return own | {"x": axis.breakpoints.tolist()}


def _finite_or_null(values: Float) -> Any:
    if np.isfinite(values).all():
        return values.tolist()
    result = values.astype(object)
    result[~np.isfinite(values)] = None
    return result.tolist()


def _format_entry(entry: dict[str, Any]) -> str:
    """Format one entry per line, tables of several dimensions one row per line, for readable diffs."""
    values = entry.get("values")
    if not values or not isinstance(values[0], list):
        return _format_compact(entry)
    head = _format_compact({key: value for key, value in entry.items() if key != "values"})
    rows = ",\n  ".join(map(_format_compact, values))
    return f'{head[:-1]}, "values": [\n  {rows}]}}'


def _format_compact(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def read_json(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a `parameters.json`; null is read as NaN.

    Raises `InputError` with all findings and its path, like `MapX.values[3]`.
    """
    findings = Findings(source.name)
    entries = _load_entries(source.text, findings)
    reader = _JsonReader(findings)
    if entries and not any(isinstance(entry, _Pairs) and "kind" in entry for _, entry in entries):
        remedy = 'Each entry needs a kind and values: {"K": {"kind": "scalar", "unit": "", "value": 1.0}}'
        findings.error(0, "", "is JSON, but contains no parameters", remedy)
        entries = []
    for name, entry in entries:
        reader.take(name, entry)
    members = reader.agreed()
    remarks = findings.finish()
    return ReadResult("JSON", ParameterSet(members, reader.texts, reader.axes.values(), reader.others), remarks)


def _load_entries(text: str, findings: Findings) -> list[tuple[str, Any]]:
    """Return the entries in order; duplicate keys are reported."""
    try:
        pairs = json.loads(text.removeprefix("\ufeff"), object_pairs_hook=_Pairs, parse_int=float)
    except json.JSONDecodeError as error:
        line = text.split("\n")[error.lineno - 1] if error.lineno <= text.count("\n") + 1 else ""
        findings.error(error.lineno, "", f"is not valid JSON: {error.msg}", "The file may be truncated.", line)
        return []
    except RecursionError:
        findings.error(0, "", "lists are nested too deeply")
        return []
    assert isinstance(pairs, _Pairs)
    for name in pairs.repeated():
        findings.error(0, name, "is defined twice", "Keep one of the two.")
    return list(pairs.items())


class _Pairs(dict[str, Any]):
    """A JSON object that remembers duplicate keys."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self._given = [key for key, _ in pairs]

    def repeated(self) -> list[str]:
        if len(self) == len(self._given):
            return []
        seen = set[str]()
        return [key for key in self._given if key in seen or seen.add(key)]  # type: ignore[func-returns-value]


class _JsonReader:
    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        self.members: list[Parameter] = []
        self.texts: list[Text] = []
        self.others: list[Parameter | Text] = []
        self.axes: dict[str, Axis] = {}

    def take(self, name: str, entry: Any) -> None:
        if not isinstance(entry, _Pairs):
            return self._wrong(name, "must be an object with a kind and values")
        for key in entry.repeated():
            self._wrong(f"{name}.{key}", "is defined twice")
        kind = entry.get("kind")
        if kind not in _KINDS:
            guess = nearest(kind, _KINDS) if isinstance(kind, str) else ""
            return self._wrong(
                f"{name}.kind", f"unknown kind {kind!r}", guess or f"Must be one of: {', '.join(_KINDS)}."
            )
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
        given = entry.get("others", [])
        if not isinstance(given, list):
            return self._wrong(f"{name}.others", f"must be a list of entries, got {_describe_value(given)}")
        inner = _JsonReader(self.findings)
        for other in given:
            inner.take(name, other)
        results: list[Parameter | Text] = [*inner.members, *inner.texts]
        variants = [str(entry.get("variant", "")), *(item.variant for item in results)]
        twice = sorted({one for one in variants if variants.count(one) > 1})
        for variant in twice:
            self._wrong(f"{name}.others", f"the variant {variant!r} is defined twice", "Keep one of the two.")
        self.others += results if not twice else []
        return None

    def _labels(self, name: str, entry: _Pairs) -> dict[str, Any]:
        labels: dict[str, Any] = {key: self._string(name, entry, key) for key in _LABELS}
        functions = entry.get("functions", [])
        if isinstance(functions, list) and all(isinstance(one, str) for one in functions):
            return labels | {"functions": tuple(functions)}
        self._wrong(f"{name}.functions", f"must be a list of names, got {_describe_value(functions)}")
        return labels

    def _wrong(self, path: str, message: str, remedy: str = "") -> None:
        self.findings.error(0, "", f"{path}: {message}", remedy)

    def _unknown_keys(self, name: str, kind: str, entry: _Pairs) -> None:
        special: dict[str, set[str]] = {text: {"text"} for text in _TEXTS}
        special |= {"axis": {"x", "input"}, "rbf": {"inputs", *_PARTS}}
        known = {"kind", "unit", "functions", "others", *_LABELS} | special.get(kind, set())
        if kind not in (*_TEXTS, "axis", "rbf"):
            letters = _TABLES.get(kind, "")
            known |= {"value" if kind == "scalar" else "values", *letters}
            known |= {f"{letter}_{key}" for letter in letters for key in _AXIS_ATTRIBUTES}
            known |= {"extrapolation"} if letters else set()
        for key in entry:
            if key not in known:
                self._wrong(f"{name}.{key}", f"unknown key of a {kind}", nearest(key, known))

    def _string(self, name: str, entry: _Pairs, key: str) -> str:
        value = entry.get(key, "")
        if isinstance(value, str):
            return value
        self._wrong(f"{name}.{key}", f"must be a text, got {_describe_value(value)}")
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
                return self._wrong(f"{name}.{key}", f"must have one to four dimensions, got {len(shape)}")
        values = list(self._numbers(entry[key], shape, f"{name}.{key}"))
        if len(values) == int(np.prod(shape)):
            self._build(name, kind, np.array(values, dtype=np.float64).reshape(shape), own, attributes)
        return None

    def _extrapolation(self, name: str, entry: _Pairs) -> str:
        given = entry["extrapolation"]
        if given in ("clip", "linear"):
            return str(given)
        self._wrong(f"{name}.extrapolation", f'must be "clip" or "linear", got {_describe_value(given)}')
        return "clip"

    def _build(self, name: str, kind: str, values: Float, axes: list[Axis], attributes: dict[str, Any]) -> None:
        try:
            result = (
                Block(name, values, **attributes) if kind == "block" else parameter(name, values, axes, **attributes)
            )
        except ArgumentError as error:
            self._wrong(name, str(error))
        else:
            self.members.append(result)

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
        given = {key: self._string(name, entry, f"{letter}_{key}") for key in _AXIS_ATTRIBUTES}
        return None if points is None else Axis(points, given["input"], given["unit"], given["name"])

    def _points(self, name: str, entry: _Pairs, letter: str) -> Float | None:
        path, given = f"{name}.{letter}", entry.get(letter)
        if not isinstance(given, list) or not given:
            message = (
                "is missing" if letter not in entry else f"must be a list of breakpoints, got {_describe_value(given)}"
            )
            self._wrong(path, message)
            return None
        points = np.array(list(self._numbers(given, [len(given)], path)), dtype=np.float64)
        if len(points) < len(given):
            return None
        wrong = _point_fault(points)
        if wrong:
            self._wrong(f"{path}[{wrong[0]}]", wrong[1])
        return None if wrong else points

    def _numbers(self, given: Any, shape: list[int], path: str) -> Iterator[float]:
        """Yield the numbers of a nested list in order; wrong entries are reported and skipped."""
        if not shape:
            number = _to_number(given)
            if number is None:
                return self._wrong(path, f"must be a number, got {_describe_value(given)}")
            yield number
        elif not isinstance(given, list):
            self._wrong(path, f"must be a list of length {shape[0]}, got {_describe_value(given)}")
        elif len(given) != shape[0]:
            self._wrong(path, f"must have length {shape[0]}, got {len(given)}")
        else:
            for index, inner in enumerate(given):
                yield from self._numbers(inner, shape[1:], f"{path}[{index}]")
        return None

    def agreed(self) -> list[Parameter]:
        """Return the tables; group axes that differ between tables are reported."""
        first: dict[str, tuple[str, Axis]] = {name: (name, axis) for name, axis in self.axes.items()}
        for member in self.members:
            for letter, axis in zip("xyzw", member.axes, strict=False):
                user, known = first.setdefault(axis.name, (member.name, axis)) if axis.name else ("", axis)
                if not np.array_equal(known.breakpoints, axis.breakpoints):
                    self._wrong(f"{member.name}.{letter}", f"group axis {axis.name} has other breakpoints in {user}")
        return self.members


def _point_fault(points: Float) -> tuple[int, str] | None:
    """Return the index and the fault of the first wrong breakpoint, or None."""
    for at in np.flatnonzero(~np.isfinite(points)):
        return int(at), "must be a finite number"
    for at in np.flatnonzero(points[1:] <= points[:-1]):
        return int(at) + 1, f"the axis is not strictly increasing: {points[at + 1]:g} follows {points[at]:g}"
    return None


def _to_number(given: Any) -> float | None:
    if given is None:
        return float("nan")
    return given if isinstance(given, float) else None


def _shape_of(given: Any) -> list[int]:
    shape: list[int] = []
    while isinstance(given, list):
        shape.append(len(given))
        given = given[0] if given else None
    return shape


def _describe_value(value: Any) -> str:
    """Return a value for an error; lists and objects are not spelled out, they may be large."""
    if isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "an object"
    return "null" if value is None else repr(value)[:60]
