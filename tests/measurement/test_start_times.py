"""The start time of a recording: the instant of time stamp 0, as far as the file states it."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from kennfeld import read
from kennfeld.measurement.cache import Cache
from kennfeld.measurement.mdf_start_time import HeaderTime
from tests.measurement.mdf_library import mdf_file, signal

TIME = 0.1 * np.arange(5)
NOON = datetime(2026, 3, 1, 12, 0, 0, 250_000)
STARTS = [NOON.replace(tzinfo=UTC), NOON.replace(tzinfo=timezone(timedelta(hours=5, minutes=30))), NOON]


def write_mdf(path, version, start, invalid=None):
    with mdf_file(version=version) as file:
        file.start_time = start
        file.append([signal(2 * TIME, TIME, name="y", invalidation_bits=invalid)], common_timebase=True)
        file.save(path, overwrite=True)


@pytest.mark.parametrize("start", STARTS, ids=["UTC", "zone", "local"])
@pytest.mark.parametrize("invalid", [None, np.arange(5) == 2], ids=["plain", "invalid samples"])
def test_mdf_4_states_it_in_its_header(tmp_path, start, invalid):
    write_mdf(tmp_path / "a.mf4", "4.10", start, invalid)
    begin = read(tmp_path / "a.mf4").start_time
    assert begin == start
    assert begin.utcoffset() == start.utcoffset()


def test_mdf_3_states_a_local_time(tmp_path):
    write_mdf(tmp_path / "a.mdf", "3.30", NOON)
    assert read(tmp_path / "a.mdf").start_time == NOON


@pytest.mark.parametrize("start", STARTS, ids=["UTC", "zone", "local"])
def test_the_header_keeps_it(start):
    begin = HeaderTime.of(start).start_time
    assert (begin, begin.utcoffset()) == (start, start.utcoffset())


def test_daylight_saving_time_belongs_to_the_offset():
    begin = HeaderTime(HeaderTime.of(STARTS[0]).nanoseconds, 60, 60, 2).start_time
    assert begin == STARTS[0]
    assert begin.utcoffset() == timedelta(hours=2)


@pytest.mark.parametrize("fields", [(0,), (10**18, 32767, 32767, 2)], ids=["none", "offset"])
def test_a_header_without_a_date_states_none(fields):
    assert HeaderTime(*fields).start_time is None


def test_a_date_before_1970_is_not_written():
    assert HeaderTime.of(datetime(1969, 12, 31)).start_time is None


def test_tdms_counts_from_the_first_waveform(tmp_path):
    properties = {"wf_increment": 0.1, "wf_start_offset": 0.0, "wf_start_time": np.datetime64(NOON)}
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([ChannelObject("g", "y", TIME, properties=properties)])
    data = read(tmp_path / "a.tdms")
    assert data.start_time == NOON.replace(tzinfo=UTC)
    np.testing.assert_allclose(data.time, TIME)


def test_tdms_counts_from_the_first_stamp_of_the_group_that_is_read(tmp_path):
    stamps = np.datetime64(NOON) + (1000 * TIME).astype("timedelta64[ms]")
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        for group, later in (("early", 0), ("late", 60)):
            channels = {"stamp": stamps + np.timedelta64(later, "s"), f"y_{group}": TIME}
            writer.write_segment([ChannelObject(group, name, values) for name, values in channels.items()])
    data = read(tmp_path / "a.tdms", ["y_late"])
    begin = data.start_time + timedelta(seconds=float(data.time[0]))
    assert begin == NOON.replace(tzinfo=UTC) + timedelta(seconds=60)


@pytest.mark.parametrize(
    ("first", "second", "start"),
    [
        ("2026-03-01 12:00:00.250", "2026-03-01 12:00:00.350", NOON),
        ("01.03.2026 12:00:00,250", "01.03.2026 12:00:00,350", NOON),
        ("2026-03-01T12:00:00.250Z", "2026-03-01T12:00:00.350Z", NOON.replace(tzinfo=UTC)),
        ("2026-03-01 12:00:00.250+05:30", "2026-03-01 12:00:00.350+05:30", STARTS[1]),
        ("12:00:00.250", "12:00:00.350", None),
        ("0.25", "0.35", None),
    ],
)
def test_text_states_it_if_it_has_dates(tmp_path, first, second, start):
    (tmp_path / "a.csv").write_text(f"time;y\n{first};1\n{second};2\n", encoding="utf-8")
    assert read(tmp_path / "a.csv").start_time == start


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_parquet_states_it_by_its_stamps(tmp_path, zone):
    import pandas

    stamps = pandas.date_range(NOON, periods=5, freq="100ms", tz=zone)
    pandas.DataFrame({"y": TIME}, index=stamps).to_parquet(tmp_path / "a.parquet")
    expected = NOON if zone is None else stamps[0].to_pydatetime()
    assert read(tmp_path / "a.parquet").start_time == expected


def test_the_cache_keeps_it(tmp_path):
    write_mdf(tmp_path / "a.mf4", "4.10", STARTS[1])
    for _ in range(2):
        cache = Cache(tmp_path / "cache")
        assert cache.read(tmp_path / "a.mf4", None, None).start_time == STARTS[1]


def test_dates_in_a_workbook_state_it(tmp_path):
    import xlsxwriter

    with xlsxwriter.Workbook(tmp_path / "a.xlsx", {"default_date_format": "yyyy-mm-dd hh:mm:ss.000"}) as book:
        sheet = book.add_worksheet()
        sheet.write_row(0, 0, ["time", "y"])
        for row in range(3):
            sheet.write_datetime(row + 1, 0, NOON.replace(microsecond=0) + timedelta(seconds=row))
            sheet.write_number(row + 1, 1, row)
    assert read(tmp_path / "a.xlsx").start_time == NOON.replace(microsecond=0)


@pytest.mark.parametrize(
    ("date", "start"),
    [
        ("Sun Mar 1 12:00:00.250 pm 2026", NOON),
        ("Sun Mar  1 12:00:00.250 2026", NOON),
        ("Son Mrz 1 12:00:00 2026", None),
    ],
)
def test_asc_states_it_in_its_first_line(tmp_path, date, start):
    lines = [
        f"date {date}",
        "base hex  timestamps absolute",
        "   0.100000 1  64              Rx   d 8 00 00 00 00 00 00 00 00",
    ]
    (tmp_path / "a.asc").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "a.dbc").write_text('BO_ 100 M: 8 X\n SG_ S : 0|8@1+ (1,0) [0|0] "" X\n', encoding="utf-8")
    assert read(tmp_path / "a.asc", dbc=tmp_path / "a.dbc").start_time == start


def test_blf_states_it_in_its_header(tmp_path):
    can = pytest.importorskip("can")
    (tmp_path / "a.dbc").write_text('BO_ 100 M: 8 X\n SG_ S : 0|8@1+ (1,0) [0|0] "" X\n', encoding="utf-8")
    with can.BLFWriter(str(tmp_path / "a.blf")) as writer:
        for number in range(3):
            writer(
                can.Message(
                    timestamp=NOON.replace(tzinfo=UTC).timestamp() + number,
                    arbitration_id=100,
                    data=bytes(8),
                    is_extended_id=False,
                )
            )
    begin = read(tmp_path / "a.blf", dbc=tmp_path / "a.dbc").start_time
    assert begin is not None
    assert abs(begin - NOON) < timedelta(days=1)  # python-can writes UTC or local time, by its version
