"""Images as calibration files: found by their A2L file, read, converted, compared and written by the commands."""

import json

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles import describe, describe_a2l, endings, read, write
from kennfeld.cli import run
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from tests.calfiles.a2l_files import ADDRESS, axis, hex_file, label, layout, method, module, s_file

TEXT = module(
    layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"),
    method("CM", "LINEAR", "COEFFS_LINEAR 0.5 0", "Nm"),
    label("VALUE", name="K", conversion="CM"),
    label("CURVE", axis("FIX_AXIS", 3, "FIX_AXIS_PAR_DIST 0 10 3"), name="C", conversion="CM", address=ADDRESS + 1),
    '/begin FUNCTION Torque "" /begin DEF_CHARACTERISTIC K C /end DEF_CHARACTERISTIC /end FUNCTION',
)
MEMORY = {ADDRESS: bytes([3, 2, 4, 6])}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ecu.a2l").write_bytes(TEXT)
    (tmp_path / "ecu.hex").write_bytes(hex_file(MEMORY))
    (tmp_path / "ecu.s19").write_bytes(s_file(MEMORY))
    return tmp_path


def error(message, *arguments, **further):
    with pytest.raises(InputError) as caught:
        message(*arguments, **further)
    return str(caught.value)


@pytest.mark.parametrize("name", ["ecu.hex", "ecu.s19"])
def test_an_image_is_read_through_the_a2l_file_beside_it(folder, name):
    parameters = kf.read_parameters(folder / name)
    assert parameters["K"].value == 1.5
    assert parameters["C"].values.tolist() == [1, 2, 3]
    assert parameters["K"].functions == ("Torque",)
    described = describe(folder / name)
    assert described.kind.endswith("with ecu.a2l")


def test_the_only_a2l_file_in_the_folder_will_do(folder):
    (folder / "ecu.a2l").rename(folder / "other.A2L")
    assert read(folder / "ecu.hex")["K"].value == 1.5


def test_a_description_may_be_named(folder):
    (folder / "elsewhere").mkdir()
    named = (folder / "ecu.a2l").rename(folder / "elsewhere" / "x.a2l")
    assert kf.read_parameters(folder / "ecu.hex", a2l=named)["K"].value == 1.5
    assert "its folder contains none. Specify it: --a2l FILE, or" in error(read, folder / "ecu.hex")
    assert "A2L file not found. Did you mean x.a2l?" in error(read, folder / "ecu.hex", named.with_name("y.a2l"))


def test_several_descriptions_are_a_question(folder):
    for name in ("one.a2l", "two.a2l"):
        (folder / name).write_bytes(TEXT)
    (folder / "ecu.a2l").unlink()
    assert "its folder contains one.a2l, two.a2l. Specify the right one: --a2l FILE, or" in error(
        read, folder / "ecu.hex"
    )


def test_a_file_that_is_included_lies_beside(folder):
    inner = TEXT.decode().partition('/begin MODULE M ""')[2].partition("/end MODULE")[0]
    (folder / "parts").mkdir()
    (folder / "parts" / "labels.a2l").write_text(inner, encoding="utf-8")
    text = '/begin PROJECT P "" /begin MODULE M "" /include "parts\\labels.a2l" /end MODULE /end PROJECT'
    (folder / "ecu.a2l").write_text(text, encoding="utf-8")
    assert read(folder / "ecu.hex")["K"].value == 1.5
    (folder / "parts" / "labels.a2l").unlink()
    assert ": cannot be read. Its path is relative to" in error(read, folder / "ecu.hex")


@pytest.mark.parametrize("place", ["parts/inner/types.a2l", "inner/types.a2l"])
def test_a_file_that_an_included_file_includes_lies_beside_that_or_the_main_file(folder, place):
    inner = TEXT.decode().partition('/begin MODULE M ""')[2].partition("/end MODULE")[0]
    for path, text in (("parts/labels.a2l", '/include "inner/types.a2l "'), (place, inner)):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    text = '/begin PROJECT P "" /begin MODULE M "" /include parts/labels.a2l /end MODULE /end PROJECT'
    (folder / "ecu.a2l").write_text(text, encoding="utf-8")
    assert read(folder / "ecu.hex")["K"].value == 1.5


