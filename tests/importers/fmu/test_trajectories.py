import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.importers.fmu.fmu_archive import digest_of
from kennfeld.importers.fmu.importing import fmu
from kennfeld.importers.fmu.trajectories import load_trajectories
from tests.draws import mostly_slow
from tests.importers.fmu.tank_fmu import COUNT, build, closed_form, recording

SINGLE = 'canHandleVariableCommunicationStepSize="true" canBeInstantiatedOnlyOncePerProcess="true"'
TABLE = np.array([0.1, 0.2, 0.3])


@pytest.fixture(scope="module", params=[2, 3])
def tank(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("tank"), request.param)


def test_outputs_are_those_of_steps_with_the_inputs_of_the_sample_before(tank):
    data = recording()
    model = fmu(tank)
    table = model.carried["table"].changed(values=TABLE)
    nodes = kf.simulate(model, data, {"gain": 1.3, "tau": 0.7, "level": 0.4, "table": table})
    x = closed_form(data, 1.3, 0.7, 0.4)
    np.testing.assert_allclose(nodes["y"].values, x + TABLE @ [1, 2, 3], rtol=1e-13)
    np.testing.assert_array_equal(nodes["steps"].values, 3 + np.arange(COUNT))
    np.testing.assert_array_equal(nodes["high"].values, x > 1)


def test_pieces_start_anew(tank):
    data = recording(2 * COUNT)
    data["flow"][COUNT - 1] = np.nan  # the end of a piece
    with pytest.warns(kf.InputWarning, match="1 of 80 samples is not simulated: flow has no value at sample 40"):
        y = kf.simulate(fmu(tank), data, {})["y"].values
    second = {name: values[COUNT:] for name, values in data.items()}
    np.testing.assert_allclose(y[-COUNT:], closed_form(second), rtol=1e-12)


@pytest.mark.parametrize(("fault", "words"), [(2, "discarded"), (3, "an error"), (4, "fatal"), (5, "did not complete")])
def test_a_failed_step_gives_nan_from_there_on_and_one_warning(tmp_path, caplog, fault, words):
    model = fmu(build(tmp_path, 2))
    data = recording()
    for _ in range(2):
        y = kf.simulate(model, data, {"fault": float(fault), "at": 1.0})["y"].values
    np.testing.assert_array_equal(np.isnan(y), (data["time"] > 1.0 - 1e-6) | (fault == 4))
    logged, stopped = (record.message for record in caplog.records)
    assert logged == f"tank.fmu logged: the tank leaks by 2.5 l at 7 bar, 1 2 3 {fault}"
    assert words in stopped
    assert stopped.endswith("t = 1 s; its outputs are NaN from there on") or fault == 4


def test_a_trajectory_after_an_error_is_not_affected(tank):
    model, data = fmu(tank), recording()
    expected = kf.simulate(model, data, {})["y"].values
    kf.simulate(model, data, {"fault": 3.0, "at": 1.0})
    np.testing.assert_array_equal(kf.simulate(model, data, {})["y"].values, expected)


def test_a_refused_initialization_is_nan(tank):
    y = kf.simulate(fmu(tank), recording(), {"tau": -1.0})["y"].values
    assert np.isnan(y).all()


def test_an_early_return_that_was_not_allowed_is_nan(tmp_path, caplog):
    y = kf.simulate(fmu(build(tmp_path, 3)), recording(), {"fault": 6.0, "at": 1.0})["y"].values
    assert np.isnan(y).tolist() == [n >= 10 for n in range(COUNT)]
    assert "returned early" in caplog.text


def test_the_last_outputs_of_an_fmu_that_ends_count(tank, caplog):
    y = kf.simulate(fmu(tank), recording(), {"fault": 7.0, "at": 1.0})["y"].values
    assert np.isnan(y).tolist() == [n >= 11 for n in range(COUNT)]
    assert "ended the simulation at t = 1 s" in caplog.text


