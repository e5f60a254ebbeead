"""Lookup Tables library: curves, maps and cubes with shared breakpoints, and splines through them."""

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import join_names, size_text
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Parameter
from kennfeld.importers.simulink.blocks.spline_interpolation import (
    interpolate_by_akima,
    interpolate_by_spline,
    nodes_needed,
)
from kennfeld.importers.simulink.lowering import ARITHMETIC, BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.lowering.parameter_fields import (
    ParameterField,
    calibrated_table,
    parameter_field,
    text_variable,
    variable_field,
)
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import (
    Signal,
    SignalOrBus,
    apply,
    broadcast,
    interpolate_line,
    period_of,
    select,
    staircase,
)
from kennfeld.importers.simulink.variables.mask_scope import USER_SOURCE, Variable
from kennfeld.models.imperative.node_arrays import Numbers

_MAX_SPLINE_NODES = 50_000
_METHODS = {
    "Linear": "linear", "Linear point-slope": "linear", "Linear Lagrange": "linear",
    "Interpolation-Extrapolation": "linear", "Interpolation-Use End Values": "linear",
    "Nearest": "nearest", "Use Input Nearest": "nearest",
    "Flat": "flat", "None - Flat": "flat", "Use Input Below": "flat", "Below": "flat",
    "Use Input Above": "above",
    "Cubic spline": "spline", "Akima spline": "akima",
}  # fmt: skip
_EXTRAPOLATIONS = {"Clip": "clip", "None - Clip": "clip", "Linear": "linear"}
_SPLINE_EXTRAPOLATIONS = {**_EXTRAPOLATIONS, "Cubic spline": "cubic"}
# the line that goes on from an Akima spline is not documented: the tangent, or that through the last two points
_AKIMA_EXTRAPOLATIONS = {"Clip": "clip", "None - Clip": "clip", "Akima spline": "akima"}


class LookupMethod(NamedTuple):
    """Interpolation (linear, nearest, flat, above, spline, akima) and extrapolation.

    The latter is clip or linear, also cubic for a spline, and clip or akima for one of Akima.
    """

    between: str
    beyond: str

    @property
    def is_spline(self) -> bool:
        """True if the table is looked up at its breakpoints alone, and the spline computed from these."""
        return self.between in ("spline", "akima")


@block("Lookup_n-D", output=ARITHMETIC,
       NumberOfTableDimensions="2", Table="[4 5 6;16 19 20;10 18 23]", InterpMethod="Linear point-slope",
       ExtrapMethod="Linear", BreakpointsForDimension1="[10,22,31]", BreakpointsForDimension2="[10,22,31]",
       BreakpointsSpecification="Explicit values", DataSpecification="Table and breakpoints", TableSource="Dialog",
       BreakpointsForDimension3="[1:3]", UseOneInputPortForAllInputData="off", SampleTime="-1")  # fmt: skip
def lookup_nd(block: BlockContext) -> SignalOrBus:
    """Look up a table with any number of dimensions."""
    if block.option("DataSpecification", "Table and breakpoints", "Lookup table object") == "Lookup table object":
        return _object(block)
    block.option("TableSource", "Dialog", "Specify via dialog")
    count = block.integer_field("NumberOfTableDimensions", 1, 30)
    if count > 4:
        raise UnsupportedError(f"its table has {count} dimensions; at most 4 are supported")
    method = method_of(block)
    names = [f"BreakpointsForDimension{i + 1}" for i in range(count)]
    if block.option("BreakpointsSpecification", "Explicit values", "Even spacing") == "Even spacing":
        starts = [block.numeric_field(f"{name}FirstPoint", "1") for name in names]
        spacings = [block.numeric_field(f"{name}Spacing", "1") for name in names]
        sizes = table_shape(block, count)
        axes = [Axis(x + dx * np.arange(n)) for x, dx, n in zip(starts, spacings, sizes, strict=False)]
    else:
        axes = table_axes(block, "Table", names)
    return lookup_field(block, "Table", axes, _coordinates(block, count), method)


