"""Files of another kind, folders, and very many problems: one message that names them, and the command that fits."""

import json
from pathlib import Path

import pytest

from kennfeld import cli
from kennfeld.terminal.output import MAX_FINDINGS
from tests.importers.ascet.amd_files import archive
from tests.importers.ascet.component_samples import plant_component
from tests.project.hostile_projects import TRAINING, write_project

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "start.dcm").write_text("KONSERVIERUNG_FORMAT 2.0\nFESTWERT K\n  WERT 1\nEND\n")
    return write_project(tmp_path)


@pytest.mark.parametrize("command", ["check", "calibrate", "simulate", "report", "app"])
@pytest.mark.parametrize(
    ("name", "kind"),
    [("bench.csv", "a recording"), ("function.kf", "formula text"), ("start.dcm", "a calibration file")],
)
def test_a_file_of_another_kind_is_named(project: Path, capsys: Captured, command: str, name: str, kind: str) -> None:
    assert cli.run([command, name]) == 2
    remedy = f"Did you mean kennfeld.toml? `kennfeld info {name}` shows what it contains."
    assert capsys.readouterr().err == f"{name}: is {kind}, not a project file. {remedy}\n"


def test_a_training_file_is_expected_by_the_training(project: Path, capsys: Captured) -> None:
    assert cli.run(["surrogate", "train", "bench.csv"]) == 2
    assert "bench.csv: is a recording, not a training file. `kennfeld info" in capsys.readouterr().err


def test_a_folder_stands_for_its_project_file(project: Path, capsys: Captured) -> None:
    assert cli.run(["check", "."]) == 0
    assert cli.run(["check", str(project.parent)]) == 0
    assert "kennfeld.toml: no problem found" in capsys.readouterr().out
    (project.parent / "empty").mkdir()
    assert cli.run(["check", "empty"]) == 2
    assert capsys.readouterr().err == "empty: the folder has no kennfeld.toml. Name a project file.\n"
    (project.parent / "empty" / "other.toml").write_text("")
    assert cli.run(["calibrate", "empty"]) == 2
    assert "Name a project file: other.toml." in capsys.readouterr().err


def test_of_very_many_problems_the_first_are_printed_and_all_are_json(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "bad.dcm"
    path.write_text("KONSERVIERUNG_FORMAT 2.0\n" + "".join(f"FESTWERT K{i}\n  WERT x{i}\nEND\n" for i in range(300)))
    assert cli.run(["info", "--json", str(path)]) == 2
    out, err = capsys.readouterr()
    assert sum("must be a finite number" in line for line in err.splitlines()) == MAX_FINDINGS
    assert err.endswith("and 280 more\n")
    findings = json.loads(out)["findings"]
    assert len(findings) == 300
    assert (findings[7]["line"], findings[7]["path"]) == (24, "K7")
    assert cli.run(["convert", str(path), str(tmp_path / "a.json")]) == 2
    assert len(capsys.readouterr().err) < 3000


def test_errors_come_before_warnings_if_there_are_very_many(capsys: Captured) -> None:
    from kennfeld.base.errors import Finding, Location
    from kennfeld.terminal.output import print_findings

    warnings = [Finding(Location(), f"w{number}", severity="warning") for number in range(30)]
    print_findings(*warnings, "broken")
    lines = capsys.readouterr().err.splitlines()
    assert (lines[0], lines[1], lines[-1]) == ("broken", "warning: w0", "and 11 more")


@pytest.mark.parametrize("code", [0, 2])
def test_a_check_prints_its_findings_as_json(project: Path, capsys: Captured, code: int) -> None:
    if code:
        project.write_text(project.read_text("utf-8").replace('"wanted"', '"wnated"'), encoding="utf-8")
    assert cli.run(["check", "--json", "."]) == code
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert [each["severity"] for each in findings].count("error") == (1 if code else 0)


def test_a_training_file_is_checked_as_json(project: Path, capsys: Captured) -> None:
    project.with_name("engine.toml").write_text(TRAINING.format(file="engine.json"))
    assert cli.run(["check", "--json", "engine.toml"]) == 0
    assert isinstance(json.loads(capsys.readouterr().out)["findings"], list)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((), "calibrate "),
        (("calibrate",), "Usage: kennfeld calibrate"),
        (("surrogate", "train"), "kennfeld surrogate train"),
    ],
)
def test_help_is_a_command(capsys: Captured, words: tuple[str, ...], line: str) -> None:
    assert cli.run(["help", *words]) == 0
    assert line in capsys.readouterr().out


