"""A project from a stranger does no harm: each entrance, through every command and every question of the app."""

import ast
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from kennfeld import cli
from kennfeld.app.project_questions import PROJECT_QUESTIONS
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.errors import KennfeldError
from tests.project.hostile_projects import TRAINING, TRAPS, contents, plant_pickles, write_outside, write_project

links = pytest.mark.skipif(os.name != "posix", reason="making links needs rights on Windows")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    return write_outside(tmp_path / "outside")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    path = write_project(tmp_path / "project")
    monkeypatch.chdir(path.parent)
    return path


COMMAND_LINES = (
    ("check", "kennfeld.toml"),
    ("check", "--no-run", "kennfeld.toml"),
    ("info", "kennfeld.toml"),
    ("info", "bench.csv"),
    ("simulate", "kennfeld.toml"),
    ("report", "kennfeld.toml"),
    ("report", "kennfeld.toml", "-o", "results/report.html"),
    ("calibrate", "kennfeld.toml", "--cross-validate", "2"),
    ("calibrate", "kennfeld.toml", "--resume"),
    ("convert", "start.json", "out.dcm"),
    ("convert", "start.json", "out.dcm", "--force"),
    ("merge", "start.json", "start.json", "-o", "out.dcm", "--force"),
    ("diff", "start.json", "start.json"),
    ("schema", "-o", "out.dcm", "--force"),
)

# arguments with which a page asks each question; None: asked by a test of its own
ARGUMENTS: dict[str, dict[str, Any]] = {
    "add-files": {"files": ["bench.csv"]},
    "add-functions": {"files": ["my.py"]},
    "calibrations": {},
    "contents": {"source": {"from": "file", "file": "start.json"}},
    "convert-function": {},
    "export": {"formats": [".json", ".dcm"], "report": True, "script": True, "simulation": ".parquet", "force": True},
    "new-function": {"name": "../new.kf"},
    "new-surrogate": {"name": "engine", "inputs": ["u"], "output": "wanted"},
    "save": {"force": True},
    "set-keys": {"title": "t", "changes": [[["calibration", "initial"], ["start.json"]]]},
    "set-text": {"title": "t", "file": "function.kf", "text": "y = K * u + 1\n"},
    "set-toml": {"path": ["optimizer", "seed"], "text": "3", "title": "t"},
    "set-values": {"title": "t", "name": "K", "cells": [0], "values": [2.0]},
    "stop": {},
    "take-values": {"source": {"from": "file", "file": "start.json"}, "names": ["K"]},
    "write-calibration": {"first": {"from": "now"}, "target": "out.dcm", "force": True},
}
ORDER = ("set-text", "set-values", "write-calibration", "export", "save", "recover", "reload", "undo")


def write_start(project: Path) -> None:
    assert cli.run(["convert", str(_values(project)), str(project.with_name("start.json")), "--force"]) == 0


def _values(project: Path) -> Path:
    path = project.with_name("given.csv")
    if not path.exists():
        from kennfeld import ParameterSet, Scalar

        ParameterSet([Scalar("K", 1.5)]).save(path)
    return path


@links
@pytest.mark.slow
@pytest.mark.parametrize("trap", TRAPS)
def test_no_command_writes_outside(project: Path, outside: Path, trap: str) -> None:
    write_start(project)
    TRAPS[trap](project.parent, outside)
    before = contents(outside)
    for line in COMMAND_LINES:
        cli.run(list(line))
        assert contents(outside) == before, f"{trap}: kennfeld {' '.join(line)}"


@links
def test_a_report_is_written_through_no_link(project: Path, outside: Path) -> None:
    for trap in ("unfinished", "results/report.html", "simulation", "cache"):
        TRAPS[trap](project.parent, outside)
    before = contents(outside)
    assert cli.run(["report", "kennfeld.toml"]) == 0
    assert "<html" in (project.parent / "results" / "report.html").read_text()
    assert contents(outside) == before


