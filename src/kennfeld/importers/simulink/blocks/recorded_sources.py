"""Recorded signals of the Sources library: in files, in variables, and in the model file itself.

A recording is interpolated or held between its points. One that is not there becomes an input of the model under the
name of its block or variable, to be measured: a calibration replaces what drove a model by what drove the engine.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.importers.simulink.blocks.lookup_tables import LookupMethod, constant_curve
from kennfeld.importers.simulink.flattening.flatten import HARDWARE_INPUT
from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.lowering.registry import Outputs
from kennfeld.importers.simulink.reader.model_tree import split_path
from kennfeld.importers.simulink.signals import CONTINUOUS, Bus, Signal, SignalOrBus, select, staircase
from kennfeld.importers.simulink.variables.datasets import Recorded
from kennfeld.importers.simulink.variables.mask_scope import Variable
from kennfeld.importers.simulink.variables.recordings import (
    RecordedSeries,
    builder_recording,
    file_recording,
    scenario_recording,
    structure_recording,
)
from kennfeld.importers.simulink.variables.stored_variables import StoredVariables
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_BIND = "Bind it to a measured channel."
_MAX_STEPS = 2000  # of a piecewise constant signal; each takes a comparison
_BUILDER_VARIABLE = "tuvar"


@block("Repeating table", "Repeating Sequence", linked=True, rep_seq_t="[0 2]", rep_seq_y="[0 2]")
def repeating_sequence(block: BlockContext) -> SignalOrBus:
    """Interpolate a periodic sequence of points linearly."""
    times, values = block.numeric_array("rep_seq_t").ravel(), block.numeric_array("rep_seq_y").ravel()
    _check_points(RecordedSeries(times, values))
    if not times[-1] > times[0]:
        raise UnsupportedError("its points all have the same time")
    # the last point is the first one of the next period
    first, span = float(times[0]), float(times[-1] - times[0])
    within = (_current_time(block) - first) % span + first
    return _line(block, "rep_seq_y", within, RecordedSeries(times, values), "clip")


@block("FromWorkspace", VariableName="simulink_input", Interpolate="on", OutputAfterFinalValue="Extrapolation",
       SampleTime="0")  # fmt: skip
def from_workspace(block: BlockContext) -> SignalOrBus:
    """Interpolate the columns of a matrix over its first one, the time, or the signals of a Signal Builder."""
    recording = block.flat.block.recording
    own = block.field_text("VariableName")
    # the inner block of a Signal Builder reads a variable of its mask code; the user knows the name of the builder
    if own == _BUILDER_VARIABLE:
        own = split_path(block.flat.path)[-2:][0]
    try:
        series = _active_group(block, own) if recording is not None else _of_variable(block)
    except EvaluationError as error:
        return _measured(block, own, f"its signal is recorded and not part of the model: {error}")
    return _joined(block, [_column(block, f"column {at}", points) for at, points in enumerate(series, 2)])


def _active_group(block: BlockContext, builder: str) -> Sequence[RecordedSeries]:
    """Return the signals of a Signal Builder, with a remark on which of several groups they are."""
    stored = block.flat.block.recording
    assert stored is not None
    group = builder_recording(stored)
    if group.count > 1:
        groups = f"one of {group.count} of the Signal Builder {builder}"
        block.warn(f"gives the signals of the active group {group.name!r}, {groups}")
    return group.signals


def _of_variable(block: BlockContext) -> Sequence[RecordedSeries]:
    """Return the columns of a matrix of times and values, or the signals of a structure with time."""
    text = block.field_text("VariableName")
    variable = block.flat.scope.find(text) if text.isidentifier() else None
    if isinstance(variable, Variable) and isinstance(variable.value, Mapping):
        return structure_recording(variable.value)
    try:
        points = block.numeric_array("VariableName")
    except UnsupportedError as error:
        raise EvaluationError(error.message) from None
    if points.shape[0] < 2 or points.shape[1] < 2:
        raise UnsupportedError("its signal is not a matrix of times and values", _BIND)
    return [RecordedSeries(points[:, 0], column) for column in points[:, 1:].T]


@block("FromFile", FileName="untitled.mat", ExtrapolationBeforeFirstDataPoint="Linear extrapolation",
       InterpolationWithinTimeRange="Linear interpolation", ExtrapolationAfterLastDataPoint="Linear extrapolation",
       SampleTime="0")  # fmt: skip
def from_file(block: BlockContext) -> SignalOrBus:
    """Interpolate or hold the rows of a matrix in a MAT-file over its first row, the time."""
    try:
        series = file_recording(_file_content(block))
    except EvaluationError as error:
        return _measured(block, block.flat.block.name, _reason(block, error))
    return _joined(block, [_file_row(block, f"row {at}", points) for at, points in enumerate(series, 2)])


def _file_content(block: BlockContext) -> StoredVariables:
    """Return the variables of the file of a block; raise `EvaluationError` if it is not there."""
    content = block.compiler.files.data(_file_of(block))
    if content is None:
        raise EvaluationError("it was not found next to the model")
    return content


def _file_of(block: BlockContext) -> str:
    return block.field_text("FileName").strip("'\"")


def _reason(block: BlockContext, why: object) -> str:
    """Return why the recording of a block is not used."""
    return f"its file {_file_of(block)[:60]} cannot be used: {why}"


def _file_row(block: BlockContext, label: str, points: RecordedSeries) -> Signal:
    """Return one signal of a file, with each of its three time ranges as the dialog says."""
    _check_points(points)
    within = block.option("InterpolationWithinTimeRange", "Linear interpolation", "Zero order hold")
    before = block.option(
        "ExtrapolationBeforeFirstDataPoint", "Linear extrapolation", "Hold first value", "Ground value"
    )
    after = block.option("ExtrapolationAfterLastDataPoint", "Linear extrapolation", "Hold last value", "Ground value")
    now, times = _current_time(block), points.times
    if within == "Linear interpolation":
        y = _line(block, label, block.time, points, "clip")
    else:
        y = _hold_points(block, now, points)
    # the points at the end, as the outermost two extrapolate whatever lies between them
    y = select(now >= float(times[0]), y, _beyond(block, points, before, 0))
    return select(now > float(times[-1]) + block.time_tolerance(), _beyond(block, points, after, len(times) - 1), y)


def _beyond(block: BlockContext, points: RecordedSeries, how: str, at: int) -> Signal:
    """Return the signal before the first point (`at` is 0) or after the last one."""
    if how == "Ground value":
        return block.constant(0.0)
    edge = float(points.values[at])
    other = 1 if at == 0 else at - 1
    span = float(points.times[other] - points.times[at])
    # two points at the same time have no slope
    if not how.startswith("Linear") or span == 0:
        return block.constant(edge)
    return edge + (float(points.values[other]) - edge) / span * (block.time - float(points.times[at]))


@block("FromSpreadsheet", FileName="untitled.xlsx")
def from_spreadsheet(block: BlockContext) -> SignalOrBus:
    """Make an input of a signal in a spreadsheet, which is not read."""
    return _measured(block, block.flat.block.name, _reason(block, "it is a spreadsheet, which is not read"))


@block("Signal Editor", "SignalEditor", FileName="untitled.mat", ActiveScenario="Scenario", ActiveSignal="",
       Interpolate="on", OutputAfterFinalValue="Setting to zero", SampleTime="0")  # fmt: skip
def signal_editor(block: BlockContext) -> Outputs:
    """Return the signals of the active scenario in a MAT-file, one a port, or inputs in their place."""
    try:
        signals = scenario_recording(_file_content(block), block.field_text("ActiveScenario"))
    except EvaluationError as error:
        return _measured_ports(block, _reason(block, error))
    if len(signals) > 1:
        shown = block.field_text("ActiveSignal") or "the one that is shown"
        block.warn(f"interpolates and ends all its signals as the file specifies it for {shown}")
    return tuple(_editor_signal(block, f"signal {at}", signal) for at, signal in enumerate(signals, 1))


def _editor_signal(block: BlockContext, label: str, signal: Recorded) -> SignalOrBus:
    if isinstance(signal, dict):
        return Bus({name: _editor_signal(block, f"{label} {name}", part) for name, part in signal.items()})
    times, values = signal
    columns = values.T
    names = [label] if len(columns) == 1 else [f"{label}[{at}]" for at in range(1, len(columns) + 1)]
    series = (RecordedSeries(times, column) for column in columns)
    return _joined(block, [_column(block, *pair) for pair in zip(names, series, strict=True)])


@block(HARDWARE_INPUT, sample="")
def hardware_input(block: BlockContext) -> Outputs:
    """Return an input of the model for what a block of a hardware support package reads."""
    return _measured_ports(block, "it reads hardware, one value a step unless blocks behind it take more")


def _measured_ports(block: BlockContext, why: str) -> Outputs:
    """Return an input for each port, as which its line names it."""
    own, ports = block.flat.block.name, block.flat.block.ports
    if ports is None or ports.outputs < 2:
        return _measured(block, own, why)
    names = [block.flat.output_names.get(at, "").strip("<>") or f"{own}:{at + 1}" for at in range(ports.outputs)]
    return tuple(_measured(block, name, why) for name in names)


def _measured(block: BlockContext, name: str, why: str) -> Signal:
    """Return an input of the model in place of a recording that is not there, with a remark."""
    inputs = block.compiler.inputs
    name = inputs.channel(block.flat, name)
    block.warn(f"is the input {name} of the model: {why}. Measure that channel, bind the block, or give its data")
    return inputs.open_signal(block.flat, name, "its recording is not there")


def _joined(block: BlockContext, columns: Sequence[Signal]) -> Signal:
    return block.signal([signal.flat[0] for signal in columns], CONTINUOUS)


def _check_points(points: RecordedSeries) -> None:
    times, values = points
    if len(times) != len(values) or len(times) < 2:
        raise UnsupportedError(f"it has {len(values)} values for {len(times)} times")
    if not (np.all(np.diff(times) >= 0) and np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise UnsupportedError("its times must increase, and its values must be finite", _BIND)


def _current_time(block: BlockContext) -> Signal:
    """Return the time, raised by a rounding tolerance."""
    return block.time + block.time_tolerance(1e-9)


def _column(block: BlockContext, label: str, points: RecordedSeries) -> Signal:
    """Return one signal of a recording that begins at 0 s, after its end as the dialog says."""
    _check_points(points)
    if points.times[0] > 0:
        raise UnsupportedError(f"its points must begin at 0 s, got {points.times[0]:g} s", _BIND)
    last = block.option("OutputAfterFinalValue", "Extrapolation", "Holding final value", "Setting to zero")
    now = _current_time(block)
    if block.is_on("Interpolate"):
        y = _line(block, label, block.time, points, "linear" if last == "Extrapolation" else "clip")
    else:
        y = _hold_points(block, now, points)
    if last == "Setting to zero":
        return select(now > float(points.times[-1]) + block.time_tolerance(), 0.0, y)
    return y


def _hold_points(block: BlockContext, now: Signal, points: RecordedSeries) -> Signal:
    if len(points.times) > _MAX_STEPS:
        raise UnsupportedError(f"it has {len(points.times)} steps; at most {_MAX_STEPS} are supported", _BIND)
    steps = zip(points.times[1:].tolist(), points.values[1:].tolist(), strict=True)
    return staircase(now, block.constant(float(points.values[0])), steps)


def _line(block: BlockContext, label: str, x: Signal, points: RecordedSeries, beyond: str) -> Signal:
    """Interpolate between points; two points at the same time are a jump."""
    times = points.times
    # a curve per piece between jumps: a curve of its own cannot have two equal breakpoints
    ends = [0, *(np.flatnonzero(np.diff(times) == 0) + 1), len(times)]
    if len(ends) > _MAX_STEPS:
        raise UnsupportedError(f"it has {len(ends) - 2} discontinuities; at most {_MAX_STEPS} are supported", _BIND)
    near, pieces = x + block.time_tolerance(1e-9), list[Signal]()
    for number, (first, end) in enumerate(pairwise(ends), 1):
        name = label if len(ends) == 2 else f"{label}, part {number}"
        part = RecordedSeries(times[first:end], points.values[first:end])
        method = LookupMethod("linear", beyond if end == len(times) else "clip")
        piece = block.constant(float(part.values[0]))
        if len(part.times) > 1:
            piece = constant_curve(block, name, x, part.times, part.values, method)
        # the last piece that has begun
        pieces.append(select(near >= float(times[first]), piece, pieces[-1]) if pieces else piece)
    return pieces[-1]
