"""Reads and writes `parameters.json`, the values of a run: one entry per parameter, one row per x.

    {"b1": {"kind": "scalar", "unit": "", "value": 1.0},
     "MapX": {"kind": "map", "unit": "Nm", "x": [1, 2], "y": [0, 9], "values": [[1, 2], [3, 4]]},
     "Model": {"kind": "rbf", "unit": "", "inputs": ["n"], "offset": 1, "slopes": [0],
               "weights": [2], "centres": [[3]], "widths": [[0.5]]}}

`description`, `functions`, `display_name` and `variant`, and `x_name`, `x_unit`, `x_input` of each axis, are omitted
if empty, `extrapolation` of a table if it is "clip", and of an rbf `kernel` if it is "gaussian" and `hinges`, rows of
input, position and height, if there are none; `others` lists further variants as entries of their own. Breakpoints
always rise; `"x_falling": true` tells that other formats store the axis from the greatest one on. A group axis that no
table uses is an entry of kind "axis", with `falling`. Non-finite numbers are null.
"""

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import nearest
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, ReadResult
from kennfeld.calfiles.storable import report_repeated
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import LABELS, Block, Parameter, parameter
from kennfeld.domain.rbf import RBF, Expansion
from kennfeld.domain.texts import Text, TextKind

_TABLES = {"scalar": "", "curve": "x", "map": "xy", "cube": "xyzw"}
_PARTS = ("offset", "slopes", "weights", "centres", "widths")
_TEXTS: tuple[TextKind, ...] = ("text", "enumeration", "boolean")
_KINDS = (*_TABLES, "block", "rbf", *_TEXTS, "axis")
_AXIS_TEXTS = ("name", "unit", "input")
_AXIS_ATTRIBUTES = (*_AXIS_TEXTS, "falling")


def write_json(parameters: ParameterSet, file: str) -> str:
    """Return the text of a `parameters.json`; bounds and locks are not stored.

    Raises `InputError` if two entries would have the same name.
    """
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    others = {name: {"others": list(map(_entry, items))} for name, items in parameters.others_by_name.items()}
    entries = [(item.name, _entry(item) | others.get(item.name, {})) for item in parameters.chosen]
    for axis in parameters.axes:
        if axis.name not in used:
            attributes = {key: getattr(axis, key) for key in ("input", "falling") if getattr(axis, key)}
            points = {"x": axis.breakpoints.tolist()}
            entries.append((axis.name, {"kind": "axis", "unit": axis.unit} | attributes | points))
    findings = FileFindings(file)
    report_repeated((name for name, _ in entries), findings)
    findings.finish()
    return "{" + ",".join(f"\n {_format_compact(name)}: {_format_entry(entry)}" for name, entry in entries) + "\n}\n"


def _entry(item: Item) -> dict[str, Any]:
    labels = {key: getattr(item, key) for key in LABELS if getattr(item, key)}
    if isinstance(item, Text):
        return {"kind": item.kind, "text": item.text} | ({"unit": item.unit} if item.unit else {}) | labels
    entry: dict[str, Any] = {"kind": item.kind, "unit": item.unit} | labels
    if isinstance(item, RBF):
        parts = {part: np.asarray(getattr(item.expansion, part)).tolist() for part in _PARTS}
        kernel = {} if item.kernel == "gaussian" else {"kernel": item.kernel}
        hinges = {"hinges": [list(hinge) for hinge in item.hinges]} if item.hinges else {}
        return entry | {"inputs": list(item.inputs)} | parts | kernel | hinges
    for letter, axis in zip(AXIS_LETTERS, item.axes, strict=False):
        entry |= {f"{letter}_{key}": getattr(axis, key) for key in _AXIS_ATTRIBUTES if getattr(axis, key)}
        entry[letter] = axis.breakpoints.tolist()
    if item.axes and item.extrapolation != "clip":
        entry["extrapolation"] = item.extrapolation
    # JSON has neither NaN nor infinity
    values = item.values.astype(object)
    values[~np.isfinite(item.values)] = None
    return entry | {"value" if item.kind == "scalar" else "values": values.tolist()}


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
    findings = FileFindings(source.name)
    entries = _load_entries(source.text, findings)
    reader = _JsonReader(findings)
    if entries and not any(isinstance(entry, _Pairs) and "kind" in entry for _, entry in entries):
        remedy = 'Each entry needs a kind and values: {"K": {"kind": "scalar", "unit": "", "value": 1.0}}'
        findings.error(0, "", "is JSON, but contains no parameters", remedy)
        entries = []
    for name, entry in entries:
        reader.take(name, entry)
    reader.check_group_axes()
    warnings = findings.finish()
    parameters = ParameterSet(reader.members, reader.texts, reader.axes.values(), reader.others)
    return ReadResult("JSON", parameters, warnings)


