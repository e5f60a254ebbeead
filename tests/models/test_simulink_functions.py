"""MATLAB Function blocks against the same written in Python."""

import numpy as np
import pytest
from simulink_code import function
from simulink_files import LAYOUTS, Model
from simulink_runs import imported, run, slopes

from kennfeld.errors import InputError

U = np.random.default_rng(11).normal(size=40)
V = np.random.default_rng(12).normal(size=40)


def written(u, v):
    """The longest of the functions below."""
    y = 0.0
    if u > 0 and v > 0:
        y = u * v
    elif u > 0:
        y = u - v
        if y > 1:
            y = 1.0
    else:
        y = -1.0
    for k in range(1, 4):
        y = y + k * u
    return y


CASES = [
    ("function y = f(u, v)\n y = u^2 + sin(v); % sum\nend\n", lambda u, v: u**2 + np.sin(v)),
    ("function y = f(u,v)\ny = max(u, v);\nif y < 0\n y = 0;\nend\n", lambda u, v: max(u, v, 0)),
    ("function y = f(u,v)\ny = 0;\nif u > 0 && v > 0\n y = u*v;\nelseif u > 0\n y = u - v;\n if y > 1\n  y = 1;\n end\n"
     "else\n y = -1;\nend\nfor k = 1:3\n y = y + k*u;\nend\n", written),
    ("function y = f(u,v)\nx = zeros(1,3);\nfor i = 1:3\n x(i) = u*i;\nend\nx(2) = v;\ny = sum(x);\nend\n",
     lambda u, v: 4 * u + v),
    ("function y = f(u,v)\nw = [u v u-v];\ny = w(1) + w(numel(w));\nend\n", lambda u, v: 2 * u - v),
]  # fmt: skip


@pytest.mark.parametrize(("code", "rule"), CASES)
def test_functions_do_what_their_code_says(code, rule, tmp_path):
    found = run(imported(function(code), tmp_path), {"u": U, "v": V})["y1"]
    np.testing.assert_allclose(found, [rule(u, v) for u, v in zip(U, V, strict=True)], atol=1e-13)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_function_with_several_results_in_every_layout(layout, tmp_path):
    code = "function [a, b] = f(u, v)\na = u + v;\nb = a*v;\nend\n"
    found = run(imported(function(code, outputs=("a", "b")), tmp_path, layout), {"u": U, "v": V})
    np.testing.assert_allclose(found["a1"], U + V)
    np.testing.assert_allclose(found["b2"], (U + V) * V)


def test_parameters_of_a_function_stay_exact(tmp_path):
    code = "function y = f(u, v, K)\nif u > v\n y = K*u;\nelse\n y = K^2*v;\nend\nend\n"
    model = imported(function(code), tmp_path, parameters=[{"K": 1.5}])
    exact, near = slopes(model, {"u": U, "v": V}, "K", "y1")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("function y = f(u, v)\npersistent x\ny = x + u;\n", "line 3: x has no value"),
        ("function y = f(u, v)\nglobal x\ny = u;\n", "line 2: global x"),
        ("function y = f(u, v)\ny = 0;\nwhile y < u\n y = y + 1;\nend\n", "line 3: .* does not end within 1000 passes"),
        ("function y = f(u, v)\nif u > 0\n y = 1;\nend\n", "gives y no value, or not in every case"),
        ("function y = f(u, v)\ny = fft(u);\n", "line 2: the function or variable fft is not known"),
        ("function y = f(u, v)\ny = 0;\nfor i = 1:100000\n y = y + u;\nend\n", "more than 20000 statements"),
        ("y = 3;", "no function"),
        ("function y = (", "F"),
    ],
)
def test_code_that_goes_further_is_told(code, told, tmp_path):
    with pytest.raises(InputError, match=told):
        imported(function(code), tmp_path)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_parameters_stand_among_the_inputs_where_the_block_says_so(layout, tmp_path):
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


@pytest.mark.parametrize("layout", LAYOUTS)
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
    found = run(imported(drawn, tmp_path), {"speed": U, "load": V})
    np.testing.assert_allclose(found["y1"], U + V)
    np.testing.assert_allclose(found["y2"], 2 * U)


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
    found = run(imported(drawn, tmp_path), {"u": U, "v": V})
    np.testing.assert_allclose(found["y1"], U**2 + V**2)
    np.testing.assert_allclose(found["y2"], U * V + 20)


def test_a_parameter_without_a_value_is_told(tmp_path):
    with pytest.raises(InputError, match=r"K is a parameter that has no value.*Give it among the parameters"):
        imported(function("function y = f(u, v, K)\ny = K*u;\n"), tmp_path)


def test_a_declared_parameter_without_a_value_is_told_like_a_variable_of_any_block(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.function("F", "function y = f(u, K)\ny = K*u;\n", data={"K": "PARAMETER_DATA"})
    drawn.outport("y")
    drawn.chain("u", "F", "y")
    with pytest.raises(InputError, match=r"variable K: has no value; F needs it. Give it among the parameters"):
        imported(drawn, tmp_path)
    assert set(imported(drawn, tmp_path, parameters=[{"K": 2.0}]).graph.parameters) == {"K"}


CURVE = {"xs": np.array([-2.0, -0.5, 0.5, 3.0]), "ys": np.array([1.0, 4.0, -2.0, 5.0])}
SURFACE = {"xs": np.array([-3.0, 0.0, 3.0]), "zs": np.array([-3.0, 3.0]), "m": np.array([[1, 2, 3], [5.0, -1, 2]])}


@pytest.mark.parametrize("held", ["xs, ys", "p"])
def test_interpolation_of_a_parameter_is_a_curve(held, tmp_path):
    names = {"xs, ys": "xs, ys", "p": "p.xs, p.ys"}[held]
    code = f"function y = f(u, v, {held})\ny = look({names}, u) + v;\nend\nfunction y = look(a, b, u)\n"
    model = imported(
        function(code + "y = interp1(a, b, u, 'linear', 'extrap');\nend\n"),
        tmp_path,
        parameters=[CURVE if held != "p" else {"p": CURVE}],
    )
    name = "ys" if held != "p" else "p.ys"
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
    u, v = np.clip(U, -2.9, 2.9), np.clip(V, -2.9, 2.9)
    rows = np.array([np.interp(u, SURFACE["xs"], row) for row in SURFACE["m"]])
    found = run(model, {"u": u, "v": v})["y1"]
    np.testing.assert_allclose(found, rows[0] + (v + 3) / 6 * (rows[1] - rows[0]))
    np.testing.assert_array_equal(run(model, {"u": [3.5], "v": [0.0]})["y1"], [np.nan])


def test_a_table_that_is_also_used_by_its_elements_is_no_curve(tmp_path):
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
    found = run(model, {"u": u, "v": 10 * u})["y1"]
    np.testing.assert_allclose(found, [2, -2, 5, 5, 5, 2])
    assert not model.values


def test_a_signal_of_a_bus_is_held_between_the_hits_of_a_function(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.function("F", "function s = f(u)\ns.a = 2*u;\n", ("u",), ("s",), updateMethod="DISCRETE", sampleTime="0.2")
    drawn.block("BusSelector", "B", ports=(1, 1), OutputSignals="a")
    drawn.inport("u")
    drawn.outport("out")
    drawn.chain("u", "F", "B", "out")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": np.arange(6.0)})["out"], [0, 0, 4, 4, 8, 8])
