"""MSL text logs: information, units, markers, restarts."""

import contextlib
import gzip
import random

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies

HEAD = '"MS2Extra comms330 : MS2/Extra release 3.3.2"\n"Capture Date: Sat Dec 26 19:53:12 EST 2015"\n'
NAMES = "Time\tRPM\tAFR\tEngine\n"
UNITS = "s\trpm\tAFR\tbits\n"
ROWS = "0.000\t900\t14.7\t9\n0.066\t910\t14.6\t9\n0.133\t905\t14.5\t1\n"


@pytest.fixture
def log(csv):
    """Writes the text of a log."""
    return lambda text, encoding="utf-8": csv(text, "run.msl", encoding)


def test_names_units_and_information_are_read(log):
    path = log(HEAD + NAMES + UNITS + ROWS)
    data = read(path)
    assert data.time.tolist() == [0, 0.066, 0.133]
    assert {c.name: c.unit for c in data.values()} == {"RPM": "rpm", "AFR": "AFR", "Engine": "bits"}
    description = describe(path)
    assert description.kind == "MSL"
    assert description.tables[0].details["by"] == "MS2Extra comms330 : MS2/Extra release 3.3.2"


def test_names_in_quotes_a_single_line_of_information_and_no_units_are_read(log):
    data = read(log('"MS1"\n"Time"\t"RPM"\n0.0\t900\n0.1\t910\n'))
    assert data["RPM"].values.tolist() == [900, 910]


def test_a_decimal_comma_is_detected(log):
    assert read(log(HEAD + NAMES + UNITS + ROWS.replace(".", ","))).time.tolist() == [0, 0.066, 0.133]


def test_units_in_the_windows_encoding_are_read(log):
    data = read(log(HEAD + "Time\tCLT\ns\t°C\n0.0\t90\n0.1\t91\n", "cp1252"))
    assert data["CLT"].unit == "°C"


@pytest.mark.parametrize("at", range(4))
def test_markers_are_reported_at_any_position(log, at):
    rows = ROWS.splitlines(keepends=True)
    rows.insert(at, "MARK 000 - Manual - Sun Aug 16 16:54:28 CEST 2020\n")
    path = log(HEAD + NAMES + UNITS + "".join(rows))
    assert read(path).samples == 3
    time = (0, 0.066, 0.133, 0.133)[at]
    markers = f"1 (MARK 000 - Manual - Sun Aug 16 16:54:28 CEST 2020 at {time:g} s)"
    assert describe(path).tables[0].details["markers"] == markers


def test_markers_in_a_table_without_information_are_reported_too(log):
    path = log(NAMES + UNITS + ROWS + 'MARK 001 - "x"\n' + "0.2\t900\t14.7\t9\n")
    assert read(path).samples == 4
    assert describe(path).kind == "CSV"
    assert describe(path).tables[0].details["markers"].startswith("1 (MARK 001")


def test_a_restart_begins_a_piece_and_its_second_header_is_not_a_row(log):
    path = log(HEAD + NAMES + UNITS + ROWS + HEAD + NAMES + UNITS + ROWS)
    data = read(path)
    assert data.piece_starts.tolist() == [0, 3]
    assert data["RPM"].values.tolist() == [900, 910, 905] * 2
    assert describe(path).tables[0].details["pieces"] == "2, since its time restarts"
    assert read(path, raster=0.05).piece_starts.tolist() == [0, 3]


def test_time_that_falls_in_another_table_stays_a_finding(log):
    with pytest.raises(InputError, match="time goes backwards"):
        read(log("Time\tRPM\n0.0\t900\n0.1\t910\n0.0\t900\n"))


def test_a_row_that_is_cut_off_is_a_finding(log):
    with pytest.raises(InputError, match=r"the row has 2 cells, the header names 4. The file seems to be cut off here"):
        read(log(HEAD + NAMES + UNITS + ROWS + "0.2\t90"))


def test_a_packed_log_is_read(tmp_path):
    path = tmp_path / "run.msl.gz"
    path.write_bytes(gzip.compress((HEAD + NAMES + UNITS + ROWS).encode()))
    assert read(path).samples == 3


@few_or_many_copies
def test_mutated_logs_give_data_or_findings(log, count):
    chance = random.Random(21)
    content = (HEAD + NAMES + UNITS + ROWS * 5 + "MARK 000 - Manual\n" + ROWS).encode()
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(chance.randint(1, 5)):
            changed[chance.randrange(len(changed))] = chance.choice(
                [0, 9, 10, 34, 44, 46, 77, 255, chance.randrange(256)]
            )
        if chance.random() < 0.3:
            del changed[chance.randrange(len(changed)) :]
        path = log(bytes(changed))
        with contextlib.suppress(InputError):
            assert read(path).samples
            describe(path)


def test_the_real_log_is_read(real):
    data = read(real("ecu_logs/empro_ms_test.msl"))
    assert (data.samples, len(data)) == (7977, 26)
    assert data["Ignition Advance"].unit == "deg"
    assert data.time[0] == 26853.346


def test_a_first_row_without_a_time_is_left_out_with_a_remark(log):
    data = read(log(HEAD + NAMES + UNITS + "\t880\t14.7\t9\n" + ROWS))
    assert data["RPM"].values.tolist() == [900, 910, 905]
    assert str(data.findings[0]).startswith("run.msl line 5: 1 line of 4 skipped: without a time stamp")


@pytest.mark.parametrize(
    "units",
    [
        "s\tsec\tRPM\tRPM",
        "s\tfoo\tbar\tbar",
        "s\tfoo\tbar\tqux",
        "s\tsec\tr/min/x\traw count",
        "s\t\tRPM\t",
        "\tx\ty\tz",
    ],
)
@pytest.mark.parametrize("separator", ["\t", ";"])
def test_a_row_of_units_below_repeated_names_is_recognised(log, csv, units, separator):
    text = f"Time\tSecL\tRPM\tRPM\n{units}\n0.0\t0\t800\t900\n0.1\t1\t801\t901\n".replace("\t", separator)
    data = read(log(HEAD + text) if separator == "\t" else csv(text))
    assert list(data) == ["SecL", "RPM", "RPM (2)"]
    assert data.time.tolist() == [0, 0.1]
    assert data["RPM (2)"].values.tolist() == [900, 901]
    if units.startswith("s"):
        assert [channel.unit for channel in data.values()] == units.split("\t")[1:]
    assert "RPM (2)" in str(data.findings[0])


def test_names_that_stand_twice_do_not_hide_the_unit_of_time(log):
    data = read(log(HEAD + NAMES + NAMES + ROWS))
    assert data.time.tolist() == [0, 0.066, 0.133]
