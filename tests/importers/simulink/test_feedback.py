"""Feedback that only a state port or a matrix makes possible, against recurrences written out."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

T = 0.1
A = np.array([[0.5, 0.2, 0.0], [-0.1, 0.7, 0.3], [0.0, -0.4, 0.6]])
B = np.array([[1.0, 0.0], [0.0, 2.0], [0.5, 0.5]])
C = np.array([[1.0, -1.0, 2.0]])
RNG = np.random.default_rng(5)


def bouncing_ball():
    """Height and velocity, both reset where the height has come to 0; the velocity to what it was, turned round."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    external = {"InitialConditionSource": "external", "ShowStatePort": "on", "SampleTime": "-1"}
    ports = {"in": 3, "out": 1, "state": 1}
    drawn.block("Constant", "g", Value="gravity", ports=(0, 1))
    drawn.block("DiscreteIntegrator", "V", ports=ports, ExternalReset="rising", **external)
    drawn.block("DiscreteIntegrator", "H", ports=ports, ExternalReset="rising", **external)
    drawn.block("Constant", "Ground", Value="0", ports=(0, 1))
    drawn.link("Below", "simulink/Logic and Bit\nOperations/Compare\nTo Zero", "Compare To Zero", relop="<=")
    drawn.block("Gain", "Bounce", ports=(1, 1), Gain="bounce")
    drawn.block("InitialCondition", "First", ports=(1, 1), Value="3", SampleTime="-1")
    drawn.block("InitialCondition", "Start", ports=(1, 1), Value="2", SampleTime="-1")
    drawn.chain("g", "V:1")
    drawn.line("Below", "V:2", "H:2")
    drawn.line("V#state", "Bounce")
    drawn.chain("Bounce", "First", "V:3")
    drawn.line("H#state", "Below")
    drawn.chain("Ground", "Start", "H:3")
    for name in ("v", "h"):
        drawn.outport(name)
        drawn.line(name.upper(), name) if name == "h" else drawn.line("V", "v", "H:1")
    return drawn


def bounced(gravity, bounce, samples):
    """Velocity and height, as the two integrators are defined."""
    v, h, below, rows = 3.0, 2.0, True, []
    for _ in range(samples):
        hits = h <= 0
        if hits and not below:
            v, h = bounce * v, 0.0
        below = hits
        rows.append((v, h))
        v, h = v + T * gravity, h + T * v
    return np.array(rows).T


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
def test_a_state_port_shows_the_state_before_its_own_reset(layout, tmp_path):
    model = imported(bouncing_ball(), tmp_path, layout, parameters=[{"gravity": -9.81, "bounce": -0.8}])
    outputs = run(model, samples=60)
    v, h = bounced(-9.81, -0.8, 60)
    np.testing.assert_allclose(outputs["v"], v, atol=1e-12)
    np.testing.assert_allclose(outputs["h"], h, atol=1e-12)
    assert np.sum(np.diff(v) > 0) >= 3


def test_slopes_through_a_state_port_are_those_of_finite_differences(tmp_path):
    model = imported(bouncing_ball(), tmp_path, parameters=[{"gravity": -9.81, "bounce": -0.8}])
    columns = {"t": T * np.arange(40)}
    for name in ("gravity", "bounce"):
        exact, differences = slopes(model, columns, name, "h")
        np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-7)
        assert np.abs(exact).max() > 0.1


@pytest.mark.parametrize("solver", ["ode1", "ode4"])
def test_a_continuous_integrator_is_reset_by_its_state_port(solver, tmp_path):
    drawn = Model(step="0.1", solver=solver)
    drawn.inport("u")
    drawn.block("Integrator", "X", ports={"in": 2, "out": 1, "state": 1}, ExternalReset="level hold",
                InitialCondition="0.25", ShowStatePort="on")  # fmt: skip
    drawn.link("Full", "simulink/Logic and Bit\nOperations/Compare\nTo Constant", "Compare To Constant",
               relop=">=", const="1")  # fmt: skip
    drawn.outport("y")
    drawn.chain("u", "X:1")
    drawn.line("X#state", "Full")
    drawn.line("Full", "X:2")
    drawn.line("X", "y")
    u = RNG.uniform(0.5, 3.0, 40)
    output = run(imported(drawn, tmp_path), {"u": u})["y"]
    x = 0.25
    for k, one in enumerate(u):
        x = 0.25 if x >= 1 else x
        assert output[k] == pytest.approx(x, abs=1e-12)
        x += T * one
    assert np.sum(np.diff(output) < 0) >= 3


def test_a_state_port_shows_a_vector_and_changes_at_the_hits_of_its_block(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="2")
    drawn.block("DiscreteIntegrator", "X", ports={"in": 1, "out": 1, "state": 1}, ShowStatePort="on", SampleTime="0.2")
    drawn.block("Gain", "K", ports=(1, 1), Gain="10")
    drawn.outport("y")
    drawn.chain("u", "X")
    drawn.line("X#state", "K")
    drawn.line("K", "y")
    model = imported(drawn, tmp_path)
    outputs = run(model, {"u[1]": np.ones(5), "u[2]": -np.ones(5)})
    assert model.graph.outputs == ("y[1]", "y[2]")
    np.testing.assert_allclose(outputs["y[2]"], [0, 0, -2, -2, -4])


