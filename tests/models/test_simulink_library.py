"""Controllers, tables in parts and as objects, referenced models, buses that feed back."""

import numpy as np
import pytest
from scipy import signal
from simulink_files import Model
from simulink_runs import alone, imported, run, slopes

from kennfeld.errors import InputError

U = np.random.default_rng(7).normal(size=30)
T = 0.1


def pid(folder, given, model=None, **parameters):
    drawn = alone("Reference", special="PID 1dof", model=model, P="Kp", I="Ki", D="Kd", N="20", **parameters)
    return imported(drawn, folder, parameters=[given])


GAINS = {"Kp": 2.0, "Ki": 3.0, "Kd": 0.1}


@pytest.mark.parametrize("form", ["Parallel", "Ideal"])
@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
def test_a_discrete_pid_controller(form, method, tmp_path):
    model = pid(tmp_path, {**GAINS, "N": 5.0}, TimeDomain="Discrete-time", SampleTime="0.1", Form=form,
                IntegratorMethod=method)  # fmt: skip
    found = run(model, {"u1": U})["y1"]
    scale = 2.0 if form == "Ideal" else 1.0
    total, last, x = 0.0, 0.0, 0.0
    for k, u in enumerate(U):
        now = {"Forward Euler": total, "Backward Euler": total + T * u, "Trapezoidal": total + T / 2 * u}[method]
        slope = 20 * (scale * 0.1 * u - x)
        assert found[k] == pytest.approx(2 * u + scale * 3 * now + slope, rel=1e-12)
        total = {"Forward Euler": total + T * u, "Backward Euler": now, "Trapezoidal": now + T / 2 * u}[method]
        x += T * slope
        last = u
    assert last == U[-1]
    for name in GAINS:
        exact, near = slopes(model, {"u1": U}, name, "y1")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-7)


def test_a_continuous_pid_controller_is_its_transfer_function(tmp_path):
    model = pid(tmp_path, GAINS, Model(solver="ode5", step="0.005"), Controller="PID")
    t = 0.005 * np.arange(300)
    found = run(model, {"u1": np.ones(300)})["y1"]
    n = 20.0  # P + I/s + D N s / (s + N)
    b = [2 + 0.1 * n, 2 * n + 3, 3 * n]
    expected = signal.lsim((b, [1, n, 0]), np.ones(300), t)[1]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_parts_of_a_pid_controller_and_what_is_not_supported(tmp_path):
    found = run(pid(tmp_path, GAINS, Controller="P", LimitOutput="on", UpperSaturationLimit="1"), {"u1": U})["y1"]
    np.testing.assert_allclose(found, np.minimum(2 * U, 1))
    with pytest.raises(InputError, match="AntiWindupMode is 'clamping'"):
        pid(tmp_path, GAINS, LimitOutput="on", AntiWindupMode="clamping")


def parts(beyond):
    """A prelookup for each direction, and a table that takes what they found."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("a")
    drawn.inport("b")
    drawn.block("PreLookup", "A", ports=(1, 2), BreakpointsData="[0 1 3]", ExtrapMethod=beyond)
    drawn.block("PreLookup", "B", ports=(1, 2), BreakpointsSpecification="Even spacing", BreakpointsFirstPoint="-1",
                BreakpointsSpacing="2", BreakpointsNumPoints="3", ExtrapMethod=beyond)  # fmt: skip
    drawn.block("Interpolation_n-D", "M", ports=(4, 1), Table="Z", ExtrapMethod=beyond)
    drawn.outport("y")
    drawn.line("a", "A")
    drawn.line("b", "B")
    for at, end in enumerate(("A:1", "A:2", "B:1", "B:2"), 1):
        drawn.line(end, f"M:{at}")
    drawn.chain("M", "y")
    return drawn


@pytest.mark.parametrize("beyond", ["Clip", "Linear"])
def test_a_table_in_parts_is_the_table_as_a_whole(beyond, tmp_path):
    Z = np.array([[1.0, 2.0, 4.0], [3.0, 8.0, 0.0], [5.0, -1.0, 2.0]])
    columns = {"a": 2 * U + 1, "b": 3 * U[::-1]}
    found = run(imported(parts(beyond), tmp_path, parameters=[{"Z": Z}]), columns)["y"]
    whole = alone("Lookup_n-D", 2, Table="Z", BreakpointsForDimension1="[0 1 3]", BreakpointsForDimension2="[-1 1 3]",
                  ExtrapMethod=beyond)  # fmt: skip
    model = imported(whole, tmp_path, parameters=[{"Z": Z}])
    expected = run(model, {"u1": columns["a"], "u2": columns["b"]})["y1"]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_table_object_holds_values_and_breakpoints(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", DataSpecification="Lookup table object",
                  LookupTableObject="Eta", ExtrapMethod="Clip")  # fmt: skip
    given = {"Eta": {"Table": [1.0, 2.0, 0.0], "Breakpoints1": [-1.0, 0.0, 2.0]}}
    model = imported(drawn, tmp_path, parameters=[given])
    assert list(model.values) == ["Eta"]
    np.testing.assert_allclose(run(model, {"u1": U})["y1"], np.interp(U, [-1, 0, 2], [1, 2, 0]))


def test_a_referenced_model_is_taken_from_beside_with_its_own_variables(tmp_path):
    inner = Model("plant", step="0.1", solver="FixedStepDiscrete", code="K = 5;")
    inner.inport("x")
    inner.block("Gain", "G", Gain="K*L")
    inner.outport("z")
    inner.chain("x", "G", "z")
    drawn = Model("whole", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("ModelReference", "Plant", ports=(1, 1), ModelNameDialog="plant.slx")
    drawn.outport("y")
    drawn.chain("u", "Plant", "y")
    with pytest.raises(InputError, match="it runs the model plant.slx, which was not found"):
        imported(drawn, tmp_path, parameters=[{"K": 1.0, "L": 2.0}])
    inner.write(tmp_path)
    model = imported(drawn, tmp_path, parameters=[{"K": 1.0, "L": 2.0}])
    assert run(model, {"u": [1.0]})["y"].tolist() == [10.0]


def test_a_bus_may_hold_what_is_computed_from_another_of_its_signals(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("BusCreator", "Bus", ports=(2, 1), Inputs="2")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="first")
    drawn.block("BusSelector", "Out", ports=(1, 1), OutputSignals="second")
    drawn.block("Gain", "K", Gain="3")
    drawn.outport("y")
    drawn.line("u", "Bus:1", name="first")
    drawn.line("Bus", "Pick", "Out")
    drawn.chain("Pick", "K")
    drawn.line("K", "Bus:2", name="second")
    drawn.chain("Out", "y")
    assert run(imported(drawn, tmp_path), {"u": [2.0]})["y"].tolist() == [6.0]


def test_a_link_to_a_library_that_is_not_there_says_which(tmp_path):
    drawn = alone("Reference", special="Own Mask")
    with pytest.raises(InputError, match=r"B: it is a link to lib/B, which was not found. Put lib.slx beside the model"):
        imported(drawn, tmp_path)
