"""Blocks without memory, each against numbers worked out by hand or by numpy."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.models.formula import formula
from kennfeld.models.formula.printer import to_text
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

U = np.array([-2.5, -1.0, -0.5, 0.0, 0.3, 1.0, 4.2])
V = np.array([1.5, -1.0, 2.0, 0.5, -3.0, 1.0, 2.0])
NAN = float("nan")

ONE = [
    ("Gain", {"Gain": "-2/4"}, -0.5 * U),
    ("Gain", {}, U),
    ("Bias", {"Bias": "pi"}, U + np.pi),
    ("UnaryMinus", {}, -U),
    ("Abs", {}, np.abs(U)),
    ("Signum", {}, np.sign(U)),
    ("Sum", {"Inputs": "-"}, -U),
    ("Product", {"Inputs": "/"}, 1 / np.where(U == 0, NAN, U)),
    ("Math", {}, np.exp(U)),
    ("Math", {"Operator": "square"}, U**2),
    ("Math", {"Operator": "10^u"}, 10.0**U),
    ("Math", {"Operator": "magnitude^2"}, U**2),
    ("Math", {"Operator": "reciprocal"}, 1 / np.where(U == 0, NAN, U)),
    ("Sqrt", {"Operator": "signedSqrt"}, np.sign(U) * np.sqrt(np.abs(U))),
    ("Rounding", {"Operator": "fix"}, np.trunc(U)),
    ("Rounding", {"Operator": "round"}, [-3, -1, -1, 0, 0, 1, 4]),
    ("Rounding", {"Operator": "ceil"}, np.ceil(U)),
    ("Rounding", {}, np.floor(U)),
    ("Trigonometry", {}, np.sin(U)),
    ("Trigonometry", {"Operator": "tanh"}, np.tanh(U)),
    ("Trigonometry", {"Operator": "asinh"}, np.arcsinh(U)),
    ("Fcn", {"Expr": "u^2 - 3*u(1) + (u > 0)"}, U**2 - 3 * U + (U > 0)),
    ("Fcn", {"Expr": "!(u[1] >= 1) && u != 0"}, (~(U >= 1) & (U != 0)).astype(float)),
    ("Fcn", {"Expr": "sgn(u)*sqrt(abs(u))"}, np.sign(U) * np.sqrt(np.abs(U))),
    ("Polyval", {"Coefs": "[2 0 -1]"}, 2 * U**2 - 1),
    ("Saturate", {}, np.clip(U, -0.5, 0.5)),
    ("Saturate", {"UpperLimit": "inf", "LowerLimit": "0"}, np.maximum(U, 0)),
    ("DeadZone", {}, np.where(U > 0.5, U - 0.5, np.where(U < -0.5, U + 0.5, 0))),
    ("Quantizer", {"QuantizationInterval": "0.5"}, [-2.5, -1.0, -0.5, 0.0, 0.5, 1.0, 4.0]),
    ("Logic", {"Operator": "NOT"}, (U == 0).astype(float)),
    ("RelationalOperator", {"Operator": "isFinite"}, np.ones(7)),
    ("DataTypeConversion", {"OutDataTypeStr": "int8"}, U),
    ("DataTypeConversion", {"OutDataTypeStr": "boolean"}, U != 0),
    ("SignalConversion", {}, U),
    ("MinMax", {"Inputs": "1"}, U),
    ("Lookup_n-D", {"NumberOfTableDimensions": "1", "Table": "[1 2 0]", "BreakpointsForDimension1": "[-1 0 2]"},
     np.where(U < 0, 2 + U, 2 - U)),
    ("Lookup_n-D", {"NumberOfTableDimensions": "1", "Table": "[1 2 0]", "BreakpointsForDimension1": "[-1 0 2]",
                    "ExtrapMethod": "Clip"}, np.interp(U, [-1, 0, 2], [1, 2, 0])),
    ("Lookup_n-D", {"NumberOfTableDimensions": "1", "Table": "[1 2 0]", "BreakpointsForDimension1": "[-1 0 2]",
                    "InterpMethod": "Flat"}, [1, 1, 1, 2, 2, 2, 0]),
    ("Lookup_n-D", {"NumberOfTableDimensions": "1", "Table": "[1 2 0]", "BreakpointsForDimension1": "[-1 0 2]",
                    "InterpMethod": "Nearest"}, [1, 1, 2, 2, 2, 0, 0]),
    ("Lookup_n-D", {"NumberOfTableDimensions": "1", "Table": "[1 2 5]", "BreakpointsSpecification": "Even spacing",
                    "BreakpointsForDimension1FirstPoint": "-1", "BreakpointsForDimension1Spacing": "1.5",
                    "ExtrapMethod": "Clip"}, np.interp(U, [-1, 0.5, 2], [1, 2, 5])),
    ("Lookup", {"InputValues": "[-1:2]", "Table": "[0 1 4 9]", "LookUpMeth": "Interpolation-Use End Values"},
     np.interp(U, [-1, 0, 1, 2], [0, 1, 4, 9])),
    ("Lookup", {"InputValues": "[-1 0]", "OutputValues": "[3 1]"}, 1 - 2 * U),
    ("LookupNDDirect", {"Table": "[10 20 30]"}, [10, 10, 10, 10, 10, 20, 30]),
]  # fmt: skip

TWO = [
    ("Sum", {}, U + V),
    ("Sum", {"Inputs": "|+-"}, U - V),
    ("Sum", {"Inputs": "-+"}, V - U),
    ("Product", {}, U * V),
    ("Product", {"Inputs": "*/"}, U / V),
    ("Product", {"Inputs": "/*"}, V / np.where(U == 0, NAN, U)),
    ("MinMax", {"Inputs": "2", "Function": "max"}, np.maximum(U, V)),
    ("MinMax", {"Inputs": "2"}, np.minimum(U, V)),
    ("Math", {"Operator": "mod"}, np.mod(U, V)),
    ("Math", {"Operator": "rem"}, np.fmod(U, V)),
    ("Math", {"Operator": "hypot"}, np.hypot(U, V)),
    ("Trigonometry", {"Operator": "atan2"}, np.arctan2(U, V)),
    ("RelationalOperator", {}, (U >= V).astype(float)),
    ("RelationalOperator", {"Operator": "~="}, (U != V).astype(float)),
    ("Logic", {"Operator": "XOR"}, ((U != 0) ^ (V != 0)).astype(float)),
    ("Logic", {"Operator": "NAND"}, (~((U != 0) & (V != 0))).astype(float)),
    ("Logic", {"Operator": "NOR"}, (~((U != 0) | (V != 0))).astype(float)),
    ("DotProduct", {}, U * V),
]


@pytest.mark.parametrize(("kind", "parameters", "expected"), ONE)
def test_blocks_of_one_input(kind, parameters, expected, tmp_path):
    output = run(imported(alone(kind, **parameters), tmp_path), {"u1": U})["y1"]
    usable = np.isfinite(np.asarray(expected, dtype=float))
    np.testing.assert_allclose(output[usable], np.asarray(expected)[usable], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(("kind", "parameters", "expected"), TWO)
def test_blocks_of_two_inputs(kind, parameters, expected, tmp_path):
    output = run(imported(alone(kind, 2, **parameters), tmp_path), {"u1": U, "u2": V})["y1"]
    usable = np.isfinite(expected)
    np.testing.assert_allclose(output[usable], np.asarray(expected)[usable], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, np.where(V >= 0, U, -U)),
        ({"Criteria": "u2 > Threshold", "Threshold": "1"}, np.where(V > 1, U, -U)),
        ({"Criteria": "u2 ~= 0", "Threshold": "9"}, U),
    ],
)
def test_a_switch_goes_by_its_criterion(parameters, expected, tmp_path):
    model = imported(alone("Switch", 3, **parameters), tmp_path)
    np.testing.assert_array_equal(run(model, {"u1": U, "u2": V, "u3": -U})["y1"], expected)


def test_a_multiport_switch_takes_the_input_of_the_number_and_the_last_beyond(tmp_path):
    drawn = alone("MultiPortSwitch", 4, Inputs=3)
    number = np.array([1.0, 2.0, 3.0, 7.0])
    outputs = run(imported(drawn, tmp_path), {"u1": number, "u2": number * 0 + 10, "u3": number * 0 + 20, "u4": number})
    assert outputs["y1"].tolist() == [10, 20, 3, 7]


LINKS = [
    ("Compare To Constant", {"relop": ">", "const": "0.3"}, 1, lambda u: u > 0.3),
    ("Compare To Zero", {"relop": "<"}, 1, lambda u: u < 0),
    ("Interval Test", {"uplimit": "1", "lowlimit": "-1", "IntervalClosedRight": "off"}, 1,
     lambda u: (u >= -1) & (u < 1)),
    ("Coulomb & Viscous Friction", {"offset": "3", "gain": "2"}, 1, lambda u: np.sign(u) * (2 * np.abs(u) + 3)),
    ("Wrap To Zero", {"Threshold": "1"}, 1, lambda u: np.where(u > 1, 0, u)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "parameters", "inputs", "rule"), LINKS)
def test_masked_blocks_of_the_library(kind, parameters, inputs, rule, tmp_path):
    model = imported(alone("Reference", inputs, special=kind, **parameters), tmp_path)
    np.testing.assert_allclose(run(model, {"u1": U})["y1"], np.asarray(rule(U), dtype=float))


def test_saturation_dynamic_has_its_limits_at_the_first_and_third_input(tmp_path):
    model = imported(alone("Reference", 3, special="Saturation Dynamic"), tmp_path)
    output = run(model, {"u1": U * 0 + 1, "u2": U, "u3": U * 0 - 1})["y1"]
    np.testing.assert_array_equal(output, np.clip(U, -1, 1))


def test_a_dynamic_table_interpolates_between_its_inputs(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Constant", "xs", Value="[-1 0 2]")
    drawn.block("Constant", "ys", Value="[1 2 0]")
    drawn.link("T", "lib/T", "Lookup Table Dynamic", ports=(3, 1), LookUpMeth="Interpolation-Use End Values")
    drawn.outport("y")
    for at, name in enumerate(("u", "xs", "ys"), 1):
        drawn.line(name, f"T:{at}")
    drawn.chain("T", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": U})["y"], np.interp(U, [-1, 0, 2], [1, 2, 0]))


def test_a_map_has_its_first_input_along_the_rows_and_is_bilinear(tmp_path):
    drawn = alone("Lookup_n-D", 2, Table="[1 2 4; 3 8 0]", BreakpointsForDimension1="[0 10]",
                  BreakpointsForDimension2="[0 1 3]", ExtrapMethod="Clip")  # fmt: skip
    output = run(imported(drawn, tmp_path), {"u1": [0, 10, 5, 20], "u2": [3, 1, 0.5, -1]})["y1"]
    np.testing.assert_allclose(output, [4, 8, (1 + 2 + 3 + 8) / 4, 3])


def test_a_map_from_before_2011(tmp_path):
    drawn = alone("Lookup2D", 2, Table="[1 2 4; 3 8 0]", RowIndex="[0 10]", ColumnIndex="[0 1 3]")
    output = run(imported(drawn, tmp_path), {"u1": [5, 20], "u2": [0.5, 0]})["y1"]
    np.testing.assert_allclose(output, [3.5, 5])


def test_a_cube_of_three_dimensions(tmp_path):
    drawn = alone("Lookup_n-D", 3, NumberOfTableDimensions=3, Table="reshape([1 2 3 4 5 6 7 8], 2, 2, 2)",
                  **{f"BreakpointsForDimension{i}": "[0 1]" for i in (1, 2, 3)})  # fmt: skip
    output = run(imported(drawn, tmp_path), {"u1": [1, 0, 0.5], "u2": [0, 1, 0.5], "u3": [0, 1, 0.5]})["y1"]
    np.testing.assert_allclose(output, [2, 7, 4.5])


# vectors


def vectors(*blocks, inputs=3):
    """u1, u2, ... in a mux, then blocks in a row, then all elements of the last as outputs."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for at in range(1, inputs + 1):
        drawn.inport(f"u{at}")
    drawn.block("Mux", "M", ports=(inputs, 1), Inputs=inputs)
    for at in range(1, inputs + 1):
        drawn.line(f"u{at}", f"M:{at}")
    for number, (kind, parameters) in enumerate(blocks):
        drawn.block(kind, f"B{number}", ports=(1, 1), **parameters)
    drawn.outport("y")
    drawn.chain("M", *(f"B{number}" for number in range(len(blocks))), "y")
    return drawn


