"""Columns that hold time, in dicts, DataFrames and datasets."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputWarning

TIME = 0.1 * np.arange(40)
STEP = np.where(np.arange(40) < 5, 0.0, 1.0)
SLOW = "y = PT1(u, T, 0)"
RESPONSE = kf.simulate(SLOW, kf.Dataset.of("step", {"u": STEP}, time=TIME), {"T": 0.7})["y"].values


def frame_of(columns):
    return frame(**columns)


def frame(index=None, **columns):
    return pytest.importorskip("pandas").DataFrame(columns, index=index)


def dates(**settings):
    return pytest.importorskip("pandas").date_range("2026-01-01", periods=40, freq="100ms", **settings)


FORMS = {
    "dict": lambda: {"time": TIME, "u": STEP, "z": RESPONSE},
    "capital": lambda: {"u": STEP, "Time": TIME, "z": RESPONSE},
    "list": lambda: {"time": TIME.tolist(), "u": STEP.tolist(), "z": RESPONSE.tolist()},
    "t": lambda: {"t": TIME, "u": STEP, "z": RESPONSE},
    "unit": lambda: {"time [ms]": 1000 * TIME, "u": STEP, "z": RESPONSE},
    "minutes": lambda: {"time_min": TIME / 60, "u": STEP, "z": RESPONSE},
    "dates": lambda: {"when": np.datetime64("2026-01-01") + (1000 * TIME).astype("m8[ms]"), "u": STEP, "z": RESPONSE},
    "differences": lambda: {"time": (1000 * TIME).astype("m8[ms]"), "u": STEP, "z": RESPONSE},
    "frame": lambda: frame(time=TIME, u=STEP, z=RESPONSE),
    "index": lambda: frame(u=STEP, z=RESPONSE, time=TIME).set_index("time"),
    "index of dates": lambda: frame(dates(), u=STEP, z=RESPONSE),
    "index with a zone": lambda: frame(dates(tz="Europe/Berlin"), u=STEP, z=RESPONSE),
    "index of differences": lambda: frame(dates() - dates()[0], u=STEP, z=RESPONSE),
    "dataset": lambda: kf.Dataset.of("step", {"time": TIME, "u": STEP, "z": RESPONSE}),
    "dataset in ms": lambda: kf.Dataset.of(
        "step", {"time": 1000 * TIME, "u": STEP, "z": RESPONSE}, units={"time": "ms"}
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_column_called_time_is_the_time_of_the_samples(form):
    data = FORMS[form]()
    with pytest.warns(kf.InputWarning, match="all 40 test samples"):
        result = kf.calibrate(SLOW, data, {"T": 0.2}, "z", test=data)
    assert result.parameters["T"].value == pytest.approx(0.7, rel=1e-6)
    simulated = kf.simulate(SLOW, data, {"T": 0.7})
    np.testing.assert_allclose(simulated.time, TIME, atol=1e-9)
    np.testing.assert_allclose(simulated["y"].values, RESPONSE, atol=1e-9)


def test_a_function_may_read_the_time_as_an_input_too():
    data = {"time": TIME, "u": STEP}
    simulation = kf.simulate("y = PT1(time, 0.0001) + 0 * u", data, {})
    np.testing.assert_allclose(simulation["y"].values, TIME, atol=1e-3)


def test_an_input_called_t_is_a_channel_unless_its_unit_is_one_of_time():
    with pytest.raises(kf.InputError, match="requires time stamps, but the data have none"):
        kf.simulate("input x\ny = PT1(x, 1)", {"t": TIME}, {}, channels={"x": "t"})
    simulation = kf.simulate("input x\ny = PT1(x, 1)", {"t": TIME, "time": TIME}, {}, channels={"x": "t"})
    np.testing.assert_allclose(simulation.time, TIME)


def test_the_time_that_a_dataset_has_counts_more_than_a_channel():
    data = kf.Dataset.of("step", {"time": 5 * TIME, "u": STEP}, time=TIME)
    np.testing.assert_array_equal(kf.simulate(SLOW, data, {"T": 0.7}).time, TIME)


def test_a_dataset_without_time_stays_so_for_a_function_without_memory():
    data = kf.Dataset.of("points", {"time": TIME, "u": STEP})
    assert kf.simulate("y = 2 * u", data, {}).time is None


def test_rows_in_any_order_are_points_for_a_function_without_memory():
    data = {"time": TIME[::-1], "u": STEP, "z": 2 * STEP}
    assert kf.calibrate("y = k * u", data, {"k": 1.0}, "z").parameters["k"].value == pytest.approx(2)


@pytest.mark.parametrize(
    ("time", "problem"),
    [
        ([0.0, 2.0, 1.0], "time does not increase at sample 3: 2 s, then 1 s"),
        ([0.0, np.nan, 1.0], "time does not increase at sample 2: 0 s, then nan s"),
        ([0.0, 1.0, 1.0], "time does not increase at sample 3: 1 s, then 1 s"),
    ],
)
def test_time_that_does_not_increase_is_reported_if_time_matters(time, problem):
    with pytest.raises(kf.InputError) as error:
        kf.simulate(SLOW, {"time": time, "u": [1, 2, 3]}, {"T": 1.0})
    remedy = "Sort the rows by time, and pass each recording as a dataset of its own."
    assert str(error.value) == f"dataset data: {problem}. {remedy}"


def test_a_missing_column_of_time_is_reported():
    with pytest.raises(kf.InputError, match="requires time stamps, but the data have none"):
        kf.simulate(SLOW, {"u": STEP}, {"T": 1.0})


def test_shifts_are_in_seconds_where_a_column_holds_the_time():
    late = {"time": TIME, "u": STEP, "z": np.concatenate([np.zeros(2), 2 * STEP[:-2]])}
    result = kf.calibrate("y = k * u", late, {"k": 1.0}, "z", shift={"u": 0.2})
    assert result.parameters["k"].value == pytest.approx(2)
    assert result.quality[0].rmse_after == pytest.approx(0, abs=1e-9)


def test_dates_other_than_the_time_are_not_channels():
    when = np.array(["2026-01-02", "2026-01-01", "2026-01-03"], dtype="M8[D]")
    assert list(kf.simulate("y = 2 * u", {"made": when, "u": [1, 2, 3]}, {})["y"].values) == [2, 4, 6]


def test_time_that_looks_like_milliseconds_is_a_warning_at_the_line_of_the_call():
    data = {"Time": 100 * np.arange(40), "u": STEP, "z": RESPONSE}
    with pytest.warns(
        kf.InputWarning, match="dataset training: the time stamps look like milliseconds: Time has"
    ) as caught:
        kf.calibrate(SLOW, data, {"T": 200.0}, "z")
    assert [warning.filename for warning in caught] == [__file__]
    with pytest.warns(kf.InputWarning, match="dataset data: the time stamps look like milliseconds"):
        kf.simulate(SLOW, data, {"T": 200.0})


def test_time_without_a_unit_is_in_seconds_where_the_length_of_a_second_does_not_matter():
    data = {"Time": 100 * np.arange(40), "u": STEP, "z": 2 * STEP}
    assert kf.calibrate("y = k * u", data, {"k": 1.0}, "z").parameters["k"].value == pytest.approx(2)


@pytest.mark.parametrize("name", ["time_ms", "time [ms]", "Zeit (ms)"])
def test_a_unit_in_the_name_needs_no_warning(name):
    data = {name: 100 * np.arange(40), "u": STEP, "z": RESPONSE}
    assert kf.calibrate(SLOW, data, {"T": 0.2}, "z").parameters["T"].value == pytest.approx(0.7, rel=1e-6)


def test_requested_dates_are_reported_as_nonnumeric():
    with pytest.raises(kf.InputError, match="channel z must be numbers, got dates"):
        kf.calibrate("y = k * u", {"u": [1, 2], "z": np.array([1, 2], dtype="M8[s]")}, {"k": 1}, "z")


def test_a_function_may_read_dates_as_the_time_in_seconds():
    simulation = kf.simulate("y = 2 * time", {"time": np.array([5, 6, 8], dtype="M8[s]")}, {})
    assert simulation["y"].values.tolist() == [0, 2, 6]


@pytest.mark.parametrize("given", ["bench.csv", np.ones((3, 2)), None])
def test_data_without_named_columns_are_refused(given):
    with pytest.raises(kf.KennfeldError, match=f"a dict or a DataFrame, got {type(given).__name__}"):
        kf.calibrate("y = k * u", given, {"k": 1}, "z")


def test_masked_samples_do_not_count():
    z = np.ma.array([3, 6, 999, 12], mask=[0, 0, 1, 0])
    result = kf.calibrate("y = k * u", {"u": [1, 2, 3, 4], "z": z}, {"k": 1}, "z")
    assert result.parameters["k"].value == pytest.approx(3)
    assert result.quality[0].samples == 3


@pytest.mark.parametrize("make", [dict, frame_of])
def test_infinite_values_of_columns_that_are_used_are_warned_of(make):
    data = make({"x": [1.0, np.inf, 3.0, 4.0], "z": [2.0, 4.0, -np.inf, 8.0], "spare": [np.inf] * 4})
    with pytest.warns(InputWarning) as caught:
        result = kf.calibrate("m = k * x", data, {"k": 1.0}, target="z")
    assert [str(one.message) for one in caught] == [
        f"dataset training, channel {name}: 1 of 4 values is infinite and treated as missing" for name in "xz"
    ]
    assert result.parameters["k"].value == pytest.approx(2)
    with pytest.warns(InputWarning) as caught:
        kf.simulate("m = k * x", data, {"k": 1.0})
    assert [str(one.message) for one in caught] == [
        "dataset data, channel x: 1 of 4 values is infinite and treated as missing",
        "dataset data: 1 of 4 samples is not simulated: x has no value at sample 2",
    ]
