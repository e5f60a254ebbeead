"""Controllers, tables in parts and as objects, referenced models, buses that feed back."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

U = np.random.default_rng(7).normal(size=30)
T = 0.1


def pid(folder, workspace, model=None, **parameters):
    drawn = alone("Reference", special="PID 1dof", model=model, P="Kp", I="Ki", D="Kd", N="20", **parameters)
    return imported(drawn, folder, parameters=[workspace])


GAINS = {"Kp": 2.0, "Ki": 3.0, "Kd": 0.1}


@pytest.mark.parametrize("form", ["Parallel", "Ideal"])
@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
def test_a_discrete_pid_controller(form, method, tmp_path):
    model = pid(tmp_path, {**GAINS, "N": 5.0}, TimeDomain="Discrete-time", SampleTime="0.1", Form=form,
                IntegratorMethod=method)  # fmt: skip
    output = run(model, {"u1": U})["y1"]
    scale = 2.0 if form == "Ideal" else 1.0
    total, last, x = 0.0, 0.0, 0.0
    for k, u in enumerate(U):
        now = {"Forward Euler": total, "Backward Euler": total + T * u, "Trapezoidal": total + T / 2 * u}[method]
        slope = 20 * (scale * 0.1 * u - x)
        assert output[k] == pytest.approx(2 * u + scale * 3 * now + slope, rel=1e-12)
        total = {"Forward Euler": total + T * u, "Backward Euler": now, "Trapezoidal": now + T / 2 * u}[method]
        x += T * slope
        last = u
    assert last == U[-1]
    for name in GAINS:
        exact, near = slopes(model, {"u1": U}, name, "y1")
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_a_continuous_pid_controller_is_its_transfer_function(tmp_path):
    model = pid(tmp_path, GAINS, Model(solver="ode5", step="0.005"), Controller="PID")
    t = 0.005 * np.arange(300)
    output = run(model, {"u1": np.ones(300)})["y1"]
    n = 20.0  # P + I/s + D N s / (s + N)
    b = [2 + 0.1 * n, 2 * n + 3, 3 * n]
    expected = scipy.signal.lsim((b, [1, n, 0]), np.ones(300), t)[1]
    np.testing.assert_allclose(output, expected, atol=1e-6)


def test_parts_of_a_pid_controller(tmp_path):
    output = run(pid(tmp_path, GAINS, Controller="P", LimitOutput="on", UpperSaturationLimit="1"), {"u1": U})["y1"]
    np.testing.assert_allclose(output, np.minimum(2 * U, 1))
    with pytest.raises(InputError, match="SatLimitsSource 'external'"):
        pid(tmp_path, GAINS, LimitOutput="on", SatLimitsSource="external")


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
    output = run(imported(parts(beyond), tmp_path, parameters=[{"Z": Z}]), columns)["y"]
    whole = alone("Lookup_n-D", 2, Table="Z", BreakpointsForDimension1="[0 1 3]", BreakpointsForDimension2="[-1 1 3]",
                  ExtrapMethod=beyond)  # fmt: skip
    model = imported(whole, tmp_path, parameters=[{"Z": Z}])
    expected = run(model, {"u1": columns["a"], "u2": columns["b"]})["y1"]
    np.testing.assert_allclose(output, expected, rtol=1e-12, atol=1e-12)


def test_a_table_object_holds_values_and_breakpoints(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", DataSpecification="Lookup table object",
                  LookupTableObject="Eta", ExtrapMethod="Clip")  # fmt: skip
    parameters = {"Eta": {"Table": [1.0, 2.0, 0.0], "Breakpoints1": [-1.0, 0.0, 2.0]}}
    model = imported(drawn, tmp_path, parameters=[parameters])
    assert list(model.values) == ["Eta"]
    np.testing.assert_allclose(run(model, {"u1": U})["y1"], np.interp(U, [-1, 0, 2], [1, 2, 0]))


def test_a_table_at_cells_that_other_blocks_make_is_by_number(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("k")
    drawn.inport("f")
    drawn.block("Interpolation_n-D", "M", ports=(2, 1), Table="Z", NumberOfTableDimensions="1")
    drawn.outport("y")
    drawn.line("k", "M:1")
    drawn.line("f", "M:2")
    drawn.chain("M", "y")
    model = imported(drawn, tmp_path, parameters=[{"Z": [1.0, 4.0, 2.0]}])
    output = run(model, {"k": [0.0, 1.0, 1.0], "f": [0.5, 0.25, 1.0]})["y"]
    assert output.tolist() == [2.5, 3.5, 2.0]


@pytest.mark.parametrize("ends", [("Clip", "Linear"), ("Linear", "Clip")])
def test_prelookups_may_differ_beyond_their_ends(ends, tmp_path):
    drawn = parts("Linear")
    for block in drawn.blocks:
        if block.name in "AB":
            block.parameters["ExtrapMethod"] = ends["AB".index(block.name)]
    Z = np.array([[1.0, 2.0, 4.0], [3.0, 8.0, 0.0], [5.0, -1.0, 2.0]])
    columns = {"a": 2 * U + 1, "b": 3 * U[::-1]}
    output = run(imported(drawn, tmp_path, parameters=[{"Z": Z}]), columns)["y"]
    points = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 1.0, 3.0])
    inside = [np.clip(x, p[0], p[-1]) if end == "Clip" else x
              for x, p, end in zip(columns.values(), points, ends, strict=True)]  # fmt: skip
    expected = scipy.interpolate.RegularGridInterpolator(points, Z, bounds_error=False, fill_value=None)(
        np.stack(inside, axis=1)
    )
    np.testing.assert_allclose(output, expected, rtol=1e-12, atol=1e-12)


def eta(values=(1.0, 2.0, 0.0), points=(-1.0, 0.0, 2.0), name="Eta"):
    return ParameterSet([Curve(name, Axis(points, unit="deg"), values, unit="Nm")])


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("Lookup_n-D", {"DataSpecification": "Lookup table object", "LookupTableObject": "Eta"}),
        ("Lookup_n-D", {"Table": "Eta", "BreakpointsForDimension1": "nowhere"}),
        ("Lookup_n-D", {"Table": "Eta", "BreakpointsForDimension1": "short"}),
        ("Lookup", {"Table": "Eta", "InputValues": "nowhere", "LookUpMeth": "Interpolation-Use End Values"}),
    ],
)
@pytest.mark.parametrize("before", [{}, {"Eta": {"Table": [5.0, 5.0], "Breakpoints1": [0.0, 1.0]}}])
def test_a_calibration_file_gives_a_table_its_axes(kind, settings, before, tmp_path):
    drawn = alone(kind, NumberOfTableDimensions="1", ExtrapMethod="Clip", **settings)
    model = imported(drawn, tmp_path, parameters=[{"short": [0.0, 1.0], **before}, eta()])
    assert list(model.values) == ["Eta"]
    assert model.values["Eta"].axes[0].unit == "deg"
    np.testing.assert_allclose(run(model, {"u1": U})["y1"], np.interp(U, [-1, 0, 2], [1, 2, 0]))


def test_the_axes_of_a_calibration_file_count_for_the_nearest_point_too(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[5 6 7]",
                  InterpMethod="Nearest")  # fmt: skip
    output = run(imported(drawn, tmp_path, parameters=[eta()]), {"u1": [-3.0, -0.4, 0.9, 1.1, 9.0]})["y1"]
    assert output.tolist() == [1.0, 2.0, 2.0, 0.0, 0.0]


def test_a_part_of_a_struct_takes_its_value_by_its_full_name(tmp_path):
    drawn = alone("Gain", Gain="data.K*data.b")
    parameters = [{"data": {"K": 2.0, "b": 3.0}}, ParameterSet([Scalar("data.K", 5.0)])]
    model = imported(drawn, tmp_path, parameters=parameters)
    assert run(model, {"u1": [1.0]})["y1"].tolist() == [15.0]
    assert model.values["data.K"].value == 5.0


def test_a_table_of_prelookups_is_one_over_their_breakpoints(tmp_path):
    Z = np.arange(9.0).reshape(3, 3) ** 2
    model = imported(parts("Clip"), tmp_path, parameters=[{"Z": Z}])
    assert [axis.breakpoints.tolist() for axis in model.values["Z"].axes] == [[0, 1, 3], [-1, 1, 3]]
    axes = Axis([0.0, 2.0, 3.0], name="speed"), Axis([-1.0, 0.0, 3.0], name="load")
    model = imported(parts("Clip"), tmp_path, parameters=[ParameterSet([Map("Z", *axes, Z)])])
    assert [axis.name for axis in model.values["Z"].axes] == ["speed", "load"]
    columns = {"a": 2 * U + 1, "b": 3 * U[::-1]}
    expected = lookup_of(Z, [a.breakpoints for a in axes], [columns["a"], columns["b"]])
    np.testing.assert_allclose(run(model, columns)["y"], expected, rtol=1e-12, atol=1e-12)


def lookup_of(values, points, columns):
    """Bilinear, held at the ends."""
    inside = [np.clip(x, p[0], p[-1]) for x, p in zip(columns, points, strict=True)]
    return scipy.interpolate.RegularGridInterpolator(points, values)(np.stack(inside, axis=1))


def test_a_calibration_files_axes_do_not_fit_a_table_that_is_looked_up_by_number(tmp_path):
    drawn = alone("LookupNDDirect", NumberOfTableDimensions="1", Table="Eta")
    with pytest.raises(InputError, match="looks it up by index"):
        imported(drawn, tmp_path, parameters=[eta()])


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
    with pytest.raises(InputError, match=r"it references the model plant.slx, which was not found"):
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


@pytest.mark.parametrize("called", ["Own Mask", "Integrator", "Switch"])
def test_a_link_to_a_missing_library_names_it(called, tmp_path):
    drawn = alone("Reference", special=called)
    with pytest.raises(
        InputError, match=r"B: it links to the library lib, which was not found in .*\. Put lib.slx next to the model"
    ):
        imported(drawn, tmp_path)


V = np.random.default_rng(8).normal(size=30)
MORE = [
    ("Dead Zone Dynamic", 3, {}, lambda u, v: np.where(v > 1, v - 1, np.where(v < -1, v + 1, 0)), (1.0, None, -1.0)),
    ("Interval Test Dynamic", 3, {}, lambda u, v: (v <= 1) & (v >= -1), (1.0, None, -1.0)),
    ("Integer Delay", 1, {"NumDelays": "3", "vinit": "4"}, lambda u, v: [4, 4, 4, *v[:-3]], (None,)),
    ("Detect Fall Nonpositive", 1, {}, lambda u, v: (v <= 0) & ~(np.concatenate([[0], v[:-1] <= 0]) > 0), (None,)),
    ("Detect Rise Nonnegative", 1, {}, lambda u, v: (v >= 0) & ~(np.concatenate([[0], v[:-1] >= 0]) > 0), (None,)),
]


@pytest.mark.parametrize(("kind", "inputs", "parameters", "rule", "given"), MORE)
def test_further_blocks_of_the_library(kind, inputs, parameters, rule, given, tmp_path):
    columns = {f"u{at + 1}": V if one is None else np.full(30, one) for at, one in enumerate(given)}
    output = run(imported(alone("Reference", inputs, special=kind, **parameters), tmp_path), columns)["y1"]
    np.testing.assert_allclose(output, np.asarray(rule(U, V), dtype=float))


def test_a_rate_limit_may_be_an_input(tmp_path):
    drawn = alone("Reference", 3, special="Rate Limiter Dynamic")
    output = run(imported(drawn, tmp_path), {"u1": np.abs(U) + 1, "u2": V, "u3": -np.abs(V)})["y1"]
    y = 0.0
    for k in range(30):
        y += np.clip(V[k] - y, -abs(V[k]) * T, (abs(U[k]) + 1) * T)
        assert output[k] == pytest.approx(y)


def test_values_one_after_the_other(tmp_path):
    drawn = alone("Reference", 0, special="Repeating Sequence Stair", OutValues="[3 1 4]", tsamp="0.2")
    assert run(imported(drawn, tmp_path), samples=8)["y1"].tolist() == [3, 3, 1, 1, 4, 4, 3, 3]


def test_a_function_call_generator_runs_a_subsystem_at_its_sample_time(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.link("Call", "simulink/Ports & Subsystems/Function-Call Generator", "Function-Call Generator", ports=(0, 1),
               sample_time="0.3")  # fmt: skip
    inner = drawn.subsystem("S")
    inner.inport("x")
    inner.block("TriggerPort", "P", TriggerType="function-call")
    inner.block("Gain", "G", Gain="2")
    inner.outport("y")
    inner.chain("x", "G", "y")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    drawn.line("Call", "S#trigger")
    output = run(imported(drawn, tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(output, 2 * np.repeat(U[::3], 3))


def test_concatenation_assignment_and_manual_switches(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("a")
    drawn.inport("b")
    drawn.block("Concatenate", "C", ports=(2, 1))
    drawn.block("BusCreator", "Bus", ports=(2, 1), Inputs="2")
    drawn.block("BusAssignment", "Set", ports=(2, 1), AssignedSignals="q")
    drawn.block("BusSelector", "Q", ports=(1, 2), OutputSignals="p,q")
    drawn.block("ManualSwitch", "M", ports=(2, 1), CurrentSetting="0")
    for name, source in (("vector", "C"), ("p", "Q:1"), ("q", "Q:2"), ("m", "M")):
        drawn.outport(name)
        drawn.line(source, name)
    drawn.line("a", "C:1", "Bus:1", "M:1", name="p")
    drawn.line("b", "C:2", "M:2", "Set:2")
    drawn.block("Gain", "K", Gain="9")
    drawn.line("a", "K")
    drawn.line("K", "Bus:2", name="q")
    drawn.line("Bus", "Set:1")
    drawn.chain("Set", "Q")
    outputs = run(imported(drawn, tmp_path), {"a": U, "b": V})
    for name, expected in (("vector[1]", U), ("vector[2]", V), ("p", U), ("q", V), ("m", V)):
        np.testing.assert_array_equal(outputs[name], expected)


@pytest.mark.parametrize(
    "text", ["[1 2", "1:1e12", "inf:0", "nan:2", "zeros(1e9)", "f(", "x(0)", "[1 2;3]", "{1}", "'a'"]
)
def test_a_meaningless_parameter_is_reported_with_its_block(text, tmp_path):
    drawn = alone("Gain", Gain=text)
    with pytest.raises(InputError, match="B: its Gain"):
        imported(drawn, tmp_path, parameters=[{"x": [1.0, 2.0]}])


def test_sizes_that_do_not_fit_are_reported_with_the_block(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Constant", "A", Value="[1 2 3]")
    drawn.block("Constant", "B", Value="[1 2]")
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.outport("y")
    drawn.line("A", "S:1")
    drawn.line("B", "S:2")
    drawn.chain("S", "y")
    with pytest.raises(InputError, match="S: its inputs have the sizes 3, 2, which do not match"):
        imported(drawn, tmp_path)


def test_a_subsystem_with_its_content_in_another_file_names_the_file(tmp_path):
    drawn = alone("SubSystem", ReferencedSubsystem="shared_part")
    with pytest.raises(InputError, match="B: its content is in the file shared_part, which was not found"):
        imported(drawn, tmp_path)


def test_a_manual_switch_of_an_old_library_passes_on_the_chosen_input(tmp_path):
    for position, expected in (("1", 3.0), ("0", 5.0)):
        drawn = alone("Reference", 2, special="Manual Switch", sw=position, action="0")
        assert run(imported(drawn, tmp_path), {"u1": [3.0], "u2": [5.0]})["y1"].tolist() == [expected]
