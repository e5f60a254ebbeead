"""Whole ASCET projects, simulated like independent transcriptions in numpy, and calibrated."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.importers.ascet.declarations import SourceTree
from kennfeld.importers.ascet.importing import esdl, import_esdl
from tests.clocks import even_clock
from tests.importers.ascet.esdl_projects import BATTERY, VEHICLE, class_model, run, write_project

SAMPLES = 400


@pytest.fixture
def battery(tmp_path):
    return write_project(tmp_path, BATTERY) / "Battery"


def load_cycle():
    """Current in A and ambient temperature over the samples."""
    time = np.arange(SAMPLES) * 0.01
    return {"current": 30.0 * np.sin(3.0 * time) + 5.0 * (time > 2.0), "ambient": 25.0 + 20.0 * np.cos(time)}


def bilinear(x, y, values, at_x, at_y):
    """The value of a map, clipped at its ends."""
    at_x, at_y = np.clip(at_x, x[0], x[-1]), np.clip(at_y, y[0], y[-1])
    i = min(int(np.searchsorted(x, at_x, side="right")) - 1, len(x) - 2)
    j = min(int(np.searchsorted(y, at_y, side="right")) - 1, len(y) - 2)
    p, q = (at_x - x[i]) / (x[i + 1] - x[i]), (at_y - y[j]) / (y[j + 1] - y[j])
    low = values[i, j] * (1 - q) + values[i, j + 1] * q
    high = values[i + 1, j] * (1 - q) + values[i + 1, j + 1] * q
    return low * (1 - p) + high * p


def plant_by_hand(current, ambient, dt=0.01):
    x, y = np.array([-20.0, 0.0, 25.0, 60.0]), np.array([0.0, 50.0, 100.0])
    leak = np.array([[2.4, 1.5, 1.3], [1.8, 1.1, 0.9], [1.2, 0.5, 0.2], [1.1, 0.3, 0.0]])
    heat, load = (ambient[0] - 20.0) * 2.73, 0.0
    rows = []
    for i_now, t_now in zip(current, ambient, strict=True):
        heat = np.clip(heat + (-1.5 * i_now + 1.7 * (t_now - (heat / 2.73 + 20.0))) * dt, -1000.0, 1000.0)
        temperature = heat / 2.73 + 20.0
        resistance = bilinear(x, y, leak, temperature, 41.5 + load / 25.0) * 1200.0 + 1200.0
        voltage = (1.55 - i_now * 0.08) * (resistance / (0.08 + resistance))
        flow = (i_now - np.exp((voltage - 1.5) / 0.05) * 5e-7) * (1.0 - (41.5 + load / 25.0) / 100.0)
        load = np.clip(load + flow * dt, -1041.325, 1458.675)
        rows.append((temperature, voltage, 41.5 + load / 25.0))
    return np.array(rows).T


@pytest.mark.slow
def test_the_battery_plant_simulates_like_numpy(battery):
    model = esdl(battery / "Cell/Plant.esdl")
    assert model.step == 0.01
    columns = load_cycle()
    nodes = run(model, columns)
    expected = plant_by_hand(columns["current"], columns["ambient"])
    for name, values in zip(("temperature", "voltage", "charge"), expected, strict=True):
        np.testing.assert_allclose(nodes[name], values, rtol=1e-12, atol=1e-12)


def test_inputs_outputs_parameters_and_states_are_reported(battery):
    report = import_esdl(battery / "Cell/Plant.esdl").report
    assert {(q.name, q.unit) for q in report.inputs} == {("current", "A"), ("ambient", "")}
    assert {q.name for q in report.outputs} == {"voltage", "charge", "temperature"}
    assert {p.name: p.shape for p in report.parameters}["leak"] == (4, 3)
    assert {(s.name, s.initial) for s in report.states} == {("heat.memory", None), ("load.memory", 0.0)}
    assert report.startup == ("Cell.Plant.init",)


@pytest.mark.slow
def test_the_task_of_an_application_chains_its_processes(battery):
    model = esdl(battery / "Battery.app")
    assert set(model.graph.inputs) == {"current", "ambient"}
    columns = load_cycle()
    nodes = run(model, columns)
    temperature, voltage, _ = plant_by_hand(columns["current"], columns["ambient"])
    shift = np.interp(temperature, [0.0, 20.0, 30.0, 40.0, 60.0], [0.17, 0.15, 0.15, 0.16, 0.19])
    estimate = np.clip((np.clip(voltage + shift, 0.5, 2.5) - 1.2) * (0.1 / 0.0006), 0.0, 100.0)
    np.testing.assert_allclose(nodes["estimate"], estimate, rtol=1e-11, atol=1e-11)


def test_a_folder_that_cannot_be_read_has_no_declarations(battery):
    assert SourceTree(battery).package("Gone", battery / "Gone") == {}


def test_the_initializer_of_an_instance_sets_its_values(battery):
    values = esdl(battery / "Cell/Sensor.esdl").values
    assert (values["accu.base"].value, values["accu.gain"].value) == (1.2, 0.0006)
    assert (values["accu.base"].lower, values["accu.base"].upper) == (0.0, 5.0)
    own = esdl(battery / "Cell/Accu.esdl").values
    assert (own["base"].value, own["gain"].value) == (1.4, 0.001)


@pytest.mark.slow
def test_a_disturbed_curve_of_the_sensor_is_recovered_from_the_plant(battery):
    plant = esdl(battery / "Cell/Plant.esdl")
    columns = {"current": np.tile([-3.0, -2.0, 0.0, 1.0], 100), "ambient": np.linspace(-10.0, 75.0, 400)}
    recorded = run(plant, columns)
    sensor = esdl(battery / "Cell/Accu.esdl")
    inputs = {"U": recorded["voltage"], "T": recorded["temperature"]}
    true = sensor.values.with_parameters(
        sensor.values["gain"].with_values(0.002), sensor.values["base"].with_values(1.1)
    )
    target = run(sensor, inputs, parameters=true)["charge"]
    disturbed = true.with_parameters(true["shift"].with_values([0.3, 0.0, 0.1, 0.3, 0.05]))
    locked = disturbed.with_parameters(*(disturbed[name].changed(locked=True) for name in ("base", "gain")))
    result = kf.calibrate(sensor, {**inputs, "charge_true": target}, locked, target="charge_true")
    np.testing.assert_allclose(result.parameters["shift"].values, true["shift"].values, atol=1e-8)


def vehicle_by_hand(accelerator, wind, road, pedal, dt):
    slope = brake = velocity = engine = air = speed = 0.0
    hold = edge = False
    previous = True
    result = []
    for acc, blow, grade, foot in zip(accelerator, wind, road, pedal, strict=True):
        if foot < 0.05:
            hold = False
        if edge and acc <= 0.01:
            hold = True
        moving = max(min(speed + ((engine - air - brake) / 1700.0 + slope) * dt, 100.0), -100.0)
        speed = 0.0 if hold else moving
        steep = 0.0 if abs(grade) <= 0.0001 else 32.0 / ((1.0 / grade) * (1.0 / grade) + 1.0)
        slope = np.sqrt(steep) * 9.81 * (1.0 if grade < 0.0 else -1.0)
        crosses = velocity * velocity <= 0.0
        sign = 0.0 if crosses else (-1.0 if velocity < 0.0 else 1.0)
        brake = np.interp(foot, [0.0, 0.1, 0.5, 1.0], [0.0, 18000.0, 80.0e3, 100.0e3]) * sign
        edge, previous = crosses and not previous, crosses
        engine = np.interp(acc, [0.0, 0.2, 0.5, 0.8, 1.0], [0.0, 1500.0, 12000.0, 18600.0, 19000.0])
        moved = blow + velocity
        air = moved * moved * 1.45 * (-1.0 if moved < 0.0 else 1.0)
        velocity = speed
        result.append(velocity)
    return np.array(result)


def test_the_vehicle_simulates_like_numpy(tmp_path):
    write_project(tmp_path, {"Car/Car/Vehicle.esdl": VEHICLE})
    model = esdl(tmp_path / "Car/Car/Vehicle.esdl")
    random = np.random.default_rng(3)
    stretches = 20
    columns = {
        "accelerator": np.repeat(random.uniform(0, 1, stretches) * (random.uniform(0, 1, stretches) > 0.4), 25),
        "wind": np.repeat(random.uniform(-10, 10, stretches), 25),
        "road": np.repeat(random.choice([0.0, 0.02, -0.01, 0.00005], stretches), 25),
        "pedal": np.repeat(random.uniform(0, 1, stretches) * (random.uniform(0, 1, stretches) > 0.5), 25),
    }
    nodes = run(model, columns, dt=0.05)
    expected = vehicle_by_hand(*(columns[name] for name in ("accelerator", "wind", "road", "pedal")), 0.05)
    assert np.ptp(expected) > 10.0
    np.testing.assert_allclose(nodes["calc"], expected, rtol=1e-12, atol=1e-12)


TORQUE = """
type MapOf is table real, real -> real;
type CurveOf is table real -> real;
class Torque {
	characteristic MapOf MapOptTorque[3][2] = {
		{ 700.0, 2000.0, 5000.0 }, { 10.0, 90.0 }, { { 10.0, 90.0 }, { 20.0, 150.0 }, { 15.0, 140.0 } } };
	characteristic MapOf MapOptIgnition[2][2] = {
		{ 700.0, 5000.0 }, { 10.0, 90.0 }, { { 20.0, 10.0 }, { 35.0, 25.0 } } };
	characteristic CurveOf CurveEtaDeltaSpark[3] = { { -5.0, 5.0, 30.0 }, { 1.0, 0.97, 0.6 } };
	characteristic MapOf MapDragTorque[2][2] = { { 700.0, 5000.0 }, { 10.0, 90.0 }, { { 8.0, 9.0 }, { 20.0, 22.0 } } };
	real trqOpt; real ignOpt; real deltaSpark; real etaSpark; real product; real dragTorque;
	@get real TorquePredict;
	public void calc(real in Speed, real in Rel_Airmass, real in Ignition) {
		trqOpt = MapOptTorque.getAt(Speed, Rel_Airmass);
		ignOpt = MapOptIgnition.getAt(Speed, Rel_Airmass);
		deltaSpark = ignOpt - Ignition;
		etaSpark = CurveEtaDeltaSpark.getAt(deltaSpark);
		product = trqOpt * etaSpark;
		dragTorque = MapDragTorque.getAt(Speed, Rel_Airmass);
		TorquePredict = product - dragTorque;
	}
}
"""
FORMULA = """trqOpt = MapOptTorque(Speed,Rel_Airmass)
ignOpt = MapOptIgnition(Speed,Rel_Airmass)
deltaSpark = ignOpt - Ignition
etaSpark = CurveEtaDeltaSpark(deltaSpark)
product = trqOpt * etaSpark
dragTorque = MapDragTorque(Speed,Rel_Airmass)
TorquePredict = product - dragTorque
"""


@pytest.mark.slow
def test_the_torque_model_is_that_of_the_formula_and_calibrates_to_the_same_bits(tmp_path):
    model = class_model(tmp_path, TORQUE)
    written = kf.formula(FORMULA, parameters=model.values)
    assert model.graph == written.graph
    random = np.random.default_rng(1)
    data = {
        "Speed": random.uniform(600, 5500, 300),
        "Rel_Airmass": random.uniform(5, 95, 300),
        "Ignition": random.uniform(0, 40, 300),
    }
    scaled = [p.with_values(p.values * random.uniform(0.8, 1.2, p.values.shape)) for p in model.values.values()]
    target = kf.simulate(model, data, model.values.with_parameters(*scaled))["TorquePredict"].values
    results = [
        kf.calibrate(each, {**data, "Torque": target}, model.values, target="Torque") for each in (model, written)
    ]
    assert results[0].quality[0].rmse_after < 0.1 * results[0].quality[0].rmse_before
    for name in model.values:
        np.testing.assert_array_equal(results[0].parameters[name].values, results[1].parameters[name].values)


@pytest.mark.slow
def test_derivatives_of_the_plant_are_those_of_differences(battery):
    model = esdl(battery / "Cell/Plant.esdl")
    columns = {name: column[:20] for name, column in load_cycle().items()}
    full = {**columns, **even_clock(0.01, 20)}
    lowered = lower_lookups(model.graph, model.values)
    for name, step in (("C_heat", 1e-6), ("leak", 1e-6), ("capacity", 1e-5), ("R_inner", 1e-7)):
        line = differentiate(lowered.graph, [lowered.graph.names["voltage"]], (name,))
        exact = Interpreter(lowered, model.values).rows(line, {name: 0}, full).jacobian[:, 0, :]
        own = model.values[name]
        for at in range(own.size):
            ends = []
            for sign in (1.0, -1.0):
                values = own.values.ravel().copy()
                values[at] += sign * step
                ends.append(run(model, columns, parameters=model.values.with_parameters(own.with_values(values))))
            slope = (ends[0]["voltage"] - ends[1]["voltage"]) / (2 * step)
            np.testing.assert_allclose(exact[:, at], slope, rtol=2e-5, atol=1e-8)


def test_delta_time_is_the_step_since_the_last_run_on_uneven_time(tmp_path):
    write_project(tmp_path, BATTERY)
    model = class_model(tmp_path, """import Lib.Time.DeltaTime;
class Own {
    real before = 0.0; real after = 0.0;
    public real compute(real in u) { after = before; before = before + u * DeltaTime.deltaT; return before + after; }
}
""")  # fmt: skip
    time, u = np.cumsum(np.resize([0.4, 0.02], 30)), np.sin(np.arange(30.0))
    steps = np.concatenate([[time[1] - time[0]], np.diff(time)])
    summed = np.cumsum(u * steps)
    (output,) = model.graph.outputs
    simulated = kf.simulate(model, {"time": time, "u": u}, {})[output].values
    np.testing.assert_allclose(simulated, summed + np.concatenate([[0.0], summed[:-1]]), rtol=1e-12, atol=1e-13)
