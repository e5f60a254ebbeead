"""Text files as the tools of the field write them, byte by byte."""

import contextlib
import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies


def columns(data):
    return {c.name: (c.unit, c.values.tolist()) for c in data.values()}


def test_inca_ascii_has_types_between_names_and_units(csv):
    text = (
        "ETASAsciiItemFile\trecord\tCrLf\tTab\r\nsampleCount\t3              \r\n"
        'time\tnmot_w\tB_ll\ttmot\t\r\nf8\tf4\tu1\tf4\t\r\n"s"\t"1/min"\t"-"\t"°C"\t\r\n'
        "0.00\t800.5\t1\t90.0\t\r\n0.01\t801.5\t1\t90.5\t\r\n0.02\t802.5\t0\t91.0\t\r\n"
    )
    data = read(csv(text, "run.ascii", "cp1252"))
    assert columns(data) == {
        "nmot_w": ("1/min", [800.5, 801.5, 802.5]),
        "B_ll": ("-", [1, 1, 0]),
        "tmot": ("°C", [90, 90.5, 91]),
    }
    assert data.time.tolist() == [0, 0.01, 0.02]


MULTI = (
    "time\ttime_10ms\tnmot\ttime_100ms\ttmot\tpmot\ns\ts\t1/min\ts\t°C\tbar\n"
    "0.00\t0.00\t800\t0.00\t90\t1\n0.01\t0.01\t801\t\t\t\n0.02\t0.02\t802\t\t\t\n"
    + "".join(f"{k / 100:.2f}\t{k / 100:.2f}\t{800 + k}\t\t\t\n" for k in range(3, 10))
    + "0.10\t0.10\t810\t0.10\t91\t2\n"
)


def test_several_rasters_of_one_table_are_joined(csv):
    path = csv(MULTI)
    with pytest.raises(InputError, match=r"different rasters: nmot every 0.01 s from 0 s, tmot every 0.1 s"):
        read(path)
    data = read(path, raster=0.05)
    assert columns(data) == {
        "nmot": ("1/min", [800, 805, 810]),
        "tmot": ("°C", [90, 90.5, 91]),
        "pmot": ("bar", [1, 1.5, 2]),
    }
    assert read(path, ["tmot", "pmot"])["pmot"].values.tolist() == [1, 2]
    assert [(t.name, t.samples) for t in describe(path).tables] == [("time_10ms", 11), ("time_100ms", 2)]


def test_groups_side_by_side_with_equal_names_of_their_time_are_joined(csv):
    path = csv("time;n;time;T\ns;rpm;s;°C\n0,0;800;0,0;90\n0,1;801;0,2;94\n0,2;802;;\n")
    data = read(path, raster=0.1)
    assert columns(data) == {"n": ("rpm", [800, 801, 802]), "T": ("°C", [90, 92, 94])}
    assert read(path, ["T"]).time.tolist() == [0, 0.2]


def test_one_time_stated_twice_stays_one(csv):
    data = read(csv("time;time_ms;n\n0,0;0;800\n0,1;100;801\n0,2;200;802\n"))
    assert columns(data) == {"time_ms": ("", [0, 100, 200]), "n": ("", [800, 801, 802])}


def test_a_time_that_every_channel_repeats_needs_no_raster(csv):
    data = read(csv("time;n;time;T\n0,0;800;0,0;90\n0,1;801;0,1;91\n"))
    assert columns(data) == {"n": ("", [800, 801]), "T": ("", [90, 91])}


def test_a_value_without_the_time_of_its_group_is_a_finding(csv):
    with pytest.raises(InputError, match=r"bench.csv line 4, column time: the time stamp is missing"):
        read(csv("time;n;time;T\n0,0;800;0,0;90\n0,1;801;0,2;94\n0,2;802;;95\n"), ["T"])


def test_a_second_time_that_falls_is_a_channel(csv):
    data = read(csv("time;n;time_2;T\n0;1;5;1\n1;2;6;2\n2;3;0;3\n"))
    assert list(data) == ["n", "time_2", "T"]


