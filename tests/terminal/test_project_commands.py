"""Options of the commands on projects, on a small project of several recordings."""

import json

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.terminal.output import is_quiet

PROJECT = """
[model]
file = "model.kf"

[[dataset]]
name = "drives"
files = ["drive_*.csv"]

[parameters.a]
initial = 1.0

[[criterion]]
node = "y"
target = { channel = "m" }
"""
ERRORS = {"drive_0.csv": 0.1, "drive_1.csv": 0.5, "drive_2.csv": 0.2}


@pytest.fixture
def project(tmp_path):
    """A project of three recordings of a line, with errors of different sizes."""
    random = np.random.default_rng(0)
    for name, error in ERRORS.items():
        time, x = 0.1 * np.arange(200), random.uniform(1, 3, 200)
        columns = time, x, 2 * x + random.normal(0, error, 200)
        rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
        (tmp_path / name).write_text("\n".join(["time,x,m", *rows]) + "\n", encoding="utf-8")
    (tmp_path / "model.kf").write_text("y = a * x\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    return tmp_path / "kennfeld.toml"


def files_in(lines):
    return [line.split()[0] for line in lines if line.startswith("drive_")]


WORST_FIRST = ["drive_1.csv", "drive_2.csv", "drive_0.csv"]


@pytest.mark.slow
def test_by_file_prints_the_worst_recording_first(project, capsys):
    assert cli.run(["calibrate", str(project)]) == 0
    assert files_in(capsys.readouterr().out.splitlines()) == []
    assert cli.run(["calibrate", str(project), "--by-file"]) == 0
    out = capsys.readouterr().out
    assert files_in(out.splitlines()) == WORST_FIRST
    assert "file         samples  RMSE before  RMSE after  max |error|  worst stretch" in out


def test_by_file_of_a_simulation_has_the_errors_of_its_values(project, capsys):
    assert cli.run(["calibrate", str(project), "--by-file"]) == 0
    calibrated = capsys.readouterr().out
    values = str(project.parent / "results" / "parameters.json")
    assert cli.run(["simulate", str(project), "-p", values, "--by-file"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert files_in(lines) == WORST_FIRST
    for line in (line for line in lines if line.startswith("drive_")):
        assert " ".join(line.split()[2:4]) in " ".join(calibrated.split())
    assert not any("RMSE before" in line for line in lines)


def test_a_table_that_values_lack_is_named_before_the_simulation(project, capsys):
    values = project.with_name("values.dcm")
    blocks = "FESTWERT a\n WERT 2\nEND\nKENNLINIE C 2\n ST/X 1 1\n WERT 5 6\nEND\n"
    values.write_text(f"KONSERVIERUNG_FORMAT 2.0\n{blocks}", encoding="utf-8")
    assert cli.run(["simulate", str(project), "-p", str(values)]) == 0
    assert "values.dcm line 6 (C): the x axis neither rises nor falls" in capsys.readouterr().err


def test_recordings_are_in_the_result(project):
    assert cli.run(["calibrate", str(project)]) == 0
    rows = json.loads((project.parent / "results" / "result.json").read_text(encoding="utf-8"))["recordings"]
    assert [row["file"] for row in rows] == list(ERRORS)
    assert list(rows[0]) == [
        *("criterion", "dataset", "file", "use", "samples", "rmse_before", "rmse_after", "max_abs_after", "worst"),
    ]
    assert list(rows[0]["worst"]) == ["begin", "end", "rmse", "unit"]
    for row in rows:
        assert row["rmse_after"] == pytest.approx(ERRORS[row["file"]], rel=0.2)


@pytest.mark.parametrize("name", ["calibrate", "simulate", "report"])
def test_quiet_prints_nothing_if_all_is_well(project, capsys, name):
    assert cli.run([name, str(project), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert cli.run([name, str(project)]) == 0
    assert "Written to" in capsys.readouterr().out


@pytest.mark.slow
def test_quiet_prints_a_table_of_files_neither(project, capsys):
    assert cli.run(["calibrate", str(project), "-q", "--by-file", "--cross-validate", "3"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (project.parent / "results" / "cross_validation.json").is_file()


def test_quiet_prints_warnings_and_errors(project, capsys):
    project.write_text(PROJECT + "[optimizer]\nmax_iterations = 1\n", encoding="utf-8")
    assert cli.run(["calibrate", str(project), "-q"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert all(line.startswith("warning: ") for line in err.splitlines())
    assert "warning: max_iterations: " in err
    project.write_text(PROJECT.replace("drive_", "gone_"), encoding="utf-8")
    assert cli.run(["calibrate", str(project), "-q"]) == 2
    assert "matches no file" in capsys.readouterr().err


def test_quiet_ends_with_the_command(project, capsys):
    assert cli.run(["simulate", str(project), "-q"]) == 0
    assert not is_quiet()


def test_values_that_cannot_be_written_are_printed_even_if_quiet(project, capsys, monkeypatch):
    monkeypatch.setattr("kennfeld.project.fallback.write_somewhere", lambda *_: ())
    assert cli.run(["calibrate", str(project), "-q"]) == 0
    assert capsys.readouterr().out.startswith("The values, as parameters.json:\n{")


def test_check_counts_the_values_to_fit(project, capsys):
    assert cli.run(["check", str(project)]) == 0
    assert "1 value of 1 parameter to fit; 600 training samples in drives" in capsys.readouterr().out


def test_a_jump_is_warned_of_once_though_check_and_fit_know_of_it(project, capsys):
    (project.parent / "model.kf").write_text("y = a * x + (a * x > 4)\n", encoding="utf-8")
    cli.run(["calibrate", str(project)])
    captured = capsys.readouterr()
    assert (captured.out + captured.err).count("derivatives do not account for that") == 1


def test_a_search_that_is_out_of_time_writes_its_values_and_exits_with_1(project, capsys):
    assert cli.run(["calibrate", str(project), "--max-seconds", "1e-9"]) == 1
    assert "stopped: Stopped after max_seconds = 1e-09" in capsys.readouterr().out
    result = json.loads((project.parent / "results" / "result.json").read_text(encoding="utf-8"))
    assert result["status"] == "stopped"
    assert result["cost"]["after"] < result["cost"]["before"]
    assert cli.run(["calibrate", str(project), "--max-seconds", "0"]) == 2
