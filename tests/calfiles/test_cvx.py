import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text

HEAD = 'CALIBRATION VALUES V2.1,.,*,"",\n\n'
X2 = "\n,K\nX_AXIS_PTS,,1,2\n"
Y2 = "\n,K\nY_AXIS_PTS,,7,8\n"


@pytest.fixture
def cvx(written):
    return lambda body, head=HEAD: written((head + body).replace("\n", "\r\n"), "start.csv")


def findings(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return [str(finding) for finding in caught.value.findings]


def test_values_start_in_the_third_column_and_units_stand_before(cvx):
    assert read(cvx(',K\nVALUE,:"1,5 ""s""":,2.5\n'))["K"] == Scalar("K", 2.5, unit='1,5 "s"')


@pytest.mark.parametrize(
    "head",
    ['CALIBRATION VALUES V1.0;,;*; ""\n', 'CALIBRATION VALUES V2.1;,;*;"";\n', 'CALIBRATION VALUES V2.1\t,\t*\t""\t\n'],
)
def test_the_first_line_declares_separator_and_decimal_point(cvx, head):
    separator = head[23]
    path = cvx(f"{separator}K{separator}\nVAL_BLK;;7,65;0,24;9\n".replace(";", separator), head)
    assert read(path)["K"] == Block("K", [7.65, 0.24, 9])


def test_a_decimal_comma_leaves_no_decimal_point(cvx):
    assert "must be a number, got '1.5'" in findings(cvx(";K\nVALUE;;1.5\n", 'CALIBRATION VALUES V2.1;,;*;"";\n'))[0]


def test_a_map_is_turned_to_x_first_and_its_embedded_breakpoints_are_ignored(cvx):
    expected = Map("K", [1, 2], [7, 8], [[1, 3], [2, 4]], unit="Nm", functions=["F"])
    for embedded in ("\n", ",,99,98\n", ",,\n"):
        path = cvx(f'tag,K\n* c\nMAP,\n{embedded}:"Nm":,7,1,2\n,8,3,4\n\nFUNCTION,,"F","f"\n{X2}{Y2}')
        assert read(path)["K"] == expected


def test_identifiers_are_compared_without_regard_to_case(cvx):
    assert read(cvx(",k\nCURVE\n,,5,6\n" + X2))["k"] == Curve("k", [1, 2], [5, 6])


def test_units_stand_between_the_string_delimiters_of_the_file(written):
    head = "CALIBRATION VALUES V2.1;,;*;'';\n\n"
    body = ";K\nVALUE;:'rpm':;1,5\n\n;C\nCURVE;\n:'Nm':;;1;2\n\n;C\nX_AXIS_PTS;:'%':;0;1\n"
    parameters = read(written(head + body, "a.csv"))
    assert (parameters["K"].unit, parameters["C"].unit, parameters["C"].axes[0].unit) == ("rpm", "Nm", "%")


def test_texts_are_carried(cvx):
    assert read(cvx(',A\nASCII,,"a,""b"\n\n,B\nVALUE,,"on"\n')).texts == (
        Text("A", 'a,"b'),
        Text("B", "on", kind="enumeration"),
    )


def test_functions_variants_and_display_names_are_read(cvx):
    head = 'FUNCTION_HDR,,\n,"F","G"\n\nVARIANT_HDR,,\n"Car","A","B"\n"Gear","M"\n\n'
    coding = (
        'FUNCTION,,"F","is, known"\nFUNCTION,,"G",""\nVARIANT,,"Car"."A","Gear"."M ""x"""\nDISPLAY_IDENTIFIER,,"k"\n'
    )
    path = cvx(f'{head},K\nVALUE,,1\n\n{coding}\n,K\nVALUE,,2\n\'VARIANT\',,"Car"."B"\n')
    first = Scalar("K", 1, functions=["F", "G"], variant='Car=A,Gear=M "x"', display_name="k")
    assert read(path) == ParameterSet([first], others=[Scalar("K", 2, variant="Car=B")])
    assert describe(path).findings == ()


def test_the_parts_of_a_variant_may_be_parted_by_a_decimal_comma(written):
    text = 'CALIBRATION VALUES V2.1;,;*;"";\n\n;K\nVALUE;;1,5\nVARIANT;;"Car","A";"Gear","M"\n'
    assert read(written(text, "a.csv"))["K"] == Scalar("K", 1.5, variant="Car=A,Gear=M")


def test_each_variant_of_a_table_has_axes_of_its_own(cvx):
    variants = "".join(
        f',K\nCURVE\n,,5,{z}\nVARIANT,,"Car"."{car}"\n\n,K\nX_AXIS_PTS,,1,{x}\nVARIANT,,"Car"."{car}"\n\n'
        for car, x, z in (("A", 2, 6), ("B", 3, 7))
    )
    parameters = read(cvx(variants))
    assert parameters["K"] == Curve("K", [1, 2], [5, 6], variant="Car=A")
    assert parameters.others == (Curve("K", [1, 3], [5, 7], variant="Car=B"),)


def test_variants_functions_and_display_names_are_written(tmp_path):
    speed = Axis([1, 2], name="N")
    table = Map("M", speed, [1, 2], [[1, 2], [3, 4]], functions=["F"], display_name="m", variant="Car=A,Gear=M")
    other = table.changed(axes=(speed, Axis([1, 3])), variant="Car=B,Gear=M")
    texts = [Text("T", "on", functions=("G",)), Text("T", "off", functions=("G",), variant="Manual")]
    parameters = ParameterSet([table], texts[:1], [speed], [other, texts[1]])
    write(parameters, tmp_path / "a.csv")
    assert read(tmp_path / "a.csv").everything == parameters.everything
    text = (tmp_path / "a.csv").read_bytes().decode()
    assert 'FUNCTION_HDR,,\r\n,"G","F"\r\n' in text
    assert 'VARIANT_HDR,,\r\n"Car","A","B"\r\n"Gear","M"\r\n"","Manual"\r\n' in text


def test_entries_without_calibration_numbers_are_skipped_with_a_remark(cvx):
    path = cvx(',B\nVAL_BLK,,"a","b"\n\n,R\nRESCALE_AXIS_PTS,,1,2\n\n,K\nVALUE,,1\n')
    assert list(read(path)) == ["K"]
    assert len(describe(path).findings) == 2


def test_a_table_whose_group_axis_is_not_named_is_skipped_with_a_remark(cvx):
    path = cvx(",K\nCURVE\n,,5,6\n\n,Axis\nAXIS_PTS,,1,2\n")
    assert describe(path).axes == (Axis([1, 2], name="Axis"),)
    assert "does not state which group axis" in str(describe(path).findings[0])


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (",K\nVALUE,,1,2\n", "line 4 (K): VALUE has 2 values, not one"),
        (",K\nVALUE\n", "line 4 (K): VALUE has 0 values"),
        (",K\nVALUE,,x\n", "line 4 (K): must be a number, got 'x'"),
        (",K\nVALUE,,nan\n", "must be a number, got 'nan'"),
        (",K\nVALUE,,1_0\n", "must be a number, got '1_0'"),
        (",K\nVAL_BLK,,\n", "VAL_BLK has no values"),
        (",K\nVAL_BLK,,1,2\n,,3\n", "VAL_BLK has rows of [1, 2] values"),
        (",K\nASCII,,1\n", "ASCII contains no text"),
        (",K\nCURVE\n,,1,2\n", "CURVE has no record X_AXIS_PTS. The file may be truncated"),
        (",K\nCURVE\n,,1,2,3\n" + X2, "line 5 (K): the row has 3 values, but the x axis has 2"),
        (",K\nMAP\n\n,,1,2\n" + X2 + Y2, "MAP has 1 row of values, but its axis requires 2"),
        (",K\nMAP\n\n,,1,2\n,,3\n" + X2 + Y2, "line 7 (K): the row has 1 value, but the x axis has 2"),
        (",K\nX_AXIS_PTS\n", "X_AXIS_PTS has no breakpoints"),
        (",K\nVALUE,,1\n\n,K\nVALUE,,2\n", "K is already defined in line 4, with other values"),
        (',K\nVALUE,,1\n\n,K\nASCII,,"2"\n', "is already defined in line"),
        ("VALUE,,1\n", "VALUE has no identifier"),
        (";K\nVALUE;;1\n", "contains no record whose cells are separated by ','"),
    ],
)
def test_errors_are_reported_with_their_line(cvx, body, message):
    assert any(message in finding for finding in findings(cvx(body)))