def _load_entries(text: str, findings: FileFindings) -> list[tuple[str, Any]]:
    """Return the entries in order; duplicate keys are reported."""
    try:
        # integers as floats, so that all numbers are of one type
        pairs = json.loads(text.removeprefix("\ufeff"), object_pairs_hook=_Pairs, parse_int=float)
    except json.JSONDecodeError as error:
        line = text.split("\n")[error.lineno - 1] if error.lineno <= text.count("\n") + 1 else ""
        findings.error(error.lineno, "", f"is not valid JSON: {error.msg}", "The file may be truncated.", line)
        return []
    except RecursionError:
        findings.error(0, "", "lists are nested too deeply")
        return []
    for name in pairs.repeated:
        findings.error(0, name, "is defined twice", "Keep one of the two.")
    return list(pairs.items())


class _Pairs(dict[str, Any]):
    """A JSON object that remembers duplicate keys."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        counts = Counter(key for key, _ in pairs) if len(self) < len(pairs) else {}
        self.repeated = [key for key, count in counts.items() if count > 1]


class _JsonReader:
    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.members: list[Parameter] = []
        self.texts: list[Text] = []
        self.others: list[Item] = []
        self.axes: dict[str, Axis] = {}

    def take(self, name: str, entry: Any) -> None:
        if not isinstance(entry, _Pairs):
            return self._wrong(name, "must be an object with a kind and values")
        for key in entry.repeated:
            self._wrong(f"{name}.{key}", "is defined twice")
        kind = entry.get("kind")
        if kind not in _KINDS:
            guess = nearest(kind, _KINDS) if isinstance(kind, str) else ""
            remedy = guess or f"Must be one of: {', '.join(_KINDS)}."
            return self._wrong(f"{name}.kind", f"unknown kind {kind!r}", remedy)
        self._report_unknown_keys(name, kind, entry)
        unit = self._string(name, entry, "unit")
        if kind in _TEXTS:
            text = self._string(name, entry, "text")
            self.texts.append(Text(name, text, kind=kind, unit=unit, **self._labels(name, entry)))
        elif kind == "axis":
            points = self._points(name, entry, "x")
            if points is not None:
                quantity, falling = self._string(name, entry, "input"), self._truth(name, entry, "falling")
                self.axes[name] = Axis(points, quantity, unit, name, falling=falling)
        else:
            attributes = self._labels(name, entry) | {"unit": unit}
            try:
                member = (self._rbf if kind == "rbf" else self._table)(name, entry, attributes)
                self.members += [member] if member else []
            except ArgumentError as error:
                self._wrong(name, str(error))
        self._take_others(name, entry)
        return None

    def _take_others(self, name: str, entry: _Pairs) -> None:
        entries = entry.get("others", [])
        if not isinstance(entries, list):
            return self._wrong(f"{name}.others", f"must be a list of entries, got {_describe_value(entries)}")
        # further variants are entries of the same form
        inner = _JsonReader(self.findings)
        for other in entries:
            inner.take(name, other)
        items: list[Item] = [*inner.members, *inner.texts]
        variants = [str(entry.get("variant", "")), *(item.variant for item in items)]
        repeated = sorted({variant for variant in variants if variants.count(variant) > 1})
        for variant in repeated:
            self._wrong(f"{name}.others", f"the variant {variant!r} is defined twice", "Keep one of the two.")
        self.others += items if not repeated else []
        return None

    def _labels(self, name: str, entry: _Pairs) -> dict[str, Any]:
        labels: dict[str, Any] = {key: self._string(name, entry, key) for key in LABELS if key != "functions"}
        functions = entry.get("functions", [])
        if isinstance(functions, list) and all(isinstance(function, str) for function in functions):
            return labels | {"functions": tuple(functions)}
        self._wrong(f"{name}.functions", f"must be a list of names, got {_describe_value(functions)}")
        return labels

    def _wrong(self, path: str, message: str, remedy: str = "") -> None:
        self.findings.error(0, path, message, remedy)

    def _report_unknown_keys(self, name: str, kind: str, entry: _Pairs) -> None:
        special: dict[str, set[str]] = {text: {"text"} for text in _TEXTS}
        special |= {"axis": {"x", "input", "falling"}, "rbf": {"inputs", *_PARTS, "kernel", "hinges"}}
        known = {"kind", "unit", "others", *LABELS} | special.get(kind, set())
        if kind not in special:
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

    def _truth(self, name: str, entry: _Pairs, key: str) -> bool:
        value = entry.get(key, False)
        if isinstance(value, bool):
            return value
        self._wrong(f"{name}.{key}", f"must be true or false, got {_describe_value(value)}")
        return False

    def _table(self, name: str, entry: _Pairs, attributes: dict[str, Any]) -> Parameter | None:
        letters = _TABLES.get(entry["kind"], "")
        # a cube has three axes or four
        letters = letters if letters != "xyzw" or "w" in entry else "xyz"
        axes = [self._axis(name, entry, letter) for letter in letters]
        if letters and "extrapolation" in entry:
            attributes["extrapolation"] = entry["extrapolation"]
            if entry["extrapolation"] not in ("clip", "linear"):
                message = f'must be "clip" or "linear", got {_describe_value(entry["extrapolation"])}'
                self._wrong(f"{name}.extrapolation", message)
                del attributes["extrapolation"]
        own = [axis for axis in axes if axis is not None]
        key = "value" if entry["kind"] == "scalar" else "values"
        if key not in entry:
            self._wrong(f"{name}.{key}", "is missing")
        elif len(own) == len(axes) and entry["kind"] == "block":
            values = self._block_values(name, entry["values"])
            return None if values is None else Block(name, values, **attributes)
        elif len(own) == len(axes):
            values = self._numbers(entry[key], [len(axis) for axis in own], f"{name}.{key}")
            return None if values is None else parameter(name, values, own, **attributes)
        return None

    def _block_values(self, name: str, values: Any) -> Float | None:
        shape: list[int] = []
        inner = values
        while isinstance(inner, list):
            shape.append(len(inner))
            inner = inner[0] if inner else None
        if 1 <= len(shape) <= 4:
            return self._numbers(values, shape, f"{name}.values")
        self._wrong(f"{name}.values", f"must have one to four dimensions, got {len(shape)}")
        return None

    def _rbf(self, name: str, entry: _Pairs, attributes: dict[str, Any]) -> Parameter | None:
        missing = [key for key in ("inputs", *_PARTS) if key not in entry]
        for key in missing:
            self._wrong(f"{name}.{key}", "is missing")
        if missing:
            return None
        labels = entry["inputs"]
        if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
            self._wrong(f"{name}.inputs", f"must be a list of names, got {_describe_value(labels)}")
            return None
        rows = entry.get("hinges", [])
        if not isinstance(rows, list):
            message = f"must be a list of rows of input, position and height, got {_describe_value(rows)}"
            self._wrong(f"{name}.hinges", message)
            return None
        # the weights state how many centres there are; all other parts must match
        inputs, centres = len(labels), len(entry["weights"]) if isinstance(entry["weights"], list) else 0
        shapes: tuple[list[int], ...] = ([], [inputs], [centres], [centres, inputs], [centres, inputs], [len(rows), 3])
        parts = []
        for key, shape in zip((*_PARTS, "hinges"), shapes, strict=True):
            numbers = self._numbers(entry.get(key, rows), shape, f"{name}.{key}")
            if numbers is None:
                return None
            parts.append(numbers)
        slopes, weights, positions, widths, hinges = parts[1:]
        kernel = entry.get("kernel", "gaussian")
        expansion = Expansion(
            float(parts[0]), slopes, weights, positions, widths, kernel=kernel, hinges=hinges.tolist()
        )
        return RBF(name, expansion, labels, **attributes)

    def _axis(self, name: str, entry: _Pairs, letter: str) -> Axis | None:
        points = self._points(name, entry, letter)
        attributes: dict[str, Any] = {key: self._string(name, entry, f"{letter}_{key}") for key in _AXIS_TEXTS}
        attributes["falling"] = self._truth(name, entry, f"{letter}_falling")
        return None if points is None else Axis(points, **attributes)

    def _points(self, name: str, entry: _Pairs, letter: str) -> Float | None:
        path, breakpoints = f"{name}.{letter}", entry.get(letter)
        if not isinstance(breakpoints, list) or not breakpoints:
            expected = f"must be a list of breakpoints, got {_describe_value(breakpoints)}"
            self._wrong(path, expected if letter in entry else "is missing")
            return None
        points = self._numbers(breakpoints, [len(breakpoints)], path)
        if points is None:
            return None
        for at in np.flatnonzero(~np.isfinite(points)):
            self._wrong(f"{path}[{at}]", "must be a finite number")
            return None
        for at in np.flatnonzero(points[1:] <= points[:-1]):
            message = f"the axis is not strictly increasing: {points[at + 1]:g} follows {points[at]:g}"
            self._wrong(f"{path}[{at + 1}]", message)
            return None
        return points

    def _numbers(self, value: Any, shape: list[int], path: str) -> Float | None:
        """Return the numbers of a nested list as an array; None, with findings, if an entry is wrong."""
        numbers = list(self._flatten(value, shape, path))
        # a wrong entry yields nothing, so that the count differs
        return np.array(numbers, dtype=np.float64).reshape(shape) if len(numbers) == int(np.prod(shape)) else None

    def _flatten(self, value: Any, shape: list[int], path: str) -> Iterator[float]:
        """Yield the numbers of a nested list in order; wrong entries are reported and skipped."""
        if not shape:
            if value is not None and not isinstance(value, float):
                return self._wrong(path, f"must be a number, got {_describe_value(value)}")
            yield float("nan") if value is None else value
        elif not isinstance(value, list):
            self._wrong(path, f"must be a list of length {shape[0]}, got {_describe_value(value)}")
        elif len(value) != shape[0]:
            self._wrong(path, f"must have length {shape[0]}, got {len(value)}")
        else:
            for index, inner in enumerate(value):
                yield from self._flatten(inner, shape[1:], f"{path}[{index}]")
        return None

    def check_group_axes(self) -> None:
        first: dict[str, tuple[str, Axis]] = {name: (name, axis) for name, axis in self.axes.items()}
        for member in self.members:
            for letter, axis in zip(AXIS_LETTERS, member.axes, strict=False):
                user, known = first.setdefault(axis.name, (member.name, axis)) if axis.name else ("", axis)
                if not np.array_equal(known.breakpoints, axis.breakpoints):
                    self._wrong(f"{member.name}.{letter}", f"group axis {axis.name} has other breakpoints in {user}")


def _describe_value(value: Any) -> str:
    """Return a value for an error; lists and objects are not spelled out, they may be large."""
    if isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "an object"
    return "null" if value is None else repr(value)[:60]
