import threading
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.graph.external_function import evaluate_points, function_remarks
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.importers.fmu.fmu_archive import digest_of
from kennfeld.importers.fmu.importing import fmu, read_fmu
from kennfeld.importers.fmu.instance import load_instance
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.samples import Piece, Samples
from tests.clocks import even_clock
from tests.draws import mostly_slow
from tests.importers.fmu.lag_fmu import TABLE, build, equations_of

STEP, COUNT = 0.1, 50
WEIGHTS = np.array([10.0 * i + j for i, j in TABLE])


@pytest.fixture(scope="module", params=[2, 3])
def lag(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("lag"), request.param)


def closed_form(u, tau, k, table):
    """The lag by Euler's method, and its slopes along tau and k."""
    n = np.arange(COUNT)
    decay = 1 - STEP / tau
    x = u + (k - u) * decay**n
    by_tau = (k - u) * n * decay ** (n - 1) * STEP / tau**2
    return k * x + table @ WEIGHTS, k * by_tau, x + k * decay**n


def test_euler_steps_are_those_of_the_closed_form(lag):
    table = np.arange(6.0)
    data = {"time": np.arange(COUNT) * STEP, "u": np.full(COUNT, 3.0)}
    y = kf.simulate(fmu(lag, solver="ode1"), data, {"tau": 0.7, "k": 1.3})["y"].values
    np.testing.assert_allclose(y, closed_form(3.0, 0.7, 1.3, table)[0], rtol=1e-13)


def test_classic_runge_kutta_follows_the_exact_solution(lag):
    t = np.arange(COUNT) * STEP
    y = kf.simulate(fmu(lag), {"time": t, "u": np.full(COUNT, 3.0)}, {"tau": 0.7})["y"].values
    np.testing.assert_allclose(y - np.arange(6.0) @ WEIGHTS, 3.0 - 2.0 * np.exp(-t / 0.7), rtol=2e-6)


def test_uneven_steps_lead_to_the_next_sample(lag):
    steps = np.resize([0.4, 0.02], COUNT - 1)
    data = {"time": np.concatenate([[0.0], np.cumsum(steps)]), "u": np.full(COUNT, 3.0)}
    decay = np.concatenate([[1.0], np.cumprod(1 - steps / 0.7)])
    expected = 1.3 * (3.0 + (1.3 - 3.0) * decay) + np.arange(6.0) @ WEIGHTS
    y = kf.simulate(replace(fmu(lag, solver="ode1"), step=None), data, {"tau": 0.7, "k": 1.3})["y"].values
    np.testing.assert_allclose(y, expected, rtol=1e-12)
    y = kf.simulate(replace(fmu(lag, solver="ode8"), step=None), data, {"tau": 0.7})["y"].values
    np.testing.assert_allclose(y - np.arange(6.0) @ WEIGHTS, 3.0 - 2.0 * np.exp(-data["time"] / 0.7), rtol=1e-8)