X = {"u1": [1.0, 4.0], "u2": [2.0, 5.0], "u3": [3.0, -6.0]}


@pytest.mark.parametrize(
    ("blocks", "expected"),
    [
        ([("Sum", {"Inputs": "+"})], [[6], [3]]),
        ([("Product", {"Inputs": "*"})], [[6], [-120]]),
        ([("MinMax", {"Inputs": "1", "Function": "max"})], [[3], [5]]),
        ([("Gain", {"Gain": "[1 10 100]"})], [[1, 20, 300], [4, 50, -600]]),
        ([("Gain", {"Gain": "[1 1 0; 0 2 1]", "Multiplication": "Matrix(K*u)"})], [[3, 7], [9, 4]]),
        ([("Gain", {"Gain": "[1 0; 0 2; 1 1]", "Multiplication": "Matrix(u*K)"})], [[4, 7], [-2, 4]]),
        ([("Selector", {"IndexOptions": "'Index vector (dialog)'", "IndexParamArray": "'[3 1]'",
                        "NumberOfDimensions": "1"})], [[3, 1], [-6, 4]]),
        ([("Selector", {"IndexOptions": "Index vector (dialog)", "Indices": "[2 3]"})], [[2, 3], [5, -6]]),
        ([("Selector", {"IndexOptions": "Starting index (dialog)", "Indices": "1", "OutputSizes": "2",
                        "IndexMode": "Zero-based"})], [[2, 3], [5, -6]]),
        ([("Reshape", {"OutputDimensionality": "Row vector (2-D)"}),
          ("Selector", {"NumberOfDimensions": "2", "IndexOptions": "Select all,Index vector (dialog)",
                        "Indices": "1,[3 1]"})], [[3, 1], [-6, 4]]),
        ([("Fcn", {"Expr": "u(1)*u[2] + u(3)"})], [[5], [14]]),
        ([("Logic", {"Operator": "AND", "Inputs": "1"})], [[1], [1]]),
        ([("Saturate", {"UpperLimit": "[1 9 9]", "LowerLimit": "0"})], [[1, 2, 3], [1, 5, 0]]),
        ([("Reshape", {"OutputDimensionality": "Column vector (2-D)"}),
          ("Gain", {"Gain": "[1 1 1]", "Multiplication": "Matrix(K*u)"})], [[6], [3]]),
    ],
)  # fmt: skip
def test_vectors(blocks, expected, tmp_path):
    model = imported(vectors(*blocks), tmp_path)
    outputs = run(model, X)
    np.testing.assert_allclose(np.stack([outputs[name] for name in model.graph.outputs], axis=1), expected)


