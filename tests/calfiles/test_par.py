"""CANape's parameter files: what is read of them, and that writing changes only numbers."""

import contextlib
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, recognise, write
from kennfeld.calfiles.merging import merge
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from tests.draws import few_or_many

HEAD = '"my ecu.a2l" 1 0 ECU\r\n;user\r\n; project\r\n\r\n'
BODY = (
    "Kp [FLOAT(32)] 0.080000001 ; 0.080\r\n"
    "Count ECU_1 [UINT(8)] 12 ; 12\r\n"
    "Scaled [INT(16)] 150 ; 1.5\r\n"
    "Mode [UINT(8)] 1 ; ON\r\n"
    "Part.Gain[2].k_f32 [FLOAT] -1.5e-3 ;\r\n"
    "Name [STRING(5)] 72 101 108 108 111 ; Hello\r\n"
)
BLOCK = ("Block", "INT(16),(1,4)", [1, -2, 3, 4], "")
MATRIX = ("Matrix", "FLOAT(64),(2,3)", [1, 2, 3, 4, 5, 6], "")
CURVE = ("Eta", "DOUBLE(64),(1,3)", [0.5, 0.75, 1.0], "X : 0 ; 0\r\nX : 10 ; 10\r\nX : 20 ; 20\r\n")
MAP = (
    "Torque",
    "FLOAT(32),(2,3)",
    [10, 20, 30, 40, 50, 60],
    "X : 700 ; 700\r\nX : 1000 ; 1000\r\nX : 1500 ; 1500\r\nY : 0 ; 0.0\r\nY : 50 ; 50.0\r\n",
)


def table(version, name, kind, values, axes):
    rows = [f"{value} ; {value}\r\n" for value in values]
    first = f"{name} [{kind}] " if version == "3.1" else f"{name} [{kind}]\r\n: "
    return first + ": ".join(rows) + axes


def text(version="3.1"):
    tables = "".join(table(version, *part) for part in (BLOCK, MATRIX, CURVE, MAP))
    return f"CANape PAR V{version}: {HEAD}{BODY}{tables}"


@pytest.fixture
def par(tmp_path):
    def write_text(content=None, name="start.par"):
        path = tmp_path / name
        path.write_bytes((text() if content is None else content).encode("cp1252"))
        return path

    return write_text


@pytest.mark.parametrize("version", ["3.1", "3.2"])
def test_labels_of_all_kinds(par, version):
    path = par(text(version))
    values = read(path)
    assert values["Kp"].value == 0.080000001
    assert values["Count"].value == 12
    assert values["Scaled"].value == 1.5
    assert values["Part.Gain[2].k_f32"].value == -1.5e-3
    assert {item.name: (item.kind, item.text) for item in values.texts} == {
        "Mode": ("enumeration", "ON"),
        "Name": ("text", "Hello"),
    }
    assert values["Block"].values.tolist() == [1, -2, 3, 4]
    assert values["Matrix"].values.tolist() == [[1, 4], [2, 5], [3, 6]]
    assert values["Eta"].axes[0].breakpoints.tolist() == [0, 10, 20]
    assert isinstance(values["Eta"], Curve)
    torque = values["Torque"]
    assert isinstance(torque, Map)
    assert torque.values[2, 0] == 30
    assert torque.values[0, 1] == 40
    assert [axis.breakpoints.tolist() for axis in torque.axes] == [[700, 1000, 1500], [0, 50]]
    assert describe(path).kind == f"CANape PAR {version}"
    assert recognise(path) == "PAR (CANape)"
    assert [f.message for f in describe(path).findings] == [
        "physical values with the digits that CANape displays: 1 label (Scaled)"
    ]


def test_cubes_and_tables_without_all_axes_are_blocks(par):
    rows = "".join(f": {k} ; {k}\r\n" for k in range(1, 13))
    path = par(f"CANape PAR V3.2: ~ 0 0 \r\nC [FLOAT(32),(2,2,3)]\r\n{rows}")
    block = read(path)["C"]
    assert block.kind == "block"
    assert block.values.shape == (3, 2, 2)
    assert block.values[1, 1, 0] == 5
    axis = "".join(f"X : {k} ; {k}\r\n" for k in range(3))
    path = par(f"CANape PAR V3.2: ~ 0 0 \r\nC [FLOAT(32),(2,2,3)]\r\n{rows}{axis}")
    assert read(path)["C"].kind == "block"
    assert "breakpoints for some of its axes only" in describe(path).findings[0].message
    axes = axis + "Y : 0 ; 0\r\nY : 1 ; 1\r\nZ : 5 ; 5\r\nZ : 6 ; 6\r\n"
    cube = read(par(f"CANape PAR V3.2: ~ 0 0 \r\nC [FLOAT(32),(2,2,3)]\r\n{rows}{axes}"))["C"]
    assert cube.kind == "cube"
    assert cube.values[1, 1, 0] == 5


