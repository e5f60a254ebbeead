"""Characteristics of ESDL classes: read, and written into a copy of the file in which only numbers change."""

import difflib

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, losses, read, write
from kennfeld.calfiles.esdl.reader import read_esdl
from kennfeld.calfiles.esdl.update import write_esdl
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.files.calibrations import ESDL
from kennfeld.files.identification import identify
from tests.draws import few_or_many

TEXT = """// a head
package Cell; /* of a battery */

type Curve is table real -> real;
class Plant {
	/** heat
	*  capacity */
	characteristic real C_heat = 2.73; // keep me
	characteristic real low = -5E-7, high = +1_000;
	characteristic integer count = 3;
	characteristic boolean busy = true;
	characteristic Mode mode = Mode.Off;
	characteristic real twice <- "2.0 * x", x = C_heat;
	characteristic real block[3] = { 1.0, 2, -3.0 };
	characteristic Curve curve[2] = { { 0.0, 10.0 }, { 1.5, 2.5[V] } };
	characteristic Unknown map[2][3] = {
		{ -20.0, 60.0 },
		{ 0.0, 50.0, 100.0 },
		{ { 2.4, 1.5, 1.3 }, { 1.8, 1.1, 0.9 } }
	};
	characteristic Speeds n[2] = { 0.0, 10.0 };
	characteristic Shared group[n] = { 4.0, 5.0 };
	const real fixed = 7.0;
	real state = 0.0;
	public void calc() { state = C_heat * 2.73; }
}
class Other { characteristic real C_heat = 1.0; characteristic real K = 1.0; }
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "Plant.esdl"
    file.write_bytes(TEXT.replace("\n", "\r\n").encode("cp1252"))
    return file


def test_all_characteristics_of_a_file_are_read(path):
    values = read(path)
    assert list(values) == [
        "Plant.C_heat", "low", "high", "count", "busy", "block", "curve", "map", "group", "Other.C_heat", "K",
    ]  # fmt: skip
    assert [values[name].value for name in ("Plant.C_heat", "low", "high", "count", "busy")] == [
        2.73, -5e-7, 1000.0, 3.0, 1.0,
    ]  # fmt: skip
    assert values["Plant.C_heat"].description == "heat capacity"
    assert values["block"].values.tolist() == [1.0, 2.0, -3.0]
    assert values["curve"].values.tolist() == [1.5, 2.5]
    assert values["map"].axes[1].breakpoints.tolist() == [0.0, 50.0, 100.0]
    assert values["map"].values[1].tolist() == [1.8, 1.1, 0.9]
    assert values["group"].axes[0].name == "n"


def test_writing_what_was_read_gives_the_same_bytes(path, tmp_path):
    write(read(path), tmp_path / "copy.esdl")
    assert (tmp_path / "copy.esdl").read_bytes() == path.read_bytes()


def test_only_changed_numbers_are_written(path, tmp_path):
    values = read(path)
    changed = values.with_parameters(
        values["Plant.C_heat"].with_values(3.0),
        values["low"].with_values(1e-9),
        values["count"].with_values(4.0),
        values["busy"].with_values(0.0),
        values["block"].with_values([1.0, 2.5, -3.0]),
        values["map"].with_values([[2.4, 1.5, 1.3], [1.8, 1.25, 0.9]]),
    )
    write(changed, tmp_path / "copy.esdl")
    text = (tmp_path / "copy.esdl").read_bytes().decode("cp1252").replace("\r\n", "\n")
    lines = [line for line in difflib.ndiff(TEXT.splitlines(), text.splitlines()) if line.startswith("+ ")]
    assert lines == [
        "+ \tcharacteristic real C_heat = 3.0; // keep me",
        "+ \tcharacteristic real low = 1.0e-09, high = +1_000;",
        "+ \tcharacteristic integer count = 4;",
        "+ \tcharacteristic boolean busy = false;",
        "+ \tcharacteristic real block[3] = { 1.0, 2.5, -3.0 };",
        "+ \t\t{ { 2.4, 1.5, 1.3 }, { 1.8, 1.25, 0.9 } }",
    ]
    again = read(tmp_path / "copy.esdl")
    assert again == changed


def test_moved_breakpoints_are_written(path, tmp_path):
    values = read(path)
    table, group = values["curve"], values["group"]
    moved = values.with_parameters(
        table.changed(axes=[table.axes[0].changed(breakpoints=[0.0, 12.5])]),
        group.changed(axes=[group.axes[0].changed(breakpoints=[0.0, 11.0])]),
    )
    write(moved, tmp_path / "copy.esdl")
    again = read(tmp_path / "copy.esdl")
    assert again["curve"].axes[0].breakpoints.tolist() == [0.0, 12.5]
    assert again["group"].axes[0].breakpoints.tolist() == [0.0, 11.0]


def test_long_names_of_ascet_are_those_of_the_file(path, tmp_path):
    origin = read(path).origin
    findings = write(
        ParameterSet([Scalar("Cell.Plant.low", 1.0), Scalar("Else.K", 2.0)], origin=origin), tmp_path / "c.esdl"
    )
    assert read(tmp_path / "c.esdl")["low"].value == 1.0
    assert "left out" in str(findings[0])
    assert "Else.K" in str(findings[0])


def test_a_set_of_another_file_or_size_is_refused(path, tmp_path):
    with pytest.raises(InputError, match="only be written over the one it was read from"):
        write(ParameterSet([Scalar("K", 1.0)]), tmp_path / "new.esdl")
    with pytest.raises(InputError, match="is a scalar, but a block 3 in the file"):
        write(ParameterSet([Scalar("block", 1.0)], origin=read(path).origin), tmp_path / "new.esdl")


def test_a_file_with_syntax_errors_is_refused_with_all_of_them(tmp_path):
    file = tmp_path / "a.esdl"
    file.write_text("package a; class C { characteristic real K = ; void m() { x = 1 +; } }")
    with pytest.raises(InputError) as error:
        read(file)
    assert len(error.value.findings) == 2


def test_a_file_is_recognised_and_described(path):
    assert identify(path).format is ESDL
    assert describe(path).kind == "ESDL"
    assert losses(read(path), path) == ()


@few_or_many(st.integers(0, len(TEXT)), st.integers(0, 40), few=10, many=100)
def test_a_damaged_file_is_read_or_refused(start, length):
    source = CalibrationSource("a.esdl", (TEXT[:start] + TEXT[start + length :]).encode())
    try:
        values = read_esdl(source).parameters
    except InputError:
        return
    assert write_esdl(values, "a.esdl").raw == source.raw


@few_or_many(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3), few=10, many=100)
def test_any_numbers_come_back(numbers):
    values = read_esdl(CalibrationSource("a.esdl", TEXT.encode())).parameters
    written = write_esdl(values.with_parameters(values["block"].with_values(numbers)), "a.esdl").raw
    again = read_esdl(CalibrationSource("a.esdl", written)).parameters
    np.testing.assert_array_equal(again["block"].values, numbers)