def test_the_layout_is_that_of_inca(tmp_path):
    speed = Axis([1, 2], unit="rpm", name="AxisSpeed")
    write(
        ParameterSet([Map("M", [1, 2], [7, 8], [[1, 3], [2, 4]], unit="Nm"), Curve("C", speed, [5, 6])]),
        tmp_path / "a.csv",
    )
    assert (tmp_path / "a.csv").read_bytes().decode().split("\r\n") == [
        'CALIBRATION VALUES V2.1,.,*,"",',
        "",
        *(",M", "MAP,", "", ':"Nm":,,1.0,2.0', ",,3.0,4.0", ""),
        *(",M", "X_AXIS_PTS,,1.0,2.0", "", ",M", "Y_AXIS_PTS,,7.0,8.0", ""),
        *(",C", "CURVE,AxisSpeed", ",,5.0,6.0", ""),
        *(",AxisSpeed", 'AXIS_PTS,:"rpm":,1.0,2.0', ""),
    ]


def test_parameters_that_cvx_cannot_hold_are_refused_by_name(tmp_path):
    parameters = ParameterSet(
        [Cube("Q", [[1], [1], [1]], np.ones((1, 1, 1))), Scalar("N", np.inf), Scalar("a,b", 1), Scalar("T", 1)],
        [Text("T", "a"), Text("L", "a\nb")],
    )
    with pytest.raises(InputError) as caught:
        write(parameters, tmp_path / "a.csv")
    for name in ("Q", "N", "a,b", "T", "L"):
        assert f"a.csv {name}: " in str(caught.value)
    assert not list(tmp_path.iterdir())
