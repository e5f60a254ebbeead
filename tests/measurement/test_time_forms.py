"""Forms of time in text and tables: numbers since 1970, minutes, durations, fractions apart, stamps with few digits."""

import gzip

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read

EPOCH = 1_767_225_600  # s from 1970 to 2026


def log(head, cells):
    return f"{head},rpm\n" + "".join(f"{cell},{800 + k}\n" for k, cell in enumerate(cells))


def severities(data):
    return [finding.severity for finding in data.findings]


@pytest.mark.parametrize("name", ["timestamp", "Time", "time [-]", "Zeit"])
@pytest.mark.parametrize(("digits", "unit"), [(3, "milliseconds"), (6, "microseconds"), (9, "nanoseconds")])
def test_numbers_since_1970_are_read_in_their_unit(csv, name, digits, unit):
    data = read(csv(log(name, [f"{EPOCH * 10**digits + k * 10 ** (digits - 1)}" for k in range(5)])))
    np.testing.assert_allclose(data.time - EPOCH, 0.1 * np.arange(5), atol=3e-7)
    assert f"the numbers are {unit} since 1970" in data.findings[0].message


@pytest.mark.parametrize("cells", [[EPOCH + 0.1 * k for k in range(4)], [1e12, 2e12, 3e12], [0, 1000, 2000]])
def test_other_numbers_are_seconds(csv, cells):
    assert read(csv(log("timestamp", cells))).time.tolist() == [float(cell) for cell in cells]


DISTANT = {
    "ticks of 100 ns since the year 1": [639_000_000_000_000_000 + k * 1_000_000 for k in range(4)],
    "ticks of 100 ns since 1601": [134_000_000_000_000_000 + k * 1_000_000 for k in range(4)],
    "days since 1900": [f"{46_022.5 + k * 0.1 / 86_400:.10f}" for k in range(4)],
    "days of MATLAB (datenum)": [f"{739_000.5 + k * 0.1 / 86_400:.10f}" for k in range(4)],
}


@pytest.mark.parametrize("name", DISTANT)
def test_days_and_ticks_are_read_in_their_unit(csv, name):
    data = read(csv(log("Time", DISTANT[name])))
    np.testing.assert_allclose(np.diff(data.time), 0.1, atol=3e-5)
    assert f"the numbers are {name}" in data.findings[0].message


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5, 1.0, 100.0])
def test_seconds_of_a_day_are_not_days(csv, step):
    data = read(csv(log("Time", [f"{46_022 + k * step:.6f}" for k in range(50)])))
    np.testing.assert_allclose(np.diff(data.time), step, rtol=1e-5)
    assert not data.findings


def test_seconds_that_look_like_milliseconds_since_1970_are_doubted(csv):
    data = read(csv(log("Time [s]", [EPOCH * 1000 + 100 * k for k in range(3)])))
    assert np.diff(data.time).tolist() == [100, 100]
    assert "in s as stated, but its numbers look like milliseconds since 1970" in data.findings[0].message
    assert severities(data) == ["warning"]


@pytest.mark.parametrize("head", ["t/ms", "Time, ms", "Time in ms", "Zeit / ms", "Time (milliseconds)", "Zeit [msec.]"])
def test_a_unit_behind_the_name_of_time_is_read(csv, head):
    assert read(csv(log(head, [0, 100, 200]).replace(",rpm", ";rpm").replace("0,8", "0;8"))).time.tolist() == [
        0,
        0.1,
        0.2,
    ]


@pytest.mark.parametrize(
    ("head", "cells", "reason"),
    [
        ("Time [10ms]", [0, 1, 2], "'10ms' is not a unit of time"),
        ("Time (foo)", [0, 1, 2], "its unit cannot be read from its name"),
        ("Time", [5, 5, 5], "the time does not advance"),
        ("Time", ["00:00:60", "00:01:00"], "the time does not advance"),
    ],
)
def test_numbers_that_are_not_read_as_the_time_are_reported(csv, head, cells, reason):
    data = read(csv(log(head, cells)))
    assert data.time is None
    assert f"{reason}, so the samples are steady-state points" in data.findings[0].message
    assert severities(data) == ["warning"]


def test_times_that_are_quantities_cause_no_warning(csv):
    data = read(csv("load,Injection time [ms],t [degC]\n1,2,20\n2,3,30\n3,4,40\n"))
    assert data.time is None
    assert not data.findings


