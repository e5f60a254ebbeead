"""Signals over time among the variables of a MATLAB file.

Known forms: vectors with a time vector of the same length, alone or in structs; the "Structure with time" of
Simulink (time, signals.values, signals.label); structs like a timeseries (Time, Data, Name, Units); the captures of
ControlDesk (X.Data, Y.Data, Y.XIndex); the matrix of a To File block (its first row is the time).
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from os.path import commonprefix

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab.builtin_objects import MatTable, MatTimes, texts_of
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
from kennfeld.measurement.unit_text import plain_unit, states_unit_of_time, time_unit

_CLOCK = re.compile(r"(?:.*[_.])?(?:time|timestamps?|zeit)(?:_.*)?|tout|(?-i:t)|t_\d.*", re.IGNORECASE)
_DATA = ("data", "value", "values")
_UNIT = ("units", "unit")
_DESCRIPTION = ("description", "comment")
_MAX_NAMES = 12  # of the values of a categorical array in a description


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
class _UntimedNumbers:
    """Numbers that no time has been found for yet."""

    path: str
    name: str
    numbers: MatNumbers
    unit: str = ""
    description: str = ""

    @property
    def values(self) -> np.ndarray:
        return self.numbers.values


@dataclass
class MatlabSignals:
    """The channels of a file by their time; `loose` are arrays of other sizes, `unreadable` what only MATLAB reads."""

    clocks: list[TimeBase] = field(default_factory=list)
    loose: dict[str, tuple[int, ...]] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)


def find_signals(variables: Mapping[str, Node]) -> MatlabSignals:
    """Return all channels of a file; steady-state points are those of a clock without time stamps."""
    finder = _SignalFinder()
    finder.collect_plain("", variables, [])
    finder.count_dates()
    clocks = [clock for clock in finder.clocks if clock.signals]
    loose = [item for item in finder.loose if item.values.size > 1]
    if not clocks:
        clocks = _first_line(loose) or _steady_points(finder.loose)
        loose = [] if clocks else loose
    return MatlabSignals(clocks, {item.path: item.values.shape for item in loose}, finder.unreadable)


class _SignalFinder:
    """Collects signals while it goes through structs within structs."""

    def __init__(self) -> None:
        self.clocks: list[TimeBase] = []
        self.loose: list[_UntimedNumbers] = []
        self.unreadable: dict[str, str] = {}
        self.dates: dict[TimeBase, MatTimes] = {}

    def collect_plain(self, path: str, fields: Mapping[str, Node], outer: list[TimeBase]) -> None:
        """Collect vectors that have a time vector in the same struct or in an enclosing one."""
        own = [clock for name, node in fields.items() if (clock := _clock(_join(path, name), name, node)) is not None]
        times = {clock.path for clock in own}
        for name, node in fields.items():
            if isinstance(node, MatTimes) and _rises(node) and (_CLOCK.fullmatch(name) or time_unit(name, "")):
                own.append(self._clock_of_times(path, node, name))
                times.add(own[-1].path)
        self.clocks += own
        for name, node in fields.items():
            place = _join(path, name)
            if not isinstance(node, MatNumbers):
                if place not in times:
                    self._visit(place, node, [*own, *outer])
            elif place not in times and node.values.size > 1:
                self._assign(_UntimedNumbers(place, name, node), [*own, *outer])

    def _visit(self, path: str, node: Node, clocks: list[TimeBase]) -> None:
        """Collect from a variable or field that is not an array of numbers."""
        if isinstance(node, MatUnreadable):
            self.unreadable[path] = node.kind
        elif isinstance(node, MatStructArray):
            for k, element in enumerate(node.elements, 1):
                self._visit(f"{path}({k})", element, clocks)
        elif isinstance(node, MatCells):
            for k, cell in enumerate(node.cells, 1):
                if not isinstance(cell, MatText | MatNumbers):
                    self._visit(f"{path}{{{k}}}", cell, clocks)
        elif isinstance(node, MatTable):
            self._collect_table(path, node, clocks)
        elif isinstance(node, MatTimes):
            self._collect_times(path, node, clocks)
        elif isinstance(node, MatStruct) and node.kind == "categorical":
            self._assign(_UntimedNumbers(path, path.rpartition(".")[2], *_categories(node)), clocks)
        elif isinstance(node, MatStruct) and node.kind:
            self.unreadable[path] = node.kind
        elif isinstance(node, MatStruct):
            fields = _fold(node)
            if not (
                self._collect_structure_with_time(path, fields)
                or self._collect_capture(path, fields)
                or self._collect_series(path, fields, clocks)
            ):
                self.collect_plain(path, node.fields, clocks)

    def _collect_times(self, path: str, node: MatTimes, clocks: list[TimeBase]) -> None:
        """Collect durations as a channel; dates say nothing but when a sample was taken."""
        if node.kind == "duration" and node.high.size > 1:
            numbers = MatNumbers(node.seconds().reshape(-1, 1))
            self._assign(_UntimedNumbers(path, path.rpartition(".")[2], numbers, "s"), clocks)

    def _collect_table(self, path: str, table: MatTable, outer: list[TimeBase]) -> None:
        """Collect the columns of a table; its time is that of the rows, or else a column of times or of its name."""
        times = table.times or _times_among(table.fields)
        clocks = [] if times is None else [self._clock_of_times(path, times)]
        if not clocks:
            candidates = (
                _clock(_join(path, name), name, node, table.units.get(name, "")) for name, node in table.fields.items()
            )
            clocks = [clock for clock in candidates if clock is not None][:1]
        self.clocks += clocks
        for name, node in table.fields.items():
            place = _join(path, name)
            if node is times or any(clock.path == place for clock in clocks):
                continue
            numbers, unit, texts = node, table.units.get(name, ""), ""
            if isinstance(node, MatStruct) and node.kind == "categorical":
                numbers, unit, texts = _categories(node)
            if isinstance(node, MatTimes) and node.kind == "duration":
                numbers, unit = MatNumbers(node.seconds().reshape(-1, 1)), "s"
            if isinstance(numbers, MatNumbers):
                description = ": ".join(filter(None, (table.descriptions.get(name, ""), texts)))
                held = numbers.whole or name in table.steps
                item = _UntimedNumbers(place, name, replace(numbers, whole=held), plain_unit(unit), description)
                self._assign(item, [*clocks, *outer])
            else:
                self._visit(place, node, [*clocks, *outer])

    def _clock_of_times(self, path: str, times: MatTimes, name: str = "time") -> TimeBase:
        clock = TimeBase(_join(path, name), times.seconds())
        if times.kind == "datetime":
            self.dates[clock] = times
        return clock

    def count_dates(self) -> None:
        """Make the time stamps that are dates count from the earliest one."""
        # a datetime is the sum of two doubles, so the earliest is a pair
        firsts = [(t.high[k], t.low[k]) for t in self.dates.values() for k in np.flatnonzero(np.isfinite(t.high))[:1]]
        origin = min(firsts, default=(0.0, 0.0))
        for clock, times in self.dates.items():
            clock.values = times.seconds((float(origin[0]), float(origin[1])))

    def _assign(self, item: _UntimedNumbers, clocks: list[TimeBase]) -> None:
        """Give it to the clock of its length whose name is the most like its own; the innermost counts first."""
        fitting = [clock for clock in clocks if clock.values is not None and clock.values.size in item.values.shape]
        if not fitting:
            self.loose.append(item)
            return
        best = max(fitting, key=lambda clock: len(commonprefix([clock.path, item.path])))  # noqa: RUF071  # by letter
        assert best.values is not None
        best.signals += _signals(item, best.values.size)

    def _collect_structure_with_time(self, path: str, fields: Mapping[str, Node]) -> bool:
        """Collect Simulink's structure with or without time."""
        signals = fields.get("signals")
        elements = signals.elements if isinstance(signals, MatStructArray) else [signals]
        if not all(isinstance(e, MatStruct) and "values" in e.fields for e in elements):
            return False
        stamps = _vector(fields.get("time"))
        clock = TimeBase(_join(path, "time"), stamps)
        for k, element in enumerate(elements, 1):
            assert isinstance(element, MatStruct)
            values = element.fields["values"]
            if not isinstance(values, MatNumbers) or not values.values.size:
                continue
            alone = path.rpartition(".")[2] if len(elements) == 1 else f"signals({k})"
            name = node_text(element.fields.get("label")).strip("<>") or alone
            item = _UntimedNumbers(_join(path, name), name, values, node_text(element.fields.get("unit")))
            if stamps is None:
                self.loose.append(item)
            else:
                # Simulink puts the time last for signals that are matrices, first for others
                clock.signals += _signals(item, stamps.size, last=values.values.ndim > 2)
        self.clocks.append(clock)
        return True

    def _collect_capture(self, path: str, fields: Mapping[str, Node]) -> bool:
        """Collect a capture of ControlDesk: each Y says by XIndex which X is its time."""
        axes, curves = _elements(fields.get("x")), _elements(fields.get("y"))
        clocks = [TimeBase(f"{path}.X({k})", _vector(axis.get("data"))) for k, axis in enumerate(axes, 1)]
        if not curves or not clocks or any(clock.values is None for clock in clocks):
            return False
        for k, curve in enumerate(curves, 1):
            data, index = curve.get("data"), curve.get("xindex")
            which = int(index.values.ravel()[0]) if isinstance(index, MatNumbers) and index.values.size else 1
            if not isinstance(data, MatNumbers) or not 1 <= which <= len(clocks):
                continue
            name = node_text(curve.get("name")) or f"Y({k})"
            texts = _first_text(curve, _UNIT), _first_text(curve, _DESCRIPTION)
            self._assign(_UntimedNumbers(_join(path, name), name, data, *texts), [clocks[which - 1]])
        self.clocks += clocks
        return True

    def _collect_series(self, path: str, fields: Mapping[str, Node], outer: list[TimeBase]) -> bool:
        """Collect a struct that is one channel: its data with a time of its own, or with a unit or a name."""
        data = next((fields[name] for name in _DATA if name in fields), None)
        stamps = _vector(fields.get("time", fields.get("t")))
        named = any(name in fields for name in (*_UNIT, "name", "datainfo"))
        vectors = [n for n in fields.values() if isinstance(n, MatNumbers) and n.values.size > 1]
        # more vectors are channels of their own, one of which happens to be called data
        if not isinstance(data, MatNumbers) or len(vectors) > 1 + (stamps is not None):
            return False
        if stamps is None and not named:
            return False
        name = node_text(fields.get("name")) or path.rpartition(".")[2]
        unit = _first_text(fields, _UNIT) or _units_of(fields.get("datainfo"))
        item = _UntimedNumbers(path, name, data, plain_unit(unit), _first_text(fields, _DESCRIPTION))
        clocks = outer
        if stamps is not None:
            clocks = [TimeBase(_join(path, "time"), stamps, _units_of(fields.get("timeinfo")) or "s")]
            self.clocks += clocks
        self._assign(item, clocks)
        return True


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _fold(node: MatStruct) -> dict[str, Node]:
    return {name.casefold(): field for name, field in node.fields.items()}


