"""Logs of CAN frames as Vector, PEAK and candump write them."""

import base64
import gzip
import logging
import re
import sys
from contextlib import suppress

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.files.can_csv_columns import can_csv_separator
from kennfeld.measurement import describe, read
from tests.measurement.bus_files import DBC, Frame, drive, eec1, engine, write_log, write_mf4

ENDINGS = (".asc", ".blf", ".log", ".trc")
FRAMES = sorted([*drive(), *(Frame(0.013 * k, 0x0CF00400, eec1(800 + k, 10), True, 2) for k in range(9))])


@pytest.fixture(autouse=True)
def _library():
    pytest.importorskip("can")


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "engine.dbc"
    path.write_text(DBC)
    return path


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_log_has_the_channels_of_an_mdf_log(tmp_path, database, ending):
    expected = read(write_mf4(tmp_path / "drive.mf4", FRAMES), raster=0.02, dbc=database)
    data = read(write_log(tmp_path / f"drive{ending}", FRAMES), raster=0.02, dbc=database)
    assert {channel.name for channel in data.channels} == {channel.name for channel in expected.channels}
    for channel in expected.channels:
        assert np.allclose(data[channel.name].values, channel.values, atol=0.1)  # TRC has a resolution of 0.1 ms


@pytest.mark.parametrize("ending", ENDINGS)
def test_channels_of_the_logger_count_from_one(tmp_path, database, ending):
    path = write_log(tmp_path / f"drive{ending}", FRAMES)
    bus = 1 if ending == ".log" else 2  # candump has names of interfaces, all "vcan0" here
    if ending == ".log":
        path.write_text(path.read_text().replace(" 1 ", " can1 ").replace(" 0 ", " can0 "))
        bus = 2
    assert read(path, ["EngineSpeed"], dbc=f"{database}@{bus}").samples == 9


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_log_without_a_database_is_named(tmp_path, ending):
    path = write_log(tmp_path / f"drive{ending}", FRAMES)
    for work in (read, describe):
        with pytest.raises(InputError, match=r"this is a bus log: it holds 39 CAN frames of 3 identifiers"):
            work(path)


def test_frames_of_can_fd_are_read(tmp_path):
    database = tmp_path / "fd.dbc"
    database.write_text('BO_ 600 Long: 64 X\n SG_ Far : 480|16@1+ (1,0) [0|0] "" X\n')
    frames = [Frame(0.1 * k, 600, bytes(60) + bytes([k, 1, 0, 0])) for k in range(3)]
    for ending in (".asc", ".blf"):
        data = read(write_log(tmp_path / f"fd{ending}", frames), ["Far"], dbc=database)
        assert data["Far"].values.tolist() == [256.0, 257.0, 258.0]


@pytest.mark.parametrize("ending", [".asc", ".blf"])
def test_a_compressed_log_is_read(tmp_path, database, ending):
    path = tmp_path / f"drive{ending}.gz"
    path.write_bytes(gzip.compress(write_log(tmp_path / f"drive{ending}", FRAMES).read_bytes()))
    assert read(path, ["Temp"], dbc=database).samples == 20


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ending", [".asc", ".log", ".trc"])
def test_a_log_cut_off_within_a_line_is_reported(tmp_path, database, ending, compressed):
    content = write_log(tmp_path / f"drive{ending}", FRAMES).read_bytes()
    for size, is_cut in ((len(content), False), (content.rstrip().rindex(b"\n") + 12, True)):
        path = tmp_path / (f"part{ending}.gz" if compressed else f"part{ending}")
        path.write_bytes(gzip.compress(content[:size]) if compressed else content[:size])
        messages = [str(finding) for table in describe(path, database).tables for finding in table.findings]
        assert any("cut off" in message or "1 line cannot be read" in message for message in messages) == is_cut