def test_a_selector_takes_its_place_from_an_input(tmp_path):
    drawn = vectors(("Selector", {"IndexOptions": "Index vector (port)"}))
    drawn.inport("place")
    drawn.line("place", "B0:2")
    columns = {"u1": [10.0] * 4, "u2": [20.0] * 4, "u3": [30.0] * 4, "place": [1.0, 2.0, 3.0, 2.0]}
    drawn.blocks[4].ports = {"in": 2, "out": 1}
    assert run(imported(drawn, tmp_path), columns)["y"].tolist() == [10, 20, 30, 20]


def test_demux_shares_elements_out_evenly_or_by_widths(tmp_path):
    drawn = vectors(inputs=3)
    drawn.wires.pop()
    drawn.block("Demux", "D", ports=(1, 2), Outputs="[2 1]")
    drawn.block("Sum", "S", ports=(1, 1), Inputs="+")
    drawn.outport("z")
    drawn.chain("M", "D", "S", "y")
    drawn.line("D:2", "z")
    outputs = run(imported(drawn, tmp_path), X)
    assert (outputs["y"].tolist(), outputs["z"].tolist()) == ([3, 9], [3, -6])


# wires


def test_buses_are_taken_apart_by_the_names_of_their_lines(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for name in ("a", "b", "c"):
        drawn.inport(name)
    drawn.block("BusCreator", "Inner", ports=(2, 1), Inputs=2)
    drawn.block("BusCreator", "Outer", ports=(2, 1), Inputs=2)
    drawn.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="engine.speed,load")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="+-")
    drawn.outport("y")
    drawn.line("a", "Inner:1", name="speed")
    drawn.line("b", "Inner:2", name="torque")
    drawn.line("Inner", "Outer:1", name="engine")
    drawn.line("c", "Outer:2", name="load")
    drawn.chain("Outer", "Pick")
    drawn.line("Pick:1", "S:1")
    drawn.line("Pick:2", "S:2")
    drawn.chain("S", "y")
    model = imported(drawn, tmp_path)
    assert model.graph.inputs == ("a", "c")
    assert run(model, {"a": [5.0], "b": [1.0], "c": [2.0]})["y"].tolist() == [3.0]