def _vector(node: Node | None) -> Float | None:
    """Return the numbers of a vector of at least two."""
    if not isinstance(node, MatNumbers) or node.values.size < 2 or node.values.size != max(node.values.shape):
        return None
    return _float64(node.values.ravel())


def _times_among(columns: Mapping[str, Node]) -> MatTimes | None:
    """Return the times of a table without row times: dates, or durations in the first column or with a name of time."""
    for at, (name, node) in enumerate(columns.items()):
        if isinstance(node, MatTimes) and _rises(node):
            is_named = time_unit(name, "") is not None or _CLOCK.fullmatch(name) is not None
            if node.kind == "datetime" or at == 0 or is_named:
                return node
    return None


def _rises(times: MatTimes) -> bool:
    return times.high.size > 1 and bool(np.all(np.diff(times.seconds()) > 0))


def _categories(node: MatStruct) -> tuple[MatNumbers, str, str]:
    """Return the codes of a categorical array, NaN where it is undefined, no unit, and the names of the codes."""
    codes = node.fields.get("codes")
    values = np.array(codes.values, dtype=np.float64) if isinstance(codes, MatNumbers) else np.empty((0, 0))
    values[values == 0] = np.nan
    names = enumerate(texts_of(node.fields.get("categoryNames")), 1)
    return MatNumbers(values, True), "", ", ".join(f"{code} = {name}" for code, name in names if code <= _MAX_NAMES)


