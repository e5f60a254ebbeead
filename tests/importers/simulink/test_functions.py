"""Ports, parameters and tables of MATLAB Function blocks, against the same written in Python."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_code import U, V, function
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("y = 3;", "not define a function"),
        ("function y = (", "model.slx F: F line 1, column "),
    ],
)
def test_code_without_a_function_is_reported(code, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(function(code), tmp_path)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
def test_parameters_are_inputs_where_the_block_declares_them(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    scopes = {"u": "INPUT_DATA", "K": "PARAMETER_DATA", "v": "INPUT_DATA", "y": "OUTPUT_DATA"}
    drawn.function("F", "function y = f(u, K, v)\ny = K*u - v;\n", ("u", "v"), ("y",), scopes)
    for at, name in enumerate("uv", 1):
        drawn.inport(name)
        drawn.line(name, f"F:{at}")
    drawn.outport("out")
    drawn.line("F", "out")
    model = imported(drawn, tmp_path, layout, parameters=[{"K": 3.0}])
    assert model.values["K"].values == 3.0
    np.testing.assert_allclose(run(model, {"u": U, "v": V})["out"], 3 * U - V)
    exact, near = slopes(model, {"u": U, "v": V}, "K", "out")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_a_function_with_a_sample_time_of_its_own(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    code = "function y = f(u)\npersistent n\nif isempty(n), n = 0; end\nn = n + u;\ny = n;\n"
    drawn.function("F", code, updateMethod="DISCRETE", sampleTime="T")
    drawn.inport("u")
    drawn.outport("out")
    drawn.chain("u", "F", "out")
    u = np.arange(1.0, 11.0)
    model = imported(drawn, tmp_path, layout, parameters=[{"T": 0.3}])
    np.testing.assert_allclose(run(model, {"u": u})["out"], np.repeat(np.cumsum(u[::3]), 3)[:10])


def test_buses_are_structs(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("speed")
    drawn.inport("load")
    drawn.block("BusCreator", "B", ports=(2, 1), Inputs="2")
    drawn.line("speed", "B:1", name="speed")
    drawn.line("load", "B:2", name="load")
    code = "function out = f(in)\nout = in;\nout.speed = 2*in.speed;\nout.load = in.load + in.speed;\nend\n"
    drawn.function("F", code, ("in",), ("out",))
    drawn.line("B", "F")
    drawn.block("BusSelector", "S", ports=(1, 2), OutputSignals="load,speed")
    drawn.line("F", "S")
    for at in (1, 2):
        drawn.outport(f"y{at}")
        drawn.line(f"S:{at}", f"y{at}")
    outputs = run(imported(drawn, tmp_path), {"speed": U, "load": V})
    np.testing.assert_allclose(outputs["y1"], U + V)
    np.testing.assert_allclose(outputs["y2"], 2 * U)


def test_vectors_are_columns_and_matrices_keep_their_shape(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("v")
    drawn.block("Mux", "M", ports=(2, 1), Inputs="2")
    drawn.line("u", "M:1")
    drawn.line("v", "M:2")
    drawn.function("F", "function [y, A] = f(x)\ny = x'*x;\nA = x*x';\nend\n", ("x",), ("y", "A"))
    drawn.line("M", "F")
    drawn.function("G", "function y = f(A)\ny = A(1, 2) + 10*size(A, 2);\nend\n", ("A",))
    drawn.line("F:2", "G")
    drawn.outport("y1")
    drawn.outport("y2")
    drawn.line("F:1", "y1")
    drawn.line("G", "y2")
    outputs = run(imported(drawn, tmp_path), {"u": U, "v": V})
    np.testing.assert_allclose(outputs["y1"], U**2 + V**2)
    np.testing.assert_allclose(outputs["y2"], U * V + 20)


def test_a_parameter_without_a_value_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"the parameter K has no value.*Define it in a script"):
        imported(function("function y = f(u, v, K)\ny = K*u;\n"), tmp_path)


def test_a_declared_parameter_without_a_value_is_reported_like_a_variable_of_any_block(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.function("F", "function y = f(u, K)\ny = K*u;\n", data={"K": "PARAMETER_DATA"})
    drawn.outport("y")
    drawn.chain("u", "F", "y")
    with pytest.raises(InputError, match=r"variable K: undefined; used by F. Define it in a script"):
        imported(drawn, tmp_path)
    assert set(imported(drawn, tmp_path, parameters=[{"K": 2.0}]).graph.parameters) == {"K"}


CURVE = {"xs": np.array([-2.0, -0.5, 0.5, 3.0]), "ys": np.array([1.0, 4.0, -2.0, 5.0])}
SURFACE = {"xs": np.array([-3.0, 0.0, 3.0]), "zs": np.array([-3.0, 3.0]), "m": np.array([[1, 2, 3], [5.0, -1, 2]])}


@pytest.mark.parametrize("arguments", ["xs, ys", "p"])
def test_interpolation_of_a_parameter_is_a_curve(arguments, tmp_path):
    names = {"xs, ys": "xs, ys", "p": "p.xs, p.ys"}[arguments]
    code = f"function y = f(u, v, {arguments})\ny = look({names}, u) + v;\nend\nfunction y = look(a, b, u)\n"
    model = imported(
        function(code + "y = interp1(a, b, u, 'linear', 'extrap');\nend\n"),
        tmp_path,
        parameters=[CURVE if arguments != "p" else {"p": CURVE}],
    )
    name = "ys" if arguments != "p" else "p.ys"
    assert model.values[name].axes[0].name == name.replace("ys", "xs")
    u = np.linspace(-2, 3, 41)
    v = np.sin(u)
    np.testing.assert_allclose(run(model, {"u": u, "v": v})["y1"], np.interp(u, *CURVE.values()) + v)
    exact, near = slopes(model, {"u": u, "v": v}, name, "y1")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


def test_interpolation_in_two_dimensions_of_a_parameter_is_a_map(tmp_path):
    model = imported(function("function y = f(u, v, xs, zs, m)\ny = interp2(xs, zs, m, u, v);\n"), tmp_path,
                     parameters=[SURFACE])  # fmt: skip
    assert model.values["m"].values.shape == (2, 3)
    assert [axis.name for axis in model.values["m"].axes] == ["zs", "xs"]
    u, v = np.clip(U, -2.9, 2.9), np.clip(V, -2.9, 2.9)
    rows = np.array([np.interp(u, SURFACE["xs"], row) for row in SURFACE["m"]])
    output = run(model, {"u": u, "v": v})["y1"]
    np.testing.assert_allclose(output, rows[0] + (v + 3) / 6 * (rows[1] - rows[0]))
    np.testing.assert_array_equal(run(model, {"u": [3.5], "v": [0.0]})["y1"], [np.nan])


def test_a_table_that_is_also_used_by_its_elements_is_not_a_curve(tmp_path):
    code = "function y = f(u, v, xs, ys)\nk = ys(2)*v;\ny = interp1(xs, ys, u, 'linear', 'extrap') + k;\n"
    model = imported(function(code), tmp_path, parameters=[CURVE])
    assert not model.values["ys"].axes
    u = np.linspace(-2, 3, 41)
    np.testing.assert_allclose(run(model, {"u": u, "v": u})["y1"], np.interp(u, *CURVE.values()) + 4 * u)
    exact, near = slopes(model, {"u": u, "v": u}, "ys", "y1")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


GEARS = "classdef Gear < Simulink.IntEnumType\n enumeration\n  Neutral(0), First(1)\n  Second(2)\n end\nend\n"


def test_enumerations_in_code_are_their_numbers(tmp_path):
    (tmp_path / "Gear.m").write_text(GEARS)
    code = (
        "function y = f(u, v)\nswitch round(u)\n case Gear.Neutral\n  y = v;\n case {Gear.First, Gear(2)}\n  y = 5;\n"
    )
    code += " otherwise\n  y = double(Gear.Second);\nend\n"
    model = imported(function(code), tmp_path)
    u = np.array([-2, -0.2, 0.9, 1.6, 2.4, 3.0])
    output = run(model, {"u": u, "v": 10 * u})["y1"]
    np.testing.assert_allclose(output, [2, -2, 5, 5, 5, 2])
    assert not model.values


def test_a_signal_of_a_bus_is_held_between_the_hits_of_a_function(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.function("F", "function s = f(u)\ns.a = 2*u;\n", ("u",), ("s",), updateMethod="DISCRETE", sampleTime="0.2")
    drawn.block("BusSelector", "B", ports=(1, 1), OutputSignals="a")
    drawn.inport("u")
    drawn.outport("out")
    drawn.chain("u", "F", "B", "out")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": np.arange(6.0)})["out"], [0, 0, 4, 4, 8, 8])


@pytest.mark.parametrize(("holder", "name"), [("S", " F"), ("S ", "F"), (" S", "F "), ("S/ ", "\na /b")])
@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
def test_blanks_around_the_names_of_blocks_hide_no_code(holder, name, layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem(holder)
    inner.function(name, "function y = f(u)\ny = 2*u;\nend", ["u"], ["y"])
    inner.between(["u"], name, ["y"])
    drawn.inport("u")
    drawn.outport("y")
    drawn.line("u", holder)
    drawn.line(holder, "y")
    assert run(imported(drawn, tmp_path, layout), {"u": [1.0, 2.0]})["y"].tolist() == [2.0, 4.0]
