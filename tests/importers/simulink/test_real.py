"""Public models, whole or with the reason why not; those that can be are compared with what scipy makes of them."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
from kennfeld.importers.simulink.importing import import_simulink, simulink
from kennfeld.models.formula import formula
from kennfeld.models.formula.printer import to_text
from tests.importers.simulink.simulink_runs import run, run_natively

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "simulink"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the public models in {DATA}")

IDLE = {
    "G": 0.02, "k": 1.1, "a": -0.8, "aL": -1.3, "b": 1.3, "bL": 0.7, "ap": -2.0, "bp": 300.0, "n0": 80.0, "phi": 20.0,
}  # fmt: skip
FUEL = dict.fromkeys(["AF_sensor_tol", "pump_tol", "MAF_sensor_tol", "kappa_tol", "tau_ww_tol", "fuel_inj_tol"], 1.0)
FUEL |= {"kp": 0.04, "ki": 0.14, "fault_time": 50.0, "measureTime": 1.0, "simTime": 50.0, "spec_num": 1.0}
VEHICLE = {
    "air_density": 1.2, "cw_air": 0.3, "frontal_area": 2.2, "mass_total": 1500.0, "gravity_acceleration": 9.81,
    "tire_radius": 0.3, "rot_mass_factor": 1.1, "tire_roll_resistance": 0.01, "max_acc_rel": 1.0, "road_surface": 1.0,
}  # fmt: skip


def idle(_, x, alpha, clutch):
    """The idle speed model written out: the slopes of speed, angle and manifold pressure."""
    n, _, p = x
    c = IDLE
    a, b = (c["a"], c["b"]) if clutch > 0 else (c["aL"], c["bL"])
    torque = c["G"] * c["k"] * (2 * c["phi"] + 135) / 175 * p
    return a * n + b * torque, 6 * n, c["ap"] * p + c["bp"] * alpha


def test_the_idle_speed_model_is_whole_and_lists_its_parameters():
    result = import_simulink(DATA / "idle_speed_control.slx", parameters=[IDLE])
    assert result.report.whole
    assert (result.report.supported, result.report.total) == (33, 33)
    assert set(result.model.graph.parameters) == set(IDLE)
    assert result.model.graph.outputs == ("n", "theta", "p")
    assert formula(to_text(result.model.graph)).graph == result.model.graph


@pytest.mark.parametrize("clutch", [0.0, 1.0])
def test_the_idle_speed_model_moves_as_scipy_integrates_it(clutch):
    model = simulink(DATA / "idle_speed_control.slx", parameters=[IDLE])
    t = 0.02 * np.arange(101)
    outputs = run(model, {"clutch": np.full(101, clutch), "alpha": np.full(101, 10.0)}, dt=0.02)
    start = (IDLE["n0"], 0.0, 7300.0)
    expected = scipy.integrate.solve_ivp(idle, (0, 2), start, t_eval=t, args=(10.0, clutch), rtol=1e-11, atol=1e-9).y
    for name, values in zip(("n", "theta", "p"), expected, strict=True):
        np.testing.assert_allclose(outputs[name], values, rtol=1e-6, atol=1e-6 * np.abs(values).max())


def test_the_vehicle_model_is_the_sum_of_its_resistances():
    model = simulink(DATA / "vehicle_model.slx", parameters=[{"config_vehicle": VEHICLE}])
    v, dv = np.array([0.0, 10.0, 30.0]), np.array([1.0, 0.5, -2.0])
    outputs = run(model, {"v_ms": v, "dv_mss": dv})
    c = VEHICLE
    air = c["air_density"] / 2 * c["cw_air"] * c["frontal_area"] * v**2
    inertia = c["mass_total"] * c["rot_mass_factor"] * dv
    weight = c["mass_total"] * c["gravity_acceleration"]
    kmh = 3.6 * v
    rolling = np.where(v > np.finfo(float).eps, weight * (c["tire_roll_resistance"] + 5e-7 * kmh + 2e-7 * kmh**2), 0)
    np.testing.assert_allclose(outputs["T_wheel_Nm"], (air + inertia + rolling) * c["tire_radius"], rtol=1e-12)
    np.testing.assert_allclose(outputs["rpm_wheel_1min"], v / (2 * c["tire_radius"] * np.pi) * 60, rtol=1e-12)
    assert "config_vehicle.mass_total" in model.graph.parameters


@pytest.mark.parametrize(
    ("file", "top", "ratio"),
    [
        ("fuel_control", "Air Fuel Control Model 1", "AF"),
        pytest.param("AbstractFuelControl_M1", "Model 1", "", marks=pytest.mark.slow),
    ],
)
def test_the_air_fuel_controllers_are_whole_and_settle(file, top, ratio):
    field = f"{top}/Cylinder and Exhaust/fuel system transport delay:MaximumDelay"
    result = import_simulink(DATA / f"{file}.slx", parameters=[FUEL | {field: 0.6}])
    assert result.report.whole
    assert result.report.supported == result.report.total
    assert result.model.step == 0.005
    assert formula(to_text(result.model.graph)).graph == result.model.graph
    assert any("ode15s -> ode4" in one for one in result.report.substitutions)
    samples = 900
    columns = {name: np.full(samples, 8.8 if "hrottle" in name else 1000.0) for name in result.model.graph.inputs}
    values = run_natively(result.model, columns)
    assert values["mode"][0] == 0
    assert abs(values["mu"][-1]) < 1e-3
    if ratio:
        assert values[ratio][-1] == pytest.approx(14.7, abs=0.01)


def curve(x, y):
    return {x: [0.0, 1.0, 2.0], y: [1.0, 1.0, 1.0]}


def side(x):
    """The settings of one of the ventilator's two controllers."""
    duty = {"MaxDuty": 100.0, "MinDuty": -50.0}
    return {
        "Scaling": 1.0,
        "Feedforward": {"Static": {"Freeze": -0.5, **curve(x, "Duty")}, "Dynamic": curve(x, "Duty")},
        "Proportional": {**duty, "Error": curve(x, "Gain"), x: curve(x, "Gain")},
        "Integral": {**duty, "Freeze": 0.1, "Reset": 5.0, "Error": curve(x, "Gain"), x: curve(x, "Gain")},
    }


