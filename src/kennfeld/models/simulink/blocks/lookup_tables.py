"""Natural cubic splines through the values of a table, which they are linear in: its derivatives stay exact.

Between two breakpoints h apart, with s + p = 1, y = s yl + p yu + ((s^3 - s) Ml + (p^3 - p) Mu) h^2 / 6. The second
derivatives M follow from the values by a matrix of the breakpoints alone; they are 0 at the ends. A table of several
dimensions is a spline along its first one for each line, then one through what these give.

Tables: each becomes a curve, map or cube; its breakpoints are shared where several tables name the same ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.errors import ArgumentError
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Numbers, reduce_nodes
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import (
    ParameterField,
    calibrated_table,
    named_text,
    parameter_field,
)
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus, fastest_sample_time
from kennfeld.models.simulink.variables.mask_scope import Variable
from kennfeld.parameters import Axis, Parameter

__all__ = ["Method", "breakpoint_axis", "constant_curve", "lookup_field", "method_of", "numbered", "shape_of"]

_LINEAR = (
    "Linear",
    "Linear point-slope",
    "Linear Lagrange",
    "Interpolation-Extrapolation",
    "Interpolation-Use End Values",
)
_NEAREST = ("Nearest", "Use Input Nearest")
_SPLINE = ("Cubic spline", "Cubic Spline")
_LARGEST_SPLINE = 50_000  # nodes
_FLAT = ("Flat", "None - Flat", "Use Input Below", "Below")


def nodes_needed(shape: Sequence[int]) -> int:
    """About how many nodes a spline through a table of a shape takes."""
    lines = np.cumprod([1, *reversed(shape[1:])])[::-1]
    return sum(int(count) * size * (2 * size + 4) for count, size in zip(lines, shape, strict=True))


def spline(
    builder: GraphBuilder,
    value: Callable[..., int],
    points: Sequence[Numbers],
    coordinates: Sequence[int],
    beyond: str,
) -> int:
    """The node of a spline at coordinates. `value` gives the node of a grid point by its places.

    `beyond` the ends it is clipped, or goes on as a line or as the cubic of the last cell ("linear", "cubic").
    """
    if not points:
        return value()
    last, x = points[-1], coordinates[-1]
    made = [
        spline(builder, lambda *rest, at=at: value(*rest, at), points[:-1], coordinates[:-1], beyond)
        for at in range(len(last))
    ]
    return _along(builder, made, last, x, beyond)


def _along(builder: GraphBuilder, values: list[int], points: Numbers, x: int, beyond: str) -> int:
    """A spline along one dimension."""
    low, high, first, second, at, width = _cell(builder, values, _bends(builder, values, points), points, x)
    call, const = builder.call, builder.const
    p = call("div", call("sub", x, at), width)
    if beyond == "clip":
        p = call("min", call("max", p, const(0.0)), const(1.0))
    s = call("sub", const(1.0), p)
    square = call("mul", call("mul", width, width), const(1 / 6))
    curved = call("add", call("mul", _cubic(builder, s), first), call("mul", _cubic(builder, p), second))
    rise = call("sub", high, low)
    y = call("add", call("add", low, call("mul", p, rise)), call("mul", curved, square))
    if beyond != "linear":
        return y
    up = call("add", rise, call("mul", first, square))
    down = call("sub", rise, call("mul", second, square))
    above = call("add", high, call("mul", up, call("sub", p, const(1.0))))
    below = call("add", low, call("mul", down, p))
    y = call("select", call("gt", p, const(1.0)), above, y)
    return call("select", call("lt", p, const(0.0)), below, y)


def _cubic(builder: GraphBuilder, p: int) -> int:
    return builder.call("mul", p, builder.call("sub", builder.call("mul", p, p), builder.const(1.0)))


def _cell(builder: GraphBuilder, values: list[int], bends: list[int], points: Numbers, x: int) -> tuple[int, ...]:
    """What holds in the cell of x: values and bends at its ends, where it begins, how wide it is."""
    begins = [builder.const(float(point)) for point in points]
    widths = [builder.const(float(width)) for width in np.diff(points)]
    rows = list(zip(values, values[1:], bends, bends[1:], begins, widths, strict=False))
    made = rows[0]
    for begin, row in zip(begins[1:], rows[1:], strict=False):
        within = builder.call("ge", x, begin)
        made = tuple(builder.call("select", within, new, old) for new, old in zip(row, made, strict=True))
    return made


def _bends(builder: GraphBuilder, values: list[int], points: Numbers) -> list[int]:
    """The second derivatives at the breakpoints."""
    made = []
    for row in _matrix(points):
        terms = [
            builder.call("mul", builder.const(float(share)), v) for share, v in zip(row, values, strict=True) if share
        ]
        made.append(reduce_nodes(builder, "add", terms))
    return made


def _matrix(points: Numbers) -> Numbers:
    """What makes the second derivatives of the values."""
    count, widths = len(points), np.diff(points)
    left, right = np.eye(count), np.zeros((count, count))
    for i, (before, after) in enumerate(pairwise(widths), 1):
        left[i, i - 1 : i + 2] = before, 2 * (before + after), after
        right[i, i - 1 : i + 2] = 6 / before, -6 / before - 6 / after, 6 / after
    return np.asarray(np.linalg.solve(left, right), dtype=np.float64)


class Method(NamedTuple):
    """Between the breakpoints: linear, nearest, flat or spline; beyond them: clip, linear, or cubic for a spline."""

    between: str
    beyond: str


@block("Lookup_n-D", NumberOfTableDimensions="2", Table="[4 5 6;16 19 20;10 18 23]", InterpMethod="Linear point-slope",
       ExtrapMethod="Linear", BreakpointsForDimension1="[10,22,31]", BreakpointsForDimension2="[10,22,31]",
       BreakpointsSpecification="Explicit values", DataSpecification="Table and breakpoints", TableSource="Dialog",
       BreakpointsForDimension3="[1:3]", UseOneInputPortForAllInputData="off", SampleTime="-1")  # fmt: skip
def lookup_nd(site: BlockContext) -> SignalOrBus:
    """A table of any number of dimensions."""
    if site.chosen("DataSpecification", "Table and breakpoints", "Lookup table object") == "Lookup table object":
        return _object(site)
    site.chosen("TableSource", "Dialog", "Specify via dialog")
    count = site.whole("NumberOfTableDimensions", 1, 30)
    if count > 4:
        raise UnsupportedError(f"its table has {count} dimensions; parameters have at most 4")
    method = method_of(site.text("InterpMethod"), site.text("ExtrapMethod"))
    names = [f"BreakpointsForDimension{i + 1}" for i in range(count)]
    if site.chosen("BreakpointsSpecification", "Explicit values", "Even spacing") == "Even spacing":
        axes = [_even(site, i + 1, size) for i, size in enumerate(shape_of(site, "Table", count))]
    else:
        axes = _axes(site, "Table", names)
    return lookup_field(site, "Table", axes, _coordinates(site, count), method)


def _object(site: BlockContext) -> SignalOrBus:
    """A table whose values and breakpoints are in one variable."""
    whole = site.text("LookupTableObject")
    method = method_of(site.text("InterpMethod"), site.text("ExtrapMethod"))
    if (given := calibrated_table(site, whole)) is not None:
        axes = list(given.variable.axes)
        return _looked_up(site, given, axes, _coordinates(site, len(axes)), method)
    table = named_text(site, f"{whole}.Table")
    count = 1 if 1 in np.atleast_2d(table.values).shape else table.values.ndim
    axes = []
    for at in range(count):
        points = named_text(site, f"{whole}.Breakpoints{at + 1}").values.ravel()
        try:
            axes.append(Axis(points))
        except ArgumentError as error:
            raise UnsupportedError(f"breakpoints {at + 1} of {whole}: {error}") from None
    return _looked_up(site, replace(table, name=whole), axes, _coordinates(site, count), method)


def method_of(between: str, beyond: str) -> Method:
    """The method that the words of a block mean; raises `UnsupportedError` for others."""
    kind = {**dict.fromkeys(_LINEAR, "linear"), **dict.fromkeys(_NEAREST, "nearest"), **dict.fromkeys(_FLAT, "flat")}
    if between in _SPLINE:
        return Method("spline", _beyond_spline(beyond))
    if between not in kind:
        known = "Linear, nearest, flat and cubic splines are."
        raise UnsupportedError(f"InterpMethod is {between!r}, which is not supported", known)
    if kind[between] != "linear":
        return Method(kind[between], "clip")
    if beyond not in ("Clip", "None - Clip", "Linear"):
        raise UnsupportedError(f"ExtrapMethod is {beyond!r}, which is not supported", "Clip and linear are.")
    return Method("linear", "linear" if beyond == "Linear" else "clip")


def _beyond_spline(beyond: str) -> str:
    if beyond in _SPLINE:
        return "cubic"
    if beyond not in ("Clip", "None - Clip", "Linear"):
        raise UnsupportedError(f"ExtrapMethod is {beyond!r}, which is not supported", "Clip, linear and cubic are.")
    return "linear" if beyond == "Linear" else "clip"


def _coordinates(site: BlockContext, count: int) -> list[Signal]:
    if not site.on("UseOneInputPortForAllInputData"):
        return [site.input(at) for at in range(count)]
    u = site.input()
    if u.size != count:
        raise UnsupportedError(f"its input has {u.size} elements for {count} dimensions")
    return u.elements


def _even(site: BlockContext, number: int, size: int) -> Axis:
    first = site.number(f"BreakpointsForDimension{number}FirstPoint", "1")
    spacing = site.number(f"BreakpointsForDimension{number}Spacing", "1")
    return Axis(first + spacing * np.arange(size))


def shape_of(site: BlockContext, name: str, count: int) -> tuple[int, ...]:
    """The sizes of a table along its dimensions."""
    found = site.numbers(name)
    return (found.size,) if count == 1 else found.shape


def _axes(site: BlockContext, table: str, names: list[str]) -> list[Axis]:
    """The axes of a table: those of a calibration file, which come with its values, else the fields' breakpoints."""
    own = parameter_field(site, table).variable.axes
    return list(own) if len(own) == len(names) else [breakpoint_axis(site, name) for name in names]


