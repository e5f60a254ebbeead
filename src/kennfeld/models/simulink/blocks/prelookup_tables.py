"""Lookups in two parts: the cell and the fraction within it, and the table at them."""

import numpy as np

from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.blocks.lookup_tables import (
    Method,
    breakpoint_axis,
    lookup_field,
    method_of,
    numbered,
    shape_of,
)
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import parameter_field
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Bus, Signal, SignalOrBus
from kennfeld.parameters import Axis

_MOST_POINTS = 2000  # that are compared with the input one by one


@block("PreLookup", BreakpointsData="[10:10:100]", BreakpointsSpecification="Explicit values",
       BreakpointsDataSource="Dialog", ExtrapMethod="Clip", OutputSelection="Index and fraction", IndexSearchMethod="",
       BreakpointsFirstPoint="10", BreakpointsSpacing="10", BreakpointsNumPoints="11",
       UseLastBreakpoint="off")  # fmt: skip
def prelookup(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """The cell that holds the input, counted from 0, and where within it."""
    selection = site.chosen("OutputSelection", "Index and fraction", "Index only", "Index and fraction as bus")
    beyond = site.chosen("ExtrapMethod", "Clip", "None - Clip", "Linear")
    index, fraction = _cell(site, site.input(0), _breakpoints(site))
    if beyond != "Linear":
        fraction = site.clip(fraction, site.constant(0.0), site.constant(1.0))
        if site.on("UseLastBreakpoint"):
            index, fraction = _last_one(site, index, fraction)
    if selection == "Index and fraction as bus":
        return Bus({"index": index, "fraction": fraction})
    return (index,) if selection == "Index only" else (index, fraction)


def _last_one(site: BlockContext, index: Signal, fraction: Signal) -> tuple[Signal, Signal]:
    """The last breakpoint as a cell of its own."""
    at_end = site.call("ge", fraction, site.constant(1.0))
    return site.call("add", index, at_end), site.select(at_end, site.constant(0.0), fraction)


def _cell(site: BlockContext, u: Signal, points: list[Signal]) -> tuple[Signal, Signal]:
    index, low, high = site.constant(0.0), points[0], points[1]
    for at in range(1, len(points) - 1):
        within = site.call("ge", u, points[at])
        index = site.select(within, site.constant(float(at)), index)
        low, high = site.select(within, points[at], low), site.select(within, points[at + 1], high)
    return index, site.call("div", site.call("sub", u, low), site.call("sub", high, low))


def _breakpoints(site: BlockContext) -> list[Signal]:
    """The breakpoints, which may come from an input."""
    if site.chosen("BreakpointsDataSource", "Dialog", "Input port") == "Input port":
        found = site.input(1).elements
    else:
        points = _points(site)
        if not np.all(np.diff(points) > 0):
            raise UnsupportedError("its breakpoints do not increase")
        found = [site.constant(float(point)) for point in points]
    if not 2 <= len(found) <= _MOST_POINTS:
        raise UnsupportedError(f"it has {len(found)} breakpoints, not 2 to {_MOST_POINTS}")
    return found


def _points(site: BlockContext) -> Numbers:
    if site.text("BreakpointsSpecification") == "Even spacing":
        count = site.whole("BreakpointsNumPoints", 2, 100_000)
        first, spacing = site.number("BreakpointsFirstPoint"), site.number("BreakpointsSpacing")
        return np.asarray(first + spacing * np.arange(count), dtype=np.float64)
    return site.numbers("BreakpointsData").ravel()


@block("Interpolation_n-D", NumberOfTableDimensions="2", Table="sqrt([1:11]' * [1:11])", InterpMethod="Linear",
       ExtrapMethod="Clip", NumSelectionDims="0", TableSource="Dialog", RequireIndexFractionAsBus="off",
       TableSpecification="Explicit values")  # fmt: skip
def interpolation(site: BlockContext) -> SignalOrBus:
    """A table at cells and fractions: the table of the prelookups' breakpoints where they come from such blocks.

    Of others, the axes are the numbers of the breakpoints. The last dimensions may be chosen by number alone. The flat
    method looks at the cell alone.
    """
    site.chosen("TableSource", "Dialog")
    site.chosen("TableSpecification", "Explicit values")
    count = site.whole("NumberOfTableDimensions", 1, 4)
    chosen = site.whole("NumSelectionDims", 0, count - 1)
    method = method_of(site.text("InterpMethod"), site.text("ExtrapMethod"))
    if method.between == "spline":
        raise UnsupportedError("it has a spline, which needs the breakpoints themselves", "Use an n-D Lookup Table.")
    before = [found for at in range(count) if (found := _prelookup_of(site, at)) is not None]
    if len(before) == count and not chosen and method.between == "linear" and not site.on("RequireIndexFractionAsBus"):
        return _at_prelookups(site, before, method)
    shape = shape_of(site, "Table", count)
    places, port = [], 0
    for _ in range(count - chosen):
        index, fraction, port = _cell_at(site, port)
        places.append(index if method.between == "flat" else site.call("add", index, fraction))
    places += [_within(site, site.input(port + at), shape[count - chosen + at]) for at in range(chosen)]
    return lookup_field(site, "Table", numbered(site, "Table", shape), places, method)


def _cell_at(site: BlockContext, port: int) -> tuple[Signal, Signal, int]:
    """The cell along a dimension and the fraction within it, of the inputs from a port on, and the port behind them."""
    if not site.on("RequireIndexFractionAsBus"):
        return site.input(port), site.input(port + 1), port + 2
    wired = site.wired(port)
    parts = list(wired.members.values()) if isinstance(wired, Bus) else []
    if len(parts) != 2 or not all(isinstance(part, Signal) for part in parts):
        raise UnsupportedError(f"its input {port + 1} is no bus of an index and a fraction")
    index, fraction = (part for part in parts if isinstance(part, Signal))
    return index, fraction, port + 1


def _within(site: BlockContext, number: Signal, size: int) -> Signal:
    """The number of a part of the table, within those there are."""
    return site.clip(site.call("floor", number), site.constant(0.0), site.constant(size - 1.0))


def _prelookup_of(site: BlockContext, at: int) -> BlockContext | None:
    """The prelookup that gives both the cell and the fraction of a dimension, in every step; None where none does."""
    sources = site.atom.inputs[2 * at : 2 * at + 2]
    if len(sources) < 2 or sources[0] is None or sources[1] is None or sources[0].atom is not sources[1].atom:
        return None
    before = site.compiler.site(sources[0].atom)
    paired = before.atom.kind == "PreLookup" and (sources[0].port, sources[1].port) == (0, 1)
    plain = paired and before.text("BreakpointsDataSource") == "Dialog" and not before.on("UseLastBreakpoint")
    return before if plain and site.compiler.timing.rate(before.atom) is None else None


def _at_prelookups(site: BlockContext, before: list[BlockContext], method: Method) -> SignalOrBus:
    """The table over the breakpoints of prelookups, at their inputs."""
    own = parameter_field(site, "Table").variable.axes
    axes = list(own) if len(own) == len(before) else [_axis_of(one) for one in before]
    ends = [method.beyond if one.text("ExtrapMethod") == "Linear" else "clip" for one in before]
    places = [
        _between(site, one.input(), axis) if end == "clip" and "linear" in ends else one.input()
        for one, axis, end in zip(before, axes, ends, strict=True)
    ]
    return lookup_field(site, "Table", axes, places, Method("linear", "linear" if "linear" in ends else "clip"))


def _between(site: BlockContext, x: Signal, axis: Axis) -> Signal:
    """A coordinate within the ends of an axis."""
    first, last = (site.constant(float(axis.breakpoints[end])) for end in (0, -1))
    return site.clip(x, first, last)


def _axis_of(before: BlockContext) -> Axis:
    even = before.text("BreakpointsSpecification") == "Even spacing"
    return Axis(_points(before)) if even else breakpoint_axis(before, "BreakpointsData")