VALVE = {"BrkPress": [0, 1, 2], "BrkDuty": [0, 1, 2], "Data": [[1.0] * 3] * 3, "DutyMax": 46.0}
VENTILATOR = {
    "LungParam": {"S1S2DR0KvKf": [50.0, 6.0, 0.5, 0.2, -0.2, 0.5]},
    "Control": {"PeeP": 5.0, "Triggered": 1.0, "Scaling": 1.0, "Flowby": 1.0, "Mode": 0.0, "VentValveP": 30.0,
                "ValveZero": 30.0, "CurrentFilter": 100.0, "Flow": side("Flow"), "Pressure": side("Pressure")},
    "Error": {key: {"MinPressure": 1.0, "MaxPressure": 2.0} for key in ("Supply", "Regulated", "Mouth", "Out")},
    "TargetProfile": {"Time": [0, 1, 2], "Pressure": [1, 2, 3], "Flow": [1, 2, 3]},
    "BreathData": {"time": [0, 1, 2], "AvgLungFlow": [0, 1, 0]},
    "InputData": {"MaskVolume": 0.3, "Stage1Volume": 0.5, "Stage2Volume": 0.5, "FiO2Target": 0.8,
                  "PReg": curve("BrkPress", "Data"), "InValve": VALVE, "OutValve": {"BrkPress": 30.0, "Data": 250.0},
                  "Regulator": {"BrkPress": 1000.0, "Data": 25.0}},
    "Mode": 1.0, "Supply": 1.0, "SupplyPress_Air": 4000.0, "SupplyPress_Oxigen": 4000.0, "Throttle_Air": 0.8,
    "Throttle_Oxigen": 1.0, "BreatFreq": 12.0,
}  # fmt: skip