@links
def test_a_results_folder_that_is_a_link_is_refused(
    project: Path, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    TRAPS["results"](project.parent, outside)
    before = contents(outside)
    for line in (
        ["calibrate", "kennfeld.toml"],
        ["report", "kennfeld.toml"],
        ["calibrate", "kennfeld.toml", "-o", "results"],
    ):
        assert cli.run(line) == 2
        message = (
            f"results: cannot be written: it is a symbolic link to {outside}, and nothing is written through links. "
        )
        assert message + "Name another folder with -o." in capsys.readouterr().err
    assert contents(outside) == before


@links
def test_links_outside_of_the_project_belong_to_the_user(project: Path, outside: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(outside)
    (tmp_path / "link.html").symlink_to(tmp_path / "real.html")
    assert cli.run(["report", "kennfeld.toml", "-o", str(tmp_path / "link.html")]) == 0
    assert (tmp_path / "link.html").is_symlink()
    assert "<html" in (tmp_path / "real.html").read_text()


@links
def test_a_page_saves_and_exports_through_no_link(project: Path, outside: Path) -> None:
    write_start(project)
    for trap in ("results/report.html", "script", "recovery"):
        TRAPS[trap](project.parent, outside)
    before = contents(outside)
    workspace = AppWorkspace(project)
    workspace.answer("set-values", ARGUMENTS["set-values"])
    with pytest.raises(KennfeldError, match=r"calibrate\.py: cannot be written: it is a symbolic link"):
        workspace.answer("export", ARGUMENTS["export"])
    workspace.answer("export", {"report": True})
    TRAPS["values"](project.parent, outside)
    assert workspace.answer("save", {}).head["conflicts"][0]["file"] == "values.json"
    with pytest.raises(KennfeldError, match=r"values\.json: cannot be written: it is a symbolic link"):
        workspace.answer("save", {"force": True})
    workspace.close()
    assert contents(outside) == before


def test_files_of_an_earlier_session_run_no_code(project: Path, outside: Path) -> None:
    write_start(project)
    plant_pickles(project.parent, outside / "exploded")
    for line in (["check", "."], ["report", "."], ["calibrate", ".", "--resume"], ["info", "values.json"]):
        cli.run(line)
    workspace = AppWorkspace(project)
    for question, arguments in (("recover", {}), ("outcome", {}), ("export", {"stored": True}), ("calibrations", {})):
        with suppress(KennfeldError):
            workspace.answer(question, arguments)
    workspace.close()
    assert not (outside / "exploded").exists()


@pytest.mark.skipif(os.name != "posix", reason="permissions as POSIX has them")
def test_files_that_others_may_write_are_read_like_any_other(project: Path) -> None:
    (project.parent / ".kennfeld").mkdir()
    for path in (project.parent, project.parent / ".kennfeld", *project.parent.iterdir()):
        path.chmod(0o777)
    assert cli.run(["check", "."]) == 0
    workspace = AppWorkspace(project)
    workspace.answer("set-values", ARGUMENTS["set-values"])
    workspace.answer("save", {})
    workspace.close()
    assert (project.parent / "values.json").is_file()


@pytest.mark.parametrize(
    "name",
    [
        'a"); import os; os.mkdir("ran"); ("b.toml',
        'a"""\nimport os\nos.mkdir("ran")\n"""b.toml',
        "it's {0}.toml",
        "ä.toml",
    ],
)
@pytest.mark.skipif(os.name != "posix", reason="names that Windows does not have")
def test_the_name_of_a_project_does_not_run_as_code_of_the_exported_script(project: Path, name: str) -> None:
    named = project.rename(project.with_name(name))
    workspace = AppWorkspace(named)
    workspace.answer("export", {"script": True})
    workspace.close()
    tree = ast.parse(project.with_name("calibrate.py").read_text("utf-8"))
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    assert texts.count(name) == 1
    imported = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    assert imported == ["kennfeld"]


def test_another_script_is_replaced_only_after_a_question(project: Path) -> None:
    script = project.with_name("calibrate.py")
    script.write_text("mine = True\n", encoding="utf-8")
    workspace = AppWorkspace(project)
    assert workspace.answer("export", {"script": True, "formats": [".dcm"]}).head["exists"] == "calibrate.py"
    assert script.read_text("utf-8") == "mine = True\n"
    assert not (project.parent / "results").exists()
    answer = workspace.answer("export", {"script": True, "force": True}).head
    assert answer["files"] == ["calibrate.py"]
    assert "exists" not in workspace.answer("export", {"script": True}).head  # the same content
    workspace.close()


def answers(workspace: AppWorkspace) -> Iterator[str]:
    """Ask every question, those that write first; yield each after it was answered."""
    names = [*ORDER, *QUESTIONS, *COMMANDS]
    for name in dict.fromkeys(names):
        if name in ("run", "train-surrogate"):  # in processes of their own
            continue
        with suppress(KennfeldError, KeyError, TypeError, IndexError):
            workspace.answer(name, ARGUMENTS.get(name, {}))
        yield name


@links
@pytest.mark.slow
@pytest.mark.parametrize("trap", TRAPS)
def test_no_question_of_the_app_writes_outside(project: Path, outside: Path, trap: str) -> None:
    write_start(project)
    TRAPS[trap](project.parent, outside)
    before = contents(outside)
    workspace = AppWorkspace(project)
    for name in answers(workspace):
        assert contents(outside) == before, f"{trap}: {name}"
    workspace.close()
    assert contents(outside) == before


def test_every_question_that_writes_is_asked() -> None:
    assert set(ARGUMENTS) <= {*QUESTIONS, *COMMANDS}
    assert {*PROJECT_QUESTIONS} == {"projects", "open", "demo", "new", "forget", "show"}


@pytest.mark.parametrize("name", ["../outside.kf", "/tmp/outside.kf", "a/../../outside.kf"])
def test_a_function_outside_of_the_folder_is_read_and_not_written(project: Path, name: str) -> None:
    target = project.parent / name
    if target.is_absolute() and not str(target).startswith(str(project.parent)):
        name = str(project.parents[1] / "outside.kf")
    outside = project.parents[1] / "outside.kf"
    (project.parent / "a").mkdir()
    outside.write_text("y = K * u\n")
    workspace = AppWorkspace(project)
    workspace.answer("set-keys", {"title": "t", "changes": [[["model", "file"], name]]})
    assert workspace.session is not None
    assert workspace.session.view is not None
    with pytest.raises(KennfeldError, match="is outside of the folder project"):
        workspace.answer("set-text", {"title": "t", "file": name, "text": "harm"})
    workspace.answer("save", {})
    assert outside.read_text() == "y = K * u\n"


@pytest.mark.parametrize("file", ["../outside.json", "/tmp/kennfeld-outside.json", "bench.json/../../outside.json"])
def test_a_surrogate_is_written_to_the_folder_of_its_training_file(
    project: Path, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    training = project.with_name("training.toml")
    training.write_text(TRAINING.format(file=file))
    for line in (["surrogate", "train"], ["check"], ["info"]):
        assert cli.run([*line, str(training)]) == 2
        assert "cannot be written: it is outside of the folder project" in capsys.readouterr().err
    assert not (project.parents[1] / "outside.json").exists()
