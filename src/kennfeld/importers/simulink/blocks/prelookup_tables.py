"""Prelookup and Interpolation Using Prelookup: a lookup in two parts, cell and fraction, then table."""

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.importers.simulink.blocks.lookup_tables import (
    LookupMethod,
    breakpoint_axis,
    index_axes,
    lookup_field,
    method_of,
    table_shape,
)
from kennfeld.importers.simulink.lowering import BlockContext, Outputs, UnsupportedError, block
from kennfeld.importers.simulink.lowering.parameter_fields import parameter_field
from kennfeld.importers.simulink.signals import Bus, Signal, SignalOrBus, apply, clip, select
from kennfeld.models.imperative.node_arrays import Numbers

_MAX_BREAKPOINTS = 2000  # each is compared with the input


@block("PreLookup", BreakpointsData="[10:10:100]", BreakpointsSpecification="Explicit values",
       BreakpointsDataSource="Dialog", ExtrapMethod="Clip", OutputSelection="Index and fraction", IndexSearchMethod="",
       BreakpointsFirstPoint="10", BreakpointsSpacing="10", BreakpointsNumPoints="11",
       UseLastBreakpoint="off")  # fmt: skip
def prelookup(block: BlockContext) -> Outputs:
    """Find the index, from 0, of the cell that contains the input, and the fraction within it."""
    selection = block.option("OutputSelection", "Index and fraction", "Index only", "Index and fraction as bus")
    beyond = block.option("ExtrapMethod", "Clip", "None - Clip", "Linear")
    index, fraction = _cell(block, block.input(0), _breakpoints(block))
    if beyond != "Linear":
        fraction = clip(fraction, block.constant(0.0), block.constant(1.0))
        if block.is_on("UseLastBreakpoint"):  # an input at or beyond the last breakpoint has an index of its own
            at_end = fraction >= 1.0
            index, fraction = index + at_end, select(at_end, 0.0, fraction)
    if selection == "Index and fraction as bus":
        return Bus({"index": index, "fraction": fraction})
    return (index,) if selection == "Index only" else (index, fraction)


def _cell(block: BlockContext, u: Signal, points: list[Signal]) -> tuple[Signal, Signal]:
    # the last cell whose begin u has reached, as in `lookup_dynamic`
    index, low, high = block.constant(0.0), points[0], points[1]
    for at in range(1, len(points) - 1):
        within = u >= points[at]
        index = select(within, float(at), index)
        low, high = select(within, points[at], low), select(within, points[at + 1], high)
    return index, (u - low) / (high - low)


def _breakpoints(block: BlockContext) -> list[Signal]:
    if block.option("BreakpointsDataSource", "Dialog", "Input port") == "Input port":
        signals = block.input(1).elements
    else:
        points = _points(block)
        if not np.all(np.diff(points) > 0):
            raise UnsupportedError("its breakpoints must increase")
        signals = [block.constant(float(point)) for point in points]
    if not 2 <= len(signals) <= _MAX_BREAKPOINTS:
        raise UnsupportedError(f"it must have 2 to {_MAX_BREAKPOINTS} breakpoints, got {len(signals)}")
    return signals


def _points(block: BlockContext) -> Numbers:
    if block.is_set_to("BreakpointsSpecification", "Even spacing"):
        count = block.integer_field("BreakpointsNumPoints", 2, 100_000)
        first, spacing = block.numeric_field("BreakpointsFirstPoint"), block.numeric_field("BreakpointsSpacing")
        return np.asarray(first + spacing * np.arange(count), dtype=np.float64)
    return block.numeric_array("BreakpointsData").ravel()


@block("Interpolation_n-D", NumberOfTableDimensions="2", Table="sqrt([1:11]' * [1:11])", InterpMethod="Linear",
       ExtrapMethod="Clip", NumSelectionDims="0", TableSource="Dialog", RequireIndexFractionAsBus="off",
       TableSpecification="Explicit values")  # fmt: skip
