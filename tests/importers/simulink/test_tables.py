"""Lookups in parts and by places, against numpy."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Map
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

RNG = np.random.default_rng(31)
COUNT = 25
U = RNG.uniform(-1, 5, size=COUNT)
POINTS = np.array([0.0, 1.0, 3.0, 4.0])


def cells(u, points):
    index = np.clip(np.searchsorted(points, u, side="right") - 1, 0, len(points) - 2)
    return index, (u - points[index]) / (points[index + 1] - points[index])


@pytest.mark.parametrize("last", ["on", "off"])
@pytest.mark.parametrize("beyond", ["Clip", "Linear"])
def test_a_prelookup_finds_the_cell_and_the_fraction(last, beyond, tmp_path):
    u = np.concatenate([U, POINTS])
    drawn = alone("PreLookup", 1, 2, BreakpointsData="[0 1 3 4]", ExtrapMethod=beyond, UseLastBreakpoint=last)
    outputs = run(imported(drawn, tmp_path), {"u1": u})
    index, fraction = cells(u, POINTS)
    if beyond == "Clip":
        fraction = np.clip(fraction, 0, 1)
        if last == "on":
            index, fraction = (
                np.where(fraction == 1, 3, index) * 1,
                np.where((fraction == 1) & (index == 2), 0, fraction),
            )
    np.testing.assert_array_equal(outputs["y1"], index)
    np.testing.assert_allclose(outputs["y2"], fraction, atol=1e-14)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_breakpoints_may_be_an_input(layout, tmp_path):
    drawn = alone("PreLookup", 2, 2, BreakpointsDataSource="Input port", ExtrapMethod="Linear")
    next(one for one in drawn.blocks if one.name == "u2").parameters["PortDimensions"] = "4"
    shift = RNG.normal(size=COUNT)
    columns = {f"u2[{at}]": point + shift for at, point in enumerate(POINTS, 1)}
    outputs = run(imported(drawn, tmp_path, layout), {"u1": U, **columns})
    index, fraction = cells(U - shift, POINTS)
    np.testing.assert_array_equal(outputs["y1"], index)
    np.testing.assert_allclose(outputs["y2"], fraction, atol=1e-12)


def parts(bus="off", chosen=0):
    """A table Z of three dimensions, the last of which is chosen by number."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    names = ["a", "b", "n"][: 2 + chosen]
    for name in names:
        drawn.inport(name)
    outputs = "Index and fraction as bus" if bus == "on" else "Index and fraction"
    for name, points in (("a", "[0 1 3]"), ("b", "[-1 1 4 5]")):
        drawn.block("PreLookup", f"P{name}", ports=(1, 1 if bus == "on" else 2), BreakpointsData=points,
                    OutputSelection=outputs)  # fmt: skip
        drawn.line(name, f"P{name}")
    ends = ["Pa", "Pb"] if bus == "on" else ["Pa:1", "Pa:2", "Pb:1", "Pb:2"]
    ends += names[2:]
    drawn.block("Interpolation_n-D", "M", ports=(len(ends), 1), Table="Z", RequireIndexFractionAsBus=bus,
                NumberOfTableDimensions=str(2 + chosen), NumSelectionDims=str(chosen))  # fmt: skip
    drawn.outport("y")
    for at, end in enumerate(ends, 1):
        drawn.line(end, f"M:{at}")
    drawn.chain("M", "y")
    return drawn


Z = RNG.normal(size=(3, 4, 2))
A, B = RNG.uniform(-1, 4, size=(2, COUNT))


def bilinear(table, a, b):
    a, b = np.clip(a, 0, 3), np.clip(b, -1, 5)
    (i, f), (j, g) = cells(a, np.array([0.0, 1, 3])), cells(b, np.array([-1.0, 1, 4, 5]))
    low = table[i, j] + f * (table[i + 1, j] - table[i, j])
    high = table[i, j + 1] + f * (table[i + 1, j + 1] - table[i, j + 1])
    return low + g * (high - low)