@pytest.mark.parametrize(
    "text",
    [
        "time;nmot;tmot\nTime of the sample;Engine speed;Engine temperature\ns;1/min;°C\n",
        "Measure file;C:\\x.dat\nDate;01.02.2020\n\ntime;nmot;tmot\ns;1/min;°C\nZeit;Drehzahl;Temperatur\n",
        "Zeit;nmot;tmot\nSekunden;1/min;°C\n",
        "s;1/min;°C\ntime;nmot;tmot\n",
        "Zeit [s];nmot [1/min];tmot (°C)\n",
        "sep=;\ntime;nmot;tmot\ns;1/min;°C\n",
        "# made by hand\n# time;nmot;tmot\n# s;1/min;°C\n",
        "Test;Bench 3\nDriver;Ada\n\nTime;nmot;tmot\n[s];[1/min];[°C]\n",
        "time;nmot;tmot\nf8;f4;f4\ns;1/min;°C\nrunning;from the ECU;from the bench\n",
    ],
)
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-16"])
def test_names_and_units_are_read_among_other_headers(csv, text, encoding):
    data = read(csv(text + "0,0;800,5;90\n0,1;801,5;91\n0,2;802,5;92\n", encoding=encoding))
    assert columns(data) == {"nmot": ("1/min", [800.5, 801.5, 802.5]), "tmot": ("°C", [90, 91, 92])}
    assert data.time.tolist() == [0, 0.1, 0.2]


def test_a_column_of_labels_before_the_headers_is_skipped(csv):
    text = '"Kanal";"Zeit";"n"\n"Einheit";"s";"1/min"\n"Kommentar";"";"Motor"\n"1";0,0;800\n"2";0,1;801\n"3";0,2;802\n'
    data = read(csv(text))
    assert columns(data)["n"] == ("1/min", [800, 801, 802])
    assert data["Kanal"].unit == ""
    assert data.time.tolist() == [0, 0.1, 0.2]


def test_a_line_of_time_above_names_is_not_a_header(csv):
    data = read(csv("Date;01.02.2020\nTime;12:00:00\nSpeed;Torque\n1;2\n3;4\n5;6\n"))
    assert columns(data) == {"Speed": ("", [1, 3, 5]), "Torque": ("", [2, 4, 6])}


def test_numbers_with_points_for_thousands_are_read_beside_a_decimal_comma(csv):
    data = read(csv("time;p\n0,0;1.013,25\n0,1;-12.001.014,5\n0,2;15,25\n"))
    np.testing.assert_array_equal(data["p"].values, [1013.25, -12001014.5, 15.25])


def test_quoted_numbers_and_exponents_with_a_decimal_comma_are_read(csv):
    data = read(csv('"time";"x"\n"0,0";"1,5E-03"\n"0,1";"-2,5e+02"\n"0,2";""\n'))
    np.testing.assert_array_equal(data["x"].values, [0.0015, -250, np.nan])


@few_or_many_copies
@pytest.mark.parametrize(
    "text",
    [
        MULTI,
        'ETASAsciiItemFile\trecord\tCrLf\tTab\nsampleCount\t9\ntime\tn\tB\nf8\tf4\tu1\n"s"\t"rpm"\t"-"\n'
        + "".join(f"0.{k}\t80{k}\t1\n" for k in range(9)),
        "Datum;Uhrzeit;n\n" + "".join(f"01.02.2020;12:00:0{k},5;1.01{k},5\n" for k in range(9)),
    ],
)
def test_mutated_exports_give_data_or_findings(csv, text, count):
    chance = random.Random(26)
    content = text.encode("cp1252")
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(chance.randint(1, 5)):
            changed[chance.randrange(len(changed))] = chance.choice(
                [0, 9, 10, 34, 44, 46, 59, 255, chance.randrange(256)]
            )
        if chance.random() < 0.3:
            del changed[chance.randrange(len(changed)) :]
        path = csv(bytes(changed))
        with contextlib.suppress(InputError):
            assert read(path, raster=0.05).samples
            describe(path)


@pytest.mark.parametrize("times", [["time"], ["time_2"], ["time_2", "time"]])
def test_a_requested_time_is_a_channel_and_still_begins_a_raster(csv, times):
    rows = [f"{k / 10},{k},{k / 5 if k < 6 else ''},{20 + k if k < 6 else ''}" for k in range(12)]
    data = read(csv("time,n,time_2,T\n" + "\n".join(rows) + "\n"), [*times, "n", "T"], raster=0.1)
    np.testing.assert_allclose(data["T"].values, 20 + data.time / 0.2)
    np.testing.assert_allclose(data["n"].values, data.time / 0.1)
    assert all(data[name].values == pytest.approx(data.time) for name in times)


def test_a_time_is_a_channel_without_others_of_its_raster(csv):
    data = read(csv("time,n,time_2,T\n0,1,0,5\n0.1,2,0.2,6\n0.2,3,,\n"), ["time", "T"], raster=0.1)
    assert data["time"].values.tolist() == pytest.approx([0, 0.1, 0.2])
    assert data["T"].values.tolist() == pytest.approx([5, 5.5, 6])
