import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.texts import Text

HEAD = "KONSERVIERUNG_FORMAT 2.0\n\n"


@pytest.fixture
def dcm(written):
    return lambda body, head=HEAD: written(head + body)


def findings(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return [str(finding) for finding in caught.value.findings]


def test_a_scalar_has_its_unit_and_description(dcm):
    path = dcm('FESTWERT K.x[3]\n  LANGNAME "a gain"\n  EINHEIT_W "1/s"\n  WERT -2.5E-3\nEND')
    assert read(path)["K.x[3]"] == Scalar("K.x[3]", -2.5e-3, unit="1/s", description="a gain")


def test_a_block_may_wrap_its_rows_over_lines(dcm):
    path = dcm("FESTWERTEBLOCK B 7\n WERT 1 2 3 4 5 6\n WERT 7\nEND\n")
    assert read(path)["B"] == Block("B", [1, 2, 3, 4, 5, 6, 7])


@pytest.mark.parametrize("header", ["B 3 @ 2", "B 3@2"])
def test_a_block_of_two_dimensions_is_indexed_by_x_first(dcm, header):
    path = dcm(f"FESTWERTEBLOCK {header}\n WERT 1 2\n WERT 3\n WERT 4 5 6\nEND\n")
    assert read(path)["B"].values.tolist() == [[1, 4], [2, 5], [3, 6]]


@pytest.mark.parametrize("kind", ["KENNLINIE", "FESTKENNLINIE", "GRUPPENKENNLINIE"])
def test_a_curve_of_any_kind_is_a_curve(dcm, kind):
    path = dcm(f'{kind} C 3\n EINHEIT_X "rpm"\n ST/X 1 2\n ST/X 3\n WERT 4 5 6\nEND')
    assert read(path)["C"] == Curve("C", Axis([1, 2, 3], unit="rpm"), [4, 5, 6])


@pytest.mark.parametrize("kind", ["KENNFELD", "FESTKENNFELD", "GRUPPENKENNFELD"])
def test_a_map_of_any_kind_is_turned_to_x_first(dcm, kind):
    body = ' EINHEIT_X "a"\n EINHEIT_Y "b"\n ST/X 1 2 3\n ST/Y 10\n WERT 1 2\n WERT 3\n ST/Y 20\n WERT 4 5 6\nEND'
    member = read(dcm(f"{kind} M 3 2\n{body}"))["M"]
    assert member == Map("M", Axis([1, 2, 3], unit="a"), Axis([10, 20], unit="b"), [[1, 4], [2, 5], [3, 6]])


def test_texts_are_carried(dcm):
    path = dcm('FESTWERT S\n TEXT "on"\nEND\nTEXTSTRING T\n LANGNAME "d"\n TEXT "say \\"yes\\""\nEND')
    assert read(path).texts == (Text("S", "on", kind="enumeration"), Text("T", 'say "yes"', "d"))


GROUP = "GRUPPENKENNLINIE C 2\n{comment}\n ST/X 1 2\n WERT 3 4\nEND\n"


@pytest.mark.parametrize("comment", ["*SSTX a b", "*SSTX\ta b", "* SSTX a b  ", "   *SSTX a b"])
def test_a_comment_names_the_group_axis(dcm, comment):
    assert read(dcm(GROUP.format(comment=comment)))["C"].axes[0].name == "a b"


def test_a_group_axis_of_a_module_is_the_distribution_of_the_same_name(dcm):
    distribution = "STUETZSTELLENVERTEILUNG distrib 2\n*SST\n ST/X 1 2\nEND\n"
    parameters = read(dcm(GROUP.format(comment="*SSTX distrib\\Module") + distribution))
    assert parameters["C"].axes[0].name == "distrib"
    assert [axis.name for axis in parameters.axes] == ["distrib"]


def test_only_group_tables_share_their_axis(dcm):
    assert read(dcm("KENNLINIE C 2\n*SSTX a\n ST/X 1 2\n WERT 3 4\nEND"))["C"].axes[0].name == ""


def test_a_table_that_contradicts_its_group_axis_keeps_its_own_breakpoints_with_a_remark(dcm):
    other = "GRUPPENKENNLINIE D 3\n*SSTX a\n ST/X 1 2 3\n WERT 3 4 5\nEND\n"
    path = dcm(GROUP.format(comment="*SSTX a") + other)
    assert read(path)["D"].axes[0] == Axis([1, 2, 3])
    assert "other breakpoints than the group axis a" in str(describe(path).findings[0])


def test_a_group_table_of_dcm_1_takes_its_breakpoints_from_the_distribution(dcm):
    body = "STUETZSTELLENVERTEILUNG a 2\n ST/X 5 6\nEND\nGRUPPENKENNLINIE C 2\n*SSTX a\n WERT 3 4\nEND\n"
    assert read(dcm(body, head=""))["C"].axes[0] == Axis([5, 6], name="a")


def test_a_fixed_table_of_dcm_1_without_breakpoints_is_skipped_with_a_remark(dcm):
    path = dcm("FESTKENNLINIE C 2\n WERT 3 4\nEND\nFESTWERT K\n WERT 1\nEND", head="")
    assert list(read(path)) == ["K"]
    assert "no x breakpoints" in str(describe(path).findings[0])


@pytest.mark.parametrize(
    "body",
    [
        'KENNLINIE C 2\n ST_TX/X "a" "b"\n WERT 1 2\nEND',
        'KENNFELD C 1 1\n ST/X 1\n ST_TX/Y "a"\n WERT 1\nEND',
        'FESTWERTEBLOCK C 2\n TEXT "a" "b"\nEND',
        'KENNLINIE C 2\n ST/X 1 2\n TEXT "a" "b"\nEND',
    ],
)
def test_text_tables_and_text_axes_are_skipped_with_a_remark(dcm, body):
    path = dcm(body + "\nFESTWERT K\n WERT 1\nEND")
    assert list(read(path)) == ["K"]
    assert "skipped" in str(describe(path).findings[0])


def test_the_lists_at_the_head_and_unknown_lines_do_not_disturb(dcm):
    head = 'MODULKOPF a "b"\nMODULKOPF "c"\nFUNKTIONEN\n FKT F "1" "d"\nEND\nVARIANTENKODIERUNG\n KRITERIUM a b\nEND\n'
    path = dcm(head + "\nFESTWERT K\n\n! c\n. c\n* c\n FUNKTION F\n BRANDNEW 7\n WERT 1\nEND")
    assert read(path)["K"].value == 1
    assert "unknown keyword BRANDNEW" in str(describe(path).findings[0])


def test_an_unknown_kind_of_block_is_skipped_with_a_remark(dcm):
    path = dcm("QUADER Q 2 2 2\n WERT 1 2\nEND\nFESTWERT K\n WERT 1\nEND")
    assert list(read(path)) == ["K"]
    assert "unknown keyword QUADER" in str(describe(path).findings[0])


def test_the_first_of_several_variants_counts_and_the_others_are_kept(dcm):
    path = dcm("FESTWERT K\n VAR Car=A\n WERT 1\nEND\nFESTWERT K\n VAR Car = B , Gear=2\n WERT 2\nEND")
    parameters = read(path)
    assert (parameters["K"].value, parameters["K"].variant) == (1, "Car=A")
    assert parameters.variants == ("Car=A", "Car=B,Gear=2")
    assert parameters.in_variant("Car=B,Gear=2")["K"].value == 2
    assert describe(path).findings == ()


def test_the_values_of_variants_below_a_value_are_kept(dcm):
    path = dcm('FESTWERT K\n WERT 1\n VAR A=2,B=3\nEND\nTEXTSTRING T\n TEXT "a, b"\n VAR A="c, d"\nEND')
    parameters = read(path)
    assert (parameters["K"].value, parameters.in_variant("B")["K"].value) == (1, 3)
    assert [text.text for text in parameters.in_variant("A").texts] == ["c, d"]
    assert parameters.in_variant("B").texts == parameters.texts


def test_a_criterion_below_a_value_is_named_by_the_variant_coding(dcm):
    head = "VARIANTENKODIERUNG\n KRITERIUM Engine 1 2\nEND\n"
    path = dcm(head + "".join(f"FESTWERT K\n WERT {value}\n VAR Engine={value}\nEND\n" for value in (1, 2)))
    assert read(path).variants == ("Engine=1", "Engine=2")


def test_functions_and_the_short_name_are_read(dcm):
    member = read(dcm('FESTWERT K\n FUNKTION F1 "F 2"\n FUNKTION F1\n DISPLAYNAME k\n WERT 1\nEND'))["K"]
    assert (member.functions, member.display_name) == (("F1", "F 2"), "k")


def test_the_same_block_twice_is_one(dcm):
    assert read(dcm("FESTWERT K\n WERT 1\nEND\n" * 2))["K"].value == 1


def test_a_block_twice_with_other_values_is_refused(dcm):
    path = dcm("FESTWERT K\n WERT 1\nEND\nFESTWERT K\n WERT 2\nEND")
    assert findings(path) == [
        "start.dcm line 6 (K): K is already defined in line 3, with other values. Keep one of the two."
    ]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("FESTWERT K\n WERT 1 2\nEND", "line 3 (K): has 2 values, but its header states 1"),
        ("FESTWERT K\nEND", "line 3 (K): has 0 values"),
        ("FESTWERT K 3\n WERT 1\nEND", "line 3 (K): FESTWERT needs only a name"),
        ("FESTWERT\n WERT 1\nEND", "line 3: FESTWERT needs only a name"),
        ("FESTWERT K\n WERT 1,5\nEND", "line 4 (K): must be a finite number, got '1,5'. Write a decimal point."),
        ("FESTWERT K\n WERT 1_5\nEND", "line 4 (K): must be a finite number, got '1_5'"),
        ("FESTWERT K\n WERT nan\nEND", "line 4 (K): must be a finite number, got 'nan'"),
        ("FESTWERT K\n WERT 1e999\nEND", "line 4 (K): must be a finite number, got '1e999'"),
        ("FESTWERTEBLOCK B 3 @ 2\n WERT 1 2 3\nEND", "has 3 values, but its header states 3 x 2 = 6"),
        ("FESTWERTEBLOCK B 0\nEND", "FESTWERTEBLOCK needs a name and its size"),
        ("KENNLINIE C 2\n ST/X 1\n WERT 1 2\nEND", "line 4 (C): has 1 x breakpoint, but its header states 2"),
        ("KENNLINIE C 2\n WERT 1 2\nEND", "has no x breakpoints. Add a line ST/X."),
        ("KENNLINIE C x\n ST/X 1\n WERT 1\nEND", "KENNLINIE needs a name and one size"),
        ("KENNLINIE C 1000000000\n ST/X 1\n WERT 1\nEND", "has 1 x breakpoint, but its header states 1000000000"),
        ("FESTWERTEBLOCK B 999999999 @ 999999999\n WERT 1\nEND", "has 1 value, but its header states"),
        (
            "KENNFELD M 2 2\n ST/X 1 2\n ST/Y 1\n WERT 1 2 3\n ST/Y 2\n WERT 4\nEND",
            "line 5 (M): the row at y = 1 has 3 values, but the header states 2",
        ),
        ("FESTWERT K\n WERT 1\nFESTWERT L\n WERT 1\nEND", "line 3 (K): FESTWERT has no END"),
        ("KENNLINIE C 2\n ST/X 1 2\n WE", "line 3 (C): KENNLINIE has no END. The file may be truncated"),
        ("FESTWERT K\n WERT 1\nEND\nEND", "line 6: END without a block"),
        ("FESTWERT K\n WERT 1\nEND\nWERT 2", "line 6: WERT is outside any block"),
        ("KENLINIE C 2\nEND", "line 3 (C): unknown keyword KENLINIE. Did you mean KENNLINIE?"),
        ('FESTWERT K\n WERT 1\nEND\nTEXTSTRING K\n TEXT "a"\nEND', "K is already defined in line 3, as a text"),
        ('TEXTSTRING K\n TEXT "a"\nEND\nFESTWERT K\n WERT 1\nEND', "K is already defined in line 3, as a number"),
        ('TEXTSTRING K\n TEXT "a"\nEND\nTEXTSTRING K\n TEXT "b"\nEND', "already defined in line 3, with another text"),
        (
            "STUETZSTELLENVERTEILUNG a 1\n ST/X 1\nEND\nSTUETZSTELLENVERTEILUNG a 1\n ST/X 2\nEND",
            "already defined in line 3, with other breakpoints",
        ),
    ],
)
def test_errors_are_reported_with_their_line(dcm, body, message):
    assert any(message in finding for finding in findings(dcm(body)))


def test_all_problems_of_a_file_are_reported_at_once_in_order(dcm):
    path = dcm("FESTWERT K\n WERT x\nEND\nKENNLINIE C 2\n ST/X 1\n WERT 1\nEND\nFESTWERT L\n WERT")
    assert [finding.split(":")[0] for finding in findings(path)] == [
        "start.dcm line 4 (K)",
        "start.dcm line 6 (C)",
        "start.dcm line 7 (C)",
        "start.dcm line 10 (L)",
    ]


def test_a_garbled_file_of_many_unknown_words_is_answered(dcm):
    path = dcm("\n".join(f"W{i:x}RT {i}\nEND" for i in range(3000)))
    assert np.size(findings(path)) >= 1


def test_a_table_without_an_axis_unit_has_that_of_its_group_axis(dcm):
    distribution = 'STUETZSTELLENVERTEILUNG a 2\n*SST\n EINHEIT_X "rpm"\n ST/X 1 2\nEND\n'
    parameters = read(dcm(distribution + GROUP.format(comment="*SSTX a")))
    assert parameters["C"].axes[0] == Axis([1, 2], unit="rpm", name="a")
