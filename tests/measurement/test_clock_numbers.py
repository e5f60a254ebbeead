"""Clock times written as one number, and the order of day and month in dates."""

from datetime import datetime

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import clock_numbers, read
from kennfeld.measurement.clock_numbers import seconds_of_clock
from kennfeld.measurement.stamps import is_stamp, parse_stamps
from kennfeld.measurement.table import Column


def clock(seconds):
    minutes, rest = divmod(round(seconds % 86_400, 3), 60)
    return f"{minutes // 60:02.0f}{minutes % 60:02.0f}{rest:06.3f}"


def test_clock_numbers_pass_minutes_and_midnight(csv):
    stamps = 86_340.0 + np.arange(0, 200, 0.5)
    data = read(csv("time,n\n" + "".join(f"{clock(s)},{k}\n" for k, s in enumerate(stamps))))
    np.testing.assert_allclose(data.time, stamps - stamps[0], atol=1e-6)
    assert [f.message for f in data.findings] == ["the numbers are clock times, HHMMSS, and were read as such"]


def test_a_stated_unit_needs_no_pattern(csv):
    data = read(csv("UTC [hhmmss.sss],n\n120059.5,1\n120100.0,2\n"))
    assert data.time.tolist() == [0, 0.5]


@pytest.mark.parametrize("unit", ["", " [s]"])
def test_seconds_are_not_taken_for_a_clock(csv, unit):
    stamps = np.arange(0, 300, 0.5)
    data = read(csv(f"time{unit},n\n" + "".join(f"{s},{k}\n" for k, s in enumerate(stamps))))
    np.testing.assert_array_equal(data.time, stamps)
    assert data.findings == ()


def test_numbers_beyond_one_day_are_not_read_as_a_clock():
    assert seconds_of_clock(np.array([240000.0])) is None
    assert seconds_of_clock(np.array([126000.0])) is None
    assert np.isnan(seconds_of_clock(np.array([np.nan, 100.0]))[0])


def dated(csv, *dates):
    return read(csv("Date;n\n" + "".join(f"{date} 12:00:00;{k}\n" for k, date in enumerate(dates))))


def test_a_part_above_twelve_decides_the_order(csv):
    assert dated(csv, "11/12/2026", "12/12/2026", "13/12/2026").time.tolist() == [0, 86_400, 172_800]
    assert dated(csv, "12/11/2026", "12/12/2026", "12/13/2026").time.tolist() == [0, 86_400, 172_800]


def test_a_part_above_twelve_in_a_later_block_decides_the_order(csv):
    rows = [f"{1 + k // 400:02d}/03/2026 10:{k % 400 // 60:02d}:{k % 400 % 60:02d};{k}" for k in range(6000)]
    data = read(csv("Date;n\n" + "\n".join(rows) + "\n"), ["n"])
    assert data.time[4000] == 10 * 86_400
    assert data.findings == ()


def test_increasing_time_decides_the_order(csv):
    data = dated(csv, "01/02/2026", "02/02/2026", "01/03/2026")
    assert data.time.tolist() == [0, 86_400, 28 * 86_400]
    assert data.findings == ()


def test_an_order_that_stays_open_is_reported(csv):
    data = dated(csv, "03/04/2026", "04/04/2026")
    assert data.time.tolist() == [0, 86_400]
    assert [str(f).partition(". ")[0] for f in data.findings] == [
        "bench.csv column Date: dates such as 03/04/2026 12:00:00 read either way; day/month is assumed"
    ]


def within_a_day(csv, date, header="Date"):
    return read(csv(f"{header};n\n" + "".join(f"{date} 12:00:{k:02d};{k}\n" for k in range(9))))


@pytest.mark.parametrize("date", ["03/04/2026", "3-4-2026"])
def test_the_day_of_a_recording_that_stays_open_is_reported(csv, date):
    data = within_a_day(csv, date)
    assert data.time.tolist() == list(range(9))
    assert data.start_time == datetime(2026, 4, 3, 12)
    [finding] = data.findings
    assert str(finding).startswith(f"bench.csv column Date: dates such as {date} 12:00:00 read either way; day/month")
    assert finding.severity == "warning"