def breakpoint_axis(site: BlockContext, name: str) -> Axis:
    """The breakpoints of a dimension; a variable by its name, so that tables share it."""
    found = parameter_field(site, name)
    group = found.name if found.is_variable else ""
    try:
        return Axis(found.values.ravel(), name=group, unit=found.variable.unit)
    except ArgumentError as error:
        raise UnsupportedError(f"its {name}: {error}") from None


def lookup_field(site: BlockContext, table: str, axes: list[Axis], coordinates: list[Signal], method: Method) -> Signal:
    """The table of a field at coordinates, element by element."""
    return _looked_up(site, parameter_field(site, table), axes, coordinates, method)


def constant_curve(
    site: BlockContext, field: str, x: Signal, points: Numbers, values: Numbers, method: Method
) -> Signal:
    """A curve through points that no one fits, called by the field that they come from."""
    held = Variable(values, source="a literal of the block")
    return _looked_up(
        site, ParameterField(f"{site.atom.path}:{field}", values, held, False), [Axis(points)], [x], method
    )


def _looked_up(
    site: BlockContext, found: ParameterField, axes: list[Axis], coordinates: list[Signal], method: Method
) -> Signal:
    table = found.name
    values = _fitted(found.values, tuple(len(axis) for axis in axes), table)
    if any(len(axis) < 2 for axis in axes):
        raise UnsupportedError(f"its {table} has a dimension with a single breakpoint")
    locked = not (found.is_variable or found.name in site.compiler.declared.promoted)
    axes = [axis.changed(input=_quantity(site, at)) if not axis.name else axis for at, axis in enumerate(axes)]
    kept = method.beyond if method.between != "spline" else "clip"
    made = site.compiler.declared.table(found.name, values, axes, found.variable, locked, kept)
    spread = site.spread(*coordinates)
    if method.between == "spline":
        return _splined(site, made, spread, method.beyond)
    if method.between != "linear":
        spread = [_snapped(site, x, axis, method.between) for x, axis in zip(spread, axes, strict=True)]
    columns = [one.nodes.ravel() for one in spread]
    nodes = [site.builder.lookup(made.name, *(int(node) for node in place)) for place in zip(*columns, strict=True)]
    period = fastest_sample_time([one.period for one in spread])
    return Signal(np.array(nodes, dtype=np.int64).reshape(spread[0].shape), period)


