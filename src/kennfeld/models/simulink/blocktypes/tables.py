"""Tables: each becomes a curve, map or cube; its breakpoints are shared where several tables name the same ones."""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.errors import ArgumentError
from kennfeld.models.simulink.blocktypes.splines import nodes_needed, spline
from kennfeld.models.simulink.expressions.signals import Signal, Wired, fastest
from kennfeld.models.simulink.variables.scopes import Array, Variable
from kennfeld.models.simulink.weaving.named import Named, given_table, named, named_text
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site
from kennfeld.parameters import Axis, Parameter

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


class Method(NamedTuple):
    """Between the breakpoints: linear, nearest, flat or spline; beyond them: clip, linear, or cubic for a spline."""

    between: str
    beyond: str


@block("Lookup_n-D", NumberOfTableDimensions="2", Table="[4 5 6;16 19 20;10 18 23]", InterpMethod="Linear point-slope",
       ExtrapMethod="Linear", BreakpointsForDimension1="[10,22,31]", BreakpointsForDimension2="[10,22,31]",
       BreakpointsSpecification="Explicit values", DataSpecification="Table and breakpoints", TableSource="Dialog",
       BreakpointsForDimension3="[1:3]", UseOneInputPortForAllInputData="off", SampleTime="-1")  # fmt: skip
def lookup_nd(site: Site) -> Wired:
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
    return looked_up(site, "Table", axes, _coordinates(site, count), method)


def _object(site: Site) -> Wired:
    """A table whose values and breakpoints are in one variable."""
    whole = site.text("LookupTableObject")
    method = method_of(site.text("InterpMethod"), site.text("ExtrapMethod"))
    if (given := given_table(site, whole)) is not None:
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


def _coordinates(site: Site, count: int) -> list[Signal]:
    if not site.on("UseOneInputPortForAllInputData"):
        return [site.input(at) for at in range(count)]
    u = site.input()
    if u.size != count:
        raise UnsupportedError(f"its input has {u.size} elements for {count} dimensions")
    return u.elements


def _even(site: Site, number: int, size: int) -> Axis:
    first = site.number(f"BreakpointsForDimension{number}FirstPoint", "1")
    spacing = site.number(f"BreakpointsForDimension{number}Spacing", "1")
    return Axis(first + spacing * np.arange(size))


def shape_of(site: Site, name: str, count: int) -> tuple[int, ...]:
    """The sizes of a table along its dimensions."""
    found = site.numbers(name)
    return (found.size,) if count == 1 else found.shape


def _axes(site: Site, table: str, names: list[str]) -> list[Axis]:
    """The axes of a table: those of a calibration file, which come with its values, else the fields' breakpoints."""
    own = named(site, table).variable.axes
    return list(own) if len(own) == len(names) else [axis_of(site, name) for name in names]


def axis_of(site: Site, name: str) -> Axis:
    """The breakpoints of a dimension; a variable by its name, so that tables share it."""
    found = named(site, name)
    group = found.name if found.is_variable else ""
    try:
        return Axis(found.values.ravel(), name=group, unit=found.variable.unit)
    except ArgumentError as error:
        raise UnsupportedError(f"its {name}: {error}") from None


def looked_up(site: Site, table: str, axes: list[Axis], coordinates: list[Signal], method: Method) -> Signal:
    """The table of a field at coordinates, element by element."""
    return _looked_up(site, named(site, table), axes, coordinates, method)


def fixed_curve(site: Site, field: str, x: Signal, points: Array, values: Array, method: Method) -> Signal:
    """A curve through points that no one fits, called by the field that they come from."""
    held = Variable(values, source="a literal of the block")
    return _looked_up(site, Named(f"{site.atom.path}:{field}", values, held, False), [Axis(points)], [x], method)


def _looked_up(site: Site, found: Named, axes: list[Axis], coordinates: list[Signal], method: Method) -> Signal:
    table = found.name
    values = _fitted(found.values, tuple(len(axis) for axis in axes), table)
    if any(len(axis) < 2 for axis in axes):
        raise UnsupportedError(f"its {table} has a dimension with a single breakpoint")
    locked = not (found.is_variable or found.name in site.weaver.declared.promoted)
    axes = [axis.changed(input=_quantity(site, at)) if not axis.name else axis for at, axis in enumerate(axes)]
    kept = method.beyond if method.between != "spline" else "clip"
    made = site.weaver.declared.table(found.name, values, axes, found.variable, locked, kept)
    spread = site.spread(*coordinates)
    if method.between == "spline":
        return _splined(site, made, spread, method.beyond)
    if method.between != "linear":
        spread = [_snapped(site, x, axis, method.between) for x, axis in zip(spread, axes, strict=True)]
    columns = [one.nodes.ravel() for one in spread]
    nodes = [site.loom.lookup(made.name, *(int(node) for node in place)) for place in zip(*columns, strict=True)]
    period = fastest([one.period for one in spread])
    return Signal(np.array(nodes, dtype=np.int64).reshape(spread[0].shape), period)