@pytest.mark.slow
def test_the_ventilator_is_whole_with_library_bound_and_parameters_supplied():
    file = DATA / "VentilatorModel_v8_5.slx"
    missing = import_simulink(file, parameters=[VENTILATOR]).report
    assert not missing.undefined
    assert {one.type for one in missing.unsupported} == {"Reference"}
    result = import_simulink(file, parameters=[VENTILATOR], bind={one.path: "1.0" for one in missing.unsupported})
    assert result.report.whole
    assert result.report.supported == result.report.total == 343
    columns = {name: np.zeros(20) for name in result.model.graph.inputs}
    values = run(result.model, columns, dt=1e-3, samples=20)
    assert all(np.isfinite(values[name]).any() for name in result.model.graph.outputs)


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        pytest.param(
            "VentilatorModel_v8_5.slx", "36 more: it links to the library Simple_pneu_library", marks=pytest.mark.slow
        ),
        ("controller.slx", "it links to the library dspfdesign"),
        pytest.param("Dyn_Vol_Line.slx", "Lib_Solve_IterNRSolverJC_TMATS", marks=pytest.mark.slow),
        ("GasTurbine_Dyn_Template.mdl", "it links to the library Lib_"),
        ("Autotrans_Model.mdl", "variable TWAIT: undefined; used by ShiftLogic"),
    ],
)
def test_the_errors_of_the_other_models_name_the_obstacle(file, reason):
    with pytest.raises(InputError) as caught:
        simulink(DATA / file)
    assert any(reason in str(finding) for finding in caught.value.findings)


GEARS = {
    "downth": [0.0, 50.0], "upth": [0.0, 50.0], "downtab": np.ones((2, 4)), "uptab": np.ones((2, 4)),
    "speedratio": [0.0, 1.0], "torqueratio": [2.0, 1.0], "Kfactor": [100.0, 200.0], "nevec": [500.0, 6000.0],
    "thvec": [0.0, 100.0], "emap": np.ones((2, 2)), "Iei": 0.02, "N20": 100.0, "Rfd": 3.0, "Rw": 1.0, "Iv": 12.0,
    "Rload0": 40.0, "Rload2": 0.02, "gear_ratio": [[1.0, 2.4], [2.0, 1.5], [3.0, 1.0], [4.0, 0.7]],
}  # fmt: skip


@pytest.mark.parametrize(
    ("file", "given", "largest"),
    [
        pytest.param("controller.slx", {}, "Controller/Pressure Control/Init Input Shaping", marks=pytest.mark.slow),
        pytest.param("Dyn_Vol_Line.slx", {}, "System Model/SystemModel/Subsystem", marks=pytest.mark.slow),
        ("automatic_transmission.slx", GEARS, ""),
        ("Autotrans_Model.mdl", {}, "Transmission/TransmissionRatio"),
        pytest.param("VentilatorModel_v8_5.slx", {}, "CO2 calculation/Inspired avg", marks=pytest.mark.slow),
    ],
)
def test_each_listed_subsystem_can_be_imported_and_run(file, given, largest):
    report = inspect_simulink(DATA / file, parameters=[given])
    assert report.subsystems
    assert largest in ("", report.subsystems[0].path)
    for one in report.subsystems:
        model = simulink(DATA / file, one.path, [given])
        assert len(model.graph.outputs) >= len(one.outputs)
        outputs = run(model, {name: np.linspace(0.5, 1.5, 5) for name in model.graph.inputs}, dt=0.01, samples=5)
        assert all(outputs[name].shape == (5,) for name in model.graph.outputs)


def test_a_part_of_the_transmission_works_by_itself():
    parameters = {"thvec": [0.0, 50.0, 100.0], "nevec": [500.0, 3000.0, 6000.0], "emap": np.ones((3, 3)), "Iei": 0.02}
    model = simulink(DATA / "Autotrans_Model.mdl", "Engine", [parameters])
    assert model.graph.outputs
    assert len(model.graph.states) == 1


GEARS = {
    "thvec": [0.0, 20.0, 40.0, 60.0, 80.0, 100.0], "nevec": [0.0, 1500.0, 3000.0, 4500.0, 6000.0],
    "emap": [[150, 30, -50, -60, -80], [220, 160, 110, 60, 10], [245, 210, 170, 130, 80], [260, 250, 220, 190, 140],
             [270, 280, 260, 230, 180], [270, 290, 295, 270, 220]],
    "downth": [0.0, 40.0, 100.0], "downtab": [[0, 5, 20, 35], [0, 8, 25, 40], [0, 30, 50, 80]],
    "upth": [0.0, 50.0, 100.0], "uptab": [[10, 30, 50, 1e6], [18, 38, 60, 1e6], [40, 70, 100, 1e6]],
    "converter_data": [[0, 137, 2], [0.25, 140, 1.9], [0.5, 150, 1.6], [0.75, 170, 1.3], [0.9, 220, 1.1], [1, 600, 1]],
    "vehicledata": [3.23, 40.0, 0.02, 1.0, 12.1, 0.0], "Iei": 0.022, "TWAIT": 2.0,
}  # fmt: skip
RATIOS = [2.393, 1.450, 1.000, 0.677]