def test_hexadecimal_values_are_numbers(par, tmp_path):
    values = read(par("CANape PAR V3.1: ~ 0 0 \r\nMask [UINT(16)] 738 ; 0x2E2\r\n"))
    assert values["Mask"].value == 738
    write(values.with_parameters(Scalar("Mask", 255.0)), tmp_path / "new.par")
    assert "Mask [UINT(16)] 255 ; 0xFF\r\n" in (tmp_path / "new.par").read_bytes().decode()


@pytest.mark.parametrize("shown", ["1,5", "1.5 bar", "-3 K"])
def test_a_text_like_a_number_is_not_read_as_a_word(par, shown):
    path = par(f"CANape PAR V3.1: ~ 0 0 \r\nK [INT(16)] 150 ; {shown}\r\nDrive [INT(16)] 1 ; 2WD\r\n")
    assert [item.text for item in read(path).texts] == ["2WD"]
    assert "K" not in read(path)
    assert "not physical values" in describe(path).findings[0].message


def test_integers_without_physical_values_are_reported(par):
    path = par("CANape PAR V3.2: ~ 0 0 \r\nA [UINT(8)] 7 ;\r\nB [INT(16),(1,2)]\r\n: 1 ;\r\n: 2 ;\r\n")
    assert read(path)["B"].values.tolist() == [1, 2]
    assert str(describe(path).findings[0]).startswith(
        "start.par: integers without physical values, read as the control unit stores them: 2 labels (A, B)."
    )


def test_an_axis_that_falls_is_turned_and_written_as_it_was(par, tmp_path):
    map_text = "Map [FLOAT(32),(2,2)] 1 ; 1\r\n: 2 ; 2\r\n: 3 ; 3\r\n: 4 ; 4\r\n"
    content = f"CANape PAR V3.1: ~ 0 0 \r\n{map_text}X : 5 ; 5\r\nX : 4 ; 4\r\nY : 0 ; 0\r\nY : 1 ; 1\r\n"
    values = read(par(content))
    assert values["Map"].axes[0].breakpoints.tolist() == [4, 5]
    assert values["Map"].values.tolist() == [[2, 4], [1, 3]]
    write(values, tmp_path / "same.par")
    assert (tmp_path / "same.par").read_bytes() == content.encode("cp1252")
    write(values.with_parameters(values["Map"].with_values([[9, 4], [1, 3]])), tmp_path / "new.par")
    assert ": 9.0 ; 9.0" in (tmp_path / "new.par").read_text("cp1252")
    assert read(tmp_path / "new.par")["Map"].values.tolist() == [[9, 4], [1, 3]]


def test_unreadable_entries_are_skipped_with_a_warning(par):
    path = par(
        "CANape PAR V3.1: ~ 0 0 \r\nWords [UINT(8),(1,2)] 0 ; OFF\r\n: 1 ; ON\r\nnot a label\r\n"
        "Falling [FLOAT(32),(1,2)] 0 ; 0\r\n: 1 ; 1\r\nX : 5 ; 5\r\nX : 5 ; 5\r\nKp [FLOAT(32)] 1 ; 1\r\n"
    )
    assert list(read(path)) == ["Kp"]
    assert [f.message.partition(":")[0] for f in describe(path).findings] == [
        "skipped, since it is not a label",
        "skipped",
        "skipped",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("K [FLOAT(32)] x ; 1\r\n", "line 2 (K): must be a number, got 'x'"),
        ("K [FLOAT(32),(1,3)] 1 ; 1\r\n: 2 ; 2\r\n", "line 2 (K): has 2 values, but 3 by its sizes"),
        ("K [FLOAT(32),(1,2)] 1 ; 1\r\n: 2 ; 2\r\nX : 1 ; 1\r\n", "line 2 (K): has 1 X breakpoint, but 2 by its sizes"),
        ("K [FLOAT(32),(0,2)] 1 ; 1\r\n", "must have 1 to 10000000 numbers"),
        (": 1 ; 1\r\n", "line 2: a number without a label"),
        ("K [FLOAT(32)] 1 ; 1\r\nK [FLOAT(32)] 2 ; 2\r\n", "K is already defined in line 2, with other values"),
        ("T [STRING(2)] 65 700 ; A\r\n", "must be a character code, 0 to 255, got '700'"),
    ],
)
def test_damage_is_named_with_its_line(par, content, message):
    with pytest.raises(InputError) as caught:
        read(par("CANape PAR V3.1: ~ 0 0 \r\n" + content))
    assert message in str(caught.value)