@pytest.mark.parametrize("bus", ["on", "off"])
def test_an_interpolation_takes_cells_and_fractions_also_as_buses(bus, tmp_path):
    model = imported(parts(bus), tmp_path, parameters=[{"Z": Z[:, :, 0]}])
    output = run(model, {"a": A, "b": B})["y"]
    np.testing.assert_allclose(output, bilinear(Z[:, :, 0], A, B), atol=1e-12)
    exact, differences = slopes(model, {"a": A, "b": B}, "Z", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


def test_parts_of_a_table_are_chosen_by_number(tmp_path):
    number = np.array([0.0, 1.0, 1.7, -3.0, 9.0] * 5)
    model = imported(parts(chosen=1), tmp_path, parameters=[{"Z": Z}])
    output = run(model, {"a": A, "b": B, "n": number})["y"]
    part = np.clip(np.floor(number), 0, 1).astype(int)
    both = np.stack([bilinear(Z[:, :, at], A, B) for at in (0, 1)])
    np.testing.assert_allclose(output, both[part, np.arange(COUNT)], atol=1e-12)


def test_a_direct_lookup_gives_elements_and_columns(tmp_path):
    place = RNG.integers(-1, 4, size=(2, COUNT)).astype(float)
    drawn = alone("LookupNDDirect", 2, NumberOfTableDimensions="2", Table="Z")
    table = Z[:, :, 0]
    model = imported(drawn, tmp_path, parameters=[{"Z": table}])
    output = run(model, {"u1": place[0], "u2": place[1] + 0.5})["y1"]
    rows, columns = np.clip(place[0], 0, 2).astype(int), np.clip(place[1], 0, 3).astype(int)
    np.testing.assert_array_equal(output, table[rows, columns])
    drawn = alone("LookupNDDirect", 1, NumberOfTableDimensions="2", Table="Z", InputsSelectThisObjectFromTable="Column")
    output = run(imported(drawn, tmp_path, parameters=[{"Z": table}]), {"u1": place[1]})
    for at in range(3):
        np.testing.assert_array_equal(output[f"y1[{at + 1}]"], table[at, columns])


@pytest.mark.parametrize(
    ("kind", "inputs", "parameters", "reason"),
    [
        (
            "LookupNDDirect",
            1,
            {"TableIsInput": "on"},
            "its table is an input, which is not supported",
        ),
        (
            "LookupNDDirect",
            1,
            {"InputsSelectThisObjectFromTable": "2-D Matrix"},
            "'2-D Matrix' is not supported",
        ),
        ("LookupNDDirect", 1, {"NumberOfTableDimensions": "2"}, "do not select an element of a table of 2 dimensions"),
        ("Interpolation_n-D", 4, {"RequireIndexFractionAsBus": "on"}, "its input 1 is not a bus of an index"),
        ("Interpolation_n-D", 4, {"TableSource": "Input port"}, "TableSource 'Input port'"),
        ("Interpolation_n-D", 4, {"InterpMethod": "Cubic spline"}, "it uses splines, which require the breakpoints"),
        ("PreLookup", 1, {"BreakpointsData": "[1 3 2]"}, "its breakpoints must increase"),
        ("Lookup_n-D", 5, {"NumberOfTableDimensions": "5"}, "its table has 5 dimensions"),
        (
            "Lookup_n-D",
            1,
            {"NumberOfTableDimensions": "1", "InterpMethod": "Akima spline"},
            "ExtrapMethod 'Linear' is not supported.*Supported: clip, akima",
        ),
        (
            "Lookup_n-D",
            2,
            {"InterpMethod": "Akima spline", "ExtrapMethod": "Clip"},
            "an Akima spline over 2 dimensions",
        ),
        ("Interpolation_n-D", 4, {"InterpMethod": "Akima spline", "ExtrapMethod": "Clip"}, "it uses splines"),
    ],
)
def test_unsupported_lookups_are_refused_with_the_reason(kind, inputs, parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(alone(kind, inputs, **parameters), tmp_path)


X1, X2 = np.array([0.0, 1.0, 2.5, 3.0, 5.0]), np.array([-1.0, 0.5, 2.0, 4.0])
W = RNG.normal(size=(5, 4))


def natural(points, values, x, beyond):
    """A natural spline of scipy, along the first dimension, and what goes on beyond its ends."""
    spline = scipy.interpolate.CubicSpline(points, values, bc_type="natural")
    inside = np.clip(x, points[0], points[-1])
    y = spline(inside) if beyond != "Cubic spline" else spline(x)
    if beyond == "Linear":
        y = y + spline(inside, 1) * (x - inside)
    return y


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
@pytest.mark.parametrize("beyond", ["Clip", "Linear", "Cubic spline"])
def test_a_spline_is_that_of_scipy(beyond, layout, tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 2.5 3 5]",
                  InterpMethod="Cubic spline", ExtrapMethod=beyond)  # fmt: skip
    model = imported(drawn, tmp_path, layout, parameters=[{"Eta": W[:, 0]}])
    u = np.concatenate([U * 1.5, X1])
    output = run(model, {"u1": u})["y1"]
    np.testing.assert_allclose(output, natural(X1, W[:, 0], u, beyond), rtol=1e-11, atol=1e-11)
    exact, differences = slopes(model, {"u1": u}, "Eta", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-7)
    assert (np.abs(exact) > 1e-6).sum(axis=1).max() == 5


@pytest.mark.slow
@pytest.mark.parametrize("beyond", mostly_slow(["Clip", "Linear", "Cubic spline"], ["Linear"]))
def test_a_spline_of_two_dimensions_goes_along_the_first_one_first(beyond, tmp_path):
    drawn = alone("Lookup_n-D", 2, NumberOfTableDimensions="2", Table="Map", BreakpointsForDimension1="[0 1 2.5 3 5]",
                  BreakpointsForDimension2="[-1 0.5 2 4]", InterpMethod="Cubic spline",
                  ExtrapMethod=beyond)  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[{"Map": W}])
    assert model.values["Map"].values.shape == (5, 4)
    a, b = RNG.uniform(-1, 6, size=(2, 8))
    assert (a > X1[-1]).any()
    assert (b < X2[0]).any() or (b > X2[-1]).any()
    output = run(model, {"u1": a, "u2": b})["y1"]
    lines = [natural(X1, W, one, beyond) for one in a]
    expected = [float(natural(X2, line, one, beyond)) for line, one in zip(lines, b, strict=True)]
    np.testing.assert_allclose(output, expected, rtol=1e-10, atol=1e-10)
    exact, differences = slopes(model, {"u1": a[:3], "u2": b[:3]}, "Map", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-7)