@pytest.mark.parametrize(
    ("date", "header", "month", "day"),
    [
        ("13/04/2026", "Date", 4, 13),
        ("04/13/2026", "Date", 4, 13),
        ("04/04/2026", "Date", 4, 4),
        ("2026-04-03", "Date", 4, 3),
        ("03.04.2026", "Date", 4, 3),
        ("03-Apr-2026", "Date", 4, 3),
        ("03/04/2026", "Date [MM/DD/YYYY hh:mm:ss]", 3, 4),
        ("03/04/2026", "Date (dd/mm/yyyy)", 4, 3),
    ],
)
def test_a_second_fact_tells_the_day_of_a_recording(csv, date, header, month, day):
    data = within_a_day(csv, date, header)
    assert data.start_time == datetime(2026, month, day, 12)
    assert data.findings == ()


def test_a_header_tells_the_order_of_several_days(csv):
    data = read(csv("Date [mm/dd/yyyy];n\n03/04/2026 12:00:00;0\n04/04/2026 12:00:00;1\n"))
    assert data.time.tolist() == [0, 31 * 86_400]
    assert data.findings == ()


def test_data_outweigh_a_header_that_contradicts_them(csv):
    assert within_a_day(csv, "13/04/2026", "Date [mm/dd/yyyy]").start_time == datetime(2026, 4, 13, 12)


def test_dates_that_are_not_the_time_leave_nothing_open(csv):
    rows = "".join(f"2026-11-01 00:00:0{k};03/04/2026 10:00:00;{k}\n" for k in range(3))
    assert read(csv("Time;Calibrated;n\n" + rows)).findings == ()


def test_dates_as_text_in_a_workbook_are_reported_like_those_of_text_files(xlsx):
    path = xlsx(Data=[["Date", "n"], *([f"03/04/2026 12:00:0{k}", k] for k in range(3))])
    assert ["read either way" in str(finding) for finding in read(path).findings] == [True]


@pytest.mark.parametrize(
    ("cells", "step"),
    [
        (["11-Nov-2026 23:59:59.500", "12-Nov-2026 00:00:00.250"], 0.75),
        (["31-Okt-2026 23:59:59,5", "01-Nov-2026 00:00:00,0"], 0.5),
        (["5 May 2025 10:00:00", "5 May 2025 10:00:01"], 1),
        (["11/25/2026 11:59:59 AM", "11/25/2026 12:00:00 PM"], 1),
        (["11/25/2026 12:00:00 AM", "11/25/2026 1:00:00 AM"], 3600),
    ],
)
def test_names_of_months_and_halves_of_days(cells, step):
    seconds, _ = parse_stamps(cells, month_first="/" in cells[0])
    assert seconds[1] - seconds[0] == pytest.approx(step)


@pytest.mark.parametrize("cell", ["11-Xyz-2026 10:00:00", "13:00:00 PM", "32/01/2026", "11-Nov-26 10:00:00"])
def test_other_words_are_not_read_as_stamps(cell):
    assert not is_stamp(cell)


def test_gaps_among_stamps_are_missing_stamps(csv):
    with pytest.raises(InputError, match=r"line 3, column Time: the time stamp is missing"):
        read(csv("Time;n\n11-Nov-2026 10:00:00;1\n-;2\n11-Nov-2026 10:00:02;3\n"))


def test_blocks_give_the_numbers_of_the_whole(monkeypatch):
    seconds = 86_380.0 + 1.5 * np.arange(60)
    clock = seconds % 86_400
    numbers = 1e4 * (clock // 3600) + 100 * (clock % 3600 // 60) + clock % 60
    numbers[[0, 5, 6, 7, 8, 20]] = np.nan
    dates = numbers + 1e6 * np.where(seconds < 86_400, 20_261_231, 20_270_101)
    whole = [clock_numbers.seconds_of_clock(numbers), clock_numbers.seconds_of_dates(dates)]
    monkeypatch.setattr(clock_numbers, "_BLOCK", 4)
    np.testing.assert_array_equal(clock_numbers.seconds_of_clock(numbers), whole[0])
    np.testing.assert_array_equal(clock_numbers.seconds_of_dates(dates), whole[1])
    np.testing.assert_allclose(whole[0][1:5], seconds[1:5])
    assert clock_numbers.decode_clock(Column("time", "", "time", numbers)).dated