@pytest.mark.parametrize("count", [15, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_log_cut_off_anywhere_ends_in_data_or_findings(tmp_path, database, ending, count):
    content = write_log(tmp_path / f"drive{ending}", FRAMES).read_bytes()
    path = tmp_path / f"cut{ending}"
    for end in range(0, len(content), max(len(content) // count, 1)):
        path.write_bytes(content[:end])
        with suppress(InputError):
            describe(path, database)


def test_a_damaged_line_is_skipped_with_a_warning(tmp_path, database):
    lines = write_log(tmp_path / "drive.asc", FRAMES).read_text().splitlines()
    lines[20] = lines[20].replace(" d ", " d x")
    (tmp_path / "drive.asc").write_text("\n".join(lines))
    data = read(tmp_path / "drive.asc", ["Temp"], dbc=database)
    assert data.samples >= 18
    assert "drive.asc: 1 line cannot be read, the first one because of" in str(data.findings[0])
    assert "the other frames are read" in str(data.findings[0])


def test_a_missing_library_is_named_with_the_command(tmp_path, database, monkeypatch):
    path = write_log(tmp_path / "drive.asc", FRAMES)
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(InputError, match=r'the package can is not installed. Run: pip install "kennfeld\[bus\]"'):
        read(path, dbc=database)


def test_blf_needs_no_library(tmp_path, database, monkeypatch):
    path = write_log(tmp_path / "drive.blf", FRAMES)
    monkeypatch.setitem(sys.modules, "can", None)
    assert read(path, ["Temp"], dbc=database).samples == 20


def test_relative_time_stamps_are_summed_with_a_warning(tmp_path, database):
    frames = [" 0.010000 1  1F4             Rx   d 8 08 11 78 01 00 00 00 00"] * 3
    head = ["date Wed Jan 1 00:00:00.000 am 2020", "base hex  timestamps relative", "internal events logged"]
    (tmp_path / "drive.asc").write_text("\n".join([*head, *frames, ""]))
    data = read(tmp_path / "drive.asc", ["Temp"], dbc=database)
    assert np.allclose(data.time, [0.01, 0.02, 0.03])
    assert "each time stamp counts from the event before" in str(data.findings[0])


def test_identifiers_that_no_frame_can_have_are_damage(tmp_path, database):
    lines = write_log(tmp_path / "drive.asc", FRAMES).read_text().splitlines()
    lines[20] = re.sub(r"^( *\S+ \d +)\S+", r"\g<1>FFFFFFFFFx", lines[20])
    (tmp_path / "drive.asc").write_text("\n".join(lines))
    assert "1 line cannot be read" in str(read(tmp_path / "drive.asc", ["Temp"], dbc=database).findings[0])


def test_times_beyond_all_numbers_are_findings(tmp_path, database):
    (tmp_path / "drive.log").write_text("(1e308) can0 1F4#0011223344556677\n(-1e308) can0 1F4#0011223344556677\n")
    with pytest.raises(InputError, match=r"^drive\.log"):
        read(tmp_path / "drive.log", ["Temp"], dbc=database)


ASC = "date Thu Sep 2 09:37:49 am 2021\n{base}{rest}" + "".join(
    f"   0.{k}00000 1  1F4             Rx   d 8 {10 + k:02d} 00 00 00 00 00 00 00\n" for k in range(1, 4)
)


@pytest.mark.parametrize(
    "rest", ["", "Begin Triggerblock\n", "no internal events logged\n", "internal events logged\n// a comment\n"]
)
@pytest.mark.parametrize("base", ["base hex  timestamps absolute\n", "base hex\n"])
@pytest.mark.parametrize("damaged", ["", "   0.050000 1  XYZ             Rx   d 1 01\n"])
def test_no_frame_of_an_asc_log_is_lost(tmp_path, database, base, rest, damaged):
    path = tmp_path / "drive.asc"
    path.write_text(ASC.format(base=base, rest=rest + damaged))
    data = read(path, dbc=database)
    np.testing.assert_allclose(data.time, [0.1, 0.2, 0.3])
    assert len(data.findings) == bool(damaged)


def test_a_log_of_one_frame_is_read(tmp_path, database):
    path = tmp_path / "drive.asc"
    path.write_text("".join(ASC.format(base="base hex  timestamps absolute\n", rest="").splitlines(True)[:3]))
    assert read(path, dbc=database).time.tolist() == [0.1]


CAN_CSV = {
    "css": (
        "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n",
        "170000000{k}.5;1;1F4;0;8;8;0;0;0;{data}\n",
    ),
    "savvycan": (
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n",
        "{k}500000,000001F4,false,Rx,1,8,{bytes}\n",
    ),
    "python-can": (
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n",
        "{k}.5,0x1f4,0,0,0,8,{base64}\n",
    ),
    "kvaser": (
        "Time,Channel,ID,Flags,DLC,D0,D1,D2,D3,D4,D5,D6,D7,Counter\n",
        "{k}.5,1,1F4,0,8,{bytes},1\n",
    ),
    "kvaser in decimal numbers": (
        "Time,Channel,ID,Flags,DLC,D0,D1,D2,D3,D4,D5,D6,D7,Counter\n",
        "{k}.5,1,500,0,8,{numbers},1\n",
    ),
    "a script": ("Time,CAN ID (hex),Payload\n", "{k}.5,0x1F4,{pairs}\n"),
    "a script with marks": ("Time [s];CAN-ID;Data\n", "{k}.5;0x1F4;0x{marks}\n"),
    "a script with columns": (
        "time,ID,Length," + ",".join(f"Byte {b}" for b in range(8)) + "\n",
        "{k}.5,1F4,8,{bytes}\n",
    ),
    "a script with bytes alone": ("time,id," + ",".join(f"B{b}" for b in range(8)) + "\n", "{k}.5,1F4,{bytes}\n"),
    "a script with decimal identifiers": ("time,ID [dec],DLC,Data\n", "{k}.5,500,8,{data}\n"),
    "a script beside python-can": ("timestamp,arbitration_id,dlc,data\n", "{k}.5,0x1f4,8,{data}\n"),
    "asammdf": (
        "timestamps,"
        + ",".join(
            f"CAN_DataFrame.CAN_DataFrame.{name}"
            for name in ("BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes")
        )
        + "\n",
        "{k}.5,1,500,0,8,8,[{blanks} 0 0]\n",
    ),
    "asammdf with dates": (
        "timestamps;CAN_DataFrame.ID;CAN_DataFrame.DLC;CAN_DataFrame.DataLength;CAN_DataFrame.DataBytes\n",
        "2026-01-01 23:59:5{k}.500000+00:00;500;8;8;[{blanks}]\n",
    ),
    "trace of asammdf": (
        "Index,timestamps,Bus,ID,IDE,Direction,Name,Event Type,Details,ESI,EDL,BRS,DLC,Data Length,Data Bytes\n",
        "{k},{k}.5,CAN 1,500,0,Rx,Engine,CAN Frame,,,Standard CAN,,8,8,{pairs}\n",
    ),
}


@pytest.mark.parametrize("maker", CAN_CSV)
def test_logs_in_csv_are_decoded(tmp_path, database, maker):
    head, row = CAN_CSV[maker]
    path = tmp_path / "drive.csv"
    text = head
    for k in range(3):
        data = engine(1000 + k, 80)
        forms = {"data": data.hex(), "bytes": ",".join(f"{byte:02X}" for byte in data)}
        forms |= {
            "numbers": ",".join(map(str, data)),
            "blanks": " ".join(map(str, data)),
            "pairs": data.hex(" "),
            "marks": data.hex("-"),
        }
        text += row.format(k=k, base64=base64.b64encode(data).decode(), **forms)
    path.write_text(text)
    data = read(path, dbc=database)
    assert data["Speed"].values.tolist() == [1000, 1001, 1002]
    np.testing.assert_allclose(np.diff(data.time), 1.0)
    with pytest.raises(InputError, match="this is a bus log: it holds 3 CAN frames of 1 identifier"):
        read(path)
    path.write_text(text + re.sub("1F4|1f4|,500,|;500;", ",XYZ,", text.splitlines()[1]) + "\n")
    assert "1 row cannot be read as a frame, the first in line 5" in read(path, dbc=database).findings[0].message


@pytest.mark.parametrize("head", ["Vehicle ID,Length,Payload", "time,id,value", "time,B0,B1,B2,id", "time,ID,Length,x"])
def test_other_tables_are_measurements(head):
    assert can_csv_separator(head) == ""


def test_databases_that_do_not_matter_are_reported(tmp_path, database):
    path = tmp_path / "drive.csv"
    path.write_text("time,Speed\n0,1\n1,2\n")
    data = read(path, dbc=database)
    assert data["Speed"].values.tolist() == [1, 2]
    assert "is not a log of bus frames but a CSV file, so no database decodes it" in data.findings[0].message


@pytest.mark.filterwarnings("ignore:The inplace keyword")  # asammdf calls pandas so
def test_csv_exports_of_asammdf_are_decoded(tmp_path, database):
    from asammdf import MDF

    frames = [Frame(float(k), 500, engine(1000 + k, 80).ljust(64, b"\0")) for k in range(3)]
    write_mf4(tmp_path / "drive.mf4", frames)
    with MDF(tmp_path / "drive.mf4") as file:
        # Python 3.14 refuses its default, which is also the quote
        file.export("csv", tmp_path / "drive.csv", single_time_base=True, escapechar=None)
    assert "\n " in (tmp_path / "drive.csv").read_text()  # 64 bytes take several lines
    data = read(tmp_path / "drive.csv", dbc=database)
    assert data["Speed"].values.tolist() == [1000, 1001, 1002]


def test_remote_and_error_frames_of_asammdf_hold_no_signals(tmp_path, database):
    head, row = CAN_CSV["trace of asammdf"]
    rows = "".join(row.format(k=k, pairs=engine(1000 + k, 80).hex(" ")) for k in range(3))
    (tmp_path / "x.csv").write_text(head + rows + rows.replace("CAN Frame", "Error Frame"))
    assert read(tmp_path / "x.csv", dbc=database).samples == 3


def test_reading_a_log_leaves_the_loggers_of_the_library_as_they_are(tmp_path, database):
    path = write_log(tmp_path / "drive.trc", FRAMES)
    level = logging.getLogger("can").level
    assert read(path, ["EngineSpeed"], dbc=database).samples
    assert logging.getLogger("can").level == level