def test_a_spline_through_two_points_is_a_line_and_one_through_very_many_is_refused(tmp_path):
    options = {"NumberOfTableDimensions": "1", "InterpMethod": "Cubic spline", "ExtrapMethod": "Linear"}
    drawn = alone("Lookup_n-D", Table="[1 3]", BreakpointsForDimension1="[0 2]", **options)
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u1": U})["y1"], 1 + U, atol=1e-12)
    drawn = alone("Lookup_n-D", Table="1:2000", BreakpointsForDimension1="1:2000", **options)
    with pytest.raises(InputError, match="its table of 2000 values is too large for spline interpolation"):
        imported(drawn, tmp_path)


# a jump between flat regions, where the weights of the slopes vanish, and a wave
FLAT = np.array([1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0, -2.0, 3.0])
X9 = np.array([0.0, 1.0, 1.5, 2.5, 3.0, 3.25, 5.0, 6.0, 6.5])


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
@pytest.mark.parametrize("beyond", ["Clip", "Akima spline"])
@pytest.mark.parametrize("count", [3, 5, 9])
def test_an_akima_spline_is_that_of_scipy(count, beyond, layout, tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="x",
                  InterpMethod="Akima spline", ExtrapMethod=beyond)  # fmt: skip
    x, y = X9[:count], FLAT[:count] if count == 9 else W[:count, 0]
    model = imported(drawn, tmp_path, layout, parameters=[{"Eta": y, "x": x}])
    u = np.concatenate([np.linspace(x[0] - 1, x[-1] + 1, 57), x])
    reference = scipy.interpolate.Akima1DInterpolator(x, y, method="makima", extrapolate=True)
    expected = reference(np.clip(u, x[0], x[-1]) if beyond == "Clip" else u)
    np.testing.assert_allclose(run(model, {"u1": u})["y1"], expected, rtol=1e-11, atol=1e-11)


def test_the_slopes_of_an_akima_spline_are_those_of_finite_differences(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 2.5 3 5]",
                  InterpMethod="Akima spline", ExtrapMethod="Akima spline")  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[{"Eta": W[:, 1]}])
    exact, differences = slopes(model, {"u1": U}, "Eta", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-7)


def test_an_akima_spline_through_two_points_is_a_line(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="[1 3]", BreakpointsForDimension1="[0 2]",
                  InterpMethod="Akima spline", ExtrapMethod="Akima spline")  # fmt: skip
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u1": U})["y1"], 1 + U, atol=1e-12)


def test_a_slider_is_a_gain(tmp_path):
    output = run(imported(alone("Reference", special="Slider Gain", gain="2.5"), tmp_path), {"u1": U})["y1"]
    np.testing.assert_allclose(output, 2.5 * U)


MATRIX = np.array([[1.0, 2.0], [5.0, 3.0]])


def map_of(drawn, name, table, **parameters):
    """A map of two rows and columns from u and v to an outport."""
    drawn.block("Lookup_n-D", name, ports=(2, 1), NumberOfTableDimensions="2", Table=table, ExtrapMethod="Linear",
                BreakpointsForDimension1="[0 1]", BreakpointsForDimension2="[0 1]", **parameters)  # fmt: skip
    drawn.outport(f"y{name}")
    drawn.line("u", f"{name}:1")
    drawn.line("v", f"{name}:2")
    drawn.line(name, f"y{name}")


def between_corners(table, u, v):
    return (1 - u) * (1 - v) * table[0, 0] + (1 - u) * v * table[0, 1] + u * (1 - v) * table[1, 0] + u * v * table[1, 1]