def _clock(path: str, name: str, node: Node, stated: str = "") -> TimeBase | None:
    """Return the clock that a vector is which is called like time; a capital T is a temperature."""
    unit = time_unit(name, stated) if name.casefold() != "t" else None
    if unit is None and not _CLOCK.fullmatch(name):
        return None
    values = _vector(node)
    if values is None or (unit is None and not np.all(values[1:] >= values[:-1])):
        return None
    # without a stated unit, the numbers may show another one than seconds
    return TimeBase(path, values, (unit or "s") if states_unit_of_time(name, stated) else "")


def _signals(item: _UntimedNumbers, samples: int, last: bool = False) -> Iterator[RecordedSignal]:
    """Yield the channel of a vector; of a matrix one for each column, `A[0]`, `A[1]`, ..."""
    values = np.squeeze(item.values)
    axes = [k for k, d in enumerate(values.shape) if d == samples]
    if not axes:
        return
    # a square matrix has two axes of this length
    values = np.moveaxis(values, axes[-1] if last else axes[0], 0)
    for place in np.ndindex(values.shape[1:]):
        index = "".join(f"[{i}]" for i in place)
        column = _float64(values[(slice(None), *place)])
        path, name = item.path + index, item.name + index
        yield RecordedSignal(path, name, column, item.unit, item.numbers.whole, item.description)