def _splined(site: BlockContext, table: Parameter, coordinates: list[Signal], beyond: str) -> Signal:
    """A spline through the values of a table, element by element."""
    points = [axis.breakpoints for axis in table.axes]
    shape = [len(axis) for axis in points]
    if nodes_needed(shape) > _LARGEST_SPLINE:
        sizes = " x ".join(map(str, shape))
        raise UnsupportedError(f"a spline through a table of {sizes} values is too large", "Linear lookups are not.")
    builder = site.builder

    def value(*places: int) -> int:
        return builder.lookup(
            table.name, *(builder.const(float(axis[at])) for axis, at in zip(points, places, strict=True))
        )

    columns = zip(*(one.nodes.ravel() for one in coordinates), strict=True)
    nodes = [spline(builder, value, points, [int(node) for node in place], beyond) for place in columns]
    period = fastest_sample_time([one.period for one in coordinates])
    return Signal(np.array(nodes, dtype=np.int64).reshape(coordinates[0].shape), period)


def _quantity(site: BlockContext, at: int) -> str:
    return site.atom.taken.get(at, "")


def _fitted(values: Numbers, shape: tuple[int, ...], table: str) -> Numbers:
    """The table's values in the shape of its breakpoints."""
    if len(shape) == 1 and values.size == shape[0]:
        return values.ravel()
    if values.shape != shape:
        sizes = " x ".join(map(str, values.shape))
        raise UnsupportedError(f"its {table} of {sizes} does not fit its {' x '.join(map(str, shape))} breakpoints")
    return values