def load(path):
    return load_trajectories(str(path), digest_of(path))


@pytest.mark.parametrize(
    ("version", "option", "resets"),
    [
        (2, "-DUSUAL", True),
        (3, "-DNO_RESET", True),
        (2, "-DLAZY_RESET", False),
        pytest.param(3, "-DUSUAL", True, marks=pytest.mark.slow),
        pytest.param(2, "-DNO_RESET", True, marks=pytest.mark.slow),
        pytest.param(3, "-DLAZY_RESET", False, marks=pytest.mark.slow),
    ],
)
def test_an_instance_that_is_not_as_new_after_a_reset_is_replaced(tmp_path, version, option, resets):
    path = build(tmp_path, version, option)
    assert load(path).resets == resets
    data = recording()
    for gain in (1.0, 3.0):
        y = kf.simulate(fmu(path), data, {"gain": gain})["y"].values
        np.testing.assert_allclose(y, closed_form(data, gain), rtol=1e-12)


@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
@pytest.mark.parametrize("options", [(), ("-DLAZY_RESET",)])
def test_the_process_is_as_the_standards_demand(tmp_path, caplog, version, options):
    model, data = fmu(build(tmp_path, version, "-DDEMANDING", *options)), recording()
    with ThreadPoolExecutor(2) as pool:
        pairs = [(gain, pool.submit(kf.simulate, model, data, {"gain": gain})) for gain in (1.0, 2.0, 3.0)]
        for gain, run in pairs:
            np.testing.assert_allclose(run.result()["y"].values, closed_form(data, gain), rtol=1e-12)
    assert not caplog.records


@pytest.mark.slow
@pytest.mark.parametrize("version", mostly_slow([2, 3], [3]))
def test_steps_of_equal_length_are_passed_on_as_equal(tmp_path, version):
    data = recording()
    y = kf.simulate(fmu(build(tmp_path, version, "-DEVEN", head="")), data, {})["y"].values
    np.testing.assert_allclose(y, closed_form(data), rtol=1e-12)


def test_a_step_of_another_length_is_nan_if_the_fmu_needs_equal_ones(tmp_path, caplog):
    path = build(tmp_path, 2, "-DEVEN", head="")
    fmu_in_process = load(path)
    parameters = [1.0, 2.0, 0.0, 0.0, 1e30, 0.0, 0.0, 0.0]
    start, ticket = np.array([0.0, 0.0, 1.0, 0.0, 1.0, *parameters]), np.zeros(1)
    fmu_in_process.start.call(start.ctypes.data, ticket.ctypes.data, None)
    outputs = [step(fmu_in_process, ticket[0], t)[0] for t in (0.0, 0.1, 0.2, 0.25, 0.35)]
    assert np.isfinite(outputs).tolist() == [True, True, True, False, False]
    assert "steps of equal length" in caplog.text


def step(fmu_in_process, ticket, t):
    point, outputs = np.array([ticket, t, 1.0, 0.0, 1.0]), np.empty(3)
    fmu_in_process.step.call(point.ctypes.data, outputs.ctypes.data, None)
    return outputs


def test_a_step_at_the_same_time_returns_the_same_outputs_and_an_earlier_one_nan(tank, caplog):
    fmu_in_process = load(tank)
    start = np.array([0.0, 5.0, 1.0, 0.0, 1.0, 1.0, 2.0, 0.0, 0.0, 1e30, 0.0, 0.0, 0.0])
    ticket = np.zeros(1)
    fmu_in_process.start.call(start.ctypes.data, ticket.ctypes.data, None)
    outputs = [step(fmu_in_process, ticket[0], t)[0] for t in (5.0, 5.0, 5.1, 5.1, 5.0, 5.2)]
    np.testing.assert_allclose(outputs, [1.0, 1.0, 1.05, 1.05, np.nan, np.nan])
    assert "does not follow" in caplog.text


