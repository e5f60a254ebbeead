from pathlib import Path

from kennfeld.calfiles import compare, merge
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.domain.texts import Text
from kennfeld.terminal.diff_lines import change_lines, difference_lines, file_labels

LEFT = ParameterSet([Scalar("K", 1.5, unit="Nm"), Curve("C", [1, 2], [3, 4]), Scalar("Old", 1)], [Text("T", "a\nb")])
RIGHT = ParameterSet([Scalar("K", 1.25), Curve("C", [1, 2], [3, 4.5]), Scalar("New", 1)], [Text("T", "")])


def test_differences_stand_under_the_names_of_the_files():
    assert difference_lines(compare(LEFT, RIGHT), "a.dcm", "b.dcm") == [
        "name  what           a.dcm   b.dcm   largest difference  differ  at",
        "K     values         1.5     1.25                  0.25",
        "K     unit           Nm      ''",
        "C     values         4.0     4.5                    0.5  1 of 2  x = 2",
        "Old   only in a.dcm  scalar  -",
        "T     text           'a\\nb'  ''",
        "New   only in b.dcm  -       scalar",
        "",
        "3 of 3 names in both differ, 1 only in a.dcm, 1 only in b.dcm",
    ]


def test_equal_files_are_reported_as_equal():
    assert difference_lines(compare(LEFT, LEFT), "a", "b") == ["equal: 4 names in both"]


def test_colours_show_which_file_has_the_entry():
    lines = difference_lines(compare(LEFT, RIGHT), "a", "b", coloured=True)
    assert [line[:5] for line in lines[1:-2]] == ["\x1b[33m"] * 3 + ["\x1b[31m", "\x1b[33m", "\x1b[32m"]
    assert all(line.endswith("\x1b[0m") for line in lines[1:-2])


def test_a_narrow_terminal_gets_a_coloured_block_for_each_difference(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    lines = difference_lines(compare(LEFT, RIGHT), "a", "b", coloured=True)
    starts = [line[:5] for line in lines if "name " in line]
    assert starts == ["\x1b[33m"] * 3 + ["\x1b[31m", "\x1b[33m", "\x1b[32m"]


def test_no_colours_where_there_is_no_terminal(capsys):
    assert not any("\x1b" in line for line in difference_lines(compare(LEFT, RIGHT), "a", "b"))


def test_changes_are_listed_with_their_old_values():
    assert change_lines(merge([("a", LEFT), ("b", RIGHT)]).changes) == [
        "name            by  what",
        "K     replaced  b   1.5 -> 1.25; unit Nm -> ''",
        "C     replaced  b   1 of 2 values, the largest difference 0.5 at x = 2",
        "New   added     b",
        "T     replaced  b   text 'a\\nb' -> ''",
        "",
        "b: 3 replaced",
        "b: 1 added",
    ]
    assert change_lines([]) == ["nothing to replace and nothing to add"]


def test_files_of_one_name_are_called_by_their_paths():
    assert file_labels([Path("a/x.dcm"), Path("b/y.dcm")]) == ["x.dcm", "y.dcm"]
    assert file_labels([Path("a/x.dcm"), Path("b/x.dcm")]) == [str(Path("a/x.dcm")), str(Path("b/x.dcm"))]


def test_labels_that_name_their_function_are_listed_by_it():
    left, right = (
        ParameterSet([Scalar("K", value), Scalar("L", value, functions=["F"]), Scalar("M", value, functions=["G"])])
        for value in (1, 2)
    )
    lines = difference_lines(compare(left, right), "a", "b")
    assert [line for line in lines if line.endswith(":")] == [
        "function F, 1 name:",
        "function G, 1 name:",
        "without a function, 1 name:",
    ]
    assert lines[-1] == "3 of 3 names in both differ"