def _snapped(site: BlockContext, x: Signal, axis: Axis, how: str) -> Signal:
    """The breakpoint that stands for a coordinate: the nearest one, the upper of two equally near, or the one below."""
    points = axis.breakpoints
    made = site.constant(float(points[0]))
    for low, high in pairwise(points):
        limit = site.constant(float(high if how == "flat" else (low + high) / 2))
        made = site.select(site.call("ge", x, limit), site.constant(float(high)), made)
    return made


@block("Lookup", InputValues="[-4:5]", Table=" rand(1,10)-0.5", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup(site: BlockContext) -> SignalOrBus:
    """A curve, as files before R2011a have it."""
    table = "Table" if site.atom.block.value("Table") is not None else "OutputValues"
    return lookup_field(site, table, _axes(site, table, ["InputValues"]), [site.input()], _old_method(site))


@block("Lookup2D", RowIndex="[0 1]", ColumnIndex="[0 1]", Table="[0 0;0 0]", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup_2d(site: BlockContext) -> SignalOrBus:
    """A map, as files before R2011a have it; the first input is along the rows."""
    rows = "RowIndex" if site.atom.block.value("RowIndex") is not None else "x"
    columns = "ColumnIndex" if site.atom.block.value("ColumnIndex") is not None else "y"
    table = "Table" if site.atom.block.value("Table") is not None else "t"
    return lookup_field(site, table, _axes(site, table, [rows, columns]), site.inputs[:2], _old_method(site))


def _old_method(site: BlockContext) -> Method:
    written = site.text("LookUpMeth")
    if written not in (*_LINEAR, *_NEAREST, *_FLAT):
        raise UnsupportedError(f"LookUpMeth is {written!r}, which is not supported")
    between = "linear" if written in _LINEAR else "nearest" if written in _NEAREST else "flat"
    return Method(between, "linear" if written == "Interpolation-Extrapolation" else "clip")


@block("LookupNDDirect", NumberOfTableDimensions="1", InputsSelectThisObjectFromTable="Element", TableIsInput="off",
       Table="[4 5 6;16 19 20;10 18 23]", SampleTime="-1")  # fmt: skip
def direct_lookup(site: BlockContext) -> SignalOrBus:
    """An element or a column of a table by its places, counted from 0; those beyond the ends take the ends."""
    wanted = site.chosen("InputsSelectThisObjectFromTable", "Element", "Column")
    if site.on("TableIsInput"):
        raise UnsupportedError("its table is an input", "Put a Selector in its place.")
    count = site.whole("NumberOfTableDimensions", 1, 4)
    shape = shape_of(site, "Table", count)
    places = [site.call("floor", one) for one in site.inputs]
    if wanted == "Column":
        places.insert(0, site.constant(*map(float, range(shape[0]))))
    if len(places) != count or (wanted == "Column" and any(place.size != 1 for place in places[1:])):
        raise UnsupportedError(f"its inputs do not choose an {wanted.lower()} of a table of {count} dimensions")
    axes = numbered(site, "Table", shape)
    return lookup_field(site, "Table", axes, places, Method("linear", "clip"))


@block("Lookup Table Dynamic", LookUpMeth="Interpolation-Extrapolation")
def lookup_dynamic(site: BlockContext) -> SignalOrBus:
    """A curve whose breakpoints and values are inputs."""
    method = _old_method(site)
    if site.count != 3:
        raise UnsupportedError(f"it has {site.count} inputs, not one each for x, the breakpoints and the values")
    x, xs, ys = (site.input(at) for at in range(3))
    if method.between != "linear" or xs.size != ys.size or xs.size < 2:
        raise UnsupportedError("only linear interpolation between two or more points is supported")
    points = [one.elements for one in (xs, ys)]
    made = _line(site, x, points, 0)
    for at in range(1, xs.size - 1):
        made = site.select(site.call("ge", x, points[0][at]), _line(site, x, points, at), made)
    if method.beyond == "linear":
        return made
    low = site.select(site.call("lt", x, points[0][0]), points[1][0], made)
    return site.select(site.call("gt", x, points[0][-1]), points[1][-1], low)


def _line(site: BlockContext, x: Signal, points: list[list[Signal]], at: int) -> Signal:
    (x0, x1), (y0, y1) = (one[at : at + 2] for one in points)
    share = site.call("div", site.call("sub", x, x0), site.call("sub", x1, x0))
    return site.call("add", y0, site.call("mul", share, site.call("sub", y1, y0)))


def numbered(site: BlockContext, table: str, shape: tuple[int, ...]) -> list[Axis]:
    """Axes that count from 0; raises `UnsupportedError` where a calibration file gives the table others."""
    axes = [Axis(np.arange(size)) for size in shape]
    own = parameter_field(site, table).variable.axes
    if own and not all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(own, axes, strict=False)):
        message = f"the calibration file gives its {table} breakpoints, but the model looks it up by number"
        raise UnsupportedError(message, "Give its values in a script or as a value block.")
    return axes