def test_help_for_an_unknown_command_is_an_error(capsys: Captured) -> None:
    assert cli.run(["help", "calibrat"]) == 2
    assert "No such command 'calibrat'" in capsys.readouterr().err


def test_completion_lists_the_shells(capsys: Captured) -> None:
    assert cli.run(["completion"]) == 2
    assert "Name bash, zsh, fish or powershell." in capsys.readouterr().err


@pytest.mark.parametrize("line", [["convert", "start.dcm"], ["merge", "start.dcm", "start.dcm", "-o"]])
def test_an_unknown_ending_is_named(project: Path, capsys: Captured, line: list[str]) -> None:
    assert cli.run([*line, "out.xyz"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("out.xyz: unknown ending .xyz. Known are .json, ")
    assert cli.run([*line, "out.dcn"]) == 2
    assert capsys.readouterr().err == "out.dcn: unknown ending .dcn. Did you mean .dcm?\n"
    assert cli.run([*line, "out"]) == 2
    assert "out: the name has no ending, which selects the format." in capsys.readouterr().err


def test_the_remedy_for_an_undefined_name_is_whole(project: Path, capsys: Captured) -> None:
    project.with_name("function.kf").write_text("y = K * Wxyzvq(u)\n")
    assert cli.run(["check", "."]) == 2
    err = capsys.readouterr().err
    assert "section. Define it: [parameters.Wxyzvq]" in err


def test_a_function_without_nodes_is_reported(project: Path, capsys: Captured) -> None:
    project.with_name("function.kf").write_text("input u\n")
    assert cli.run(["check", "."]) == 2
    assert "The function has ." not in capsys.readouterr().err


DIAGRAM = """Model {
  Version 8.5
  System {
    Block {
      BlockType Inport
      Name "n"
    }
    Block {
      BlockType Gain
      Name "K"
      Gain "2"
    }
    Block {
      BlockType Outport
      Name "y"
    }
    Line {
      SrcBlock "n"
      SrcPort 1
      DstBlock "K"
      DstPort 1
    }
    Line {
      SrcBlock "K"
      SrcPort 1
      DstBlock "y"
      DstPort 1
    }
  }
}
"""
PUMP = (
    "package engine;\nclass Pump { characteristic real gain = 2.0; public real flow(real in u) { return gain * u; } }\n"
)


@pytest.mark.guests
@pytest.mark.parametrize(
    ("name", "content"),
    [("engine.mdl", DIAGRAM.encode()), ("pump.esdl", PUMP.encode()), ("plant.axl", archive(plant_component()))],
    ids=["Simulink", "ESDL", "archive"],  # an archive has the time of day
)
@pytest.mark.parametrize("target", ["out.kf", "out.json"])
def test_a_model_is_converted_whatever_its_name(
    tmp_path: Path, capsys: Captured, name: str, content: bytes, target: str
) -> None:
    results = []
    for source in (name, "model.bin"):
        folder = tmp_path / Path(source).stem
        folder.mkdir()
        (folder / source).write_bytes(content)
        status = cli.run(["convert", str(folder / source), str(folder / target)])
        said = capsys.readouterr().err.replace(str(folder), "").replace(source, "MODEL")
        written = {path.name: path.read_text() for path in folder.glob("out.*")}
        results.append((status, said, {key: text.replace(source, "MODEL") for key, text in written.items()}))
    assert results[0] == results[1]
    assert results[0][0] == 0 or name != "pump.esdl"


def test_a_recording_is_not_converted_as_a_model(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "drive.slx"
    path.write_text("time,Speed\n0,1000\n0.1,1010\n0.2,1020\n")
    assert cli.run(["convert", str(path), str(tmp_path / "out.json")]) == 2
    assert "Speed" not in capsys.readouterr().out