def _splined(site: Site, table: Parameter, coordinates: list[Signal], beyond: str) -> Signal:
    """A spline through the values of a table, element by element."""
    points = [axis.breakpoints for axis in table.axes]
    shape = [len(axis) for axis in points]
    if nodes_needed(shape) > _LARGEST_SPLINE:
        sizes = " x ".join(map(str, shape))
        raise UnsupportedError(f"a spline through a table of {sizes} values is too large", "Linear lookups are not.")
    loom = site.loom

    def value(*places: int) -> int:
        return loom.lookup(table.name, *(loom.const(float(axis[at])) for axis, at in zip(points, places, strict=True)))

    columns = zip(*(one.nodes.ravel() for one in coordinates), strict=True)
    nodes = [spline(loom, value, points, [int(node) for node in place], beyond) for place in columns]
    period = fastest([one.period for one in coordinates])
    return Signal(np.array(nodes, dtype=np.int64).reshape(coordinates[0].shape), period)


def _quantity(site: Site, at: int) -> str:
    return site.atom.taken.get(at, "")


def _fitted(values: Array, shape: tuple[int, ...], table: str) -> Array:
    """The table's values in the shape of its breakpoints."""
    if len(shape) == 1 and values.size == shape[0]:
        return values.ravel()
    if values.shape != shape:
        sizes = " x ".join(map(str, values.shape))
        raise UnsupportedError(f"its {table} of {sizes} does not fit its {' x '.join(map(str, shape))} breakpoints")
    return values


def _snapped(site: Site, x: Signal, axis: Axis, how: str) -> Signal:
    """The breakpoint that stands for a coordinate: the nearest one, the upper of two equally near, or the one below."""
    points = axis.breakpoints
    made = site.constant(float(points[0]))
    for low, high in pairwise(points):
        limit = site.constant(float(high if how == "flat" else (low + high) / 2))
        made = site.select(site.call("ge", x, limit), site.constant(float(high)), made)
    return made


@block("Lookup", InputValues="[-4:5]", Table=" rand(1,10)-0.5", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup(site: Site) -> Wired:
    """A curve, as files before R2011a have it."""
    table = "Table" if site.atom.block.value("Table") is not None else "OutputValues"
    return looked_up(site, table, _axes(site, table, ["InputValues"]), [site.input()], _old_method(site))


@block("Lookup2D", RowIndex="[0 1]", ColumnIndex="[0 1]", Table="[0 0;0 0]", LookUpMeth="Interpolation-Extrapolation",
       SampleTime="-1")  # fmt: skip
def lookup_2d(site: Site) -> Wired:
    """A map, as files before R2011a have it; the first input is along the rows."""
    rows = "RowIndex" if site.atom.block.value("RowIndex") is not None else "x"
    columns = "ColumnIndex" if site.atom.block.value("ColumnIndex") is not None else "y"
    table = "Table" if site.atom.block.value("Table") is not None else "t"
    return looked_up(site, table, _axes(site, table, [rows, columns]), site.inputs[:2], _old_method(site))


def _old_method(site: Site) -> Method:
    written = site.text("LookUpMeth")
    if written not in (*_LINEAR, *_NEAREST, *_FLAT):
        raise UnsupportedError(f"LookUpMeth is {written!r}, which is not supported")
    between = "linear" if written in _LINEAR else "nearest" if written in _NEAREST else "flat"
    return Method(between, "linear" if written == "Interpolation-Extrapolation" else "clip")


@block("LookupNDDirect", NumberOfTableDimensions="1", InputsSelectThisObjectFromTable="Element", TableIsInput="off",
       Table="[4 5 6;16 19 20;10 18 23]", SampleTime="-1")  # fmt: skip
def direct_lookup(site: Site) -> Wired:
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
    return looked_up(site, "Table", axes, places, Method("linear", "clip"))


@block("Lookup Table Dynamic", LookUpMeth="Interpolation-Extrapolation")
def lookup_dynamic(site: Site) -> Wired:
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


def _line(site: Site, x: Signal, points: list[list[Signal]], at: int) -> Signal:
    (x0, x1), (y0, y1) = (one[at : at + 2] for one in points)
    share = site.call("div", site.call("sub", x, x0), site.call("sub", x1, x0))
    return site.call("add", y0, site.call("mul", share, site.call("sub", y1, y0)))


def numbered(site: Site, table: str, shape: tuple[int, ...]) -> list[Axis]:
    """Axes that count from 0; raises `UnsupportedError` where a calibration file gives the table others."""
    axes = [Axis(np.arange(size)) for size in shape]
    own = named(site, table).variable.axes
    if own and not all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(own, axes, strict=False)):
        what = f"the calibration file gives its {table} breakpoints, but the model looks it up by number"
        raise UnsupportedError(what, "Give its values in a script or as a value block.")
    return axes
