"""Exports of loggers and diagnosis tools in their published layouts, and damaged variants of them."""

import contextlib
import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read


def quoted(*cells):
    return ",".join(f'"{cell}"' for cell in cells)


def lines(*parts, end="\r\n"):
    flat = [line for part in parts for line in ([part] if isinstance(part, str) else part)]
    return end.join(flat) + end


def columns(data):
    return {c.name: (c.unit, c.values[0], c.values[-1]) for c in data.values()}


AIM_PREAMBLE = [
    "Format,AiM CSV File",
    "Session,Test",
    "Vehicle,Kart",
    "Comment,",
    'Date,"Monday, May 5, 2025"',
    "Time,10:00 AM",
    "Sample Rate,20",
    "Duration,5.000",
    "Segment,Session",
    "Beacon Markers,1.500,3.000,5.000",
    "Segment Times,0:01.500,0:01.500,0:02.000",
]
AIM_ROWS = [f"{k / 20:.3f},{30 + k % 7}.5,{k % 3 - 1:.2f},{3000 + 7 * k}" for k in range(100)]
AIM_HEAD = ["Time,GPS Speed,GPS LatAcc,RPM", "s,km/h,g,rpm"]
AIM = lines(AIM_PREAMBLE, "", AIM_HEAD, "", AIM_ROWS)
OLD_AIM = lines(
    [quoted("Format", "AiM CSV File"), quoted("Venue", "Kerpen"), quoted("Beacon Markers", "1.5", "3")],
    "",
    [quoted("Time", "Distance", "RPM"), quoted("sec", "km", "rpm"), quoted("1", "2", "3"), "", ""],
    [quoted(f"{k / 20:.3f}", f"{k / 1000:.4f}", 3000 + k) for k in range(60)],
)
OLDEST_AIM = lines(
    [quoted("Format", "AIM CSV File"), quoted("Venue", "Kerpen"), quoted("Time", "10:00:00"), ""],
    2 * [quoted("Time", "Distance", "RPM", "GPS_Speed") + ","],
    [quoted("sec", "km", "rpm", "km/h") + ",", quoted("", "", "1", "2") + ",", ""],
    [f"{k / 20:.3f},{k / 1000:.6f},{3000 + k}.000,{50 + k / 10:.3f}" for k in range(60)],
    end="\n",
)
MOTEC = lines(
    '"Format","MoTeC CSV File",,,"Workbook",""',
    '"Venue","Track",,,"Worksheet",""',
    '"Device","ADL"',
    '"Log Date","05/05/2025",,,"Origin Time","0.000","s"',
    '"Sample Rate","20.000","Hz",,"End Time","5.000","s"',
    '"Range","entire outing",,,"End Distance","0","m"',
    '"Beacon Markers","1.500 3.000 "',
    ["", ""],
    quoted("Time", "Distance", "Ground Speed", "Engine RPM", "Gear"),
    quoted("s", "m", "km/h", "rpm", ""),
    ["", ""],
    [quoted(f"{k / 20:.3f}", f"{k * 1.5:.1f}", 80 + k % 9, 4000 + k, 1 + k % 5) for k in range(100)],
)


def torque_row(k):
    stamp = f"11-Nov-2026 23:59:{58 + k / 2:06.3f}" if k < 4 else f"12-Nov-2026 00:00:{(k - 4) / 2:06.3f}"
    temperature = "-" if k % 3 else 90 + k
    return f"Wed Nov 11 23:59:58 GMT+01:00 2026,{stamp},-81.99,0.5,-9.2,{800 + k},{temperature},14.7,-"