def test_an_unchanged_set_is_the_same_file(par, tmp_path):
    for version in ("3.1", "3.2"):
        path = par(text(version))
        write(read(path), tmp_path / "new.par")
        assert (tmp_path / "new.par").read_bytes() == path.read_bytes()


def test_only_changed_numbers_are_rewritten(par, tmp_path):
    path = par()
    values = read(path)
    torque = values["Torque"]
    table = torque.values.copy()
    table[2, 0] = 31.25
    changed = values.with_parameters(torque.changed(values=table), Scalar("Kp", 0.09), Scalar("Count", 13.4))
    findings = write(changed, tmp_path / "new.par")
    expected = (
        text()
        .replace(": 30 ; 30\r\n", ": 31.25 ; 31.25\r\n")
        .replace("0.080000001 ; 0.080", "0.09 ; 0.09")
        .replace("12 ; 12", "13 ; 13")
    )
    assert (tmp_path / "new.par").read_bytes() == expected.encode("cp1252")
    assert [str(f) for f in findings] == ["new.par Count: rounded to integers, as stored; the largest change is 0.4"]


def test_breakpoints_and_texts_can_change(par, tmp_path):
    path = par()
    values = read(path)
    eta = values["Eta"]
    moved = Curve("Eta", [0, 12, 20], eta.values)
    name = next(item for item in values.texts if item.name == "Name")
    changed = values.merged(ParameterSet([moved], [replace(name, text="Hi")]))
    write(changed, tmp_path / "new.par")
    again = read(tmp_path / "new.par")
    assert again["Eta"].axes[0].breakpoints.tolist() == [0, 12, 20]
    assert "Name [STRING(5)] 72 105 0 0 0 ; Hi\r\n" in (tmp_path / "new.par").read_bytes().decode("cp1252")
    assert next(item.text for item in again.texts if item.name == "Name") == "Hi"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Scalar("Scaled", 2.0), "Scaled: is stored with a conversion that the file does not state"),
        (Scalar("Count", 256.0), r"Count: must be stored as 0 to 255, in UINT(8), got 256 for 256"),
        (Scalar("Block", 1.0), "Block: is a scalar, but a block 4 in the file"),
        (Scalar("Kp", np.nan), "Kp: a parameter file cannot store non-finite values"),
        (Scalar("Mode", 0.0), "Mode: is a text in one file and a number in the other"),
    ],
)
def test_what_the_file_cannot_take_is_an_error(par, tmp_path, change, message):
    values = read(par())
    changed = ParameterSet([change], origin=values.origin)
    with pytest.raises(InputError) as caught:
        write(changed, tmp_path / "new.par")
    assert message in str(caught.value)
    assert not (tmp_path / "new.par").exists()


def test_a_zero_does_not_tell_the_conversion_of_an_integer(par, tmp_path):
    values = read(par("CANape PAR V3.1: ~ 0 0 \r\nK [UINT(8)] 0 ; 0.0\r\n"))
    with pytest.raises(InputError, match="a conversion that the file does not state"):
        write(values.with_parameters(Scalar("K", 1.0)), tmp_path / "new.par")


A2L = """ASAP2_VERSION 1 60
/begin PROJECT P "" /begin MODULE M ""
/begin COMPU_METHOD Tenth "" RAT_FUNC "%6.2" "Nm" COEFFS 0 100 0 0 0 1 /end COMPU_METHOD
/begin COMPU_METHOD Half "" LINEAR "%6.1" "rpm" COEFFS_LINEAR 0.5 -20 /end COMPU_METHOD
/begin COMPU_METHOD Switch "" TAB_VERB "%3.0" "" COMPU_TAB_REF Words /end COMPU_METHOD
/begin COMPU_VTAB Words "" TAB_VERB 2 0 "OFF" 1 "ON" /end COMPU_VTAB
/begin CHARACTERISTIC Scaled "a scaled one" VALUE 0x0 L 0 Tenth -300 300 /end CHARACTERISTIC
/begin CHARACTERISTIC Mode "" VALUE 0x2 L 0 Switch 0 1 /end CHARACTERISTIC
/begin CHARACTERISTIC Curve "" CURVE 0x4 L 0 Tenth -300 300
/begin AXIS_DESCR STD_AXIS Speed Half 2 -20 100 /end AXIS_DESCR /end CHARACTERISTIC
/end MODULE /end PROJECT
"""
SCALED = (
    "CANape PAR V3.1: ecu.a2l 1 0 ECU\r\nScaled [INT(16)] 150 ; 1.5\r\nMode [UINT(8)] 1 ; ON\r\n"
    "Curve [INT(16),(1,2)] 100 ; 1.00\r\n: 133 ; 1.3\r\nX : 40 ; 0\r\nX : 45 ; 2.5\r\n"
)