def interpolation(block: BlockContext) -> SignalOrBus:
    """Look up a table at indices and fractions.

    If they come from Prelookup blocks, the table has their breakpoints; otherwise its axes are breakpoint numbers. The
    last dimensions may be selected by index alone. The flat method ignores the fraction.
    """
    block.option("TableSource", "Dialog")
    block.option("TableSpecification", "Explicit values")
    count = block.integer_field("NumberOfTableDimensions", 1, 4)
    chosen = block.integer_field("NumSelectionDims", 0, count - 1)
    method = method_of(block)
    if method.is_spline:
        raise UnsupportedError("it uses splines, which require the breakpoints", "Use an n-D Lookup Table block.")
    before = [context for at in range(count) if (context := _prelookup_of(block, at)) is not None]
    plain = not chosen and method.between == "linear" and not block.is_on("RequireIndexFractionAsBus")
    if plain and len(before) == count:
        return _look_up_at_prelookups(block, before, method)
    shape = table_shape(block, count)
    places, port = [], 0
    for _ in range(count - chosen):
        index, fraction, port = _cell_at(block, port)
        # breakpoint numbers as coordinates: cell + fraction
        places.append(index if method.between == "flat" else index + fraction)
    for at, size in enumerate(shape[count - chosen :], port):  # selected by index
        places.append(clip(apply("floor", block.input(at)), block.constant(0.0), block.constant(size - 1.0)))
    return lookup_field(block, "Table", index_axes(block, "Table", shape), places, method)


def _cell_at(block: BlockContext, port: int) -> tuple[Signal, Signal, int]:
    """Return the index and fraction along a dimension from the inputs at a port, and the next port."""
    if not block.is_on("RequireIndexFractionAsBus"):
        return block.input(port), block.input(port + 1), port + 2
    wired = block.input_or_bus(port)
    parts = list(wired.members.values()) if isinstance(wired, Bus) else []
    if len(parts) != 2 or not all(isinstance(part, Signal) for part in parts):
        raise UnsupportedError(f"its input {port + 1} is not a bus of an index and a fraction")
    index, fraction = (part for part in parts if isinstance(part, Signal))
    return index, fraction, port + 1


def _prelookup_of(block: BlockContext, at: int) -> BlockContext | None:
    """Return the Prelookup that gives both index and fraction of a dimension in every step, or None."""
    # an index and a fraction per dimension
    sources = block.flat.inputs[2 * at : 2 * at + 2]
    if len(sources) < 2 or sources[0] is None or sources[1] is None or sources[0].flat is not sources[1].flat:
        return None
    before = block.of(sources[0].flat)
    paired = before.flat.type == "PreLookup" and (sources[0].port, sources[1].port) == (0, 1)
    plain = paired and before.is_set_to("BreakpointsDataSource", "Dialog") and not before.is_on("UseLastBreakpoint")
    return before if plain and block.compiler.timing.specified_sample_time(before.flat) is None else None


def _look_up_at_prelookups(block: BlockContext, before: list[BlockContext], method: LookupMethod) -> SignalOrBus:
    """Look up a table over the breakpoints of the Prelookup blocks at their inputs."""
    own = parameter_field(block, "Table").variable.axes
    axes = list(own) if len(own) == len(before) else [_axis_of(block) for block in before]
    # a table extrapolates along all of its dimensions or none; where a Prelookup clips, its input is clipped instead
    ends = [method.beyond if block.is_set_to("ExtrapMethod", "Linear") else "clip" for block in before]
    places = [
        clip(context.input(), *(block.constant(float(axis.breakpoints[i])) for i in (0, -1)))
        if end == "clip" and "linear" in ends
        else context.input()
        for context, axis, end in zip(before, axes, ends, strict=True)
    ]
    return lookup_field(block, "Table", axes, places, LookupMethod("linear", "linear" if "linear" in ends else "clip"))


def _axis_of(before: BlockContext) -> Axis:
    even = before.is_set_to("BreakpointsSpecification", "Even spacing")
    return Axis(_points(before)) if even else breakpoint_axis(before, "BreakpointsData")