def bilinear(x, y, table):
    """A map that goes on in a straight line beyond its ends."""

    def cell(axis, at):
        index = min(max(np.searchsorted(axis, at, "right") - 1, 0), axis.size - 2)
        return index, (at - axis[index]) / (axis[index + 1] - axis[index])

    def value(u, v):
        (i, f), (j, g) = cell(x, u), cell(y, v)
        low, high = table[i, j : j + 2] * (1 - f) + table[i + 1, j : j + 2] * f
        return low + g * (high - low)

    return value


class Transmission:
    """The model of the transmission written out: speeds by Runge-Kutta, the shift logic by its states."""

    def __init__(self):
        gears_and_maps = {name: np.array(value, dtype=float) for name, value in GEARS.items()}
        gears = np.array([1.0, 2.0, 3.0, 4.0])
        self.torque = bilinear(gears_and_maps["thvec"], gears_and_maps["nevec"], gears_and_maps["emap"])
        self.limits = [
            bilinear(gears_and_maps[f"{way}th"], gears, gears_and_maps[f"{way}tab"]) for way in ("up", "down")
        ]
        slips, *columns = gears_and_maps["converter_data"].T
        self.converter = [bilinear(slips, gears[:2], np.stack([column, column], axis=1)) for column in columns]
        self.vehicle = gears_and_maps["vehicledata"]
        self.gear, self.shifting, self.ticks = 0, "steady", 0

    def slopes(self, x, throttle, brake):
        drive, drag, air, _, inertia, _ = self.vehicle
        ratio = RATIOS[self.gear - 1]
        slip = x[1] * drive * ratio / x[0]
        factor, gain = (column(slip, 0.0) for column in self.converter)
        impeller = (x[0] / factor) ** 2
        load = drag + air * self.speed(x) ** 2 + brake
        engine = (self.torque(throttle, x[0]) - impeller) / GEARS["Iei"]
        return np.array([engine, (drive * ratio * gain * impeller - np.sign(self.speed(x)) * load) / inertia])

    def speed(self, x):
        return 2 * np.pi * self.vehicle[3] * x[1] * 60 / 5280

    def shift(self, speed, throttle):
        self.ticks += 1
        if self.gear == 0:
            self.gear = 1
            return
        up, down = (limit(throttle, self.gear) for limit in self.limits)
        waited = self.ticks >= GEARS["TWAIT"]
        if self.shifting == "steady" and (speed > up or speed < down):
            self.shifting, self.ticks = ("up" if speed > up else "down"), 0
        elif self.shifting == "up" and (waited or speed < up) and speed != up:
            self.gear, self.shifting = min(self.gear + (speed >= up), 4), "steady"
        elif self.shifting == "down" and (waited or speed > down) and speed != down:
            self.gear, self.shifting = max(self.gear - (speed <= down), 1), "steady"

    def run(self, throttle, brake, step=0.01):
        x, rows = np.array([1000.0, 0.0]), []
        for at, (pedal, stop) in enumerate(zip(throttle, brake, strict=True)):
            if at % 4 == 0:
                self.shift(self.speed(x), pedal)
            rows.append([self.speed(x), x[0], self.gear])
            slopes = np.zeros((6, 2))
            for stage, weights in enumerate(scipy.integrate.RK45.A):
                slopes[stage] = self.slopes(x + step * weights[:stage] @ slopes[:stage], pedal, stop)
            x = x + step * scipy.integrate.RK45.B @ slopes
        return np.array(rows).T


@cache
def drive():
    """Throttle, brake, and how the transmission moves."""
    time = 0.01 * np.arange(1800)
    throttle = np.interp(time, [0, 4, 8, 8.1, 13, 18], [60, 60, 40, 5, 5, 95])
    brake = np.interp(time, [0, 8, 8.1, 13, 13.1, 18], [0, 0, 1900, 1900, 0, 0])
    return throttle, brake, Transmission().run(throttle, brake)


