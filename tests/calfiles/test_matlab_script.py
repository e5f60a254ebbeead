"""MATLAB scripts as people write them, and as Kennfeld writes them."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, write
from kennfeld.calfiles.matlab_reader import format_comment, parse_comment
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text
from kennfeld.files.calibrations import SCRIPT
from kennfeld.files.head import FileHead
from tests.draws import mostly_slow

PEOPLE = """%% Engine calibration
clear all; clc
%{
K = 99;
%}
K = 1.2e-3;      % [Nm/rpm] gain of the governor
L = -2 * (3 + 1)^2 / 4; M = pi, N = inf;
On = true;
V = [1, 2, 3]';
W = [1 -2 +3
     4 5 6];      # 6 numbers
R = [1 - 2, 3 ...  goes on
     -4];
Step = 0:500:2000;
X.Value = uint16(7);   X.Unit = 'rpm'; X.Min = 0;
P = Simulink.Parameter(5); P.Description = 'it''s "five"';
Q = Simulink.Parameter;
Q.Value = [1 2; 3 4];
LUT = Simulink.LookupTable;
LUT.Table.Value = [1 2 3; 4 5 6];
LUT.Breakpoints(1).Value = [10 20];
LUT.Breakpoints(2).Value = [0 50 100];
Gov.Kp = 0.08; Gov.Ki = 0.046;
Eta.x = Step; Eta.values = linspace(1, 0, 5);
Eta.y_is = "free text";
T = 'text with % and ...';
Turned.X = [1 2]; Turned.Y = [1 2 3]; Turned.Data = [1 2; 3 4; 5 6];
Pair = struct('x', [0 1], 'y', [2 3]);
"""


@pytest.fixture
def script(written):
    return lambda text: written(text, "start.m")


def refused(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return str(caught.value)


def test_hand_written_scripts_are_read(script):
    parameters = read(script(PEOPLE))
    assert parameters["K"] == Scalar("K", 1.2e-3, unit="Nm/rpm", description="gain of the governor")
    assert [parameters[name].value for name in ("L", "M", "N", "On")] == [-8.0, np.pi, np.inf, 1.0]
    assert parameters["V"] == Block("V", [1, 2, 3])
    assert parameters["W"].values.tolist() == [[1, -2, 3], [4, 5, 6]]
    assert parameters["R"].values.tolist() == [-1, 3, -4]
    assert parameters["X"] == Scalar("X", 7, unit="rpm")
    assert parameters["P"] == Scalar("P", 5, description='it\'s "five"')
    assert parameters["Q"].values.tolist() == [[1, 2], [3, 4]]
    assert parameters["LUT"] == Map("LUT", [10, 20], [0, 50, 100], [[1, 2, 3], [4, 5, 6]])
    assert (parameters["Gov.Kp"].value, parameters["Gov.Ki"].value) == (0.08, 0.046)
    assert parameters["Eta"] == Curve("Eta", [0, 500, 1000, 1500, 2000], [1, 0.75, 0.5, 0.25, 0])
    assert parameters["Turned"].values.tolist() == [[1, 3, 5], [2, 4, 6]]
    assert parameters["Pair"] == Curve("Pair", [0, 1], [2, 3])
    assert parameters.texts == (Text("T", "text with % and ..."),)


def test_the_fields_of_a_parameter_object_are_parameters(script):
    text = "V.A = single(7); V.in.B = [1 2];\nP = Simulink.Parameter(V);\nP.CoderInfo.StorageClass = 'ExportedGlobal';"
    parameters = read(script(text))
    assert parameters["P.A"] == Scalar("P.A", 7)
    assert parameters["P.in.B"] == Block("P.in.B", [1, 2])


def test_skipped_entries_are_reported_with_their_line(script):
    remarks = "\n".join(str(warning) for warning in describe(script(PEOPLE)).findings)
    assert "clear" not in remarks
    assert "unknown fields skipped: Min, y_is" in remarks
    assert "(Turned): has one row per y breakpoint (3); read transposed" in remarks


def test_foreign_code_is_not_executed_and_its_variables_are_undefined(script):
    text = "K = 1;\nL = 2;\nM = 3;\nK = system('x');\nif M > 2\n  L = 5;\nend\nM2 = M * 2;\nM(2) = 4;\n"
    description = describe(script(text))
    assert [summary.name for summary in description.parameters] == ["L", "M", "M2"]
    assert read(script(text))["L"].value == 5
    assert [str(remark.location) for remark in description.findings] == ["start.m line 4, column 5"]
    assert "unknown function system; K remains undefined" in str(description.findings[0])


def test_loops_and_files_beside_are_followed(tmp_path, script):
    write(ParameterSet([Scalar("K", 2.0)]), tmp_path / "data.mat")
    (tmp_path / "axes.m").write_text("Speed = [700 1000];", encoding="utf-8")
    text = "first = 1;\nload data.mat\naxes\nfor i = 1:2\n  Map.values(i) = i*K;\nend\nMap.x = Speed; % [rpm]\n"
    parameters = read(script(text))
    assert parameters["Map"] == Curve("Map", Axis([700, 1000], unit="rpm"), [2, 4])
    assert "file ../data.mat not found" in str(describe(script("K = 1;\nload ../data.mat")).findings[0])


def test_the_body_of_a_function_counts_its_other_functions_do_not(script):
    parameters = read(script("function p = engine()\np.K = 1;\nend\nfunction x = other()\nx = 2;\nend\n"))
    assert list(parameters) == ["p.K"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("M.x = [1 2 3];\nM.y = [1 2];\nM.values = [2 3];\n", "has values of size 1 x 2, but its axes require 3 x 2"),
        ("M.x = [1 2];\nM.y = 'a';\nM.values = [2 3];\n", "M.y contains no numbers"),
        ("M.x = 'a';\nM.values = [2 3];\n", "M.x contains no numbers. Assign numbers in brackets."),
        ("K = 1;\nM = [1 2\n3 4;\n", "start.m line 2, column 5: [ is never closed"),
        (
            "A.x = [1 2]; A.x_name = 'G'; A.values = [1 2]; B.x = [1 3]; B.x_name = 'G'; B.values = [1 2];",
            "group axis G",
        ),
        ("K.name = 'a'; K.value = 1; L.name = 'a'; L.value = 2;", "a is defined twice"),
        ("B.size = [2 2]; B.values = [1 2 3];", "B.size does not match its 3 values"),
        ("K = foo(1);", "assigns no numbers"),
    ],
)
def test_errors_are_named(script, text, message):
    assert message in refused(script(text))


def test_a_script_of_ours_reads_like_one_written_by_hand(tmp_path):
    speed = Axis([700, 1000.5], "n", "rpm", "Axis.Speed")
    parameters = ParameterSet(
        [
            Scalar("K", 0.08, unit="Nm", description="gain"),
            Map("MapX", speed, [1, 2], [[1, 2], [3, np.nan]], unit="a]b", description="it's"),
            Cube("C", [[1, 2], [3], [4, 5]], np.arange(4.0).reshape(2, 1, 2), functions=["f", "g"]),
            Scalar("a.b[0]", -0.0, variant="Engine=1"),
            Scalar("if", np.inf),
        ],
        [Text("T", "line\nbreak", "said")],
        [speed],
        [Scalar("a.b[0]", 3, variant="Engine=2")],
    )
    write(parameters, tmp_path / "a.m")
    text = (tmp_path / "a.m").read_text(encoding="utf-8")
    assert read(tmp_path / "a.m") == parameters
    assert "\nK = 0.08; % [Nm] gain\n" in text
    assert "\nMapX.x = Axis_Speed.x;\n" in text
    assert "\nMapX.values = [\n   1 2\n   3 NaN\n];\n" in text
    assert "C.values = reshape([0 2 ...\n   1 3], [2 1 2]);" in text


def test_a_changed_group_axis_changes_its_tables(tmp_path):
    speed = Axis([700, 1000], name="Speed")
    write(ParameterSet([Curve(name, speed, [1, 2]) for name in "AB"]), tmp_path / "a.m")
    text = (tmp_path / "a.m").read_text(encoding="utf-8").replace("[700 1000]", "[800 1000]")
    (tmp_path / "a.m").write_text(text, encoding="utf-8")
    assert [curve.axes[0].breakpoints[0] for curve in read(tmp_path / "a.m").parameters] == [800, 800]


@pytest.mark.parametrize(
    "text", ["y = a + b\n", "x[rpm] = 3\n", "import numpy\nx = 3;\n", "time,n\n0,1\n", "", "% K = 1\n"]
)
def test_other_texts_are_not_scripts(text):
    assert not SCRIPT.recognises(FileHead(Path("a.txt"), text.encode()))


HOSTILE = [
    "K=" + "(" * 10_000,
    "K = " + "-" * 10_000 + "1;",
    "K = zeros(1e9);",
    "K = 0:1e-9:1;",
    "x = [\n" * 5_000 + "]",
]
HOSTILE += ["A = [1 1];" + "A = [A A];" * 60, "S.a = 1;" + "S.a = S; S.b = S;" * 30, "S.a = 1;" + "S.a = S;" * 2000]
HOSTILE += ["K" + ".a" * 9_999 + "=1;", "\n".join(f"A{i} = zeros(3000);" for i in range(30))]


@pytest.mark.parametrize("hostile", mostly_slow(HOSTILE, 9), ids=range(len(HOSTILE)))
def test_hostile_scripts_end(script, hostile):
    with pytest.raises(InputError):
        read(script(f"% Kennfeld calibration\nM.x = 2;\n{hostile}\nM.values = 'a';"))


@pytest.mark.parametrize(("unit", "description"), [("Nm", "gain"), ("", "gain"), ("Nm", ""), ("a b", "x % y")])
def test_a_comment_gives_unit_and_description(unit, description):
    assert parse_comment(format_comment(unit, description)) == (unit, description)


@pytest.mark.parametrize(("unit", "description"), [("a]", ""), ("", "[x] y"), ("", " blank"), ("", "a\nb")])
def test_texts_that_do_not_fit_in_a_comment_are_written_elsewhere(unit, description):
    assert format_comment(unit, description) is None