def _object(block: BlockContext) -> SignalOrBus:
    """Look up a table whose values and breakpoints are one lookup table object."""
    whole = block.field_text("LookupTableObject")
    method = method_of(block)
    # a calibration file gives values and breakpoints together, so that those of the object do not count
    if (field := calibrated_table(block, whole)) is not None:
        axes = list(field.variable.axes)
        return _look_up(block, field, axes, _coordinates(block, len(axes)), method)
    table = variable_field(block, f"{whole}.Table")
    # a row or column is a curve
    count = 1 if 1 in np.atleast_2d(table.values).shape else table.values.ndim
    axes = [_object_axis(block, whole, at) for at in range(1, count + 1)]
    return _look_up(block, replace(table, name=whole), axes, _coordinates(block, count), method)


def _object_axis(block: BlockContext, whole: str, number: int) -> Axis:
    """Return the breakpoints of a table object: its own, or those of the breakpoint object that it names."""
    own = f"{whole}.Breakpoints{number}"
    shared = text_variable(block, own)
    field = variable_field(block, shared or own)
    return _axis(field.values, f"breakpoints {number} of {whole}", name=shared, unit=field.variable.unit)


def method_of(block: BlockContext) -> LookupMethod:
    """Read the method that a block specifies; raise `UnsupportedError` for unsupported ones."""
    between, beyond = block.field_text("InterpMethod"), block.field_text("ExtrapMethod")
    kind = _METHODS.get(match_word(between, _METHODS) or "")
    if kind is None:
        remedy = "Supported: linear, nearest, flat, cubic spline and Akima spline."
        raise UnsupportedError(f"InterpMethod {between!r} is not supported", remedy)
    # the outermost breakpoints are the nearest ones beyond the ends
    if kind in ("nearest", "flat"):
        return LookupMethod(kind, "clip")
    known = {"spline": _SPLINE_EXTRAPOLATIONS, "akima": _AKIMA_EXTRAPOLATIONS}.get(kind, _EXTRAPOLATIONS)
    end = match_word(beyond, known)
    if end is None:
        names = join_names(list(dict.fromkeys(known.values())), 4)
        raise UnsupportedError(f"ExtrapMethod {beyond!r} is not supported", f"Supported: {names}.")
    return LookupMethod(kind, known[end])


def _coordinates(block: BlockContext, count: int) -> list[Signal]:
    if not block.is_on("UseOneInputPortForAllInputData"):
        return [block.input(at) for at in range(count)]
    u = block.input()
    if u.size != count:
        raise UnsupportedError(f"its input has {u.size} elements for {count} dimensions")
    return u.elements


def table_shape(block: BlockContext, count: int) -> tuple[int, ...]:
    """Return the size of the table along each of its dimensions."""
    numbers = block.numeric_array("Table")
    return (numbers.size,) if count == 1 else numbers.shape


def table_axes(block: BlockContext, table: str, names: list[str]) -> list[Axis]:
    """Return the axes of a table: those of the calibration file that gives its values, else the breakpoint fields."""
    own = parameter_field(block, table).variable.axes
    return list(own) if len(own) == len(names) else [breakpoint_axis(block, name) for name in names]


def breakpoint_axis(block: BlockContext, name: str) -> Axis:
    """Read the breakpoints of a dimension; a variable gives the axis its name, so that tables share it."""
    field = parameter_field(block, name)
    group = field.name if field.is_variable else ""
    return _axis(field.values, f"its {name}", name=group, unit=field.variable.unit)


def _axis(points: Numbers, description: str, **attributes: Any) -> Axis:
    try:
        return Axis(points.ravel(), **attributes)
    except ArgumentError as error:
        raise UnsupportedError(f"{description}: {error}") from None


def lookup_field(
    block: BlockContext, table: str, axes: list[Axis], coordinates: list[Signal], method: LookupMethod
) -> Signal:
    """Look up the table of a field at coordinates, element by element."""
    return _look_up(block, parameter_field(block, table), axes, coordinates, method)


def constant_curve(
    block: BlockContext, field: str, x: Signal, points: Numbers, values: Numbers, method: LookupMethod
) -> Signal:
    """Look up a curve whose values are constants, named after the field they come from."""
    variable = Variable(values, source="a literal of the block")
    literal = ParameterField(f"{block.flat.path}:{field}", values, variable, False)
    return _look_up(block, literal, [Axis(points)], [x], method)


