"""Decimal marks and thousands: one file has one form, and each number that shows it settles the others."""

import pytest

from kennfeld.measurement import read

CASES = {
    "German": ("Speed;Torque;lambda\n5.253;106;1,00\n4.184;83;1,01\n", {"Speed": [5253, 4184], "lambda": [1, 1.01]}),
    "beside small ones": ("Speed;Torque\n1.013;1,5\n950;12,75\n", {"Speed": [1013, 950], "Torque": [1.5, 12.75]}),
    "English": ("Speed;Torque\n1,013;1.5\n950;2.5\n", {"Speed": [1013, 950], "Torque": [1.5, 2.5]}),
    "tabs": ("Speed\tTorque\n1.013\t1,5\n950\t2,5\n", {"Speed": [1013, 950], "Torque": [1.5, 2.5]}),
    "quoted commas": ('Speed,Torque\n"1,500","0,25"\n"2,250","0,5"\n', {"Speed": [1.5, 2.25], "Torque": [0.25, 0.5]}),
    "a quoted comma": ('x,y\n"1,5",1\n"3,125",3\n', {"x": [1.5, 3.125], "y": [1, 3]}),
    "quoted thousands": ('a,b\n"1,200.5",1\n"2,300",2\n', {"a": [1200.5, 2300], "b": [1, 2]}),
    "plain points": ("Speed;Torque\n1.013;1.5\n950;2.5\n", {"Speed": [1.013, 950], "Torque": [1.5, 2.5]}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_number_that_shows_the_decimal_mark_settles_the_others(tmp_path, case):
    text, wanted = CASES[case]
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    data = read(path)
    assert {name: data[name].values.tolist() for name in wanted} == wanted
    assert data.findings == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a\tb\n1,100\t5\n950\t2\n", "1,100 is read as 1.1, but may mean 1100: other cells have no comma"),
        ("a;b\n1.100;5\n950;2\n", "1.100 is read as 1.1, but may mean 1100: other cells have no point"),
        ('a,b\n"1,005",5\n"1,125",2\n', "1,005 is read as 1005, but may mean 1.005: no cell tells"),
    ],
)
def test_an_undecided_decimal_mark_is_reported(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    assert [finding.message for finding in read(path).findings] == [message]