def test_of_two_included_files_the_one_beside_the_including_file_counts(folder):
    inner = TEXT.decode().partition('/begin MODULE M ""')[2].partition("/end MODULE")[0]
    (folder / "parts").mkdir()
    (folder / "parts" / "labels.a2l").write_text('/include "types.a2l"', encoding="utf-8")
    (folder / "parts" / "types.a2l").write_text(inner, encoding="utf-8")
    (folder / "types.a2l").write_text(inner.replace(" K ", " Wrong "), encoding="utf-8")
    text = '/begin PROJECT P "" /begin MODULE M "" /include parts/labels.a2l /end MODULE /end PROJECT'
    (folder / "ecu.a2l").write_text(text, encoding="utf-8")
    assert "K" in read(folder / "ecu.hex")


FRAGMENT = '/* labels */\n/begin COMPU_METHOD CM "" IDENTICAL "%5.2" "bar"\n/end COMPU_METHOD\n'


def test_a_fragment_of_an_a2l_file_is_named_as_such(folder):
    (folder / "part.a2l").write_text(FRAGMENT, encoding="utf-8")
    message = (
        "part.a2l: is a fragment of an A2L file: it starts with COMPU_METHOD, without an enclosing PROJECT "
        "and MODULE. Pass the A2L file that includes it."
    )
    assert error(read, folder / "part.a2l") == message
    assert error(describe_a2l, folder / "part.a2l") == message
    assert error(read, folder / "ecu.hex", folder / "part.a2l") == message


def test_a_module_without_a_project_is_a_description(folder):
    module = TEXT.decode().partition('/begin MODULE M ""')[2].partition("/end MODULE")[0]
    (folder / "part.a2l").write_text(f'/begin MODULE M ""{module}/end MODULE', encoding="utf-8")
    assert read(folder / "ecu.hex", folder / "part.a2l")["K"].value == 1.5


def test_an_a2l_file_alone_holds_no_values(folder):
    assert "ecu.a2l: is an A2L description, which contains no values" in error(read, folder / "ecu.a2l")
    a2l = describe_a2l(folder / "ecu.a2l")
    assert [one.name for one in a2l.labels] == ["K", "C"]


def test_a_set_from_an_image_is_saved_into_it(folder):
    parameters = kf.read_parameters(folder / "ecu.hex")
    parameters.save(folder / "same.hex")
    assert (folder / "same.hex").read_bytes() == (folder / "ecu.hex").read_bytes()
    parameters.with_parameters(parameters["K"].with_values(4.0)).save(folder / "new.hex")
    assert read(folder / "new.hex", folder / "ecu.a2l")["K"].value == 4.0


def test_a_set_from_elsewhere_needs_an_image(folder):
    values = ParameterSet([Scalar("K", 2.0)])
    assert "writing an image requires an existing image to modify, but none is given" in error(
        write, values, folder / "new.hex"
    )
    remarks = write(values, folder / "new.s19", folder / "ecu.s19")
    assert [str(one) for one in remarks] == [
        "new.s19: checksums of the control unit are not updated; the flash tool must do it"
    ]
    assert (folder / "new.s19").read_bytes() == s_file({ADDRESS: bytes([4, 2, 4, 6])})


def test_the_ending_must_match_the_format_of_the_image(folder):
    message = error(kf.read_parameters(folder / "ecu.hex").save, folder / "new.s19")
    assert "ecu.hex is Intel HEX, which has other endings than .s19. Use .hex, .ihex." in message
    assert {".hex", ".s19"} <= set(endings())
    with pytest.raises(ArgumentError, match="must end like a calibration file"):
        write(ParameterSet(), folder / "new.bin")


def test_a_damaged_image_is_refused_with_its_lines(folder):
    lines = hex_file(MEMORY).replace(b"03020406", b"03020407")
    (folder / "ecu.hex").write_bytes(lines)
    assert "ecu.hex line 2: has the checksum DD, but its bytes give DC" in error(read, folder / "ecu.hex")


