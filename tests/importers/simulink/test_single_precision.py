"""Signals of type single: with float32 they are rounded as generated code rounds them, against floats of NumPy."""

import numpy as np
import pytest

from kennfeld.project.schema import read_project
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run

SINGLE = {"OutDataTypeStr": "single"}
RNG = np.random.default_rng(3)
U, V = RNG.normal(0, 3, 40), RNG.normal(0, 3, 40)
F, G = U.astype(np.float32), V.astype(np.float32)
f32 = np.float32


def drawing(**options):
    """A model with inports u of type single and v."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete", **options)
    drawn.inport("u", **SINGLE)
    drawn.inport("v", **SINGLE)
    return drawn


def outcome(drawn, folder, **options):
    """The output y with single precision; it must differ from that in double."""
    columns = {name: values for name, values in (("u", U), ("v", V)) if name in [b.name for b in drawn.blocks]}
    rounded = run(imported(drawn, folder, float32=True, **options), columns)["y"]
    assert not np.array_equal(rounded, run(imported(drawn, folder, **options), columns)["y"])
    return rounded


def test_each_operation_and_each_state_of_a_loop_is_rounded(tmp_path):
    drawn = drawing()
    drawn.block("Gain", "K", Gain="0.1")
    drawn.block("Sum", "S", ports=(3, 1), Inputs="++-")
    drawn.block("UnitDelay", "D", SampleTime="0.1", InitialCondition="0.3")
    drawn.block("DiscreteIntegrator", "I", SampleTime="0.1", gainval="0.7", InitialCondition="0.1")
    drawn.block("Product", "P", ports=(2, 1), Inputs="*/")
    drawn.outport("y")
    drawn.chain("u", "K", "S:1")
    drawn.line("S", "D", "I", "P:2")
    drawn.line("D", "S:2")
    drawn.line("v", "S:3")
    drawn.chain("I", "P", "y")
    expected, state, integral = [], f32(0.3), f32(0.1)
    for u, v in zip(F, G, strict=True):
        total = (f32(0.1) * u + state) - v
        expected.append(integral / total)
        integral, state = integral + f32(0.7 * 0.1) * total, total
    np.testing.assert_array_equal(outcome(drawn, tmp_path), np.array(expected, dtype=float))


@pytest.mark.parametrize(
    ("kind", "inputs", "parameters", "expected"),
    [
        ("Sum", 2, {"Inputs": "+-"}, F - G),
        ("Gain", 1, {"Gain": "[0.1]"}, f32(0.1) * F),
        ("Bias", 1, {"Bias": "1/3"}, F + f32(1 / 3)),
        ("Sqrt", 1, {"Operator": "signedSqrt"}, np.sign(F) * np.sqrt(np.abs(F))),
        ("Math", 1, {"Operator": "square"}, F * F),
        ("MinMax", 2, {"Inputs": "2", "Function": "max"}, np.maximum(F, G)),
        ("Saturate", 1, {"UpperLimit": "0.7", "LowerLimit": "-0.3"}, np.clip(F, f32(-0.3), f32(0.7))),
        ("DeadZone", 1, {"LowerValue": "-0.1", "UpperValue": "0.7"}, F - np.clip(F, f32(-0.1), f32(0.7))),
        ("Polyval", 1, {"Coefs": "[0.1 0.2 0.3]"}, (f32(0.1) * F + f32(0.2)) * F + f32(0.3)),
        ("Fcn", 1, {"Expr": "u*u + 0.1"}, F * F + f32(0.1)),
    ],
)  # fmt: skip
def test_a_block_of_single_inputs_computes_in_single_precision(kind, inputs, parameters, expected, tmp_path):
    drawn = alone(kind, inputs, **parameters)
    for block in drawn.blocks:
        if block.kind == "Inport":
            block.parameters |= SINGLE
    values = run(imported(drawn, tmp_path, float32=True), {"u1": U, "u2": V})["y1"]
    np.testing.assert_array_equal(values, expected.astype(float))


def test_double_operands_make_a_result_double_unless_its_block_says_otherwise(tmp_path):
    drawn = drawing()
    drawn.block("Constant", "C", Value="0.1")
    drawn.block("Constant", "B", Value="0.1", OutDataTypeStr="Inherit: Inherit via back propagation")
    drawn.block("Constant", "S", Value="single(0.1)")
    for at, name in enumerate("CBS"):
        drawn.block("Sum", f"A{at}", ports=(2, 1), Inputs="++")
        drawn.outport(f"y{at}")
        drawn.line("u", f"A{at}:1")
        drawn.line(name, f"A{at}:2")
        drawn.chain(f"A{at}", f"y{at}")
    drawn.block("Sum", "T", ports=(2, 1), Inputs="++", **SINGLE)
    drawn.outport("t")
    drawn.line("u", "T:1")
    drawn.line("C", "T:2")
    drawn.chain("T", "t")
    values = run(imported(drawn, tmp_path, float32=True), {"u": U})
    np.testing.assert_array_equal(values["y0"], F.astype(float) + 0.1)
    np.testing.assert_array_equal(values["y1"], (F + f32(0.1)).astype(float))
    np.testing.assert_array_equal(values["y2"], (F + f32(0.1)).astype(float))
    np.testing.assert_array_equal(values["T"], (F.astype(float) + 0.1).astype(f32).astype(float))


@pytest.mark.parametrize("value", ["K", "2 * K", "P"])
def test_variables_of_single_precision_pass_their_type_on(value, tmp_path):
    (tmp_path / "k.m").write_text("K = single(0.1);\nP = Simulink.Parameter(0.2);\nP.DataType = 'single';\n")
    drawn = drawing()
    drawn.block("Constant", "C", Value=value)
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.chain("C", "S:2")
    drawn.chain("S", "y")
    number = f32(0.1) if value == "K" else f32(0.2)
    rounded = outcome(drawn, tmp_path, parameters=[tmp_path / "k.m"])
    np.testing.assert_array_equal(rounded, (F + number).astype(float))


def test_elements_of_a_bus_have_the_types_of_its_object(tmp_path):
    (tmp_path / "b.m").write_text(
        "B = Simulink.Bus; a = Simulink.BusElement; a.Name = 'a'; a.DataType = 'single'; d = Simulink.BusElement; "
        "d.Name = 'd'; B.Elements = [a; d];"
    )
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="a,d")
    drawn.line("In", "Pick")
    for at, name in enumerate("ad", 1):
        drawn.block("Gain", f"G{name}", Gain="0.1")
        drawn.outport(f"y{name}")
        drawn.chain(f"Pick:{at}", f"G{name}", f"y{name}")
    values = run(imported(drawn, tmp_path, float32=True, parameters=[tmp_path / "b.m"]), {"In.a": U, "In.d": V})
    np.testing.assert_array_equal(values["ya"], (F * f32(0.1)).astype(float))
    np.testing.assert_array_equal(values["yd"], V * 0.1)


def test_results_of_code_are_rounded_by_their_types(tmp_path):
    drawn = drawing()
    drawn.function("M", "function [y, z] = f(u)\ny = 0.1 * u + 0.2;\nz = 0.1 * u;\n", outputs=("y", "z"),
                   data={"y": "OUTPUT_DATA", "z": "OUTPUT_DATA"})  # fmt: skip
    drawn.outport("y")
    drawn.line("u", "M")
    drawn.chain("M", "y")
    np.testing.assert_array_equal(outcome(drawn, tmp_path), (f32(0.1) * F + f32(0.2)).astype(float))


def test_a_data_store_of_type_single_keeps_rounded_numbers(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", **SINGLE)
    drawn.block("DataStoreMemory", "A", ports=(0, 0), DataStoreName="A", InitialValue="0.1", **SINGLE)
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A")
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="A")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.chain("R", "S:2")
    drawn.line("S", "W", "y")
    np.testing.assert_array_equal(
        outcome(drawn, tmp_path), np.cumsum(np.append(f32(0.1), F), dtype=f32)[1:].astype(float)
    )


@pytest.mark.parametrize("layout", LAYOUTS[1:4:2])
def test_ports_without_a_type_have_the_default_type_of_the_model(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.solver["DefaultUnderspecifiedDataType"] = "single"
    drawn.inport("u")
    drawn.block("Gain", "K", Gain="0.1")
    drawn.outport("y")
    drawn.chain("u", "K", "y")
    values = run(imported(drawn, tmp_path, layout, float32=True), {"u": U})["y"]
    np.testing.assert_array_equal(values, (f32(0.1) * F).astype(float))


def test_integrators_over_time_stay_double(tmp_path):
    drawn = Model(step="0.1", solver="ode1")
    drawn.inport("u", **SINGLE)
    drawn.block("Integrator", "I")
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    values = run(imported(drawn, tmp_path, float32=True), {"u": U})["y"]
    np.testing.assert_allclose(values, 0.1 * np.append(0, np.cumsum(F.astype(float)))[:-1], rtol=1e-12)


def test_a_remark_says_where_single_precision_is_ignored_or_not_known(tmp_path):
    drawn = drawing()
    drawn.block("Gain", "K", Gain="0.1", **SINGLE)
    drawn.outport("y")
    drawn.chain("u", "K", "y")
    notes = [str(note) for note in imported(drawn, tmp_path).remarks]
    assert notes == ["single precision is ignored in u, v, K: generated code rounds there, as float32 = true does"]
    assert not imported(drawn, tmp_path, float32=True).remarks
    drawn.function("M", "function y = f(u)\ny = double(u) * 0.1;\n")
    drawn.outport("z")
    drawn.line("u", "M")
    drawn.chain("M", "z")
    notes = [str(note) for note in imported(drawn, tmp_path, float32=True).remarks]
    assert notes == ["the results of M are not rounded to single precision: their data types are not known"]


def test_a_project_asks_for_single_precision(tmp_path):
    file = tmp_path / "kennfeld.toml"
    rest = '[[dataset]]\nfiles = ["a.csv"]\n[[criterion]]\nnode = "y"\ntarget = "m"\n'
    file.write_text(f'[model]\nfile = "m.slx"\nfloat32 = true\n{rest}')
    assert read_project(file).import_request().options.float32