TORQUE_HEAD = (
    "GPS Time, Device Time, Longitude,GPS Speed (Meters/second), G(x),Engine RPM(rpm),"
    "Engine Coolant Temperature(°C),Air Fuel Ratio(Measured)(:1),Miles Per Gallon(Instant)(mpg)"
)
TORQUE = lines(TORQUE_HEAD, [torque_row(k) for k in range(31)], end="\n")
VBO_DATA = [
    f"012 {(235959.5 + k / 10 if k < 5 else (k - 5) / 10):010.3f} +3114.0000{k:02d} -0055.20000000 080.500 123.45 "
    f"+00100.00 +0000.10 +1.2500{k:02d}E+01"
    for k in range(30)
]
VBO = lines(
    "File created on 01/05/2025 @ 12:00:02",
    "",
    "[header]",
    ["satellites", "time", "latitude", "longitude", "velocity kmh", "heading", "height", "vertical velocity m/s"],
    ["Brake Pressure", "", "[channel units]", "bar", "", "[comments]", "Log Rate (Hz) : 10.00", ""],
    ["[laptiming]", "Start  +00060.0 +0100.0 +0060.1 +100.1 ¬ Start / Finish", ""],
    ["[column names]", "sats time lat long velocity heading height vert-vel Brake_Pressure", "", "[data]"],
    VBO_DATA,
)
VBOX_CSV = lines(
    "Satellites,Time (UTC),Latitude (Degrees),Speed (km/h),Height (m)",
    [f"12,12:00:{k / 10:05.2f},52.0,{80 + k},100.0" for k in range(30)],
)
VCDS_HEAD = [
    "Sunday,23,August,2026,10:44:27:00000-VCID:AAAA,VCDS Version: Release 25.3.2,Data version: 20250822",
    "8P0 907 115 P,,2.0l R4/4V TFSI 0010,",
    "",
]
VCDS_ROWS = [
    f"{'1' if k == 3 else ''},{k * 0.3:.2f},{800 + k},20.3,{990 + k}.0,{k * 0.3 + 0.15:.2f},{810 + k},25.0,,,,"
    for k in range(30)
]
VCDS = lines(
    VCDS_HEAD,
    ",Group A:,'115,,,,Group B:,'118,,,Group C:, Not Running",
    ",,RPM,Load,Absolute Pres.,,RPM,Temperature,,,,",
    ",TIME,,,(actual),TIME,,,TIME,,,",
    "Marker,STAMP, /min, %, mbar,STAMP, /min,°C,STAMP,,,",
    VCDS_ROWS,
)
VCDS_CHANNELS = lines(
    VCDS_HEAD[:2],
    ",,G004,F0,G008,F0,G332,F0,",
    "",
    "Marker,TIME,Loc. IDE00021,TIME,Loc. IDE00075,TIME,Loc. IDE04098,",
    ",STAMP,Engine speed,STAMP,Vehicle speed,STAMP,NOX Sensor,",
    ",, /min,, km/h,, ,",
    [
        f",{k * 0.5 + 0.42:.2f},{900 + k},{k * 0.5 + 0.44:.2f},{k},{k * 0.5 + 0.06:.2f},NOx11:65535 ppm,"
        for k in range(20)
    ],
)
HALTECH_CHANNELS = (
    ("RPM", "EngineSpeed"),
    ("Manifold Pressure", "Pressure"),
    ("Coolant Temperature", "Temperature"),
    ("Knock Level", "Decibel"),
)
HALTECH = lines(
    ["%DataLog%", "DataLogVersion : 1.1", "Software : Haltech NSP", "DownloadDateTime : 20250718 04:09:48"],
    [
        f"Channel : {name} \r\nID : {k}\r\nType : {kind}\r\nDisplayMaxMin : 20000,0"
        for k, (name, kind) in enumerate(HALTECH_CHANNELS)
    ],
    ["Log Source : 20", "Log Number : 1118", "Log : 20250718 02:15:46"],
    [f"23:59:59.{900 + 20 * k},{3000 + k},1013,3531,7" for k in range(5)],
    [f"00:00:00.{20 * k:03d},{3005 + k},980,2147483647,7" for k in range(5)],
)
ALL = {
    "aim": AIM,
    "old aim": OLD_AIM,
    "oldest aim": OLDEST_AIM,
    "motec": MOTEC,
    "torque": TORQUE,
    "vbo": VBO,
    "vbox csv": VBOX_CSV,
    "vcds": VCDS,
    "vcds channels": VCDS_CHANNELS,
    "haltech": HALTECH,
}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_race_studio_3(csv, separator):
    path = csv(AIM if separator == "," else AIM.replace(",", separator))
    data = read(path)
    assert columns(data) == {
        "GPS Speed": ("km/h", 30.5, 31.5),
        "GPS LatAcc": ("g", -1, -1),
        "RPM": ("rpm", 3000, 3693),
    }
    assert data.time[[0, -1]].tolist() == [0, 4.95]
    assert describe(path).tables[0].details["beacon markers"] == "1.500, 3.000, 5.000 s"


