"""Models of the public projects of ETAS, simulated like independent transcriptions in numpy.

They run if the environment variable `ASCET_PROJECTS` names a copy of the repository etas/ascet.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from kennfeld.importers.ascet.importing import esdl
from tests.importers.ascet.esdl_projects import run

PLANT = "BatteryManagementSystem/BMS/SOCClasses/BatteryPlantModel.esdl"
VEHICLE = "AdaptiveCruiseControl/ACCSystem/VehicleModel/VehicelDynamicModel/VehicleDynamicModelClass.esdl"
STEP, SAMPLES = 0.01, 5000


@pytest.fixture
def projects():
    folder = os.environ.get("ASCET_PROJECTS", "")
    if not (folder and (Path(folder) / PLANT).is_file()):
        pytest.skip("ASCET_PROJECTS does not name a copy of the repository etas/ascet")
    return Path(folder)


def bilinear(table, x, y):
    """The value of a map, clipped at its ends."""
    axes = [axis.breakpoints for axis in table.axes]
    at = [np.clip(value, axis[0], axis[-1]) for value, axis in zip((x, y), axes, strict=True)]
    cell = [min(max(int(np.searchsorted(a, v, "right")) - 1, 0), a.size - 2) for a, v in zip(axes, at, strict=True)]
    p, q = ((v - a[k]) / (a[k + 1] - a[k]) for v, a, k in zip(at, axes, cell, strict=True))
    z = table.values[cell[0] : cell[0] + 2, cell[1] : cell[1] + 2]
    return (1 - p) * ((1 - q) * z[0, 0] + q * z[0, 1]) + p * ((1 - q) * z[1, 0] + q * z[1, 1])


def test_the_battery_plant_simulates_like_numpy(projects):
    model = esdl(projects / PLANT)
    time = STEP * np.arange(SAMPLES)
    columns = {"current": 20 * np.sin(2 * time) - 3.0, "T_ambient": 290 + 25 * np.cos(0.3 * time)}
    values = {name: model.values[name].values.item() for name in model.values if model.values[name].size == 1}
    nodes, p = run(model, columns), values
    heat, load = columns["T_ambient"][0], 0.0
    for k, (current, ambient) in enumerate(zip(*columns.values(), strict=True)):
        power = -1.5 * current
        heat += (power + p["C_ThermicDampCoeff"] * (ambient - (heat / p["C_Bat"] + p["T0"]))) * STEP
        cell, charge = heat / p["C_Bat"] + p["T0"], p["P0"] + load / p["KN"]
        leak = bilinear(model.values["T_SOC_2_RV"], cell, charge) * p["R_V_0"] + p["R_V_0"]
        voltage = (p["U_0"] - current * p["R_P"]) * (leak / (p["R_P"] + leak))
        exponent = (voltage - p["UN"]) / p["K1"] + (cell - p["TN"]) * p["K2"] / (p["TN"] * cell)
        lost = np.exp(exponent) * p["I0"]
        load = np.clip(load + STEP * (current - lost) * (1 - charge / 100), -1041.325, 1458.675)
        expected = {"T_Cell": cell, "voltage": voltage, "SOC_model": p["P0"] + load / p["KN"]}
        for name, value in expected.items():
            assert nodes[name][k] == pytest.approx(value, rel=1e-12, abs=1e-12), (name, k)


def test_the_vehicle_simulates_like_numpy(projects):
    model = esdl(projects / VEHICLE, step=STEP)
    time = STEP * np.arange(SAMPLES)
    columns = {
        "CtrlVal_accel": np.clip(np.sin(0.5 * time), 0, 1),
        "WindSpeed": 4 * np.sin(0.2 * time),
        "RoadSlope": 0.03 * np.sin(0.15 * time),
        "CtrlVal_brake": np.clip(-np.sin(0.5 * time), 0, 1),
    }
    nodes, tables = run(model, columns), model.values
    scalars = {name: tables[name].values.item() for name in tables if tables[name].size == 1}

    def look_up(name, x):
        return np.interp(x, tables[name].axes[0].breakpoints, tables[name].values)

    slope = brake = engine = air = velocity = integral = 0.0
    hold, crossed, before = False, False, True  # the detector of edges: its output, and the signal of the last step
    for k, (accelerator, wind, road, pedal) in enumerate(zip(*columns.values(), strict=True)):
        hold = hold and not pedal < 0.05
        hold = hold or (crossed and accelerator <= 0.01)
        pull = (engine - air - brake) / scalars["vehicle_mass"] + slope
        integral = 0.0 if hold else integral + pull * STEP * scalars["K"]
        grade = 0.0 if abs(road) <= 1e-4 else scalars["c_SlopePlus"] / ((1 / road) ** 2 + 1)
        slope = np.sqrt(grade) * 9.81 * (1.0 if road < 0 else -1.0)
        zero = velocity * velocity <= 0.0
        brake = look_up("BrakeForceCurve_instance", pedal) * (0.0 if zero else -1.0 if velocity < 0 else 1.0)
        crossed, before = zero and not before, zero
        engine = look_up("EngineForceCurve_instance", accelerator)
        speed = wind + velocity
        air = speed * speed * scalars["A"] * scalars["cw"] * 0.5 * scalars["roh"] * (-1.0 if speed < 0 else 1.0)
        velocity = integral
        assert nodes["calc"][k] == pytest.approx(velocity, rel=1e-12, abs=1e-12), k
