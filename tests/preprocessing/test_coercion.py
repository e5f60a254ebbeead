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


def noisy():
    """A line with noise that persists over many samples, at which deviations are larger than for points."""
    rng, x = np.random.default_rng(2), np.linspace(0, 1, 400)
    noise = np.convolve(rng.standard_normal(459), np.ones(60) / 60, "valid")
    return {"x": x, "z": 2 * x + noise, "time": 0.1 * np.arange(400)}


def as_xarray(columns):
    return pytest.importorskip("xarray").Dataset({name: ("k", values) for name, values in columns.items()})


WAYS = {
    "dict": dict,
    "frame": frame_of,
    "index": lambda c: frame_of(c).set_index("time"),
    "dates": lambda c: frame(pytest.importorskip("pandas").to_datetime(c["time"], unit="s"), x=c["x"], z=c["z"]),
    "series": lambda c: dict(frame_of(c)),
    "to_frame": lambda c: kf.Dataset.of("d", c).to_frame(),
    "fields": lambda c: np.rec.fromarrays(list(c.values()), names=list(c)),
    "arrow": lambda c: pytest.importorskip("pyarrow").table(c),
    "polars": lambda c: pytest.importorskip("polars").DataFrame(c),
    "xarray": as_xarray,
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("wrapped", [False, True], ids=["as it is", "Dataset.of"])
def test_the_deviations_are_the_same_whatever_holds_the_columns(way, wrapped):
    data = WAYS[way](noisy())
    model, expected = kf.formula("y = a * x", parameters=["a"]), kf.Dataset.of("d", noisy())
    assert expected.time is not None
    result = kf.calibrate(model, kf.Dataset.of("d", data) if wrapped else data, {"a": 1.0}, "z")
    trust = kf.calibrate(model, expected, {"a": 1.0}, "z").trust
    assert trust.persistence["y"] > 10
    assert result.trust.persistence == trust.persistence
    assert result.trust.deviation["a"] == trust.deviation["a"]


def test_a_recording_of_several_pieces_comes_back_from_a_frame():
    pytest.importorskip("pandas")
    columns = {"u": STEP, "z": RESPONSE}
    data = kf.Dataset.of("drive", columns, time=np.tile(TIME[:20], 2), piece_starts=[0, 20], units={"u": "V"})
    for frame_ in (data.to_frame(), data.to_frame().reset_index()):
        back = kf.Dataset.of("back", frame_)
        assert back.piece_starts.tolist() == [0, 20]
        np.testing.assert_array_equal(back.time, data.time)
        assert back["u"].unit == "V"
        np.testing.assert_array_equal(
            kf.simulate(SLOW, frame_, {"T": 0.7})["y"].values, kf.simulate(SLOW, data, {"T": 0.7})["y"].values
        )


def test_a_column_called_t_that_the_function_reads_is_not_time_in_a_dataset_either():
    columns = {"t": TIME, "z": np.exp(-TIME)}
    results = [
        kf.calibrate("y = exp(-t / T)", data, {"T": 2.0}, "z") for data in (columns, kf.Dataset.of("d", columns))
    ]
    assert kf.Dataset.of("d", columns).time is not None
    assert results[0].trust.persistence == results[1].trust.persistence
    assert results[0].trust.deviation["T"] == results[1].trust.deviation["T"]


def test_series_with_different_indexes_are_not_joined():
    pandas = pytest.importorskip("pandas")
    data = {"u": pandas.Series([1.0, 2.0, 3.0]), "z": pandas.Series([6.0, 2.0, 4.0], index=[2, 0, 1])}
    message = "columns u and z are series with different indexes: pandas.DataFrame.data. joins them by index"
    with pytest.raises(kf.ArgumentError, match=message):
        kf.calibrate("y = k * u", data, {"k": 1.0}, "z")
    joined = kf.calibrate("y = k * u", pandas.DataFrame(data), {"k": 1.0}, "z")
    assert joined.parameters["k"].value == pytest.approx(2)


def test_a_unit_of_an_unknown_column_is_refused():
    with pytest.raises(kf.ArgumentError, match=r"units of dataset d: there is no column Sped\. Did you mean Speed\?"):
        kf.Dataset.of("d", {"Speed": [1.0]}, units={"Sped": "rpm"})


def test_columns_of_polars_keep_missing_values():
    polars = pytest.importorskip("polars")
    series = {"u": polars.Series([1, 2, None, 4]), "z": polars.Series([2.0, 4.0, 6.0, None])}
    result = kf.calibrate("y = k * u", series, {"k": 1.0}, "z")
    assert result.quality[0].samples == 2
    assert result.parameters["k"].value == pytest.approx(2)


def test_a_column_of_arrow_states_its_unit():
    pyarrow = pytest.importorskip("pyarrow")
    schema = pyarrow.schema([pyarrow.field("p", "float64", metadata={"unit": "kPa"})])
    data = kf.Dataset.of("d", pyarrow.table({"p": [1.0, None]}, schema=schema))
    assert data["p"].unit == "kPa"
    assert np.isnan(data["p"].values[1])


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


@pytest.mark.parametrize("given", ["bench.csv", np.ones((3, 2)), 3])
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