def test_race_studio_3_with_decimal_commas(csv):
    data = read(csv(AIM.replace(",", ";").replace(".", ",")))
    assert data["GPS Speed"].values[:3].tolist() == [30.5, 31.5, 32.5]
    assert data.time[-1] == 4.95


def test_a_row_of_column_numbers_is_not_a_sample(csv):
    data = read(csv(OLD_AIM))
    assert columns(data) == {"Distance": ("km", 0, 0.059), "RPM": ("rpm", 3000, 3059)}
    assert data.time[:2].tolist() == [0, 0.05]


def test_a_row_of_channel_numbers_below_duplicate_names_is_not_a_sample(csv):
    data = read(csv(OLDEST_AIM))
    assert columns(data) == {
        "Distance": ("km", 0, 0.059),
        "RPM": ("rpm", 3000, 3059),
        "GPS_Speed": ("km/h", 50, 55.9),
    }
    assert data.time[[0, -1]].tolist() == [0, 2.95]


def test_samples_that_count_from_one_stay(csv):
    data = read(csv("time,n,T\ns,rpm,K\n1,2,3\n2,800,300\n3,801,301\n4,802,301\n"))
    assert data["n"].values.tolist() == [2, 800, 801, 802]


def test_motec_i2(csv):
    path = csv(MOTEC)
    data = read(path)
    assert columns(data) == {
        "Distance": ("m", 0, 148.5),
        "Ground Speed": ("km/h", 80, 80),
        "Engine RPM": ("rpm", 4000, 4099),
        "Gear": ("", 1, 5),
    }
    assert data.time[-1] == 4.95
    assert describe(path).tables[0].details["beacon markers"] == "1.500, 3.000 s"


def test_a_missing_units_row_leaves_the_units_empty(csv):
    data = read(csv(AIM.replace("s,km/h,g,rpm\r\n", "")))
    assert data["RPM"].unit == ""
    assert data["RPM"].values[-1] == 3693
    assert read(csv(MOTEC.replace(quoted("s", "m", "km/h", "rpm", "") + "\r\n", "")))["Distance"].values[-1] == 148.5


def test_torque_counts_its_device_time_across_midnight(csv):
    data = read(csv(TORQUE))
    np.testing.assert_allclose(np.diff(data.time), 0.5)
    assert data["Engine RPM"].unit == "rpm"
    assert data["GPS Speed"].unit == "Meters/second"
    assert data["Air Fuel Ratio(Measured)"].unit == ":1"
    assert "G(x)" in data
    temperature = data["Engine Coolant Temperature"]
    assert temperature.unit == "°C"
    assert temperature.values[[0, 3]].tolist() == [90, 93]
    assert np.isnan(temperature.values[1])
    assert np.isnan(data["Miles Per Gallon(Instant)"].values).all()
    assert "GPS Time" not in data
    assert describe(csv(TORQUE)).tables[0].left_out == ("GPS Time",)


def test_the_time_is_read_for_selected_channels_too(csv):
    assert read(csv(TORQUE), ["Engine RPM"]).time[1] == 0.5


def test_stamps_of_whole_seconds_that_repeat_are_spread_with_a_remark(csv):
    rows = [f"-,11-Nov-2026 10:00:{k // 4:02d},-,{800 + k}" for k in range(40)]
    data = read(csv(lines("GPS Time, Device Time, Longitude,Engine RPM(rpm)", rows)))
    np.testing.assert_allclose(data.time, 0.25 * np.arange(40))
    assert "column Device Time: 30 samples of 40 repeat the time stamp before" in str(data.findings[0])


def test_repeated_dates_are_not_taken_as_time(csv):
    data = read(csv(lines("Datum;n", [f"{1 + k // 4:02d}.02.2020;{k}" for k in range(40)])))
    assert data.time is None


def test_torque_repeats_its_names_after_a_pause(csv):
    head, *rows = TORQUE.splitlines()
    data = read(csv("\n".join([head, *rows[:10], head, *rows[10:]]) + "\n"))
    assert data.time.size == 31


def test_vbo_has_degrees_and_a_clock_that_passes_midnight(csv):
    path = csv(VBO, "run.vbo", "cp1252")
    data = read(path)
    np.testing.assert_allclose(data.time, np.arange(30) / 10, atol=1e-9)
    latitude, longitude = data["latitude"], data["longitude"]
    assert (latitude.unit, latitude.values[0]) == ("deg", 3114 / 60)
    assert (longitude.unit, longitude.values[0]) == ("deg", pytest.approx(55.2 / 60))
    assert data["velocity"].unit == "km/h"
    assert data["vertical velocity"].unit == "m/s"
    assert data["Brake Pressure"].unit == "bar"
    assert data["Brake Pressure"].values[1] == 12.50001
    assert describe(path).tables[0].details == {"recorded": "01/05/2025 @ 12:00:02"}
    assert list(read(path, ["velocity"])) == ["velocity"]