def transposed():
    """Maps of a matrix and of its transpose, the latter straight and through a mask that turns it twice more."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("v")
    map_of(drawn, "A", "M'")
    map_of(drawn, "B", "M")
    inner = drawn.subsystem("S", mask=Mask({"N": "M'"}))
    inner.inport("u")
    inner.inport("v")
    map_of(inner, "C", "N''")
    drawn.outport("yS")
    drawn.line("u", "S:1")
    drawn.line("v", "S:2")
    drawn.line("S", "yS")
    return drawn


@pytest.mark.parametrize("given", [{"M": MATRIX}, ParameterSet([Map("M", [0, 1], [0, 1], MATRIX)])])
def test_a_matrix_and_its_transpose_are_two_tables(given, tmp_path):
    model = imported(transposed(), tmp_path, parameters=[given])
    columns = {"u": RNG.uniform(-1, 2, COUNT), "v": RNG.uniform(-1, 2, COUNT)}
    outputs = run(model, columns)
    np.testing.assert_allclose(outputs["yB"], between_corners(MATRIX, **columns), rtol=1e-12)
    for name in ("yA", "yS"):
        np.testing.assert_allclose(outputs[name], between_corners(MATRIX.T, **columns), rtol=1e-12)
    assert {name: one.values.tolist() for name, one in model.values.items()} == {
        "M'": MATRIX.T.tolist(), "M": MATRIX.tolist(),
    }  # fmt: skip
    exact, differences = slopes(model, columns, "M'", "yA")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


def test_axes_and_limits_of_a_transposed_table_change_over(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("v")
    map_of(drawn, "A", "M'")
    original = Map("M", [0, 10], [0, 1, 2], np.arange(6.0).reshape(2, 3), lower=-np.arange(6.0).reshape(2, 3))
    table = imported(drawn, tmp_path, parameters=[ParameterSet([original])]).values["M'"]
    assert [axis.breakpoints.tolist() for axis in table.axes] == [[0, 1, 2], [0, 10]]
    np.testing.assert_array_equal(table.lower, original.lower.T)


def test_a_row_that_is_transposed_stays_the_variable(tmp_path):
    model = imported(alone("Lookup_n-D", NumberOfTableDimensions="1", Table="R'", BreakpointsForDimension1="[0 1 3]"),
                     tmp_path, parameters=[{"R": [[1.0, 2.0, 0.0]]}])  # fmt: skip
    assert list(model.values) == ["R"]


@pytest.mark.parametrize("first", ["Gain", "Lookup_n-D"])
def test_a_variable_may_be_a_table_and_numbers(first, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    curve = {"NumberOfTableDimensions": "1", "BreakpointsForDimension1": "[0 1 3]", "ExtrapMethod": "Clip"}
    kinds = {"Gain": {"Gain": "R"}, "Lookup_n-D": {"Table": "R", **curve}}
    for kind in sorted(kinds, key=lambda kind: kind != first):
        drawn.block(kind, kind, **kinds[kind])
        drawn.outport(f"y{kind}")
        drawn.chain("u", kind, f"y{kind}")
    outputs = run(imported(drawn, tmp_path, parameters=[{"R": [1.0, 2.0, 0.0]}]), {"u": U})
    np.testing.assert_allclose(outputs["yLookup_n-D"], np.interp(U, [0, 1, 3], [1, 2, 0]), atol=1e-12)
    np.testing.assert_allclose(outputs["yGain[2]"], 2 * U)


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("Use Input Nearest", [10, 10, 20, 20, 40, 40, 40]),
        ("Use Input Below", [10, 10, 10, 20, 20, 40, 40]),
        ("Use Input Above", [10, 10, 20, 20, 40, 40, 40]),
        ("Interpolation-Use End Values", [10, 10, 15, 20, 30, 40, 40]),
        ("Interpolation-Extrapolation", [0, 10, 15, 20, 30, 40, 50]),
    ],
)
@pytest.mark.parametrize("dynamic", [True, False])
def test_old_methods_choose_the_point_below_above_or_nearest(method, expected, dynamic, tmp_path):
    u = [0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]
    if dynamic:
        drawn = Model(step="0.1", solver="FixedStepDiscrete")
        drawn.inport("u1")
        drawn.block("Constant", "X", Value="[1 2 4]", ports=(0, 1))
        drawn.block("Constant", "Y", Value="[10 20 40]", ports=(0, 1))
        drawn.link("B", "lib/B", "Lookup Table Dynamic", ports=(3, 1), LookUpMeth=method)
        drawn.outport("y1")
        drawn.line("u1", "B:1")
        drawn.line("X", "B:2")
        drawn.line("Y", "B:3")
        drawn.line("B", "y1")
    else:
        drawn = alone("Lookup", InputValues="[1 2 4]", Table="[10 20 40]", LookUpMeth=method)
    assert run(imported(drawn, tmp_path), {"u1": u})["y1"].tolist() == expected
