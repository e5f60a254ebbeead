from dataclasses import replace

from kennfeld.optimize import TraceLine
from kennfeld.terminal import progress
from kennfeld.terminal.output import print_findings, print_lines
from kennfeld.terminal.progress import display

LINE = TraceLine(1, 1, "plain", 1234.5, 1.5, 0.1, 1e-3, 0, 0.2)


def test_elsewhere_a_stage_is_a_line_and_not_every_step_is(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_INTERVAL", 1e9)
    with display("compiling") as shown:
        for stage in ("plain", "smooth 4"):
            for iteration in (1, 2, 3):
                shown(replace(LINE, stage=stage, iteration=iteration))
    out, err = capsys.readouterr()
    assert out == ""
    assert [line.split()[0] for line in err.splitlines()] == ["plain", "smooth"]
    assert "cost 1234.5" in err
    assert "RMSE 1.5" in err


def test_elsewhere_a_long_stage_is_heard_of_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_INTERVAL", 0.0)
    with display("compiling") as shown:
        shown(LINE)
        shown(LINE)
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_elsewhere_each_of_several_starts_has_a_line(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_INTERVAL", 1e9)
    with display("compiling", starts=2) as shown:
        for stage in ("plain", "smooth 4"):
            for start in (1, 2):
                shown(replace(LINE, stage=stage, start=start))
    assert [line[:15] for line in capsys.readouterr().err.splitlines()] == ["start  1  plain", "start  2  plain"]


def test_lines_go_where_they_belong(capsys):
    print_lines("one", "two")
    print_findings("three\nfour")
    assert capsys.readouterr() == ("one\ntwo\n", "three four\n")