def _float64(values: np.ndarray) -> Float:
    """Return a copy in float64."""
    with np.errstate(invalid="ignore"):
        copied = np.array(values, dtype=np.float64)
    copied[np.isnan(copied)] = np.nan  # a NaN that signals would set off warnings later
    return copied


def _elements(node: Node | None) -> list[dict[str, Node]]:
    structs = node.elements if isinstance(node, MatStructArray) else [node]
    return [_fold(struct) for struct in structs if isinstance(struct, MatStruct)]


def _first_text(fields: Mapping[str, Node], names: Iterable[str]) -> str:
    return next((text for name in names if (text := node_text(fields.get(name)))), "")


def _units_of(node: Node | None) -> str:
    return _first_text(_fold(node), _UNIT) if isinstance(node, MatStruct) else ""


def _first_line(arrays: list[_UntimedNumbers]) -> list[TimeBase]:
    """Return a single matrix whose first row or column rises: the time, as a To File block writes it."""
    if len(arrays) != 1 or arrays[0].values.ndim != 2 or min(arrays[0].values.shape) < 2:
        return []
    (item,) = arrays
    # the samples lie along the longer axis
    lines = item.values if item.values.shape[1] >= item.values.shape[0] else item.values.T
    time = _float64(lines[0])
    if time.size < 3 or not np.all(time[1:] > time[:-1]):
        return []
    signals = [
        RecordedSignal(f"{item.path}[{k}]", f"{item.name}[{k}]", _float64(line), held=item.numbers.whole)
        for k, line in enumerate(lines[1:], 1)
    ]
    return [TimeBase(f"{item.path}[0]", time, signals=signals)]


def _steady_points(loose: list[_UntimedNumbers]) -> list[TimeBase]:
    """Return vectors of one length without a time, or the columns of matrices, as steady-state points."""
    arrays = [item.values for item in loose if item.values.size > 1]
    lengths = {array.size if array.size == max(array.shape) else array.shape[0] for array in arrays}
    if len(lengths) != 1 or any(array.size != max(array.shape) and array.ndim > 2 for array in arrays):
        return []
    (samples,) = lengths
    return [TimeBase("", None, signals=[signal for item in loose for signal in _signals(item, samples)])]
