"""Signals over time among the variables of a MATLAB file.

Known forms: vectors with a time vector of the same length, alone or in structs; the "Structure with time" of
Simulink (time, signals.values, signals.label); structs like a timeseries (Time, Data, Name, Units); the captures of
ControlDesk (X.Data, Y.Data, Y.XIndex); the matrix of a To File block (its first row is the time).
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.mat_nodes import (
    MatCells,
    MatNumbers,
    MatStruct,
    MatStructArray,
    MatText,
    MatUnreadable,
    Node,
    node_text,
)
from kennfeld.measurement.unit_text import plain_unit, time_unit

_CLOCK = re.compile(r"(?:.*[_.])?(?:time|timestamps?|zeit)(?:_.*)?|tout|(?-i:t)|t_\d.*", re.IGNORECASE)
_DATA = ("data", "value", "values")
_UNIT = ("units", "unit")
_SAID = ("description", "comment")


@dataclass(eq=False)
class TimeBase:
    """Time stamps and the signals sampled at them; `values` is None if there are none."""

    path: str
    values: Float | None  # Float[samples]
    unit: str = "s"
    signals: list["RecordedSignal"] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class RecordedSignal:
    """One channel: `path` leads to it from the top of the file, `name` is the last part of that."""

    path: str
    name: str
    values: Float  # Float[samples]
    unit: str = ""
    held: bool = False
    description: str = ""


@dataclass(frozen=True)
class _Loose:
    """Numbers that no time has been found for yet."""

    path: str
    name: str
    numbers: MatNumbers
    unit: str = ""
    description: str = ""


@dataclass
class MatlabSignals:
    """The channels of a file by their time; `loose` are arrays of other sizes, `unreadable` what only MATLAB reads."""

    clocks: list[TimeBase] = field(default_factory=list)
    loose: dict[str, tuple[int, ...]] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)


def find_signals(variables: Mapping[str, Node]) -> MatlabSignals:
    """Return all channels of a file; steady-state points are those of a clock without time stamps."""
    finder = _Finder()
    finder.plain("", variables, [])
    clocks = [clock for clock in finder.clocks if clock.signals]
    loose = finder.loose
    if not clocks:
        clocks = _first_line(loose) or _steady(loose)
        loose = [] if clocks else loose
    sizes = {item.path: item.numbers.values.shape for item in loose if item.numbers.values.size > 1}
    return MatlabSignals(clocks, sizes, finder.unreadable)


class _Finder:
    """Collects while it goes through structs within structs."""

    def __init__(self) -> None:
        self.clocks: list[TimeBase] = []
        self.loose: list[_Loose] = []
        self.unreadable: dict[str, str] = {}

    def visit(self, path: str, node: Node, clocks: list[TimeBase]) -> None:
        """Return a variable or field that is no array of numbers."""
        if isinstance(node, MatUnreadable):
            self.unreadable[path] = node.kind
        elif isinstance(node, MatStructArray):
            for k, element in enumerate(node.elements, 1):
                self.visit(f"{path}({k})", element, clocks)
        elif isinstance(node, MatCells):
            for k, cell in enumerate(node.cells, 1):
                if not isinstance(cell, MatText | MatNumbers):
                    self.visit(f"{path}{{{k}}}", cell, clocks)
        elif isinstance(node, MatStruct):
            known = {name.casefold(): inner for name, inner in node.fields.items()}
            if not (self._with_signals(path, known) or self._capture(path, known) or self._series(path, known, clocks)):
                self.plain(path, node.fields, clocks)

    def plain(self, path: str, fields: Mapping[str, Node], outer: list[TimeBase]) -> None:
        """Collect vectors that have a time vector in the same struct or in an enclosing one."""
        own = [clock for name, node in fields.items() if (clock := _clock(_joined(path, name), name, node)) is not None]
        self.clocks += own
        times = {clock.path for clock in own}
        for name, node in fields.items():
            place = _joined(path, name)
            if not isinstance(node, MatNumbers):
                self.visit(place, node, [*own, *outer])
            elif place not in times and node.values.size > 1:
                self._place(_Loose(place, name, node), [*own, *outer])

    def _place(self, item: _Loose, clocks: list[TimeBase]) -> None:
        """Give it to the clock of its length whose name is the most like its own; the innermost counts first."""
        fitting = [
            clock for clock in clocks if clock.values is not None and clock.values.size in item.numbers.values.shape
        ]
        if not fitting:
            self.loose.append(item)
            return
        best = max(fitting, key=lambda clock: _alike(clock.path, item.path))
        assert best.values is not None
        best.signals += _columns(item, best.values.size)

    def _with_signals(self, path: str, known: Mapping[str, Node]) -> bool:
        """Collect Simulink's structure with or without time."""
        signals, time = known.get("signals"), known.get("time")
        elements = signals.elements if isinstance(signals, MatStructArray) else [signals]
        if not all(isinstance(e, MatStruct) and "values" in e.fields for e in elements):
            return False
        stamps = _vector(time)
        clock = TimeBase(_joined(path, "time"), stamps)
        for k, element in enumerate(elements, 1):
            assert isinstance(element, MatStruct)
            values = element.fields["values"]
            if not isinstance(values, MatNumbers) or not values.values.size:
                continue
            alone = path.rpartition(".")[2] if len(elements) == 1 else f"signals({k})"
            name = node_text(element.fields.get("label")).strip("<>") or alone
            item = _Loose(_joined(path, name), name, values, node_text(element.fields.get("unit")))
            if stamps is None:
                self.loose.append(item)
            else:
                clock.signals += _columns(item, stamps.size, last=values.values.ndim > 2)
        self.clocks.append(clock)
        return True

    def _capture(self, path: str, known: Mapping[str, Node]) -> bool:
        """Return a capture of ControlDesk: each Y says by XIndex which X is its time."""
        axes, curves = _elements(known.get("x")), _elements(known.get("y"))
        clocks = [TimeBase(f"{path}.X({k})", _vector(axis.get("data"))) for k, axis in enumerate(axes, 1)]
        if not curves or not clocks or any(clock.values is None for clock in clocks):
            return False
        for k, curve in enumerate(curves, 1):
            data, index = curve.get("data"), curve.get("xindex")
            which = int(index.values.ravel()[0]) if isinstance(index, MatNumbers) and index.values.size else 1
            if not isinstance(data, MatNumbers) or not 1 <= which <= len(clocks):
                continue
            name = node_text(curve.get("name")) or f"Y({k})"
            item = _Loose(_joined(path, name), name, data, _first_text(curve, _UNIT), _first_text(curve, _SAID))
            self._place(item, [clocks[which - 1]])
        self.clocks += clocks
        return True

    def _series(self, path: str, known: Mapping[str, Node], outer: list[TimeBase]) -> bool:
        """Return a struct that is one channel: its data with a time of its own, or with a unit or a name."""
        data = next((known[name] for name in _DATA if name in known), None)
        stamps = _vector(known.get("time", known.get("t")))
        named = any(name in known for name in (*_UNIT, "name", "datainfo"))
        vectors = [n for n in known.values() if isinstance(n, MatNumbers) and n.values.size > 1]
        if (
            not isinstance(data, MatNumbers)
            or len(vectors) > 1 + (stamps is not None)
            or (stamps is None and not named)
        ):
            return False
        name = node_text(known.get("name")) or path.rpartition(".")[2]
        unit = _first_text(known, _UNIT) or _units_of(known.get("datainfo"))
        item = _Loose(path, name, data, plain_unit(unit), _first_text(known, _SAID))
        if stamps is None:
            self._place(item, outer)
            return True
        clock = TimeBase(_joined(path, "time"), stamps, _units_of(known.get("timeinfo")) or "s")
        self.clocks.append(clock)
        self._place(item, [clock])
        return True


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _alike(first: str, second: str) -> int:
    """Return the length of the common prefix of two paths."""
    return next(
        (k for k, (a, b) in enumerate(zip(first, second, strict=False)) if a != b), min(len(first), len(second))
    )


