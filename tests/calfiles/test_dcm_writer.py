import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text

SPEED = Axis([700, 1000], unit="rpm", name="AxisSpeed")


def test_the_layout_is_that_of_inca(tmp_path):
    parameters = ParameterSet([Map("M", SPEED, [0.1, 0.2, 0.3], [[1, 2, 3], [4, 5, 6]], unit="Nm", description="d")])
    write(parameters, tmp_path / "a.dcm")
    assert (tmp_path / "a.dcm").read_text(encoding="utf-8") == (
        '* encoding="UTF-8"\n* DAMOS format\n* Created by Kennfeld\n\nKONSERVIERUNG_FORMAT 2.0\n\n'
        'GRUPPENKENNFELD M 2 3\n   LANGNAME "d"\n   EINHEIT_X "rpm"\n   EINHEIT_Y ""\n   EINHEIT_W "Nm"\n'
        "*SSTX\tAxisSpeed\n   ST/X   700.0   1000.0\n"
        "   ST/Y   0.1\n   WERT   1.0   4.0\n   ST/Y   0.2\n   WERT   2.0   5.0\n   ST/Y   0.3\n   WERT   3.0   6.0\n"
        "END\n\n"
        'STUETZSTELLENVERTEILUNG AxisSpeed 2\n*SST\n   LANGNAME ""\n   EINHEIT_X "rpm"\n   ST/X   700.0   1000.0\nEND\n'
    )


def test_a_group_axis_is_written_once(tmp_path):
    parameters = ParameterSet([Curve("A", SPEED, [1, 2]), Curve("B", SPEED, [3, 4])])
    write(parameters, tmp_path / "a.dcm")
    assert (tmp_path / "a.dcm").read_text(encoding="utf-8").count("STUETZSTELLENVERTEILUNG AxisSpeed") == 1
    assert read(tmp_path / "a.dcm") == parameters


def test_a_table_without_a_group_axis_is_a_plain_one(tmp_path):
    write(ParameterSet([Curve("A", [1, 2], [1, 2])]), tmp_path / "a.dcm")
    assert "\nKENNLINIE A 2\n" in (tmp_path / "a.dcm").read_text(encoding="utf-8")


def test_a_group_axis_with_blanks_in_its_name_is_read_back(tmp_path):
    parameters = ParameterSet([Curve("A", Axis([1, 2], name="DISTRIBUTION X"), [1, 2])])
    write(parameters, tmp_path / "a.dcm")
    assert read(tmp_path / "a.dcm") == parameters


def test_no_line_holds_more_than_six_numbers(tmp_path):
    write(ParameterSet([Block("B", np.arange(13))]), tmp_path / "a.dcm")
    lines = (tmp_path / "a.dcm").read_text(encoding="utf-8").splitlines()
    assert [len(line.split()) - 1 for line in lines if line.startswith("   WERT")] == [6, 6, 1]


def test_parameters_that_dcm_cannot_hold_are_refused_by_name_before_writing(tmp_path):
    kept = tmp_path / "a.dcm"
    kept.write_text("as it was", encoding="utf-8")
    parameters = ParameterSet(
        [
            Cube("Q", [[1], [1], [1]], np.ones((1, 1, 1))),
            Block("B3", np.ones((1, 1, 1))),
            Block("B0", np.ones(0)),
            Scalar("N", np.nan),
            Scalar("two words", 1),
            Scalar("T", 1),
        ],
        [Text("T", "a"), Text("L", "a\nb")],
        [Axis([1], name="spare axis")],
    )
    with pytest.raises(InputError) as caught:
        write(parameters, kept)
    message = str(caught.value)
    for name in ("Q", "B3", "B0", "N", "two words", "T", "L", "spare axis"):
        assert f"a.dcm {name}: " in message
    assert "DCM cannot store a cube of 3 dimensions. Write it as .json." in message
    assert kept.read_text(encoding="utf-8") == "as it was"
    assert list(tmp_path.iterdir()) == [kept]