def _look_up(
    block: BlockContext, field: ParameterField, axes: list[Axis], coordinates: list[Signal], method: LookupMethod
) -> Signal:
    shape = tuple(len(axis) for axis in axes)
    if field.values.size == 1 and _is_given(block, field):
        values = np.full(shape, field.values.item())  # as a number is in a section of formula text
    else:
        values = _reshape_values(field.values, shape, field.name)
    if any(len(axis) < 2 for axis in axes):
        raise UnsupportedError(f"its {field.name} has a dimension with only one breakpoint")
    # literals of a block stay as they are unless they are promoted
    locked = not (field.is_variable or field.name in block.compiler.declared.promoted)
    inputs = block.flat.input_names
    # an axis without a name is described by the signal that it is looked up with
    axes = [axis if axis.name else axis.changed(input=inputs.get(at, "")) for at, axis in enumerate(axes)]
    # a spline looks its table up at breakpoints only
    kept = "clip" if method.is_spline else method.beyond
    parameter = block.compiler.declared.table(field.name, values, axes, field.variable, locked, kept)
    spread = broadcast(*coordinates)
    if method.is_spline:
        return _look_up_spline(block, parameter, spread, method)
    if method.between != "linear":
        # at a breakpoint, linear interpolation gives the value there
        spread = [_snap(block, x, axis, method.between) for x, axis in zip(spread, axes, strict=True)]
    places = zip(*(signal.flat for signal in spread), strict=True)
    nodes = [block.builder.lookup(parameter.name, *place) for place in places]
    return block.signal(nodes, period_of(spread), spread[0].shape)


def _is_given(block: BlockContext, field: ParameterField) -> bool:
    """Return True if the value comes from a project or from Python, under the name of the variable or of the field."""
    return block.flat.scope.variables.get(field.name, field.variable).source == USER_SOURCE


def _look_up_spline(block: BlockContext, table: Parameter, coordinates: list[Signal], method: LookupMethod) -> Signal:
    """Look up a spline through the values of a table, element by element."""
    points = [axis.breakpoints for axis in table.axes]
    shape = [len(axis) for axis in points]
    if nodes_needed(shape) > _MAX_SPLINE_NODES:
        message = f"its table of {size_text(shape)} values is too large for spline interpolation"
        raise UnsupportedError(message, "Use linear interpolation.")
    builder = block.builder

    def value(*indices: int) -> int:
        point = (builder.const(float(axis[at])) for axis, at in zip(points, indices, strict=True))
        # a lookup at a breakpoint is the value there, with the derivative 1 with respect to it
        return builder.lookup(table.name, *point)

    places = zip(*(signal.flat for signal in coordinates), strict=True)
    if method.between == "akima":
        if len(shape) > 1:
            message = f"it is an Akima spline over {len(shape)} dimensions; only curves are supported"
            raise UnsupportedError(message, "Use a cubic spline or linear interpolation.")
        values = [value(at) for at in range(shape[0])]
        nodes = [interpolate_by_akima(builder, values, points[0], place[0], method.beyond) for place in places]
    else:
        nodes = [interpolate_by_spline(builder, value, points, place, method.beyond) for place in places]
    return block.signal(nodes, period_of(coordinates), coordinates[0].shape)


def _reshape_values(values: Numbers, shape: tuple[int, ...], table: str) -> Numbers:
    """Return the table values in the shape of the breakpoints."""
    if len(shape) == 1 and values.size == shape[0]:
        return values.ravel()
    if values.shape != shape:
        sizes = size_text(values.shape)
        raise UnsupportedError(f"its {table} of size {sizes} does not match its {size_text(shape)} breakpoints")
    return values


def _snap(block: BlockContext, x: Signal, axis: Axis, how: str) -> Signal:
    """Round a coordinate to a breakpoint: the nearest (ties to the upper one), or the one below or above."""
    first, *points = axis.breakpoints.tolist()
    if how == "above":
        rounded = block.constant(first)
        for low, high in pairwise([first, *points]):
            rounded = select(x > low, high, rounded)
        return rounded
    # the nearest breakpoint changes in the middle between two
    limits = points if how == "flat" else [(low + high) / 2 for low, high in pairwise([first, *points])]
    return staircase(x, block.constant(first), zip(limits, points, strict=True))