@pytest.mark.parametrize(
    ("file", "count"),
    [pytest.param("automatic_transmission.slx", 1800, marks=pytest.mark.slow), ("Autotrans_Model.mdl", 300)],
)
@pytest.mark.slow
def test_the_transmission_shifts_as_when_it_is_written_out(file, count):
    result = import_simulink(DATA / file, parameters=[GEARS])
    assert result.report.whole
    throttle, brake, expected = drive()
    moved = run_natively(result.model, {"throttle": throttle[:count], "brake": brake[:count]})
    assert set(expected[2]) == {1.0, 2.0, 3.0, 4.0}
    assert np.sum(np.diff(expected[2]) < 0) >= 2
    for name, values in zip(("speed", "RPM", "gear"), expected, strict=True):
        np.testing.assert_allclose(moved[name], values[:count], rtol=1e-9, atol=1e-9)


def chart_of_the_controller(name, columns):
    model = simulink(DATA / "controller.slx", f"Controller/{name}", step=0.1)
    return run(model, columns, dt=0.1)[model.graph.outputs[0]]


def test_the_pulse_generator_of_the_controller_follows_its_chart():
    random = np.random.default_rng(8)
    count = 400
    columns = {"BPM": np.full(count, 20.0), "IE_ratio": np.full(count, 0.5), "trigger": random.random(count) < 0.05}
    columns["enable_trigger"] = (np.arange(count) // 100) % 2
    columns["control_mode"] = np.repeat([0, 0, 1, 1, 2], count // 5)
    state, since, expected = "INSPIRATION", 0, []
    for k in range(count):
        changed = k > 0 and columns["control_mode"][k] != columns["control_mode"][k - 1]
        allowed, waited = columns["enable_trigger"][k], k - since
        new = None
        if state == "INSPIRATION":
            new = state if changed else "EXPIRATION" if waited >= 10 else "WAIT" if allowed else None
        elif state == "EXPIRATION":
            new = "INSPIRATION" if changed or waited >= 20 else None
        elif state == "WAIT":
            new = "TRIGGERED" if columns["trigger"][k] else None if allowed else "INSPIRATION"
        else:
            new = "WAIT" if waited >= 10 else None if allowed else "INSPIRATION"
        if new is not None:
            state, since = new, k
        expected.append(float(state in ("INSPIRATION", "TRIGGERED")))
    output = chart_of_the_controller("Pulse Generator", columns)
    np.testing.assert_array_equal(output, expected)
    assert 10 < np.sum(np.diff(expected) != 0) < 200


def test_the_largest_volume_of_the_controller_is_that_of_each_breath():
    random = np.random.default_rng(9)
    count = 300
    volume, wanted = random.random(count), (np.arange(count) // 70) % 2
    idle, largest, since, expected = True, 0.0, 0, []
    known = np.nan
    for k in range(count):
        if idle and wanted[k]:
            idle, largest, since = False, volume[k], k
        elif not idle and not wanted[k]:
            idle, known = True, np.nan
        elif not idle and k - since >= 20:
            known, largest, since = largest, volume[k], k
        elif not idle:
            largest = max(largest, volume[k])
        expected.append(known)
    output = chart_of_the_controller("TV Max", {"BPM": np.full(count, 30.0), "compute": wanted, "TV": volume})
    np.testing.assert_array_equal(output, expected)


def test_the_correction_of_the_controller_adds_up():
    count = 60
    largest = np.repeat([np.nan, 1.0, 1.5, 1.5, 2.0, 0.5], 10)
    on = np.ones(count)
    on[:5] = 0
    columns = {"VCV": on, "TV_max": largest, "TV_d": np.full(count, 1.2), "gain": np.full(count, 0.5)}
    expected = np.zeros(count)
    for k in (10, 20, 40, 50):
        expected[k:] += 0.5 * (1.2 - largest[k])
    np.testing.assert_allclose(chart_of_the_controller("TV Correction", columns), expected, atol=1e-12)


def test_a_chart_is_cut_and_fed_from_a_channel():
    parameters = {**GEARS, "fixed_gear": 2.0}
    model = simulink(DATA / "automatic_transmission.slx", parameters=[parameters], bind={"ShiftLogic": "gear"})
    assert "gear" in model.graph.inputs
