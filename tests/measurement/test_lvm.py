"""LabVIEW's measurements: one time, many, or none; segments; comments."""

import contextlib
import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies


@pytest.fixture
def lvm(csv):
    """Writes a file from its settings and lines of segments; a blank stands for a tab."""

    def write(*segments, decimal=".", times="One", **more):
        settings = {"Writer_Version": "2", "Separator": "Tab", "Multi_Headings": "No", "X_Columns": times} | more
        if decimal:
            settings["Decimal_Separator"] = decimal
        head = [*(f"{k} {v}" for k, v in settings.items()), "***End_of_Header*** ", " "]
        lines = [line for segment in segments for line in segment]
        text = "\n".join([*head, *lines, ""]).replace(" ", "\t")
        return csv("LabVIEW Measurement\t\n" + text, "run.lvm")

    return write


def segment(names, *rows, **settings):
    settings = {"Samples": "3 3", "Y_Unit_Label": "rpm Nm", "X_Dimension": "Time Time"} | settings
    return ["Channels 2 ", *(f"{k} {v} " for k, v in settings.items()), "***End_of_Header*** ", names, *rows]


def columns(data):
    return {c.name: (c.unit, c.values.tolist()) for c in data.values()}


ROWS = ("0.0 1000.5 80", "0.1 1001.5 81", "0.2 1002.5 82")
READ = {"Speed": ("rpm", [1000.5, 1001.5, 1002.5]), "Torque": ("Nm", [80, 81, 82])}


def test_one_column_of_time_serves_all_channels(lvm):
    path = lvm(segment("X_Value Speed Torque Comment", *ROWS), Operator="Ada", Date="2024/02/01")
    data = read(path)
    assert columns(data) == READ
    assert data.time.tolist() == [0, 0.1, 0.2]
    assert describe(path).kind == "LabVIEW"
    assert describe(path).tables[0].details == {"date": "2024/02/01", "operator": "Ada"}


@pytest.mark.parametrize("decimal", [",", ""])
def test_a_decimal_comma_is_stated_or_detected(lvm, decimal):
    rows = [row.replace(".", ",") for row in ROWS]
    path = lvm(segment("X_Value Speed Torque", *rows, Delta_X="0,1 0,1"), decimal=decimal)
    assert columns(read(path)) == READ


def test_each_channel_may_have_its_time(lvm):
    settings = {"Samples": "3  2", "Y_Unit_Label": "rpm  Nm", "X_Dimension": "Time  Time"}
    rows = ("0.0 1000 0.0 80", "0.1 1001 0.2 84", "0.2 1002  ")
    path = lvm(segment("X_Value Speed X_Value Torque Comment", *rows, **settings), times="Multi")
    with pytest.raises(InputError, match=r"different rasters: Speed every 0.1 s from 0 s, Torque every 0.2 s"):
        read(path)
    assert columns(read(path, raster=0.1)) == {"Speed": ("rpm", [1000, 1001, 1002]), "Torque": ("Nm", [80, 82, 84])}
    assert read(path, ["Torque"]).time.tolist() == [0, 0.2]


def test_times_that_are_equal_need_no_raster(lvm):
    rows = ("0.0 1000 0.0 80", "0.1 1001 0.1 81")
    data = read(lvm(segment("X_Value Speed X_Value Torque", *rows, Y_Unit_Label="rpm  Nm"), times="Multi"))
    assert columns(data) == {"Speed": ("rpm", [1000, 1001]), "Torque": ("Nm", [80, 81])}
    assert data.time.tolist() == [0, 0.1]


def test_a_time_that_is_not_written_is_computed(lvm):
    rows = ("1000 80", "1001 81", "1002 82")
    names = "Speed Torque Comment"
    data = read(lvm(segment(names, *rows, X0="1.0 1.0", Delta_X="0.5 0.5"), times="No"))
    assert data.time.tolist() == [1, 1.5, 2]
    assert data["Torque"].values.tolist() == [80, 81, 82]
    path = lvm(segment(names, *rows, X0="0 0", Delta_X="0.1 0.2"), times="No")
    assert columns(read(path, raster=0.1))["Torque"] == ("Nm", [80, 80.5, 81])


def test_segments_follow_each_other(lvm):
    names = "X_Value Speed Torque Comment"
    path = lvm(segment(names, *ROWS), segment(names, "0.3 1 2", "0.4 3 4"))
    assert read(path).time.tolist() == [0, 0.1, 0.2, 0.3, 0.4]
    path = lvm(segment(names, *ROWS), segment(names, *ROWS))
    assert read(path).piece_starts.tolist() == [0, 3]
    assert describe(path).tables[0].details["pieces"] == "2, since its time restarts"


def test_a_segment_of_other_channels_and_a_long_row_are_findings(lvm):
    path = lvm(segment("X_Value Speed Torque", *ROWS, "0.3 1 2 3"), segment("X_Value Speed", "0.4 1"))
    with pytest.raises(InputError) as caught:
        read(path)
    messages = [str(finding) for finding in caught.value.findings]
    assert messages[0].startswith("run.lvm line 18: the row has 4 cells, there are 3 names. Give the row as many cells")
    assert messages[1].startswith("run.lvm line 24: this segment has other channels than the segment in line 14.")


def test_text_among_numbers_is_a_finding(lvm):
    with pytest.raises(InputError, match=r"run.lvm line 16, column Speed: must be a number, got 'x'"):
        read(lvm(segment("X_Value Speed Torque", "0.0 1 2", "0.1 x 3", "0.2 4 5")))


def test_an_x_axis_other_than_time_gives_points(lvm):
    data = read(lvm(segment("X_Value Speed Torque", *ROWS, X_Dimension="Frequency Frequency")))
    assert data.time is None
    assert columns(data) == READ


def test_names_that_come_twice_are_kept_apart(lvm):
    assert list(read(lvm(segment("X_Value Untitled Untitled", *ROWS)))) == ["Untitled", "Untitled (2)"]


def test_a_file_that_is_cut_off_is_a_finding(lvm):
    for text in (["Channels 2"], segment("X_Value Speed Torque")):
        with pytest.raises(InputError, match="the LabVIEW file has no rows of numbers"):
            read(lvm(text))


@few_or_many_copies
def test_mutated_files_give_data_or_findings(lvm, csv, count):
    chance = random.Random(24)
    names = "X_Value Speed X_Value Torque Comment"
    rows = [f"0.{k} {k} 0.{k} {k}" for k in range(9)]
    content = lvm(segment(names, *rows), segment(names, *rows), times="Multi").read_bytes()
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(chance.randint(1, 5)):
            at = chance.randrange(20, len(changed))
            changed[at] = chance.choice([0, 9, 10, 44, 46, 255, chance.randrange(256)])
        if chance.random() < 0.3:
            del changed[chance.randrange(20, len(changed)) :]
        path = csv(bytes(changed), "run.lvm")
        with contextlib.suppress(InputError):
            assert read(path, raster=0.05).samples
            describe(path)


def test_rows_beyond_the_samples_of_a_channel_are_none_of_its(lvm):
    rows = ("1000 80", "1001 82", "1002 ")
    path = lvm(segment("Speed Torque", *rows, X0="0 0", Delta_X="0.1 0.2", Samples="3 2"), times="No")
    assert read(path, ["Torque"]).time.tolist() == [0, 0.2]
    np.testing.assert_allclose(read(path, raster=0.1)["Torque"].values, [80, 81, 82])
