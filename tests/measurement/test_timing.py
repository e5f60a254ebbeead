"""The time of the samples: which column it is, its unit, and what may be wrong with it."""

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.measurement import read


@pytest.mark.parametrize("name", ["time", "Time", "t", "Zeit", "timestamps", "time_s", "Time [s]", "t (sec)"])
def test_a_column_called_time_is_the_time(csv, name):
    data = read(csv(f"a,{name}\n5,0\n6,0.5\n"))
    assert data.time.tolist() == [0, 0.5]
    assert list(data) == ["a"]


@pytest.mark.parametrize(("unit", "expected"), [("ms", 0.003), ("us", 3e-6), ("µs", 3e-6), ("min", 180), ("h", 10800)])
def test_time_is_given_in_seconds(csv, unit, expected):
    assert read(csv(f"Uhr [{unit}],a\n0,5\n3,6\n")).time[1] == expected


def test_the_suffix_of_the_name_is_a_unit(csv):
    assert read(csv("time_ms,a\n0,1\n10,2\n")).time[1] == 0.01


@pytest.mark.parametrize("head", ["a", "t [°C]", "t", "dwell [ms]"])
def test_other_columns_are_not_taken_as_time(csv, head):
    assert read(csv(f"{head},b\n3,1\n2,1\n4,1\n")).time is None


def test_a_time_that_never_changes_is_a_channel(csv):
    data = read(csv("time,b\n30,1\n30,1\n30,2\n"))
    assert data.time is None
    assert "time" in data


def test_time_is_a_channel_too_where_it_is_asked_for(csv):
    data = read(csv("time [ms],a\n0,1\n10,2\n"), ["time", "a"])
    assert data["time"].values.tolist() == [0, 10]
    assert data.time.tolist() == [0, 0.01]


@pytest.mark.parametrize("head", ["t", "t [-]", "dwell [ms]"])
def test_what_only_looks_like_time_is_a_channel_where_it_is_asked_for(csv, head):
    path, name = csv(f"{head},a\n1,5\n2,6\n4,7\n"), head.split()[0]
    assert read(path).time.tolist() == [x / 1000 if name == "dwell" else x for x in (1, 2, 4)]
    data = read(path, [name, "a"])
    assert data.time is None
    assert data[name].values.tolist() == [1, 2, 4]


def test_another_column_is_the_time_where_t_is_a_channel(csv):
    data = read(csv("t,time [s],a\n1,0,5\n2,0.1,6\n"), ["t", "a"])
    assert data.time.tolist() == [0, 0.1]
    assert data["t"].values.tolist() == [1, 2]


def test_a_t_in_seconds_stays_the_time(csv):
    data = read(csv("t [s],a\n0,5\n0.1,6\n"), ["t", "a"])
    assert data.time.tolist() == [0, 0.1]
    assert data["t"].values.tolist() == [0, 0.1]


def test_stamps_of_one_instant_are_merged(csv):
    data = read(csv("time,a,b\n0,1,\n1,,5\n1.0000000000001,3,6\n2,4,7\n"))
    assert data.time.tolist() == [0, 1, 2]
    assert data["a"].values.tolist() == [1, 3, 4]
    np.testing.assert_array_equal(data["b"].values, [np.nan, 5, 7])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,1\n1,2\n0.5,3\n2,4\n", "bench.csv line 4, column time: time goes backwards, from 1 s to 0.5 s"),
        ("0,1\n,2\n2,4\n", "bench.csv line 3, column time: the time stamp is missing"),
        ("0,1\n0,2\n0,4\n1,4\n1,5\n", "time does not increase at 3 samples"),
        ("0,1\n1,2\n1e9,3\n", "bench.csv line 4, column time: raster=0.1 s would create 1e+10 samples of 3"),
    ],
)
def test_wrong_stamps_are_findings(csv, rows, message):
    with pytest.raises(InputError) as caught:
        read(csv("time,a\n" + rows), raster=0.1)
    assert message in str(caught.value)


