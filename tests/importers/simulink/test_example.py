"""The example of a Simulink project is what its drawing says, and the fit finds the values behind its recordings."""

import csv
from pathlib import Path

import numpy as np
import pytest

from kennfeld import Project, cli
from kennfeld.calfiles import read
from kennfeld.importers.simulink.importing import simulink
from kennfeld.models.formula import read as read_formula
from tests.importers.simulink.exhaust_drawing import LOADS, MAP, SPEEDS, STEP, TRUE, drive, exhaust, temperature, write
from tests.importers.simulink.simulink_runs import run

EXAMPLE = Path(__file__).parents[3] / "examples" / "simulink"
BIND = {"Sensor/Radiation": "0.15 * (t_wand - 20)"}
CHANNELS = {"Speed": "n_mot", "Load": "rl", "Ignition": "zw", "Vehicle": "v_fzg", "t_wand": "t_wand"}


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("example")
    write(folder)
    (folder / "kennfeld.toml").write_bytes((EXAMPLE / "kennfeld.toml").read_bytes())
    assert cli.run(["calibrate", str(folder / "kennfeld.toml")]) == 0
    return folder


@pytest.mark.parametrize("name", ["exhaust.mdl", "exhaust.m", "drive_1.csv", "drive_2.csv", "drive_3.csv"])
def test_the_files_are_those_that_the_drawing_writes(name, tmp_path):
    write(tmp_path)
    assert (EXAMPLE / name).read_text(encoding="utf-8") == (tmp_path / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("layout", ["mdl", "slx parts"])
def test_the_model_with_the_true_values_gives_the_true_temperature(layout, tmp_path):
    path = exhaust().write(tmp_path, layout)
    values = TRUE | {"NAxis": SPEEDS, "LoadAxis": LOADS, "MapGas": MAP}
    model = simulink(path, parameters=[values], bind=BIND, promote=["Gas/Cooling:Gain"])
    columns, count = drive(1), 200
    outputs = run(model, {name: columns[column][:count] for name, column in CHANNELS.items()}, dt=0.2)
    z = STEP / TRUE["TauSensor"]
    of_ode3 = 1 - z + z**2 / 2 - z**3 / 6  # exp(-z) as every method of order 3 with three stages has it
    np.testing.assert_allclose(outputs["T_sensor"], temperature(columns, of_ode3)[:count], rtol=1e-12)
    np.testing.assert_allclose(outputs["T_sensor"], temperature(columns)[:count], atol=1e-3)


def test_the_true_values_lie_within_what_the_fit_trusts(calibrated):
    with (calibrated / "results" / "trust.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 20 + len(TRUE)
    for row in rows:
        name = row["parameter"]
        place = [int(np.argmin(abs(axis - float(row[key])))) for key, axis in (("x", SPEEDS), ("y", LOADS)) if row[key]]
        true = MAP[tuple(place)] if place else TRUE[name]
        assert abs(float(row["value"]) - true) < 5 * float(row["deviation"])
        assert float(row["deviation"]) < 0.02 * abs(true)  # it is worth something, in the emptiest corner too


def test_the_values_come_back_through_a_calibration_file(calibrated):
    project = Project.read(calibrated / "kennfeld.toml")
    results = calibrated / "results"
    ways = [project.simulate(read(results / f"parameters.{ending}"))[0]["T_sensor"].values for ending in ("json", "m")]
    np.testing.assert_allclose(*ways, rtol=1e-12)


def test_a_part_as_text_gives_the_same_in_a_project(calibrated, capsys):
    folder = calibrated
    assert cli.run(["convert", str(folder / "exhaust.mdl"), str(folder / "gas.kf"), "--subsystem", "Gas",
                    "--parameters", str(folder / "exhaust.m")]) == 0  # fmt: skip
    rest = '[[dataset]]\nfiles = ["drive_1.csv"]\n[[criterion]]\nnode = "T_gas"\ntarget = "t_abg"\n'
    rest += '[channels]\nSpeed = "n_mot"\nLoad = "rl"\nIgnition = "zw"\nVehicle = "v_fzg"\n'
    drawn = '[model]\nfile = "exhaust.mdl"\nsubsystem = "Gas"\nparameters = "exhaust.m"\n'
    text = '[model]\nfile = "gas.kf"\n[calibration]\ninitial = "gas.json"\n'
    temperatures = []
    for name, model in (("drawn", drawn), ("text", text)):
        path = folder / f"{name}.toml"
        path.write_text(model + rest, encoding="utf-8")
        temperatures.append(Project.read(path).simulate()[0]["T_gas"].values)
    np.testing.assert_array_equal(*temperatures)


def test_a_block_is_bound_on_the_command_line_as_in_the_project(tmp_path, capsys):
    write(tmp_path)
    source, target = str(tmp_path / "exhaust.mdl"), tmp_path / "exhaust.kf"
    more = ["--parameters", str(tmp_path / "exhaust.m"), "--bind", "Sensor/Radiation = " + BIND["Sensor/Radiation"]]
    assert cli.run(["info", source, *more]) == 0
    assert "all outputs can be calibrated" in capsys.readouterr().out
    assert cli.run(["convert", source, str(target), *more]) == 0
    values = read(target.with_suffix(".json"))
    columns = {name: column[:100] for name, column in drive(1).items()}
    inputs = {name: columns[column] for name, column in CHANNELS.items()}
    drawn = simulink(source, parameters=[tmp_path / "exhaust.m"], bind=BIND)
    output = run(read_formula(target), inputs, dt=0.2, parameters=values)["T_sensor"]
    np.testing.assert_allclose(output, run(drawn, inputs, dt=0.2)["T_sensor"], rtol=1e-12)


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        ("Sensor/Radiation", "--bind Sensor/Radiation: has no formula"),
        ("Sensr/Radiation=1", "unknown block Sensr/Radiation. Did you mean Sensor/Radiation?"),
        ("Sensor/Radiation=", "is empty"),
        ("Sensor/Radiation=0.15 *", "bind Sensor/Radiation"),
    ],
)
def test_an_incomplete_binding_is_reported(binding, message, tmp_path, capsys):
    write(tmp_path)
    assert cli.run(["info", str(tmp_path / "exhaust.mdl"), "--bind", binding]) == 2
    assert message in capsys.readouterr().err