def test_info_shows_descriptions_and_images(folder, capsys):
    assert run(["info", str(folder / "ecu.a2l")]) == 0
    shown = capsys.readouterr().out
    assert "A2L description (ASAP2 1.71, project P), 2 labels, 0 group axes, 0 measurements" in shown
    assert "0x1001" in shown
    assert run(["info", str(folder / "ecu.a2l"), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["content"] == "a2l"
    assert info["labels"][1] | {"description": ""} == {
        "name": "C",
        "kind": "curve",
        "shape": [3],
        "unit": "Nm",
        "lower": 0.0,
        "upper": 0.0,
        "address": 4097,
        "functions": ["Torque"],
        "description": "",
        "read_only": False,
    }
    assert run(["info", str(folder / "ecu.hex"), "--json"]) == 0
    assert [one["name"] for one in json.loads(capsys.readouterr().out)["parameters"]] == ["K", "C"]


def test_convert_goes_both_ways(folder, capsys):
    assert run(["convert", str(folder / "ecu.hex"), str(folder / "now.dcm")]) == 0
    assert read(folder / "now.dcm")["C"].values.tolist() == [1, 2, 3]
    write(ParameterSet([Scalar("K", 7.3, unit="Nm"), Scalar("Other", 1.0)]), folder / "new.json")
    status = run(["convert", str(folder / "new.json"), str(folder / "new.hex"), "--image", str(folder / "ecu.hex")])
    assert status == 0
    stderr = capsys.readouterr().err
    assert "1 label (Other) left out: not in ecu.a2l" in stderr
    assert "1 number of 1 label rounded to storable values, by at most 0.2 Nm" in stderr
    assert (folder / "new.hex").read_bytes() == hex_file({ADDRESS: bytes([15, 2, 4, 6])})


def test_values_that_cannot_be_stored_leave_no_file(folder, capsys):
    write(ParameterSet([Scalar("K", 500.0)]), folder / "new.json")
    target = folder / "new.hex"
    assert run(["convert", str(folder / "new.json"), str(target), "--image", str(folder / "ecu.hex")]) == 2
    assert "the value is 500 Nm, outside the storable and allowed range 0 to 127.5" in capsys.readouterr().err
    assert not target.exists()


def test_diff_and_merge_take_images(folder, capsys):
    assert run(["diff", str(folder / "ecu.hex"), str(folder / "ecu.s19")]) == 0
    write(ParameterSet([Scalar("K", 2.0, unit="Nm")]), folder / "new.dcm")
    merged = folder / "merged.hex"
    command = ["merge", str(folder / "ecu.hex"), str(folder / "new.dcm"), "-o", str(merged)]
    assert run([*command, "--a2l", str(folder / "ecu.a2l")]) == 0
    assert run(["diff", str(folder / "ecu.hex"), str(merged), "--a2l", str(folder / "ecu.a2l")]) == 1
    assert "K" in capsys.readouterr().out
    assert merged.read_bytes() == hex_file({ADDRESS: bytes([4, 2, 4, 6])})


def test_the_result_of_a_calibration_is_saved_into_the_image_of_its_start(folder):
    x = np.array([0.0, 5.0, 10.0, 15.0, 20.0])
    data = kf.Dataset("bench", (kf.Channel("x", x), kf.Channel("y", np.interp(x, [0, 10, 20], [2, 8, 3]))))
    start = kf.read_parameters(folder / "ecu.hex")
    result = kf.calibrate("y_model = C(x)", data, start, target="y", free=["C"])
    result.parameters.save(folder / "new.hex")
    assert (folder / "new.hex").read_bytes() == hex_file({ADDRESS: bytes([3, 4, 16, 6])})


def test_curves_keep_their_breakpoints_through_dcm(folder):
    write(kf.read_parameters(folder / "ecu.hex"), folder / "now.dcm")
    again = read(folder / "now.dcm")
    assert np.array_equal(again["C"].axes[0].breakpoints, [0, 10, 20])
    changed = again.with_parameters(Curve("C", again["C"].axes[0], [5, 6, 7], unit="Nm"))
    write(changed, folder / "new.hex", folder / "ecu.hex")
    assert (folder / "new.hex").read_bytes() == hex_file({ADDRESS: bytes([3, 10, 12, 14])})