def test_a_stated_unit_counts_more_than_the_size_of_the_numbers(csv):
    path = csv(log("timestamp", [EPOCH * 1000, EPOCH * 1000 + 1]))
    data = read(path, units={"timestamp": "us"})
    assert np.diff(data.time) == pytest.approx([1e-6], abs=3e-7)
    assert not data.findings


def test_numbers_since_1970_are_read_from_parquet(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    for digits, type_ in ((3, pa.int64()), (9, pa.int64()), (3, pa.float64())):
        stamps = pa.array([EPOCH * 10**digits + k * 10 ** (digits - 1) for k in range(4)], type_)
        parquet.write_table(pa.table({"timestamp": stamps, "rpm": [1.0, 2, 3, 4]}), tmp_path / "x.parquet")
        np.testing.assert_allclose(read(tmp_path / "x.parquet").time - EPOCH, 0.1 * np.arange(4), atol=3e-7)


def test_stamps_of_pandas_are_read(tmp_path):
    pandas = pytest.importorskip("pandas")
    index = pandas.date_range("2026-01-01", periods=4, freq="100ms", tz="UTC")
    for form in (index, index.tz_localize(None), index - index[0]):
        frame = pandas.DataFrame({"rpm": [800, 801, 802, 803]}, index=form)
        frame.to_csv(tmp_path / "x.csv")
        np.testing.assert_allclose(read(tmp_path / "x.csv").time, [0, 0.1, 0.2, 0.3])
        frame.to_parquet(tmp_path / "x.parquet")
        np.testing.assert_allclose(read(tmp_path / "x.parquet").time, [0, 0.1, 0.2, 0.3])


FORMS = {
    "minutes": (["00:00.0", "00:00.1", "00:10.5"], [0, 0.1, 10.5]),
    "minutes with a comma": (["59:59,9", "00:00,0", "00:00,1"], [0, 0.1, 0.2]),
    "many minutes": (["98:59.50", "99:00.50", "100:00.00"], [0, 1, 60.5]),
    "minutes, then hours": (["59:59.5", "1:00:00.5"], [0, 1]),
    "durations of pandas": (["0 days 23:59:59.5", "1 days 00:00:00", "1 days 00:00:01.25"], [0, 0.5, 1.75]),
    "negative durations": (["-1 days +23:59:59.5", "0 days 00:00:00", "0 days 00:00:01"], [0, 0.5, 1.5]),
    "durations of Python": (["1 day, 0:00:00.5", "2 days, 0:00:00.5"], [0, 86400]),
    "ISO durations": (["P0DT0H0M0.5S", "PT1.5S", "PT1M"], [0, 1, 59.5]),
    "ISO basic": (["20260101T101112.5Z", "20260101T101113Z", "20260102T101113Z"], [0, 0.5, 86400.5]),
    "ISO basic with a zone": (["20260101T101112+0100", "20260101T091113Z", "20260101T101114+01"], [0, 1, 2]),
    "one number": (["20260131235959", "20260201000000", "20260201000001.5"], [0, 1, 2.5]),
    "zone by its name": (["2026-01-01 10:11:12 UTC", "2026-01-01 10:11:13 UTC"], [0, 1]),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_time(csv, form):
    cells, seconds = FORMS[form]
    text = log("time", cells).replace(",", ";") if any("," in cell for cell in cells) else log("time", cells)
    text = text if ";" not in text else "time;rpm\n" + "".join(f"{cell};{800 + k}\n" for k, cell in enumerate(cells))
    np.testing.assert_allclose(read(csv(text)).time - read(csv(text)).time[0], seconds, atol=1e-9)


@pytest.mark.parametrize("name", ["ms", "Millisekunden", "msec"])
@pytest.mark.parametrize("head", ["Date,Time", "Datum,Uhrzeit"])
def test_milliseconds_in_a_column_of_their_own_belong_to_the_time(csv, head, name):
    rows = "".join(f"01.02.2026,10:00:{59 + k // 4 - 1:02d},{250 * (k % 4)},{k}\n" for k in range(8))
    data = read(csv(f"{head},{name},rpm\n{rows}"), ["rpm"])
    np.testing.assert_allclose(np.diff(data.time), 0.25)
    assert severities(data) == ["remark"]


def test_an_unreadable_time_is_reported(csv):
    path = csv(log("Time", ["noon", "later", "12:00"]))
    data = read(path)
    assert data.time is None
    assert "line 2, column Time: 'noon' cannot be read as a time" in str(data.findings[0])
    assert data.findings[0].severity == "warning"
    assert describe(path).tables[0].findings == data.findings


@pytest.mark.parametrize("rate", [199, 200, 333, 1000, 30])
@pytest.mark.parametrize("packed", [False, True])
def test_stamps_with_few_digits_keep_their_samples(tmp_path, rate, packed):
    text = log("Time", [f"{int(100 * k / rate) / 100:.2f}" for k in range(1000)])
    path = tmp_path / "x.csv"
    path.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    data = read(path)
    assert data.samples == 1000
    np.testing.assert_allclose(data.time, np.arange(1000) / rate, atol=0.0101)
    assert np.all(np.diff(data.time) > 0)
    assert severities(data) == ([] if rate == 30 else ["remark"])


def test_equal_rows_are_left_out_and_counted(csv):
    data = read(csv("time,a\n0,1\n1,2\n1,2\n2,3\n"))
    assert data.time.tolist() == [0, 1, 2]
    assert "1 sample of 4 repeat the time stamp before with the same values, and were left out" in str(data.findings[0])


def test_a_pause_after_equal_stamps_is_not_filled(csv):
    data = read(csv("time,a\n0,1\n0.1,2\n0.1,3\n60,4\n60.1,5\n"))
    np.testing.assert_allclose(data.time, [0, 0.1, 0.15, 60, 60.1])


def test_rows_that_complete_each_other_are_one_sample_without_a_remark(csv):
    data = read(csv("time,a,b\n0,1,\n0,,5\n1,2,\n1,,6\n"))
    assert (data.time.tolist(), data["b"].values.tolist(), data.findings) == ([0, 1], [5, 6], ())


def test_a_clock_that_stands_still_is_refused(csv):
    with pytest.raises(InputError, match="time does not increase at 3 samples"):
        read(csv("time,a\n0,1\n0,2\n0,4\n1,4\n1,5\n"))


RATES = [2_000, 10_000, 1_000_000]


def exact_stamps(rate, digits, count=40):
    """Return time stamps since 1970 with so many digits behind the point of seconds, as integers."""
    return [(EPOCH * rate + k) * 10**digits // rate for k in range(count)]


def as_decimal(number, digits):
    return f"{number // 10**digits}.{number % 10**digits:0{digits}d}" if digits else str(number)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("bulk", [False, True])
@pytest.mark.parametrize(
    ("digits", "shift"), [(6, 6), (9, 9), (6, 3), (9, 6), (6, 0), (9, 0)], ids=["s", "s.9", "ms", "ms.6", "us", "ns"]
)
def test_fast_stamps_since_1970_keep_their_steps(csv, monkeypatch, rate, bulk, digits, shift):
    if bulk:
        monkeypatch.setattr("kennfeld.measurement.text.BULK", 0)
        monkeypatch.setattr("kennfeld.measurement.text._LEAST_BULK", 0)
    data = read(csv(log("timestamp", [as_decimal(stamp, shift) for stamp in exact_stamps(rate, digits)])))
    np.testing.assert_allclose(data.time, np.arange(40) / rate, rtol=1e-12)
    assert "count from the first one" in data.findings[-1].message


@pytest.mark.parametrize("rate", RATES)
def test_fast_stamps_of_tables_keep_their_steps(tmp_path, rate):
    import h5py
    import pyarrow as pa
    from pyarrow import parquet

    nanoseconds = np.array(exact_stamps(rate, 9))
    for stamps in (nanoseconds, nanoseconds.astype(np.uint64), nanoseconds // 1000, nanoseconds // 1000 / 1e6):
        parquet.write_table(pa.table({"timestamp": pa.array(stamps), "x": np.arange(40.0)}), tmp_path / "x.parquet")
        with h5py.File(tmp_path / "x.h5", "w") as file:
            file["timestamp"], file["x"] = stamps, np.arange(40.0)
        for name in ("x.parquet", "x.h5"):
            np.testing.assert_allclose(read(tmp_path / name).time, np.arange(40) / rate, rtol=1e-12)


def test_fast_stamps_of_two_rasters_count_from_one_instant(csv):
    stamps = exact_stamps(10_000, 7, 40)
    rows = [f"{as_decimal(stamps[k], 7)};{k};{as_decimal(stamps[2 * k + 3], 7)};{2 * k + 3}" for k in range(18)]
    data = read(csv("time_1;a;time_2;b\n" + "\n".join(rows) + "\n"), ["a", "b"], raster=1e-4)
    np.testing.assert_allclose(data.time, 1e-4 * np.arange(3, 18), rtol=1e-9)
    np.testing.assert_allclose([data["a"].values, data["b"].values], [np.arange(3, 18)] * 2, rtol=1e-9)


def test_slow_stamps_since_1970_stay_as_they_are(csv):
    data = read(csv(log("timestamp", [f"{EPOCH + 0.001 * k:.3f}" for k in range(9)])))
    assert data.time[0] == EPOCH
    assert not data.findings


def test_times_of_a_spreadsheet_go_on_after_24_hours(tmp_path):
    import xlsxwriter

    with xlsxwriter.Workbook(tmp_path / "x.xlsx") as book:
        sheet, form = book.add_worksheet(), book.add_format({"num_format": "mm:ss.0"})
        sheet.write_row(0, 0, ["Time", "rpm"])
        for k, seconds in enumerate([86_399.5, 86_400.5, 86_401.5, 3 * 86_400.0]):
            sheet.write_number(k + 1, 0, seconds / 86_400, form)
            sheet.write_number(k + 1, 1, 800 + k)
    data = read(tmp_path / "x.xlsx")
    np.testing.assert_allclose(data.time, [0, 1, 2, 172_800.5], atol=1e-3)
    assert data.start_time is None


def test_times_of_day_of_a_spreadsheet_continue_across_midnight(tmp_path):
    import xlsxwriter

    with xlsxwriter.Workbook(tmp_path / "x.xlsx") as book:
        sheet, form = book.add_worksheet(), book.add_format({"num_format": "hh:mm:ss"})
        sheet.write_row(0, 0, ["Time", "rpm"])
        for k, seconds in enumerate([86_398, 86_399, 0, 1]):
            sheet.write_number(k + 1, 0, seconds / 86_400, form)
            sheet.write_number(k + 1, 1, 800 + k)
    np.testing.assert_allclose(read(tmp_path / "x.xlsx").time, [0, 1, 2, 3], atol=1e-6)


@pytest.mark.parametrize(
    ("rows", "seconds"),
    [
        (["01.02.2026;23:00:00", "03.02.2026;01:00:00", "03.02.2026;01:00:01"], [0, 93_600, 93_601]),
        (["01.02.2026;10:00:00", "02.02.2026;11:00:00"], [0, 90_000]),
        (["01.02.2026;23:59:59", "02.02.2026;00:00:00"], [0, 1]),
        (["01.02.2026;23:59:59", "01.02.2026;00:00:00"], [0, 1]),
    ],
)
def test_a_date_of_its_own_places_the_time_of_day(csv, rows, seconds):
    text = "Date;Time;rpm\n" + "".join(f"{row};{800 + k}\n" for k, row in enumerate(rows))
    assert read(csv(text)).time.tolist() == seconds
    assert read(csv(text), ["rpm"]).time.tolist() == seconds


def test_dates_that_fall_while_the_day_goes_on_are_left_out_of_the_time(csv):
    data = read(csv("Date;Time;rpm\n03.02.2026;10:00:00;800\n02.02.2026;10:00:01;801\n01.02.2026;10:00:02;802\n"))
    assert data.time.tolist() == [0, 1, 2]
    (finding,) = data.findings
    assert "its dates do not go with the times of day of Time" in finding.message


@pytest.mark.parametrize(
    ("steps", "counted"), [([1, 1, 9000], True), ([1, 1, 9000, 9000], False), ([1, 3, 5, 9], True)]
)
def test_the_median_step_decides_whether_stamps_are_too_coarse(csv, steps, counted):
    # steps below 64 are too coarse for doubles near this number
    stamps = 2.0**40 + np.cumsum([0.0, *steps]) / 4096 * 64
    data = read(csv("time [s],n\n" + "".join(f"{s!r},{k}\n" for k, s in enumerate(stamps.tolist()))))
    assert any("count from the first one" in finding.message for finding in data.findings) == counted