def test_vbo_without_full_names_takes_the_short_ones(csv):
    end = VBO.index("[channel units]")
    data = read(csv("File created on 01/05/2025 @ 12:00\r\n[header]\r\n" + VBO[end:]))
    assert data["lat"].values[0] == 3114 / 60
    assert data["Brake_Pressure"].unit == "bar"


def test_vbo_units_that_do_not_fit_are_left_out_with_a_warning(csv):
    data = read(csv(VBO.replace("\r\nbar\r\n", "\r\nbar\r\nrpm\r\n%\r\n")))
    assert data["Brake Pressure"].unit == ""
    assert [f.message for f in data.findings] == [
        "[channel units] has 3 lines for 1 channels; their units are left out"
    ]


def test_an_invalid_vbo_clock_time_is_an_error_with_its_line(csv):
    with pytest.raises(InputError, match=r"line 29, column time: must be a time of day, HHMMSS.sss, got 236100"):
        read(csv(VBO.replace("235959.700", "236100.000")))


def test_vbo_rows_that_lack_cells_are_errors(csv):
    with pytest.raises(InputError, match=r"line 32: the row has 3 cells, the header names 9"):
        read(csv(VBO.replace(VBO_DATA[5], "012 000000.000 +3114.0")))


@pytest.mark.parametrize("end", ["[data]", "[column names]"])
def test_a_vbo_without_rows_is_reported(csv, end):
    with pytest.raises(InputError, match=r"no rows below \[data\]"):
        read(csv(VBO[: VBO.index(end) + len(end)] + "\r\n"))


def test_vbox_csv(csv):
    data = read(csv(VBOX_CSV))
    assert columns(data)["Speed"] == ("km/h", 80, 109)
    assert data["Latitude"].unit == "Degrees"
    assert data.time[-1] == 2.9


def test_vcds_groups_have_their_own_time(csv):
    path = csv(VCDS, "log.csv", "cp1252")
    with pytest.raises(InputError, match=r"different rasters: RPM every 0.3 s from 0 s, RPM \(2\) .* from 0.15 s"):
        read(path)
    data = read(path, raster=0.15)
    assert data["Absolute Pres. (actual)"].unit == "mbar"
    assert data["RPM"].unit == "/min"
    assert data["Temperature"].unit == "°C"
    start = data.time[0]
    np.testing.assert_allclose(data["RPM"].values[:3], 800 + (start + np.arange(3) * 0.15) / 0.3)
    np.testing.assert_allclose(data["RPM (2)"].values[:3], 810 + (start + np.arange(3) * 0.15 - 0.15) / 0.3)
    assert read(path, ["Load"]).time.tolist() == pytest.approx([0.3 * k for k in range(30)])


def test_vcds_channels_with_their_own_times_need_a_raster(csv):
    path = csv(VCDS_CHANNELS)
    with pytest.raises(InputError, match=r"different rasters: Engine speed every 0\.5 s from 0\.42 s, Vehicle speed"):
        read(path)
    data = read(path, raster=0.5)
    assert list(data) == ["Engine speed", "Vehicle speed"]
    np.testing.assert_allclose(data["Engine speed"].values[:2], 900 + (data.time[:2] - 0.42) / 0.5, atol=1e-9)


def test_vcds_groups_of_equal_times_are_one_recording(csv):
    rows = [",".join(["", *(f"{k / 2:.2f},{n + k}" for n in (900, 10)), ""]) for k in range(9)]
    text = lines(
        VCDS_CHANNELS.splitlines()[:4], ",TIME,Loc. IDE1,TIME,Loc. IDE2,", ",STAMP,n,STAMP,v,", ",, /min,, km/h,", rows
    )
    data = read(csv(text))
    assert list(data) == ["n", "v"]
    assert data.time.tolist() == [k / 2 for k in range(9)]