def _vector(node: Node | None) -> Float | None:
    """Return the numbers of a vector of at least two."""
    if not isinstance(node, MatNumbers) or node.values.size < 2 or node.values.size != max(node.values.shape):
        return None
    return _float64(node.values.ravel())


def _clock(path: str, name: str, node: Node) -> TimeBase | None:
    """Return the clock that a vector is which is called like time; a capital T is a temperature."""
    unit = time_unit(name, "") if name.casefold() != "t" else None
    if unit is None and not _CLOCK.fullmatch(name):
        return None
    values = _vector(node)
    if values is None or (unit is None and not np.all(values[1:] >= values[:-1])):
        return None
    return TimeBase(path, values, unit or "s")


def _columns(item: _Loose, samples: int, last: bool = False) -> Iterator[RecordedSignal]:
    """Return the channel of a vector; of a matrix one for each column, `A[0]`, `A[1]`, ..."""
    values = item.numbers.values
    kept = tuple(d for d in values.shape if d != 1)
    values = values.reshape(kept)
    axes = [k for k, d in enumerate(kept) if d == samples]
    if not axes:
        return
    values = np.moveaxis(values, axes[-1] if last else axes[0], 0)
    for place in np.ndindex(values.shape[1:]):
        index = "".join(f"[{i}]" for i in place)
        column = _float64(values[(slice(None), *place)])
        yield RecordedSignal(
            item.path + index, item.name + index, column, item.unit, item.numbers.whole, item.description
        )


