"""Signals over time whose values are in the model: lines between points, once or again and again."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.models.simulink.blocktypes.tables import Method, fixed_curve
from kennfeld.models.simulink.expressions.signals import CONTINUOUS, Signal, Wired
from kennfeld.models.simulink.variables.scopes import Array
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site

_MOST_STEPS = 2000  # of a signal that jumps; each takes a comparison
_BIND = "Bind it to a channel of the measurement, which takes its place."


class _Points(NamedTuple):
    times: Array
    values: Array


@block("Repeating table", "Repeating Sequence", linked=True, rep_seq_t="[0 2]", rep_seq_y="[0 2]")
def repeating_sequence(site: Site) -> Wired:
    """Lines between points, from the first to the last, again and again."""
    times, values = site.numbers("rep_seq_t").ravel(), site.numbers("rep_seq_y").ravel()
    _checked(times, values[:, None])
    if not times[-1] > times[0]:
        raise UnsupportedError("its points are all at one time")
    span = site.constant(float(times[-1] - times[0]))
    since = site.call("mod", site.call("sub", _now(site), site.constant(float(times[0]))), span)
    within = site.call("add", since, site.constant(float(times[0])))
    return _line(site, "rep_seq_y", within, _Points(times, values), "clip")


@block("FromWorkspace", VariableName="simulink_input", Interpolate="on", OutputAfterFinalValue="Extrapolation",
       SampleTime="0")  # fmt: skip
def from_workspace(site: Site) -> Wired:
    """The columns of a matrix over its first one, the time."""
    points = _points(site)
    times, values = points[:, 0], points[:, 1:]
    _checked(times, values)
    if times[0] > 0:
        raise UnsupportedError(f"its points begin at {times[0]:g} s, after the start", _BIND)
    last = site.text("OutputAfterFinalValue")
    columns = [_column(site, f"column {at}", _Points(times, one), last) for at, one in enumerate(values.T, 2)]
    nodes = np.array([one.flat[0] for one in columns], dtype=np.int64)
    return Signal(nodes, CONTINUOUS)


def _points(site: Site) -> Array:
    """The matrix of a field; other variables hold recordings."""
    try:
        points = site.numbers("VariableName")
    except UnsupportedError as error:
        raise UnsupportedError(f"its signal is recorded and not part of the model: {error.what}", _BIND) from None
    if points.shape[0] < 2 or points.shape[1] < 2:
        raise UnsupportedError("its signal is no matrix of times and values", _BIND)
    return points


def _checked(times: Array, values: Array) -> None:
    if len(times) != len(values) or len(times) < 2:
        raise UnsupportedError(f"it has {len(values)} values at {len(times)} times")
    if not (np.all(np.diff(times) >= 0) and np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise UnsupportedError("its times do not increase, or a value is not finite", _BIND)


def _now(site: Site) -> Signal:
    """The time, raised by what rounding may have taken from it."""
    return site.call("add", site.time, site.constant(1e-9 * (site.weaver.clock.step or 0.0)))


def _column(site: Site, label: str, points: _Points, last: str) -> Signal:
    now = _now(site)
    if site.on("Interpolate"):
        y = _line(site, label, site.time, points, "linear" if last == "Extrapolation" else "clip")
    else:
        y = _stairs(site, now, points)
    match last:
        case "Extrapolation" | "Holding final value":
            return y
        case "Setting to zero":
            return site.select(site.call("gt", now, site.constant(_end(site, points))), site.constant(0.0), y)
    raise UnsupportedError(f"OutputAfterFinalValue is {last!r}, which is not supported", _BIND)


def _end(site: Site, points: _Points) -> float:
    return float(points.times[-1]) + 1e-6 * (site.weaver.clock.step or 0.0)


def _stairs(site: Site, now: Signal, points: _Points) -> Signal:
    if len(points.times) > _MOST_STEPS:
        raise UnsupportedError(f"it has {len(points.times)} steps; {_MOST_STEPS} are the most", _BIND)
    y = site.constant(float(points.values[0]))
    for time, value in zip(points.times[1:], points.values[1:], strict=True):
        y = site.select(site.call("ge", now, site.constant(float(time))), site.constant(float(value)), y)
    return y


def _line(site: Site, label: str, x: Signal, points: _Points, beyond: str) -> Signal:
    """Lines between points; where two are at one time, the signal jumps there."""
    times = points.times
    ends = [0, *(np.flatnonzero(np.diff(times) == 0) + 1), len(times)]
    if len(ends) > _MOST_STEPS:
        raise UnsupportedError(f"it jumps at {len(ends) - 2} times; {_MOST_STEPS} are the most", _BIND)
    near = site.call("add", x, site.constant(1e-9 * (site.weaver.clock.step or 0.0)))
    y: Signal | None = None
    for number, (first, end) in enumerate(pairwise(ends), 1):
        name = label if len(ends) == 2 else f"{label}, part {number}"
        part = _Points(times[first:end], points.values[first:end])
        piece = _piece(site, name, x, part, beyond if end == len(times) else "clip")
        begun = site.call("ge", near, site.constant(float(times[first])))
        y = piece if y is None else site.select(begun, piece, y)
    assert y is not None
    return y


def _piece(site: Site, name: str, x: Signal, points: _Points, beyond: str) -> Signal:
    if len(points.times) == 1:
        return site.constant(float(points.values[0]))
    return fixed_curve(site, name, x, points.times, points.values, Method("linear", beyond))
