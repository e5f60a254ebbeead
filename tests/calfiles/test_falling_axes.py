"""Axes that fall in a file are turned around, in any format, and written back as they were."""

import re

import numpy as np
import pytest

from kennfeld import ParameterSet, read_parameters
from kennfeld.calfiles import describe
from kennfeld.parameters import Axis, Map

DCM = """\
KONSERVIERUNG_FORMAT 2.0

FESTWERT GAIN
   WERT 2.0
END

STUETZSTELLENVERTEILUNG AXIS_T 3
*SST
   ST/X   -130.0   -140.0   -150.0
END

GRUPPENKENNLINIE CUR_T 3
*SSTX	AXIS_T
   ST/X   -130.0   -140.0   -150.0
   WERT   1.0   2.0   5.0
END

KENNFELD MAP 3 2
   ST/X   3.0   2.0   1.0
   ST/Y   10.0
   WERT   31.0   21.0   11.0
   ST/Y   20.0
   WERT   32.0   22.0   12.0
END
"""


@pytest.fixture
def dcm(tmp_path):
    path = tmp_path / "x.dcm"
    path.write_text(DCM, encoding="utf-8")
    return path


def test_tables_of_a_dcm_file_are_turned(dcm):
    values = read_parameters(dcm)
    assert values["CUR_T"].axes[0].breakpoints.tolist() == [-150.0, -140.0, -130.0]
    assert values["CUR_T"].axes[0].name == "AXIS_T"
    assert values["CUR_T"].values.tolist() == [5.0, 2.0, 1.0]
    assert values["MAP"].axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    assert values["MAP"].values.tolist() == [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]]
    assert values["GAIN"].value == 2.0


def test_a_dcm_file_is_written_back_byte_for_byte(dcm, tmp_path):
    read_parameters(dcm).save(tmp_path / "y.dcm")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == DCM


def test_new_values_go_where_the_old_ones_were(dcm, tmp_path):
    values = read_parameters(dcm)
    table = values["MAP"]
    changed = table.with_values(table.values + np.array([[0.5, 0], [0, 0], [0, 0]]))
    values.with_parameters(changed, values["CUR_T"].with_values([5.0, 2.0, 7.0])).save(tmp_path / "y.dcm")
    text = DCM.replace("21.0   11.0", "21.0   11.5").replace("WERT   1.0   2.0   5.0", "WERT   7.0   2.0   5.0")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == text


def test_new_breakpoints_go_where_the_old_ones_were(dcm, tmp_path):
    values = read_parameters(dcm)
    axis = Axis([-155.0, -140.0, -130.0], name="AXIS_T")
    moved = values["CUR_T"].changed(axes=(axis,))
    values.with_parameters(moved).save(tmp_path / "y.dcm")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == DCM.replace("-150.0", "-155.0")


@pytest.mark.parametrize("points", ["1.0 3.0 2.0", "1.0 1.0 2.0"])
def test_an_axis_that_neither_rises_nor_falls_leaves_out_its_tables_alone(dcm, points):
    dcm.write_text(DCM.replace("-130.0   -140.0   -150.0", points), encoding="utf-8")
    assert set(read_parameters(dcm)) == {"GAIN", "MAP"}
    warnings = [str(finding) for finding in describe(dcm).findings]
    assert len(warnings) == 2
    assert all("neither rises nor falls" in warning for warning in warnings)


def test_a_table_without_its_skipped_axis_is_skipped(dcm):
    text = DCM.replace("FORMAT 2.0", "FORMAT 1.0").replace("-130.0   -140.0   -150.0", "1 3 2")
    dcm.write_text(text.replace("*SSTX\tAXIS_T\n   ST/X   1 3 2\n", "*SSTX\tAXIS_T\n"), encoding="utf-8")
    assert set(read_parameters(dcm)) == {"GAIN", "MAP"}


def rising(tmp_path, ending):
    """A map written in a format, to be edited into one with a falling axis."""
    path = tmp_path / f"x{ending}"
    table = Map("MAP", Axis([1.0, 2.0, 3.0]), Axis([10.0, 20.0]), [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]])
    ParameterSet([table]).save(path)
    return path, path.read_text(encoding="utf-8")


def test_a_cvx_file_is_turned(tmp_path):
    path, text = rising(tmp_path, ".csv")
    path.write_text(re.sub(r"([\d.]+),([\d.]+),([\d.]+)$", r"\3,\2,\1", text, flags=re.MULTILINE), encoding="utf-8")
    assert_turned(path)


def test_a_cdfx_file_is_turned(tmp_path):
    path, text = rising(tmp_path, ".cdfx")
    value = r"(<V>[\d.]+</V>)"
    path.write_text(re.sub(value * 3, r"\3\2\1", text), encoding="utf-8")
    assert_turned(path)


def test_a_matlab_script_is_turned(tmp_path):
    path = tmp_path / "x.m"
    path.write_text("MAP.x = [3 2 1];\nMAP.y = [10 20];\nMAP.values = [31 32; 21 22; 11 12];\n", encoding="utf-8")
    assert_turned(path)
    path.write_text(
        "K = 1;\nMAP.x = [3 1 2];\nMAP.y = [10 20];\nMAP.values = [31 32; 21 22; 11 12];\n", encoding="utf-8"
    )
    assert set(read_parameters(path)) == {"K"}


def assert_turned(path):
    table = read_parameters(path)["MAP"]
    assert table.axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(table.values, [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]])