@pytest.mark.slow
def test_threads_run_trajectories_at_once(tank):
    model, data = fmu(tank), recording(2000)
    gains = np.linspace(0.5, 2.0, 24)
    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(lambda gain: kf.simulate(model, data, {"gain": gain})["y"].values, gains))
    for gain, y in zip(gains, results, strict=True):
        np.testing.assert_allclose(y, closed_form(data, gain), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
def test_an_fmu_with_one_instance_runs_one_trajectory_at_a_time(tmp_path, version):
    path = build(tmp_path, version, "-DSINGLE", head=SINGLE)
    assert load(path).step.trajectories == 1
    data = recording()
    for _ in range(2):
        y = kf.simulate(fmu(path), data, {})["y"].values
        np.testing.assert_allclose(y, closed_form(data), rtol=1e-12)


def test_an_fmu_with_one_instance_cannot_be_called_twice(tmp_path):
    path = build(tmp_path, 2, "-DSINGLE", head=SINGLE)
    text = "a = tank.y(flow, 0, 1)\nb = tank.y(2 * flow, 0, 1)"
    with pytest.raises(InputError, match="allows one instance in a process"):
        kf.formula(text, functions={"tank": path})


def test_formula_text_calls_an_fmu_several_times(tank):
    text = "a = tank.y(flow, mode, open)\nb = tank.y(2 * flow, 0, 1)\nc = tank.steps(flow, mode, open)"
    model = kf.formula(text, functions={"tank": tank})
    assert calls_of(model) == 2
    data = recording()
    nodes = kf.simulate(model, data, {})
    np.testing.assert_allclose(nodes["a"].values, closed_form(data), rtol=1e-12)
    doubled = {**data, "flow": 2 * data["flow"], "open": np.ones(COUNT)}
    np.testing.assert_allclose(nodes["b"].values, closed_form(doubled), rtol=1e-12)
    np.testing.assert_array_equal(nodes["c"].values, 3 + np.arange(COUNT))


def test_outputs_are_constant_within_a_step_of_a_solver(tank):
    text = "solver ode4\ny = tank.y(flow + 0 * z, mode, open)\nz = integrator(y - z, 0)"
    model = kf.formula(text, functions={"tank": tank})
    data = recording()
    nodes = kf.simulate(model, data, {})
    y = nodes["y"].values
    np.testing.assert_allclose(y, closed_form(data), rtol=1e-12)
    z = [0.0]
    for level in y[:-1]:
        z.append(level + (z[-1] - level) * (1 - 0.1 + 0.1**2 / 2 - 0.1**3 / 6 + 0.1**4 / 24))
    np.testing.assert_allclose(nodes["z"].values, z, rtol=1e-12)


def test_calibration_finds_parameters_through_the_memory_of_an_fmu(tank):
    model, data = fmu(tank), recording()
    data["target"] = closed_form(data, 1.3, 0.7, 0.4)
    result = kf.calibrate(model, data, {}, "target", node="y", free=["gain", "tau", "level"])
    for name, value in (("gain", 1.3), ("tau", 0.7), ("level", 0.4)):
        assert result.parameters[name].value == pytest.approx(value, rel=1e-7)


def test_a_nan_input_ends_the_trajectory(tank, caplog):
    model = kf.formula("y = tank.y(flow, mode, sqrt(1.05 - t))", functions={"tank": tank})
    y = kf.simulate(model, recording(), {})["y"].values
    assert np.isnan(y).tolist() == [n >= 12 for n in range(COUNT)]  # from the step on that has this input
    assert "an input is not a number at t = 1.1 s" in caplog.text


def test_inputs_may_depend_on_the_outputs_of_the_same_sample(tank):
    text = "y = tank.y(3 - 2 * y, n, 1)\nn = tank.steps(3 - 2 * y, n, 1)"
    model = kf.formula(text, functions={"tank": tank})
    nodes = kf.simulate(model, {"time": recording()["time"]}, {"tank.tau": 0.7})
    x = [0.0]  # the flow starts with its own start value, 0
    for _ in range(COUNT - 1):
        x.append(x[-1] + 0.1 * (3 - 2 * x[-1]) - 0.1 * x[-1] / 0.7)
    np.testing.assert_allclose(nodes["y"].values, x, rtol=1e-12)
    np.testing.assert_array_equal(nodes["n"].values, np.arange(COUNT))
    assert calls_of(model) == 1


def calls_of(model):
    return sum(node.op == "external" and not node.payload.function.sequential for node in model.graph.nodes)


def closed_loop(level, tau):
    """Return the levels of two tanks; the flow into the first one starts with its own start value, 0."""
    a, b = [level], [level]
    for _ in range(COUNT - 1):
        following = a[-1] + 0.1 * (1 - b[-1]) - 0.1 * a[-1] / 2.0
        b.append(b[-1] + 0.1 * a[-1] - 0.1 * b[-1] / tau)
        a.append(following)
    return a, b


def test_two_fmus_drive_each_other(tank, tmp_path):
    other = build(tmp_path, 3)
    text = "a = first.y(1 - b, 0, 1)\nb = second.y(a, 0, 1)"
    model = kf.formula(text, functions={"first": tank, "second": other})
    nodes = kf.simulate(model, {"time": recording()["time"]}, {"second.tau": 0.5, "first.level": 0.2})
    a, b = closed_loop(0.2, 0.5)
    np.testing.assert_allclose(nodes["a"].values, a, rtol=1e-12)
    np.testing.assert_allclose(nodes["b"].values, b, rtol=1e-12)


def test_trajectories_are_those_of_fmpy(tank):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    data = recording()
    dtype = [(name, np.bool_ if name == "open" else np.int32 if name == "mode" else float) for name in data]
    signals = np.array(list(zip(*data.values(), strict=True)), dtype=dtype)
    result = fmpy.simulate_fmu(
        str(tank), validate=False, start_time=0.0, stop_time=data["time"][-1], output_interval=0.1, input=signals,
        fmi_type="CoSimulation", output=["y", "steps", "high"], start_values={"tau": 0.7, "gain": 1.3},
    )  # fmt: skip
    nodes = kf.simulate(fmu(tank), data, {"tau": 0.7, "gain": 1.3})
    for name in ("y", "steps", "high"):
        np.testing.assert_allclose(nodes[name].values, result[name], rtol=1e-12)


def test_a_library_that_does_not_create_an_instance_is_reported(tmp_path):
    path = build(tmp_path, 2)
    other = path.with_name("other.fmu")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, content.replace(b"{tank}", b"{new}") if name.endswith("xml") else content)
    with pytest.raises(InputError, match="does not create an instance"):
        load(other)


@pytest.mark.parametrize("interface", ["co-simulation", "co_simulation"])
def test_the_interface_is_named_with_a_hyphen_or_an_underscore(tank, interface):
    assert kf.fmu(tank, interface=interface).graph.names == kf.fmu(tank).graph.names


def test_an_fmu_that_ticks_its_clocks_itself_runs_and_a_remark_names_them(tmp_path):
    path, other = build(tmp_path, 3), tmp_path / "clocked.fmu"
    clock = b'<Clock name="tick" valueReference="40" causality="output" intervalVariability="triggered"/>'
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b"<ModelVariables>", b"<ModelVariables>" + clock))
    model = fmu(other)
    assert "clocks are not read; the FMU itself handles their ticks: tick" in " ".join(map(str, model.remarks))
    np.testing.assert_allclose(kf.simulate(model, recording(), {})["y"].values, closed_form(recording()), rtol=1e-12)


def test_an_unknown_interface_is_named_with_those_that_there_are(tank):
    with pytest.raises(ArgumentError, match="interface='both' must be model-exchange or co-simulation"):
        kf.fmu(tank, interface="both")