@pytest.mark.parametrize("with_a2l", [False, True])
def test_the_a2l_file_states_conversions_and_units(par, tmp_path, with_a2l):
    a2l = tmp_path / ("other.a2l" if with_a2l else "ecu.a2l")
    a2l.write_text(A2L)
    path = par(SCALED)
    values = read(path, a2l if with_a2l else None)
    curve = values["Curve"]
    assert (values["Scaled"].value, values["Scaled"].unit, values["Scaled"].description) == (1.5, "Nm", "a scaled one")
    assert curve.values.tolist() == [1, 1.33]
    assert curve.axes[0].breakpoints.tolist() == [0, 2.5]
    assert (curve.axes[0].unit, curve.axes[0].input) == ("rpm", "Speed")
    assert describe(path, a2l if with_a2l else None).findings == ()
    mode = replace(values.texts[0], text="OFF")
    changed = Curve("Curve", curve.axes[0].changed(breakpoints=[0, 3]), [1, 1.427], unit="Nm")
    findings = write(values.merged(ParameterSet([Scalar("Scaled", -0.25), changed], [mode])), tmp_path / "new.par")
    assert (tmp_path / "new.par").read_bytes().decode() == SCALED.replace("150 ; 1.5", "-25 ; -0.2").replace(
        "1 ; ON", "0 ; OFF"
    ).replace("133 ; 1.3", "143 ; 1.4").replace("45 ; 2.5", "46 ; 3.0")
    assert [str(f) for f in findings] == ["new.par Curve: rounded to integers, as stored; the largest change is 0.003"]
    assert read(tmp_path / "new.par", a2l)["Curve"].values.tolist() == [1, 1.43]


def test_an_a2l_file_of_another_program_is_not_used(par, tmp_path):
    (tmp_path / "ecu.a2l").write_text(A2L.replace("0 100 0 0 0 1", "0 10 0 0 0 1"))
    path = par(SCALED)
    assert read(path)["Scaled"].value == 1.5
    message = describe(path).findings[0].message
    assert (
        message == "the physical values do not follow from the A2L file, which is not used for 2 labels (Scaled, Curve)"
    )


def test_a_damaged_a2l_file_beside_it_is_reported(par, tmp_path):
    (tmp_path / "ecu.a2l").write_text(A2L[: A2L.index("/end MODULE")])
    path = par(SCALED)
    assert read(path)["Scaled"].value == 1.5
    assert any(f.message.startswith("ecu.a2l is not used: ecu.a2l") for f in describe(path).findings)


def test_a_word_that_the_a2l_file_lacks_is_an_error(par, tmp_path):
    (tmp_path / "ecu.a2l").write_text(A2L)
    values = read(par(SCALED))
    with pytest.raises(InputError, match="Mode: 'AUTO' is not a word of Switch"):
        write(values.merged(ParameterSet([], [replace(values.texts[0], text="AUTO")])), tmp_path / "new.par")


def test_a_set_of_another_file_needs_a_parameter_file(tmp_path):
    with pytest.raises(InputError, match=r"kennfeld merge base\.par new\.dcm -o new\.par"):
        write(ParameterSet([Scalar("Kp", 1.0)]), tmp_path / "new.par")


def test_values_of_other_files_are_merged_into_a_parameter_file(par, tmp_path):
    write(ParameterSet([Scalar("Kp", 0.5), Scalar("New", 1.0)]), tmp_path / "new.dcm")
    merged = merge([("start.par", read(par())), ("new.dcm", read(tmp_path / "new.dcm"))]).parameters
    findings = write(merged, tmp_path / "out.par")
    assert read(tmp_path / "out.par")["Kp"].value == 0.5
    assert [str(finding) for finding in findings] == [
        "out.par: left out, since the file does not have them: 1 label (New)"
    ]


@few_or_many(
    st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=6, max_size=6), few=20, many=40
)
def test_numbers_read_back_exactly(par, tmp_path, numbers):
    values = read(par())
    changed = values.with_parameters(values["Torque"].changed(values=np.reshape(numbers, (3, 2))))
    write(changed, tmp_path / "new.par")
    assert read(tmp_path / "new.par") == changed


def test_a_file_cut_off_anywhere_gives_a_set_or_findings(par):
    content = text()
    for cut in range(0, len(content), 3):
        with contextlib.suppress(InputError):
            read(par(content[:cut]))


@pytest.mark.parametrize("count", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_give_a_set_or_findings(par, tmp_path, count):
    draw = random.Random(1)
    content = text("3.2")
    for _ in range(count):
        letters = list(content)
        for _ in range(draw.randrange(1, 8)):
            letters[draw.randrange(20, len(letters))] = draw.choice("0123456789;:[](),XYZ .eE-\n\0ä")
        path = par("".join(letters))
        with contextlib.suppress(InputError):
            write(read(path), tmp_path / "new.par")
