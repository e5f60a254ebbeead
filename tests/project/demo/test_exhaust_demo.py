import tomllib
from pathlib import Path

import numpy as np
import pytest

from kennfeld import formula, read
from kennfeld.cli import run
from kennfeld.project import Project
from kennfeld.project.demo import diesel_drive, exhaust, write
from kennfeld.project.demo.diesel_drive import drive
from tests.draws import mostly_slow

SPEED = np.linspace(800.0, 4200.0, 18)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return Project.read(write("exhaust", tmp_path_factory.mktemp("exhaust")))


@pytest.fixture(scope="module")
def result(project):
    return project.calibrate()


@pytest.mark.slow
def test_the_drive_has_the_published_length_and_is_reproducible():
    data = exhaust.training()
    assert data.samples == 26_482
    assert np.allclose(np.diff(data.time), 0.1)
    again = exhaust.training()
    assert all(np.array_equal(data[name].values, again[name].values) for name in data)


def test_another_seed_is_another_drive():
    (_, speed, _), (_, other, _) = drive(3000, 0), drive(3000, 1)
    assert not np.array_equal(speed, other)


@pytest.mark.parametrize("seed", range(6))
def test_the_engine_stays_within_its_limits(seed):
    _, speed, fuel = drive(8000, seed)
    assert speed.min() > 0.9 * diesel_drive.IDLE_SPEED
    assert speed.max() < diesel_drive.TOP_SPEED - 1
    assert fuel.min() == 0.0  # overrun
    assert np.all(fuel <= 1.001 * diesel_drive.full_load(np.arange(5000.0)).max())


def test_the_drive_stands_pulls_and_coasts():
    _, speed, fuel = drive(26_482, 0)
    assert np.mean(np.abs(speed - diesel_drive.IDLE_SPEED) < 20) > 0.02
    assert np.mean((fuel == 0) & (speed > 1000)) > 0.05
    assert np.mean(fuel > 40) > 0.03
    assert np.mean(speed > 3000) > 0.03


def test_more_fuel_is_hotter_and_takes_more_air():
    fuel = np.linspace(0.0, 52.0, 40)
    for speed in SPEED:
        assert np.all(np.diff(diesel_drive.settled_temperature(np.full(40, speed), fuel)) > 0)
    pulling = fuel[fuel > 25]  # below, recirculated gas gives way
    for speed in SPEED:
        assert np.all(np.diff(diesel_drive.stroke_air(np.full(pulling.size, speed), pulling)) > 0)


def test_more_air_is_faster():
    assert np.all(np.diff(diesel_drive.lag(np.linspace(30.0, 500.0, 50))) < 0)


def test_no_grid_of_this_size_holds_the_surface_exactly():
    """The truth is no map: between the grid points it lies off the planes through them."""
    table = exhaust.start()["MapSettled"]
    x, y = (axis.breakpoints for axis in table.axes)
    middle = diesel_drive.settled_temperature((x[3] + x[4]) / 2, (y[2] + y[3]) / 2)
    corners = [diesel_drive.settled_temperature(a, b) for a in x[3:5] for b in y[2:4]]
    assert abs(middle - np.mean(corners)) > 1.0


def test_the_start_has_the_published_size_and_error(project):
    problem = project.problem()
    assert sum(problem.parameters[name].size for name in problem.free_names) == 154
    predicted = project.simulate()[0]["TemperaturePredict"].values
    error = predicted - exhaust.training()["Temperature"].values
    assert np.sqrt(np.mean(error**2)) == pytest.approx(197.57, rel=0.01)


def test_the_errors_after_are_the_noise_on_both_drives(result):
    training, test = result.quality
    assert result.converged
    assert (training.use, test.use) == ("training", "test")
    assert training.rmse_after <= 1.02 * exhaust.NOISE
    assert test.rmse_after <= 1.05 * exhaust.NOISE


def test_the_fitted_time_constants_are_those_of_the_engine(result):
    curve = result.parameters["CurveTimeConstant"]
    assert curve.values == pytest.approx(diesel_drive.lag(curve.axes[0].breakpoints), rel=0.05)


def test_the_fitted_map_is_that_of_the_engine_along_the_drive(result):
    data = exhaust.training()
    steady = diesel_drive.settled_temperature(data["Speed"].values, data["Injection"].values)
    model = formula("y = MapSettled(Speed, Injection)", parameters=list(exhaust.start()))
    assert np.sqrt(np.mean((_simulated(model, data, result.parameters) - steady) ** 2)) < 5.0


def _simulated(model, data, parameters):
    from kennfeld import simulate

    return simulate(model, data, parameters)["y"].values


@pytest.mark.parametrize("seed", mostly_slow([3, 4], 1))
def test_other_drives_give_similar_errors(seed):
    from kennfeld import calibrate

    other = calibrate(
        formula(exhaust.FORMULA, parameters=list(exhaust.start())),
        exhaust.training(seed),
        exhaust.start(),
        "Temperature",
        node="TemperaturePredict",
        test=exhaust.another(seed + 10),
        smoothness=exhaust.SMOOTHNESS,
        bounds=exhaust.BOUNDS,
    )
    assert other.quality[1].rmse_after <= 1.1 * exhaust.NOISE


def test_the_project_file_agrees_with_the_module(project):
    tables = tomllib.loads(project.path.read_text(encoding="utf-8"))["parameters"]
    assert {name: table["smoothness"] for name, table in tables.items()} == exhaust.SMOOTHNESS
    assert {name: tuple(table["bounds"]) for name, table in tables.items()} == exhaust.BOUNDS


def test_files_contain_the_data_of_the_module(project):
    data, written = exhaust.another(), read(project.path.with_name("another_drive.csv"))
    assert np.array_equal(written.time, data.time)
    for name in data:
        assert np.array_equal(written[name].values, data[name].values)
        assert written[name].unit == data[name].unit


@pytest.mark.slow
def test_the_command_runs_the_demo_and_states_the_noise(tmp_path, capsys):
    assert run(["demo", "exhaust", "--dir", str(tmp_path / "demo")]) == 0
    output = capsys.readouterr().out
    assert "3.7 degC" in output
    assert "converged" in output
    files = {path.name for path in Path(tmp_path / "demo").iterdir()}
    assert files - {".kennfeld"} == {
        "kennfeld.toml",
        "kennfeld.schema.json",
        "results",
        *exhaust.FILES,
    }  # a slow machine caches recordings


def test_the_help_names_every_demo(capsys):
    assert run(["demo", "--help"]) == 0
    output = capsys.readouterr().out
    assert "torque" in output
    assert "exhaust" in output
