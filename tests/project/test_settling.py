"""Steady-state points for a function with memory, as a project file gives them."""

import numpy as np
import pytest

from kennfeld.project.results import write

TEXT = """
input Speed[rpm]
input Load
Predict[Nm] = PT1(Gain(Speed) * Load + offset, 2.0, 0)
"""


@pytest.fixture
def points(shop):
    """Points of which the function has seen 5 s, with Gain = 1, 2, 3 and offset = 5."""
    shop.text = TEXT
    shop.bench("bench.csv")
    return shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nsettle = 20.0\naverage = 1.0\nstep = 0.1')


def test_each_point_is_held_and_scored_once(points, tmp_path):
    project = points.project
    assert project.check() == []
    result = project.calibrate()
    assert result.quality[0].samples == 6
    assert result.parameters["offset"].value == pytest.approx(5.0, rel=1e-3)
    write(result, project, tmp_path / "out")
    import pandas as pd

    simulated = pd.read_parquet(tmp_path / "out" / "simulation.parquet")
    assert len(simulated) == 6
    assert simulated["Predict"].to_numpy() == pytest.approx(simulated["Torque"].to_numpy(), rel=1e-3)


def test_the_step_of_the_model_is_the_default(points):
    points.change("\nstep = 0.1", "").change("[channels]", "step = 0.5\n[channels]")
    assert points.project.problem().training[0].count == 6 * 41
    points.change("step = 0.5\n", "")
    assert points.error() == (
        "kennfeld.toml [[dataset]] 1 (bench) step: settle requires a time step, but "
        "neither the dataset nor the model defines one. "
        "Write step = ... in s, here or in [model]."
    )


def test_the_step_of_the_dataset_takes_precedence(points):
    points.change("[channels]", "step = 0.5\n[channels]")
    assert points.project.problem().training[0].count == 6 * 201


def test_recorded_time_stamps_are_ignored(points):
    columns = {"time [s]": np.arange(4), "n [rpm]": [1000, 2000, 3000, 1500], "Load": [1, 2, 3, 4], "Torque": [5] * 4}
    points.csv("bench.csv", columns)
    data = points.project.problem().datasets[0]
    assert data.time is None
    assert points.project.simulate()[0].samples == 4


def test_the_message_names_settle_if_it_is_missing(points):
    points.change("\nsettle = 20.0\naverage = 1.0\nstep = 0.1", "")
    assert points.error().endswith(
        "Name the time channel `time`, or write settle = ... if these are steady-state points."
    )


def test_settle_is_a_finding_for_a_function_without_memory(points):
    points.text = TEXT.replace("PT1(Gain(Speed) * Load + offset, 2.0, 0)", "Gain(Speed) * Load + offset")
    assert points.warning() == (
        "kennfeld.toml [[dataset]] 1 (bench) settle: settle has no effect: the function has no states. Remove settle."
    )


def test_too_many_samples_for_the_memory_are_an_error(points):
    message = points.change("step = 0.1", "step = 1e-6").error()
    assert "6 points of 20000001 samples each are 120000006 samples, which exceeds 100000000" in message


@pytest.mark.parametrize(
    ("keys", "error"),
    [
        ("average = 1.0", "average: average requires settle. Write settle = ... in s, or remove it."),
        ("step = 0.1", "step: step requires settle."),
        ("settle = 0", "settle: must be > 0, got 0"),
        ("settle = 'long'", "settle: must be a number, got 'long'"),
        ("settle = 5\naverage = 6", "average: must be <= settle = 5 s, got 6 s. Shorten it."),
        ("settle = 5\nstep = 6", "step: must be <= settle = 5 s, got 6 s. Shorten it."),
        ("settle = 5\nraster = 0.1", "raster: raster contradicts settle, which is for steady-state points."),
        ("settle = 5\nwarmup = 1", "warmup: warmup contradicts settle"),
        ("settle = 5\nmax_gap = 1", "max_gap: max_gap contradicts settle"),
    ],
)
def test_keys_that_exclude_each_other_are_errors(shop, keys, error):
    assert error in shop.change('files = ["bench.csv"]', f'files = ["bench.csv"]\n{keys}').error()