def _float64(values: np.ndarray) -> Float:
    """Return a copy in float64."""
    with np.errstate(invalid="ignore"):
        copied = np.array(values, dtype=np.float64)
    copied[np.isnan(copied)] = np.nan  # a NaN that signals would set off warnings later
    return copied


def _elements(node: Node | None) -> list[dict[str, Node]]:
    found = [node] if isinstance(node, MatStruct) else node.elements if isinstance(node, MatStructArray) else []
    return [{name.casefold(): inner for name, inner in element.fields.items()} for element in found]


def _first_text(known: Mapping[str, Node], names: Iterable[str]) -> str:
    return next((text for name in names if (text := node_text(known.get(name)))), "")


def _units_of(node: Node | None) -> str:
    return _first_text({k.casefold(): v for k, v in node.fields.items()}, _UNIT) if isinstance(node, MatStruct) else ""


def _first_line(loose: list[_Loose]) -> list[TimeBase]:
    """Return a single matrix whose first row or column rises: the time, as a To File block writes it."""
    arrays = [item for item in loose if item.numbers.values.size > 1]
    if len(arrays) != 1 or arrays[0].numbers.values.ndim != 2 or min(arrays[0].numbers.values.shape) < 2:
        return []
    (item,) = arrays
    wide = item.numbers.values.shape[1] >= item.numbers.values.shape[0]
    lines = item.numbers.values if wide else item.numbers.values.T
    time = _float64(lines[0])
    if time.size < 3 or not np.all(time[1:] > time[:-1]):
        return []
    clock = TimeBase(f"{item.path}[0]", time)
    for k, line in enumerate(lines[1:], 1):
        clock.signals.append(
            RecordedSignal(f"{item.path}[{k}]", f"{item.name}[{k}]", _float64(line), held=item.numbers.whole)
        )
    return [clock]


def _steady(loose: list[_Loose]) -> list[TimeBase]:
    """Return vectors of one length without a time, or the columns of matrices, as steady-state points."""
    arrays = [item.numbers.values for item in loose if item.numbers.values.size > 1]
    lengths = {array.size if array.size == max(array.shape) else array.shape[0] for array in arrays}
    if len(lengths) != 1 or any(array.size != max(array.shape) and array.ndim > 2 for array in arrays):
        return []
    (samples,) = lengths
    clock = TimeBase("", None)
    for item in loose:
        clock.signals += _columns(item, samples)
    return [clock]