@block("Lookup", output=ARITHMETIC,
       InputValues="[-4:5]", Table=" rand(1,10)-0.5", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup(block: BlockContext) -> SignalOrBus:
    """Look up a curve (block before R2011a)."""
    table = block.field_name("Table", "OutputValues")
    return lookup_field(block, table, table_axes(block, table, ["InputValues"]), [block.input()], named_method(block))


@block("Lookup2D", RowIndex="[0 1]", ColumnIndex="[0 1]", Table="[0 0;0 0]", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup_2d(block: BlockContext) -> SignalOrBus:
    """Look up a map (block before R2011a); the first input selects the row."""
    rows, columns = block.field_name("RowIndex", "x"), block.field_name("ColumnIndex", "y")
    table = block.field_name("Table", "t")
    return lookup_field(block, table, table_axes(block, table, [rows, columns]), block.inputs[:2], named_method(block))


def named_method(block: BlockContext) -> LookupMethod:
    """Read the method of a block that names interpolation and extrapolation in one field."""
    word = block.option("LookUpMeth", *(word for word, kind in _METHODS.items() if kind != "spline"))
    return LookupMethod(_METHODS[word], "linear" if word == "Interpolation-Extrapolation" else "clip")


@block("LookupNDDirect", NumberOfTableDimensions="1", InputsSelectThisObjectFromTable="Element", TableIsInput="off",
       Table="[4 5 6;16 19 20;10 18 23]", SampleTime="-1")  # fmt: skip
def direct_lookup(block: BlockContext) -> SignalOrBus:
    """Select an element or column of a table by indices from 0, clipped to the table."""
    wanted = block.option("InputsSelectThisObjectFromTable", "Element", "Column")
    if block.is_on("TableIsInput"):
        raise UnsupportedError("its table is an input, which is not supported", "Use a Selector block instead.")
    count = block.integer_field("NumberOfTableDimensions", 1, 4)
    shape = table_shape(block, count)
    places = [apply("floor", signal) for signal in block.inputs]
    if wanted == "Column":
        # all rows of the column, which broadcasting looks up at once
        places.insert(0, block.constant(*map(float, range(shape[0]))))
    if len(places) != count or (wanted == "Column" and any(place.size != 1 for place in places[1:])):
        raise UnsupportedError(f"its inputs do not select an {wanted.lower()} of a table of {count} dimensions")
    axes = index_axes(block, "Table", shape)
    return lookup_field(block, "Table", axes, places, LookupMethod("linear", "clip"))


@block("Lookup Table Dynamic", LookUpMeth="Interpolation-Extrapolation")
def lookup_dynamic(block: BlockContext) -> SignalOrBus:
    """Look up a curve whose breakpoints and values are inputs."""
    method = named_method(block)
    if block.input_count != 3:
        raise UnsupportedError(f"it must have three inputs (x, breakpoints and values), got {block.input_count}")
    x, xs, ys = (block.input(at) for at in range(3))
    if xs.size != ys.size or xs.size < 2:
        raise UnsupportedError(f"it must have at least two points, got {xs.size} breakpoints and {ys.size} values")
    points, values = xs.elements, ys.elements
    if method.between != "linear":
        return _select_point(x, points, values, method.between)
    result = interpolate_line(x, points, values)
    # the last segment whose begin x has reached, as for constant breakpoints
    for at in range(1, xs.size - 1):
        result = select(x >= points[at], interpolate_line(x, points[at:], values[at:]), result)
    if method.beyond == "linear":
        return result
    return select(x > points[-1], values[-1], select(x < points[0], values[0], result))


def _select_point(x: Signal, points: list[Signal], values: list[Signal], how: str) -> Signal:
    """Return the value at the breakpoint below x, above it, or nearest to it (ties to the upper one)."""
    result = values[0]
    for low, high, value in zip(points, points[1:], values[1:], strict=False):
        limits = {"flat": x >= high, "above": x > low, "nearest": x >= 0.5 * (low + high)}
        result = select(limits[how], value, result)
    return result


def index_axes(block: BlockContext, table: str, shape: tuple[int, ...]) -> list[Axis]:
    """Create axes 0, 1, 2, ...; raise `UnsupportedError` if a calibration file gives the table other breakpoints."""
    axes = [Axis(np.arange(size)) for size in shape]
    own = parameter_field(block, table).variable.axes
    if own and not all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(own, axes, strict=False)):
        message = f"the calibration file defines breakpoints for its {table}, but the model looks it up by index"
        raise UnsupportedError(message, "Define its values in a script or as a value block.")
    return axes
