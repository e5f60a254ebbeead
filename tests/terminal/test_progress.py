from dataclasses import replace

import pytest

from kennfeld.optimize import TraceLine
from kennfeld.terminal import progress
from kennfeld.terminal.output import print_findings, print_lines
from kennfeld.terminal.progress import ReadingProgress, display

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


def test_lines_go_to_stdout_and_findings_to_stderr(capsys):
    print_lines("one", "two")
    print_findings("three\nfour")
    assert capsys.readouterr() == ("one\ntwo\n", "three four\n")


class TestReading:
    @pytest.fixture
    def clock(self, monkeypatch):
        now = [0.0]
        monkeypatch.setattr("kennfeld.terminal.progress.time.monotonic", lambda: now[0])
        return now

    def test_files_that_are_read_at_once_are_not_mentioned(self, clock, capsys):
        progress = ReadingProgress()
        for done in range(1, 4):
            progress(done, 3)
        assert capsys.readouterr().err == ""

    def test_elsewhere_a_line_appears_from_time_to_time(self, clock, capsys):
        progress = ReadingProgress()
        for done in range(1, 11):
            clock[0] += 0.5
            progress(done, 10)
        assert capsys.readouterr().err.splitlines() == ["reading: 4 of 10 files", "reading: 8 of 10 files"]

    def test_on_a_terminal_the_line_is_removed_at_the_end(self, clock, capsys, monkeypatch):
        progress = ReadingProgress()
        monkeypatch.setattr("sys.stderr.isatty", lambda: True)
        for done in range(1, 4):
            clock[0] += 1.0
            progress(done, 3)
        shown = capsys.readouterr().err
        assert shown.startswith("\rreading: 1 of 3 files\rreading: 2 of 3 files\r")
        assert shown.rpartition("files")[2].strip() == ""