def test_an_unknown_signal_of_a_bus_is_reported_with_the_known_ones(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("a")
    drawn.block("BusCreator", "Bus", ports=(1, 1), Inputs=1)
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="sped")
    drawn.outport("y")
    drawn.line("a", "Bus", name="speed")
    drawn.chain("Bus", "Pick", "y")
    with pytest.raises(InputError, match="Pick: it selects sped, but the bus contains speed"):
        imported(drawn, tmp_path)


def nested():
    """Goto and From of every visibility around two levels of subsystems."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Goto", "G", GotoTag="wide", TagVisibility="global")
    drawn.block("Goto", "L", GotoTag="here")
    drawn.block("From", "F", GotoTag="here")
    inner = drawn.subsystem("Engine/Torque")
    inner.inport("x")
    inner.block("From", "F", GotoTag="wide")
    inner.block("Sum", "S", ports=(2, 1))
    inner.outport("z")
    inner.chain("x", "S", "z")
    inner.line("F", "S:2")
    drawn.outport("y")
    drawn.line("u", "G", "L")
    drawn.chain("F", "Engine/Torque", "y")
    return drawn


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
def test_tags_and_subsystems_are_wires(layout, tmp_path):
    model = imported(nested(), tmp_path, layout)
    assert run(model, {"u": U})["y"].tolist() == (2 * U).tolist()
    assert model.graph.names["Engine//Torque/S"] == model.graph.names["y"]


def test_a_subsystem_alone_takes_what_it_reads_from_outside_as_inputs(tmp_path):
    model = imported(nested(), tmp_path, subsystem="Engine//Torque")
    assert (model.graph.inputs, model.graph.outputs) == (("x", "wide"), ("z",))
    assert run(model, {"x": [1.0], "wide": [2.0]})["z"].tolist() == [3.0]
    with pytest.raises(InputError, match=r"unknown subsystem Engin.*Did you mean Engine//Torque"):
        imported(nested(), tmp_path, subsystem="Engin//Torque")


# parameters


def test_a_named_variable_is_a_parameter_and_an_expression_stays_exact(tmp_path):
    drawn = alone("Gain", Gain="K*2 - 1/T")
    model = imported(drawn, tmp_path, parameters=[{"K": 3.0, "T": 0.5}])
    assert dict(model.graph.parameters) == {"K": 0, "T": 0}
    assert (model.values["K"].value, model.values["T"].value) == (3.0, 0.5)
    np.testing.assert_allclose(run(model, {"u1": U})["y1"], 4 * U)
    np.testing.assert_allclose(slopes(model, {"u1": U}, "T", "y1")[0][:, 0], U / 0.25)


@pytest.mark.parametrize(
    ("kind", "inputs", "parameters", "name", "value"),
    [
        ("Gain", 1, {"Gain": "K"}, "K", 1.7),
        ("Gain", 1, {"Gain": "V(2)*V(1)"}, "V", [1.2, 3.4]),
        ("Saturate", 1, {"UpperLimit": "K"}, "K", 0.7),
        ("Fcn", 1, {"Expr": "exp(-K*u(1)^2) + K"}, "K", 0.7),
        ("Lookup_n-D", 1, {"NumberOfTableDimensions": "1", "Table": "K", "BreakpointsForDimension1": "[-1 0.1 2]"},
         "K", [1.0, 2.0, -1.0]),
        ("Lookup_n-D", 2, {"Table": "K", "BreakpointsForDimension1": "[-1 2]", "BreakpointsForDimension2": "X"},
         "K", [[1.0, 2.0, -1.0], [0.0, 3.0, 1.0]]),
        ("RateLimiter", 1, {"RisingSlewLimit": "K"}, "K", 3.0),
        ("DiscreteFilter", 1, {"Numerator": "[1 K]", "Denominator": "[1 -K/2]"}, "K", 0.4),
        ("DiscreteIntegrator", 1, {"gainval": "K", "SampleTime": "0.1"}, "K", 0.4),
    ],
)  # fmt: skip
def test_slopes_are_those_of_finite_differences(kind, inputs, parameters, name, value, tmp_path):
    drawn = alone(kind, inputs, **parameters)
    model = imported(drawn, tmp_path, parameters=[{name: value, "X": [-1.0, 0.0, 1.1]}])
    exact, differences = slopes(model, {f"u{i + 1}": one for i, one in enumerate((U + 0.01, V)[:inputs])}, name, "y1")
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)
    assert np.any(exact != 0)


def test_tables_are_called_by_their_variables_and_share_the_axes_that_they_name(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("n")
    drawn.inport("q")
    options = {"BreakpointsForDimension1": "AxisN", "BreakpointsForDimension2": "AxisQ", "ExtrapMethod": "Clip"}
    drawn.block("Lookup_n-D", "One", ports=(2, 1), Table="MapOne", **options)
    drawn.block("Lookup_n-D", "Two", ports=(2, 1), Table="data.Two", **options)
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.outport("y")
    for at, name in ((1, "n"), (2, "q")):
        drawn.line(name, f"One:{at}", f"Two:{at}")
    drawn.line("One", "S:1")
    drawn.line("Two", "S:2")
    drawn.chain("S", "y")
    one, two = np.arange(6.0).reshape(2, 3), np.ones((2, 3))
    parameters = {"MapOne": one, "data": {"Two": two}, "AxisN": [0.0, 1.0], "AxisQ": [0.0, 1.0, 2.0]}
    model = imported(drawn, tmp_path, parameters=[parameters])
    assert list(model.values) == ["MapOne", "data.Two"]
    assert [axis.name for axis in model.values["data.Two"].axes] == ["AxisN", "AxisQ"]
    np.testing.assert_array_equal(model.values["MapOne"].values, one)
    assert not model.values["MapOne"].locked.any()
    assert run(model, {"n": [1.0], "q": [2.0]})["y"].tolist() == [6.0]


def test_a_promoted_literal_is_a_parameter(tmp_path):
    drawn = nested()
    drawn.block("Gain", "K", Gain="3")
    drawn.outport("w")
    drawn.chain("u", "K", "w")
    assert not imported(drawn, tmp_path).values
    model = imported(drawn, tmp_path, promote=["K:Gain"])
    assert model.values["K:Gain"].value == 3.0
    np.testing.assert_allclose(slopes(model, {"u": U}, "K:Gain", "w")[0][:, 0], U)


def test_masks_are_evaluated_outside_and_seen_inside(tmp_path):
    from tests.importers.simulink.simulink_files import Mask

    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    outer = drawn.subsystem("Outer", mask=Mask({"a": "K*2", "b": "5"}))
    outer.inport("x")
    inner = outer.subsystem("Inner", mask=Mask({"K": "a + b"}))
    inner.inport("x")
    inner.block("Gain", "G", Gain="K")
    inner.outport("y")
    inner.chain("x", "G", "y")
    outer.outport("y")
    outer.chain("x", "Inner", "y")
    drawn.outport("y")
    drawn.chain("u", "Outer", "y")
    model = imported(drawn, tmp_path, parameters=[{"K": 1.5}])
    assert run(model, {"u": [1.0]})["y"].tolist() == [8.0]
    assert slopes(model, {"u": [1.0]}, "K", "y")[0].tolist() == [[2.0]]
    model = imported(drawn, tmp_path, parameters=[{"K": 1.5}], promote=["Outer:b"])
    assert dict(model.graph.parameters) == {"K": 0, "Outer:b": 0}


def test_a_mask_that_refers_to_itself_is_reported(tmp_path):
    from tests.importers.simulink.simulink_files import Mask

    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("S", mask=Mask({"K": "K + 1"}))
    inner.inport("x")
    inner.block("Gain", "G", Gain="K")
    inner.outport("y")
    inner.chain("x", "G", "y")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    with pytest.raises(InputError, match=r"variable K: undefined; used by S/G"):
        imported(drawn, tmp_path)


# what cannot be built


def test_all_unsupported_blocks_are_reported_and_can_be_bound(tmp_path):
    drawn = Model("car", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("S-Function", "Vendor", ports=(1, 1), FunctionName="x")
    drawn.block("Gain", "K", Gain="nowhere")
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.outport("y")
    drawn.line("u", "Vendor", "K")
    drawn.line("Vendor", "S:1")
    drawn.line("K", "S:2")
    drawn.chain("S", "y")
    with pytest.raises(InputError) as caught:
        imported(drawn, tmp_path)
    messages = [str(finding) for finding in caught.value.findings]
    assert any("car.slx Vendor: blocks of type S-Function are not supported" in one for one in messages)
    assert any("car.slx variable nowhere: undefined; used by K" in one for one in messages)
    model = imported(drawn, tmp_path, bind={"Vendor": "2*n_rpm", "K": "load"})
    assert set(model.graph.inputs) == {"n_rpm", "load"}
    assert run(model, {"n_rpm": [3.0], "load": [1.0]})["y"].tolist() == [7.0]
    with pytest.raises(InputError, match=r"unknown block Vndor. Did you mean Vendor"):
        imported(drawn, tmp_path, bind={"Vndor": "x"})


def test_an_algebraic_loop_is_reported_with_its_blocks(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.block("Gain", "K", Gain="0.5")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.line("S", "K", "y")
    drawn.line("K", "S:2")
    with pytest.raises(InputError, match=r"algebraic loop: .*(S -> K -> S|K -> S -> K)"):
        imported(drawn, tmp_path)


def test_a_block_that_no_output_needs_does_not_stop_the_import(tmp_path):
    drawn = alone("Gain", Gain="2")
    drawn.block("S-Function", "Vendor", ports=(1, 1))
    drawn.block("Scope", "Look", ports=(1, 0))
    drawn.line("u1", "Vendor")
    drawn.line("Vendor", "Look")
    assert run(imported(drawn, tmp_path), {"u1": [1.0]})["y1"].tolist() == [2.0]


def test_signals_of_scopes_are_the_outputs_of_a_model_without_others(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "Twice", Gain="2")
    drawn.block("Gain", "Thrice", Gain="3")
    drawn.block("Scope", "Look", ports=(2, 0))
    drawn.block("Display", "Again", ports=(1, 0))
    drawn.block("Scope", "Nothing", ports=(1, 0))
    drawn.line("u", "Twice", "Thrice")
    drawn.line("Twice", "Look:1", "Again", name="double")
    drawn.line("Thrice", "Look:2")
    model = imported(drawn, tmp_path)
    assert model.graph.outputs == ("double", "Thrice")
    outputs = run(model, {"u": U})
    np.testing.assert_array_equal(outputs["double"], 2 * U)
    np.testing.assert_array_equal(outputs["Thrice"], 3 * U)


@pytest.mark.parametrize("port", [{"OutDataTypeStr": "Bus: Engine"}, {}])
def test_the_signals_of_a_bus_from_outside_are_inputs_by_their_names(port, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("in", **port)
    inner = drawn.subsystem("S")
    inner.inport("bus")
    inner.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="engine.speed,load")
    inner.block("BusSelector", "Engine", ports=(1, 1), OutputSignals="engine")
    inner.block("BusSelector", "Torque", ports=(1, 1), OutputSignals="torque")
    inner.block("Sum", "Add", ports=(3, 1), Inputs="+-+")
    inner.outport("y")
    inner.line("bus", "Pick", "Engine")
    inner.chain("Engine", "Torque")
    inner.line("Pick:1", "Add:1")
    inner.line("Pick:2", "Add:2")
    inner.line("Torque", "Add:3")
    inner.chain("Add", "y")
    drawn.outport("y")
    drawn.chain("in", "S", "y")
    for subsystem, name in ((None, "in"), ("S", "bus")):
        model = imported(drawn, tmp_path, subsystem=subsystem)
        parts = {f"{name}.engine.speed": U, f"{name}.load": 2 * U**2, f"{name}.engine.torque": U + 3}
        assert set(model.graph.inputs) == set(parts)
        np.testing.assert_allclose(run(model, parts)["y"], 2 * U - 2 * U**2 + 3)
        assert formula(to_text(model.graph)).graph == model.graph


def test_a_signal_of_a_bus_from_outside_may_be_replaced(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("in")
    drawn.inport("u")
    drawn.block("BusAssignment", "Put", ports=(2, 1), AssignedSignals="a.x")
    drawn.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="a.x,a.y")
    drawn.outport("x")
    drawn.outport("y")
    drawn.line("in", "Put:1")
    drawn.line("u", "Put:2")
    drawn.chain("Put", "Pick", "x")
    drawn.line("Pick:2", "y")
    model = imported(drawn, tmp_path)
    assert set(model.graph.inputs) == {"u", "in.a.y"}
    outputs = run(model, {"u": U, "in.a.y": 2 * U})
    np.testing.assert_array_equal(outputs["x"], U)
    np.testing.assert_array_equal(outputs["y"], 2 * U)


def test_blocks_that_share_a_number_are_distinguished_by_their_names(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "Twice", Gain="2")
    drawn.block("Bias", "Plus", Bias="1")
    drawn.outport("y")
    drawn.chain("u", "Twice", "Plus", "y")
    for block in drawn.blocks:
        block.sid = 0
    result = import_simulink(drawn.write(tmp_path, "mdl"))
    assert run(result.model, {"u": U})["y"].tolist() == (2 * U + 1).tolist()
    assert any("two blocks with the SID 0" in str(remark) for remark in result.report.remarks)