def test_a_raster_without_time_is_a_finding(csv):
    with pytest.raises(InputError, match="requires a time column, but there is none"):
        read(csv("a,b\n1,2\n"), raster=0.1)
    with pytest.raises(InputError, match="Time holds text, such as 'noon'"):
        read(csv("Time,b\nnoon,2\n12:00:02,3\n"), raster=0.1)


@pytest.mark.parametrize("raster", [0, -1, np.nan, np.inf])
def test_an_impossible_raster_is_refused(csv, raster):
    with pytest.raises(ArgumentError, match="must be a time in s > 0"):
        read(csv("time,b\n1,2\n"), raster=raster)


@pytest.mark.parametrize(
    ("unit", "factor"), [("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("min", 60), ("h", 3600), ("s", 1)]
)
def test_the_caller_may_state_the_unit_of_the_time(csv, unit, factor):
    for head in ("Time", "Time [s]", "time_s"):
        name = head.split()[0]
        data = read(csv(f"{head},a\n0,5\n3,6\n"), units={name: unit})
        np.testing.assert_allclose(data.time, [0, 3 * factor])
        assert data.clock.name == name


@pytest.mark.parametrize("unit", ["ms", "us", "min", "h"])
def test_a_row_of_units_gives_the_unit_of_time(csv, unit):
    stated = read(csv("Time,a\n0,5\n3,6\n"), units={"Time": unit}).time
    np.testing.assert_array_equal(read(csv(f"Time,a\n{unit},-\n0,5\n3,6\n")).time, stated)


def test_a_stated_unit_makes_a_column_of_another_name_the_time(csv):
    assert read(csv("Counter,a\n0,5\n10,6\n"), units={"Counter": "ms"}).time.tolist() == [0, 0.01]


def test_the_unit_of_a_channel_may_be_stated_too(csv):
    data = read(csv("time [s],a [Nm]\n0,5\n3,6\n"), units={"a": "kNm"})
    assert (data["a"].unit, data["a"].values.tolist()) == ("kNm", [5, 6])


def test_a_unit_for_a_missing_column_is_reported(csv):
    with pytest.raises(InputError, match=r"has no column Tim. Did you mean Time\?"):
        read(csv("Time,a\n0,5\n3,6\n"), units={"Tim": "ms"})


@pytest.mark.parametrize(
    ("head", "cells", "expected"),
    [
        ("Time", (0, 10, 20), True),
        ("Time [-]", (0, 10, 20), True),
        ("Time", (0, 1000, 1500), True),
        ("Time", (0, 100.00000000000001, 300.00000000000006), True),
        ("Time", (0, 5, 10), False),
        ("Time", (0, 10.5, 20), False),
        ("Time", (0, 0.01, 0.02), False),
        ("Time [s]", (0, 10, 20), False),
        ("Time_s", (0, 10, 20), False),
        ("Time [ms]", (0, 10, 20), False),
    ],
)
def test_whole_numbers_far_apart_without_a_unit_look_like_milliseconds(csv, head, cells, expected):
    rows = "".join(f"{cell},{at}\n" for at, cell in enumerate(cells))
    assert read(csv(f"{head},a\n{rows}")).clock.in_milliseconds is expected


def test_dates_are_in_seconds(csv):
    data = read(csv("when,a\n2026-01-01 00:00:00,1\n2026-01-01 00:01:00,2\n2026-01-01 00:02:00,4\n"))
    assert data.time.tolist() == [0, 60, 120]
    assert data.clock.in_milliseconds is False


def test_a_raster_that_is_absurd_in_seconds_names_the_unit(csv):
    rows = "".join(f"{100 * at},{at % 7}\n" for at in range(2000))
    with pytest.raises(InputError) as error:
        read(csv(f"Time,a\n{rows}"), raster=0.05)
    assert 'the time stamps look like milliseconds. If they are, write [units] Time = "ms"' in str(error.value)