def test_sensitivities_are_those_of_the_closed_form(lag):
    model = fmu(lag, solver="ode1")
    parameters = model.carried
    lowered = lower_lookups(model.graph, parameters, ())
    kernel = Kernel(lowered, [Output(lowered.graph.names["y"])], parameters, tuple(parameters))
    columns = {"u": np.full(COUNT, 3.0), **even_clock(STEP, COUNT)}
    samples = Samples(
        [columns[name] for name in kernel.layout.inputs], np.zeros((1, COUNT)), [Piece(0, COUNT, np.ones(1))]
    )
    _, jacobian = Accumulator(kernel, samples, sparse=False).rows(kernel.values.pack(parameters))
    _, by_tau, by_k = closed_form(3.0, 2.0, 1.0, np.arange(6.0))
    offsets = kernel.values.offsets
    np.testing.assert_allclose(jacobian[:, offsets["tau"]], by_tau, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(jacobian[:, offsets["k"]], by_k, rtol=1e-6, atol=1e-9)
    table = jacobian[:, offsets["table"] : offsets["table"] + 6]
    np.testing.assert_allclose(table, np.tile(WEIGHTS, (COUNT, 1)), rtol=1e-6)


def test_calibration_finds_parameters_of_all_kinds(lag):
    data = {"time": np.arange(COUNT) * STEP, "u": 3.0 + np.sin(np.arange(COUNT))}
    model = fmu(lag)
    data["target"] = kf.simulate(model, data, {"tau": 0.7, "k": 1.3})["y"].values
    result = kf.calibrate(model, data, {}, "target", free=["tau", "k"])
    assert result.parameters["tau"].value == pytest.approx(0.7, rel=1e-9)
    assert result.parameters["k"].value == pytest.approx(1.3, rel=1e-9)


def test_wrong_directional_derivatives_give_way_to_differences(lag):
    slopes = load_instance(str(lag.resolve()), digest_of(lag)).slopes
    assert {slopes["x"], slopes["u"]} == {"directional derivatives"}
    assert {slopes["tau"], slopes["k"], slopes["table[2,3]"]} == {"differences"}


def test_a_remark_names_the_slopes_along_each_argument(lag):
    (remark,) = function_remarks(fmu(lag).graph.nodes)
    assert remark.startswith("slopes of lag.fmu: directional derivatives along x, u; differences along tau, k, table[")


def test_slopes_are_those_of_the_equations(lag):
    names = [a.name for a in load_instance(str(lag.resolve()), digest_of(lag)).arguments[5:]]  # as the file lists them
    order = [TABLE.index((int(name[6]), int(name[8]))) for name in names]
    point = np.array([[0.0, 1.5, 3.0, 0.8, 1.2, *np.arange(6.0)[order]]])
    results, slopes = evaluate_points(equations_of(lag), point)
    np.testing.assert_allclose(results[0], [1.5 / 0.8, 1.2 * 1.5 + np.arange(6) @ WEIGHTS])
    np.testing.assert_allclose(slopes[0, 0, :5], [0, -1 / 0.8, 1 / 0.8, -1.5 / 0.64, 0], atol=1e-8)
    np.testing.assert_allclose(slopes[0, 1], [0, 1.2, 0, 0, 1.5, *WEIGHTS[order]], rtol=1e-8, atol=1e-5)


def test_slopes_at_a_limit_stay_within_it(lag):
    point = np.array([[0.0, 1.5, 3.0, 0.01, 1.2, *range(6)]])
    _, slopes = evaluate_points(equations_of(lag), point)
    assert slopes[0, 0, 3] == pytest.approx(-1.5 / 0.0001, rel=1e-6)


def test_an_error_of_the_code_is_nan_and_does_not_last(lag):
    usable, refused = [0.0, 1.5, 3.0, 0.8, 1.2, *range(6)], [0.0, 1.5, 3.0, -1.0, 1.2, *range(6)]
    results, _ = evaluate_points(equations_of(lag), np.array([usable, refused, usable]))
    assert np.isnan(results[1]).all()
    np.testing.assert_array_equal(results[0], results[2])


def test_several_threads_may_call_at_once(lag):
    function = equations_of(lag)
    points = np.tile([0.0, 1.5, 3.0, 0.8, 1.2, *range(6)], (300, 1))
    points[:, 1] = np.linspace(-1, 1, 300)
    points[:, 3] = np.linspace(0.5, 1.5, 300)
    expected = (3.0 - points[:, 1]) / points[:, 3]
    differences = []

    def run():
        differences.append(np.max(np.abs(evaluate_points(function, points)[0][:, 0] - expected)))

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(differences) == 4
    assert max(differences) < 1e-12


def test_formula_text_calls_an_fmu_with_its_own_solver(lag):
    function = read_fmu(lag, "", "plant", 0.1)
    text = "y = plant(3 * drive)\nz = plant(3 * drive) * gain"
    model = kf.formula(text, parameters=["gain"], functions=[function])
    assert len(model.graph.states) == 1
    assert model.solver == "ode4"
    assert set(model.graph.parameters) == {"gain", "plant.tau", "plant.k", "plant.table"}
    data = {"time": np.arange(COUNT) * STEP, "drive": np.ones(COUNT)}
    nodes = kf.simulate(model, data, {"gain": 2.0})
    alone = kf.simulate(fmu(lag), {"time": data["time"], "u": 3 * data["drive"]}, {})
    np.testing.assert_array_equal(nodes["y"].values, alone["y"].values)
    np.testing.assert_array_equal(nodes["z"].values, 2 * alone["y"].values)


@pytest.mark.parametrize(("capability", "count"), [("", 16), ('canBeInstantiatedOnlyOncePerProcess="true"', 0)])
@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
def test_differences_along_parameters_have_instances_of_their_own(tmp_path, version, capability, count):
    path = build(tmp_path, version, head=capability)
    instance = load_instance(str(path), digest_of(path))
    assert instance.further_instances == 0
    points = np.array([[0.0, x, 3.0, 0.8, 1.2, *range(6)] for x in (1.0, 1.5, 2.0)])
    _, slopes = evaluate_points(equations_of(path), points)
    np.testing.assert_allclose(slopes[:, 0, 3], (points[:, 1] - 3.0) / 0.64, rtol=1e-8)
    assert instance.further_instances == count


@pytest.mark.slow
def test_slopes_along_many_parameters_are_the_same_with_one_instance_and_with_many(tmp_path):
    table = [(i, j) for i in (1, 2) for j in range(1, 10)]
    point = np.array([[0.0, x, 3.0, 0.8, 1.2, *np.arange(17.0, -1.0, -1.0)] for x in (1.0, 1.5, 2.0)])
    slopes, instances = [], []
    for capability in ("", 'canBeInstantiatedOnlyOncePerProcess="true"'):
        folder = tmp_path / str(len(slopes))
        folder.mkdir()
        path = build(folder, 2, "-DCOLUMNS=9", head=capability, table=table)
        slopes.append(evaluate_points(equations_of(path), point)[1])
        instances.append(load_instance(str(path), digest_of(path)).further_instances)
    assert instances == [40, 0]
    np.testing.assert_array_equal(slopes[0], slopes[1])
    np.testing.assert_allclose(slopes[0][0, 1, 5:], [10 * i + j for i, j in reversed(table)], rtol=1e-7)


@pytest.mark.parametrize("version", mostly_slow([2, 3], [3]))
def test_equations_with_memory_are_refused(tmp_path, version):
    path = build(tmp_path, version, "-DMEMORY")
    with pytest.raises(InputError, match="depend on earlier evaluations"):
        load_instance(str(path), digest_of(path))


@pytest.mark.slow
def test_co_simulation_is_named_where_the_equations_cannot_be_used(tmp_path):
    path, other = build(tmp_path, 2, "-DMEMORY"), tmp_path / "both.fmu"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            both = b'<CoSimulation modelIdentifier="lag"/><ModelExchange'
            new.writestr(name, old.read(name).replace(b"<ModelExchange", both))
    with pytest.raises(InputError, match="Choose its co-simulation"):
        load_instance(str(other), digest_of(other))


def test_slopes_that_are_not_needed_are_not_computed(lag):
    call = load_instance(str(lag.resolve()), digest_of(lag)).equations.call
    point, results, slopes = np.array([0.0, 1.5, 3.0, 0.8, 1.2, *range(6)]), np.empty(2), np.full((2, 11), 7.0)
    slopes[0] = 0.0
    slopes[0, 3] = 1.0
    call(point.ctypes.data, results.ctypes.data, slopes.ctypes.data)
    np.testing.assert_allclose(slopes[0], [0, 0, 0, -1.5 / 0.64, *[0] * 7], rtol=1e-8)
    np.testing.assert_allclose(slopes[1], [7, 7, 7, 0, *[7] * 7], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
def test_a_simulation_that_ends_is_nan_there_alone(tmp_path, version):
    path = build(tmp_path, version, "-DENDING", indicators=1)
    points = np.array([[0.0, x, 3.0, 0.8, 1.2, *range(6)] for x in (1.0, 2.5, 1.0)])
    results, _ = evaluate_points(equations_of(path), points)
    assert np.isnan(results[1]).all()
    assert np.isfinite(results[[0, 2]]).all()


def test_a_changed_file_is_not_run(tmp_path):
    path = build(tmp_path, 2)
    function = equations_of(path)
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(InputError, match="has changed since it was read"):
        evaluate_points(function, np.zeros((1, 11)))


def test_a_library_that_refuses_is_reported(tmp_path):
    path = build(tmp_path, 2)
    other = path.with_name("other.fmu")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, content.replace(b"{lag}", b"{new}") if name.endswith("xml") else content)
    with pytest.raises(InputError, match="does not create an instance"):
        load_instance(str(other), digest_of(other))


@pytest.mark.parametrize("solver", ["ode1"])
def test_trajectories_are_those_of_fmpy(lag, solver):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    t = np.arange(COUNT) * STEP
    result = fmpy.simulate_fmu(
        str(lag), validate=False, start_time=0.0, stop_time=t[-1], solver="Euler", step_size=STEP,
        output_interval=STEP, fmi_type="ModelExchange", output=["y"], start_values={"tau": 0.7, "u": 3.0},
    )  # fmt: skip
    y = kf.simulate(fmu(lag, solver=solver), {"time": t, "u": np.full(COUNT, 3.0)}, {"tau": 0.7})["y"].values
    np.testing.assert_allclose(y, result["y"], rtol=1e-9)
