"""Lines on a terminal: names from files can neither colour, move nor rewrite what it shows."""

import json

import pytest

from kennfeld import cli
from kennfeld.base.errors import Finding, Location
from kennfeld.terminal.diff_lines import _RED, _paint
from kennfeld.terminal.output import align, print_findings, print_lines

EVIL = "Sp\x1b]0;title\x07e\x1b[2Jed\r\u202e[red]\x9b"
SHOWN = r"Sp\u001b]0;title\u0007e\u001b[2Jed\u000d\u202e[red]\u009b"


def test_lines_show_control_characters_as_escapes(capsys):
    print_lines(f"channel {EVIL}", "plain äöü °C µ 转速")
    print_findings(Finding(Location(f"{EVIL}.csv", 4), "is odd", excerpt=f"{EVIL};1"), f"no file {EVIL}")
    out, err = capsys.readouterr()
    assert out == f"channel {SHOWN}\nplain äöü °C µ 转速\n"
    assert err == f"{SHOWN}.csv line 4: is odd\n    {SHOWN};1\nno file {SHOWN}\n"


def test_colours_of_our_own_stay(capsys):
    print_lines(_paint(align([("name",), (EVIL,)])[1], _RED))
    assert capsys.readouterr().out == f"\x1b[31m{SHOWN}\x1b[0m\n"


def test_columns_of_a_table_fit_their_contents():
    heading, row = align([("name", "unit"), (f"a\n{EVIL}", "rpm")])
    assert row == rf"a\u000a{SHOWN}  rpm"
    assert heading.index("unit") == row.index("rpm")


def test_a_column_is_aligned_right_if_all_its_cells_are_numbers():
    rows = [("name", "first", "all"), ("a", "none", "1.5"), ("b", "10", "10")]
    assert align(rows) == ["name  first  all", "a     none   1.5", "b     10      10"]


@pytest.mark.parametrize("name", ["bench.csv", "be\x1b[31mnch.csv"])
def test_info_shows_names_of_channels_units_and_files_as_escapes(tmp_path, capsys, name):
    path = tmp_path / name
    try:
        path.write_text("time [s],Sp\x1b[31meed [r\x9bpm],Lo\u202ead\n0,1,2\n1,2,3\n", encoding="utf-8")
    except OSError:
        pytest.skip("the file system knows no such names")
    assert cli.run(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert r"Sp\u001b[31meed" in out
    assert r"r\u009bpm" in out
    assert r"Lo\u202ead" in out
    assert not {"\x1b", "\x9b", "\u202e"} & set(out)
    assert cli.run(["info", "--json", str(path)]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["file"] == name
    assert info["tables"][0]["channels"][1]["name"] == "Sp\x1b[31meed"


def test_json_that_is_not_ascii_stays_json(capsys):
    print_lines(json.dumps({"name": EVIL + "\U000e0041ä"}, ensure_ascii=False))
    out = capsys.readouterr().out
    assert json.loads(out) == {"name": EVIL + "\U000e0041ä"}
    assert not {"\x9b", "\u202e", "\U000e0041"} & set(out)


def test_findings_show_names_as_escapes(tmp_path, capsys):
    path = tmp_path / "bench.csv"
    path.write_text("time,Sp\x1b[31meed\n0,1\n1,x\n2,3\n3,4\n", encoding="utf-8")
    (tmp_path / "a.kf").write_text("y = k * v\n")
    project = tmp_path / "kennfeld.toml"
    project.write_text(
        '[model]\nfile = "a.kf"\n[channels]\nv = "Sp\\u001b[31meed"\n[[dataset]]\nfiles = "bench.csv"\n'
        '[parameters.k]\ninitial = 1\n[[criterion]]\nnode = "y"\ntarget = 1\n'
    )
    assert cli.run(["check", str(project)]) == 2
    err = capsys.readouterr().err
    assert r"column Sp\u001b[31meed" in err
    assert "\x1b" not in err
