"""Tables, timetables, dates, durations, strings and categories of MATLAB, in files of versions 5 and 7.3."""

import random
from contextlib import suppress

import numpy as np
import pytest

from kennfeld import read_parameters
from kennfeld.base.errors import InputError
from kennfeld.matlab.mat_nodes import MatText
from kennfeld.matlab.mat_reader import load_nodes
from kennfeld.measurement import describe, read
from tests.importers.simulink.simulink_data import Thing
from tests.measurement.matlab_objects import (
    categorical,
    datetime,
    duration,
    even_times,
    save5,
    save_objects73,
    string,
    table,
    timetable,
)

DATE = 1_767_225_600_000.0  # ms from 1970 to 2026
SPEED = {"Speed": np.array([[800.0], [810.0], [820.0]]), "Gear": np.array([[1], [2], [3]], np.uint8)}


@pytest.fixture(params=[save5, save_objects73], ids=["5", "7.3"])
def save(request, tmp_path):
    """Writes variables into a file."""
    return lambda **variables: request.param(tmp_path / "bench.mat", variables)


TIMES = {
    "durations": (duration([1.0, 1.5, 2.5]), [1, 1.5, 2.5]),
    "dates": (datetime([DATE, DATE + 100, DATE + 300]), [0, 0.1, 0.3]),
    "a rate": (even_times(duration([0.5]), rate=1000.0), [0.5, 0.501, 0.502]),
    "a step": (even_times(duration([0.0]), step=duration([0.25])), [0, 0.25, 0.5]),
    "a step from a date": (even_times(datetime([DATE]), step=duration([0.25])), [0, 0.25, 0.5]),
}


@pytest.mark.parametrize("form", TIMES)
def test_the_row_times_of_a_timetable_are_the_time(save, form):
    times, seconds = TIMES[form]
    data = read(save(run=timetable(times, SPEED, ("rpm", ""), ("engine speed", ""), ("continuous", "step"))))
    np.testing.assert_allclose(data.time, seconds, rtol=1e-12)
    assert [(c.name, c.unit, c.description) for c in data.values()] == [
        ("Speed", "rpm", "engine speed"),
        ("Gear", "", ""),
    ]
    assert data["Speed"].values.tolist() == [800, 810, 820]
    assert data["Gear"].values.tolist() == [1, 2, 3]


def test_dates_keep_their_microseconds(save):
    low = np.array([0.0, 3e-5, -4e-5])
    milliseconds = DATE + 0.1 * np.arange(3)
    data = read(save(run=timetable(datetime(milliseconds, low), SPEED)))
    expected = ((milliseconds - DATE) + low) / 1e3
    np.testing.assert_allclose(data.time, expected, rtol=0, atol=1e-12)


def test_timetables_with_dates_count_from_the_earliest_one(save):
    fast = timetable(datetime(DATE + 100 * np.arange(5.0)), {"a": np.arange(5.0)[:, None]}, rows=5)
    slow = timetable(datetime(DATE + 100 + 100 * np.arange(3.0)), {"b": 1 + np.arange(3.0)[:, None]})
    data = read(save(slow=slow, fast=fast), raster=0.1)
    np.testing.assert_allclose(data.time, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(data["a"].values, data["b"].values)


def test_steps_of_a_timetable_are_held(save):
    run = timetable(duration([0.0, 1.0, 2.0]), {"Mode": np.array([[0.0], [1.5], [3.0]])}, continuity=("step",))
    assert read(save(run=run), raster=0.5)["Mode"].values.tolist() == [0, 0, 1.5, 1.5, 3]


def test_columns_of_a_table_are_channels(save):
    columns = SPEED | {
        "Hold": duration([1.0, 2.0, 3.0]),
        "Map": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        "State": categorical(["off", "on"], [1, 2, 0]),
        "Note": string("a", "b", "c"),
    }
    data = read(save(points=table(columns, ("rpm", "", "", "bar", "", ""))))
    assert data.time is None
    assert list(data) == ["Speed", "Gear", "Hold", "Map[0]", "Map[1]", "State"]
    assert [data[name].unit for name in ("Speed", "Hold", "Map[1]")] == ["rpm", "s", "bar"]
    assert data["Hold"].values.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(data["State"].values, [1, 2, np.nan])
    assert data["State"].description == "1 = off, 2 = on"


@pytest.mark.parametrize(
    "times",
    [
        {"Date": datetime([DATE, DATE + 1e3, DATE + 2e3])},
        {"Elapsed": duration([0.0, 1.0, 2.0])},
        {"time": np.array([[0.0], [1000.0], [2000.0]])},
    ],
)
def test_a_table_with_times_is_a_recording(save, times):
    columns = times | SPEED
    units = ("ms", "", "") if "time" in times else ()
    data = read(save(run=table(columns, units)))
    np.testing.assert_allclose(data.time, [0, 1, 2])
    assert list(data) == ["Speed", "Gear"]


@pytest.mark.parametrize("times", [duration([0.0, 0.5, 1.0]), datetime([DATE, DATE + 500, DATE + 1000])])
def test_vectors_beside_times_are_channels(save, times):
    data = read(save(time=times, Speed=SPEED["Speed"]))
    np.testing.assert_allclose(data.time, [0, 0.5, 1])
    assert data["Speed"].values.tolist() == [800, 810, 820]


def test_strings_are_texts(save):
    path = save(name=string("Größe 😀"), units=string("rpm", "", "Nm"))
    variables = load_nodes(path.read_bytes()).whole().variables
    assert variables["name"] == MatText("Größe 😀")
    assert [cell.text for cell in variables["units"].cells] == ["rpm", "", "Nm"]


def test_a_unit_may_be_a_string(save):
    path = save(Speed={"Data": SPEED["Speed"], "Time": np.array([[0.0], [1.0], [2.0]]), "Units": string("rpm")})
    assert read(path)["Speed"].unit == "rpm"


def test_a_recording_is_not_a_calibration(save):
    path = save(run=timetable(duration([0.0, 1.0, 2.0]), SPEED))
    with pytest.raises(InputError, match="recorded samples"):
        read_parameters(path)
    assert describe(path).tables[0].channels[1].name == "Speed"


def test_variables_for_matlab_alone_are_listed(save):
    calendar = Thing("calendarDuration", {"components": {"months": 1.0, "days": 0.0, "millis": 0.0}, "fmt": "ymdt"})
    path = save(run=timetable(even_times(datetime([DATE]), step=calendar), SPEED), x=np.arange(3.0)[:, None])
    assert "run (timetable)" in describe(path).tables[0].details["only for MATLAB"]
    with pytest.raises(InputError, match=r"only MATLAB can read its variables: t \(timeseries\)"):
        read(save(t=Thing("timeseries", {"Data_": np.arange(3.0)})))


def test_damaged_objects_are_reported(tmp_path):
    columns = SPEED | {"Note": string("a", "b", "c"), "State": categorical(["off"], [1, 1, 1])}
    whole = save5(tmp_path / "x.mat", {"run": timetable(datetime([DATE, DATE + 1, DATE + 2]), columns)}).read_bytes()
    rng = random.Random(5)
    for _ in range(100):
        damaged = bytearray(whole)
        for _ in range(3):
            damaged[rng.randrange(128, len(damaged))] = rng.randrange(256)
        (tmp_path / "x.mat").write_bytes(damaged)
        with suppress(InputError):
            assert read(tmp_path / "x.mat").samples <= 3