def test_vcds_channels_are_named_by_their_text_and_text_values_are_left_out(csv):
    path = csv(VCDS_CHANNELS)
    data = read(path, ["Engine speed"])
    assert (data["Engine speed"].unit, data.time[0]) == ("/min", 0.42)
    assert "NOX Sensor" in describe(path).tables[0].left_out
    with pytest.raises(InputError, match="holds text, such as 'NOx11:65535 ppm'"):
        read(path, ["NOX Sensor"])


def test_vcds_without_its_first_lines(csv):
    data = read(csv("\r\n".join(VCDS.splitlines()[3:]) + "\r\n"), ["RPM"])
    assert (data["RPM"].unit, data["RPM"].values[-1]) == ("/min", 829)


def test_vcds_without_its_units(csv):
    data = read(csv(VCDS_CHANNELS.replace(",, /min,, km/h,, ,\r\n", "")), ["Vehicle speed"])
    assert (data["Vehicle speed"].unit, data["Vehicle speed"].values[-1]) == ("", 19)


def test_haltech_scales_the_types_that_are_known(csv):
    path = csv(HALTECH)
    data = read(path)
    assert columns(data)["RPM"] == ("rpm", 3000, 3009)
    assert columns(data)["Manifold Pressure"] == ("kPa", 101.3, 98)
    assert columns(data)["Knock Level"] == ("", 7, 7)
    assert data["Coolant Temperature"].unit == "K"
    assert data["Coolant Temperature"].values[0] == 353.1
    assert np.isnan(data["Coolant Temperature"].values[-1])
    np.testing.assert_allclose(data.time, np.arange(10) * 0.02, atol=1e-9)
    assert [f.message for f in data.findings] == [
        "Knock Level: the scale of type Decibel is not known; the integers of the file are read"
    ]


@pytest.mark.parametrize(
    ("kind", "unit", "value"),
    [
        ("Raw", "", 3531),
        ("Gear", "", 3531),
        ("EngineSpeed", "rpm", 3531),
        ("Percentage", "%", 353.1),
        ("AbsPressure", "kPa", 353.1),
        ("Angle", "deg", 353.1),
        ("BatteryVoltage", "V", 3.531),
        ("Time_us", "us", 3531),
        ("Time_ms", "ms", 3531),
        ("Ratio", "", 3.531),
        ("AFR", "lambda", 3.531),
        ("Speed", "km/h", 353.1),
        ("AngularVelocity", "deg/s", 353.1),
    ],
)
def test_haltech_integers_are_scaled_by_their_type(csv, kind, unit, value):
    data = read(csv(HALTECH.replace("Type : Temperature", f"Type : {kind}")))
    assert (data["Coolant Temperature"].unit, data["Coolant Temperature"].values[0]) == (unit, value)


def test_a_haltech_log_without_rows_is_reported(csv):
    with pytest.raises(InputError, match="no rows below its channels"):
        read(csv(HALTECH[: HALTECH.index("23:59")]))


@pytest.mark.parametrize("count", [6, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ALL)
def test_a_file_cut_off_anywhere_gives_data_or_findings(csv, name, count):
    text = ALL[name].encode("utf-8")
    draw = random.Random(name)
    for cut in sorted({*range(0, 60, 14), *(draw.randrange(len(text)) for _ in range(count))}):
        path = csv(text[:cut])
        with contextlib.suppress(InputError):
            describe(path)
        with contextlib.suppress(InputError):
            read(path, raster=0.1)


@pytest.mark.parametrize("name", ["aim", "motec", "torque", "vbo", "vcds", "haltech"])
def test_a_ragged_row_is_an_error_with_its_line(csv, name):
    rows = ALL[name].splitlines()
    rows[-3] = rows[-3][: len(rows[-3]) // 3]
    with pytest.raises(InputError, match=rf"line {len(rows) - 2}"):
        read(csv("\r\n".join(rows) + "\r\n"), raster=0.1)


@pytest.mark.parametrize("name", ["aim", "motec", "vbo", "vcds", "haltech"])
def test_words_among_the_numbers_are_errors(csv, name):
    rows = ALL[name].splitlines()
    mark = " " if name == "vbo" else ","
    cells = rows[-3].split(mark)
    cells[2] = '"word"' if name == "motec" else "word"
    rows[-3] = mark.join(cells)
    with pytest.raises(InputError, match=rf"line {len(rows) - 2}, .* got 'word'"):
        read(csv("\r\n".join(rows) + "\r\n"), raster=0.1)