def test_a_state_port_of_another_block_is_reported(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Memory", "M", ports={"in": 1, "out": 1, "state": 1})
    drawn.block("Gain", "K", ports=(1, 1))
    drawn.outport("y")
    drawn.line("M#state", "K")
    drawn.line("K", "M", "y")
    with pytest.raises(InputError, match="M: its state port is used, which is not supported"):
        imported(drawn, tmp_path)


def test_an_initial_value_that_depends_on_its_own_state_is_reported(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DiscreteIntegrator", "X", ports={"in": 2, "out": 1, "state": 1}, ShowStatePort="on",
                InitialConditionSource="external", SampleTime="-1")  # fmt: skip
    drawn.block("Bias", "One more", ports=(1, 1), Bias="1")
    drawn.outport("y")
    drawn.chain("u", "X:1")
    drawn.line("X#state", "One more")
    drawn.line("One more", "X:2")
    drawn.line("X", "y")
    with pytest.raises(InputError, match="X: its initial value depends on its own state"):
        imported(drawn, tmp_path)


# widths


def linear(memory, model=None):
    """The model x of the next hit = A x + B u, y = C x, drawn with matrices; the memory starts with a scalar."""
    drawn = model or Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="2")
    for name, matrix in (("A", A), ("B", B), ("C", C)):
        text = "[" + ";".join(" ".join(map(str, row)) for row in matrix) + "]"
        drawn.block("Gain", name, ports=(1, 1), Gain=text, Multiplication="Matrix(K*u)")
    drawn.block(*memory)
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.chain("u", "B", "S:1")
    drawn.line("A", "S:2")
    drawn.line("S", "X")
    drawn.line("X", "A", "C")
    drawn.line("C", "y")
    return drawn


def test_a_matrix_behind_a_memory_gives_it_its_width(tmp_path):
    u = RNG.normal(size=(30, 2))
    output = run(imported(linear(("Memory", "X")), tmp_path), {"u[1]": u[:, 0], "u[2]": u[:, 1]})["y"]
    x = np.zeros(3)
    for k in range(30):
        assert output[k] == pytest.approx((C @ x).item(), abs=1e-12)
        x = A @ x + B @ u[k]


def test_a_matrix_behind_an_integrator_gives_it_its_width(tmp_path):
    drawn = linear(("Integrator", "X"), Model(step="0.1", solver="ode1"))
    u = RNG.normal(size=(30, 2))
    output = run(imported(drawn, tmp_path), {"u[1]": u[:, 0], "u[2]": u[:, 1]})["y"]
    x = np.zeros(3)
    for k in range(30):
        assert output[k] == pytest.approx((C @ x).item(), abs=1e-12)
        x = x + T * (A @ x + B @ u[k])


@pytest.mark.parametrize(
    ("kind", "fields", "inputs", "expected"),
    [
        ("Selector", {"Indices": "[3 1 2]", "InputPortWidth": "3"}, [4.0, 5.0, 6.0], [6.0, 4.0]),
        ("CombinatorialLogic", {"TruthTable": "[0 8;1 7;2 6;3 5]"}, [1.0, 0.0], [2.0, 6.0]),
    ],
)
def test_a_selector_or_a_truth_table_gives_an_inport_its_width(kind, fields, inputs, expected, tmp_path):
    model = imported(alone(kind, **fields), tmp_path)
    columns = {f"u1[{at}]": [value] for at, value in enumerate(inputs, 1)}
    assert set(model.graph.inputs) == set(columns)
    outputs = run(model, columns)
    assert [outputs[f"y1[{at}]"][0] for at in (1, 2)] == expected


def test_a_demux_or_a_matrix_gives_an_inport_its_width(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for name in ("u", "v"):
        drawn.inport(name)
    drawn.block("Demux", "D", ports=(1, 2), Outputs="2")
    drawn.block("Gain", "K", ports=(1, 1), Gain="[1 2 3]", Multiplication="Matrix(K*u)")
    drawn.block("Sum", "S", ports=(3, 1), Inputs="+-+")
    drawn.outport("y")
    drawn.line("u", "D")
    drawn.line("v", "K")
    for port, source in enumerate(("D:1", "D:2", "K"), 1):
        drawn.line(source, f"S:{port}")
    drawn.line("S", "y")
    model = imported(drawn, tmp_path)
    assert set(model.graph.inputs) == {"u[1]", "u[2]", "v[1]", "v[2]", "v[3]"}
    columns = {name: np.full(2, value) for name, value in zip(sorted(model.graph.inputs), range(5), strict=True)}
    assert run(model, columns)["y"][0] == 0 - 1 + 2 + 2 * 3 + 3 * 4


def test_a_matrix_times_a_scalar_memory_is_a_matrix(tmp_path):
    drawn = alone("UnitDelay", InitialCondition="2", SampleTime="-1")
    drawn.block("Gain", "K", ports=(1, 1), Gain="[1 2; 3 4]", Multiplication="Matrix(K*u)")
    drawn.outport("z")
    drawn.line("B", "K")
    drawn.line("K", "z")
    outputs = run(imported(drawn, tmp_path), {"u1": np.ones(2)})
    assert [outputs[f"z[{at}]"][0] for at in (1, 2, 3, 4)] == [2, 6, 4, 8]


def test_a_scalar_that_a_matrix_would_widen_is_reported(tmp_path):
    drawn = alone("UnitDelay", SampleTime="-1")
    drawn.block("Gain", "K", ports=(1, 1), Gain="[1 2 3; 3 4 5]", Multiplication="Matrix(K*u)")
    drawn.block("Constant", "Two", ports=(0, 1), Value="[1 2]")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("z")
    drawn.line("B", "K")
    drawn.line("K", "S:1")
    drawn.line("Two", "S:2")
    drawn.line("S", "z")
    with pytest.raises(InputError, match="which do not match"):
        imported(drawn, tmp_path)
