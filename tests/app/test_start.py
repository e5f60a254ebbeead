"""The start page: recent projects with their summaries, and new projects from dropped files."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import kennfeld as kf
from kennfeld.app.answer import Answer
from kennfeld.app.project_questions import DEMOS, DemoRow
from kennfeld.app.questions import QUESTIONS
from kennfeld.app.recent import forget, recent_file, recent_projects, remember, summarise
from kennfeld.app.session.session import Session
from kennfeld.app.session.summary import summarise_session
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.errors import ArgumentError
from kennfeld.project import Project
from kennfeld.project.demo import write
from tests.measurement.bus_files import DBC, drive, write_mf4

EXAMPLE = Path(__file__).parents[2] / "examples" / "simulink"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_last_project_is_the_first_of_the_list(torque: Path, exhaust: Path) -> None:
    for path in (torque, exhaust, torque):
        remember(path)
    assert [each.path for each in recent_projects()] == [torque, exhaust]
    forget(torque)
    assert [each.path for each in recent_projects()] == [exhaust]


def test_a_removed_project_is_not_listed(torque: Path) -> None:
    remember(torque)
    torque.unlink()
    assert recent_projects() == []


@pytest.mark.parametrize("content", ["", "{", "{}", "[1, null, {}]", '[{"path": 5}]'])
def test_a_damaged_list_is_empty(content: str) -> None:
    recent_file().parent.mkdir()
    recent_file().write_text(content)
    assert recent_projects() == []


def test_the_list_of_an_earlier_version_is_read(torque: Path) -> None:
    recent_file().parent.mkdir()
    recent_file().write_text(json.dumps([str(torque), {"path": str(torque), "opened": "x", "summary": 3}]))
    assert [each.opened for each in recent_projects()] == [0.0, 0.0]


def test_a_summary_has_the_errors_of_the_project(torque: Path) -> None:
    session = Session(torque)
    summary = summarise_session(session)
    training = next(score for score in session.require_view().now.scores if score.use == "training")
    assert summary["training"] == training.rmse
    assert (summary["node"], summary["unit"], summary["state"]) == ("TorquePredict", "Nm", "ready")
    assert sum(summary["histogram"]) == sum(
        s.samples for s in session.require_view().now.scores if s.use == "training" and s.criterion == 0
    )
    assert len(summary["picture"]["x"]) == len(summary["picture"]["now"]) <= 400
    remember(torque)
    summarise(torque, summary)
    remember(torque)  # opened again: the summary stays
    assert recent_projects()[0].summary["training"] == training.rmse


def test_a_project_with_problems_says_so(torque: Path) -> None:
    torque.write_text(torque.read_text(encoding="utf-8").replace('"torque.kf"', '"missing.kf"'), encoding="utf-8")
    summary = summarise_session(Session(torque))
    assert summary["state"].endswith("problem") or summary["state"].endswith("problems")
    assert "missing.kf" in summary["problem"]


def test_the_start_page_lists_recent_projects(torque: Path, exhaust: Path) -> None:
    workspace = AppWorkspace(torque)
    workspace.answer("open", {"path": str(exhaust)})
    rows = workspace.answer("projects", {}).head["recent"]
    assert [(row["name"], row["open"]) for row in rows] == [("exhaust", True), ("torque", True)]
    assert rows[1]["training"] > 0
    workspace.close()


def test_an_open_project_is_not_opened_twice(torque: Path) -> None:
    workspace = AppWorkspace(torque)
    session = workspace.session
    workspace.answer("open", {"path": str(torque.parent)})
    assert workspace.session is session


def test_two_projects_are_open_at_once_and_answers_say_which_they_are_about(torque: Path, exhaust: Path) -> None:
    workspace = AppWorkspace(torque)
    first = workspace.latest
    opened = workspace.answer("open", {"path": str(exhaust)}).head["project"]
    assert opened == workspace.latest != first
    edit = {"name": "MapOptTorque", "cells": [0], "values": [1.0], "title": "set"}
    before = workspace.session_of(first).revision
    answer = workspace.answer("set-values", edit, first).head
    assert (answer["project"], answer["revision"] > before) == (first, True)
    assert workspace.session is not None
    assert (workspace.session_of(first).undo(), workspace.session.undo()) == ("set", "")
    workspace.close()


def test_a_project_that_no_page_shows_is_closed_unless_it_has_edits(
    torque: Path, exhaust: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kennfeld.app.workspace.UNSEEN", -1.0)
    workspace = AppWorkspace(torque)
    edited = workspace.latest
    workspace.answer("set-values", {"name": "MapOptTorque", "cells": [0], "values": [1.0], "title": "set"})
    hidden = workspace.open(exhaust)
    shown = workspace.answer("new", {"name": str(tmp_path / "empty")}).head["project"]
    workspace.watch({shown})
    assert [workspace.join(project) for project in (edited, shown)] == [edited, shown]
    with pytest.raises(ArgumentError, match="not open any more"):
        workspace.answer("undo", {}, hidden)
    assert workspace.join(hidden) == hidden  # its address opens it again
    assert workspace.join("unknown") == ""
    workspace.close()


def test_a_change_on_disk_is_noticed_after_one_of_another_project(torque: Path, exhaust: Path) -> None:
    workspace, news = AppWorkspace(torque), list[Any]()

    def note(topic: str, answer: Answer, project: str) -> None:
        if topic == "state":
            news.append(answer.head["state"]["changedOnDisk"])

    workspace.subscribe(note, lambda project: None)
    for project in (torque, exhaust):
        workspace.answer("open", {"path": str(project)})
        project.write_text(project.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
        workspace.watch({workspace.latest})
        workspace.watch({workspace.latest})
    assert [bool(changes) for changes in news] == [False, True, False, True]


@pytest.mark.parametrize("demo", DEMOS[:2], ids=lambda demo: demo.name)
def test_the_facts_on_a_demo_are_those_of_its_project(demo: DemoRow, tmp_path: Path) -> None:
    problem = Project.read(write(demo.name, tmp_path / "demo")).problem()
    samples = {use: sum(each.samples for each in problem.datasets if each.use == use) for use in ("training", "test")}
    plain = demo.facts.replace("\u2009", "").replace(" ", "")
    assert plain.startswith(f"{samples['training']}+{samples['test']}")
    assert f",{problem.free_size}values" in plain


def write_files(folder: Path) -> None:
    (folder / "bench.csv").write_text("x,y\n1,2\n2,3\n")
    (folder / "more.csv").write_text("x,y\n1,2\n")
    (folder / "start.csv").write_text("")
    kf.ParameterSet([kf.Scalar("k", 1.0)]).save(folder / "start.csv")
    kf.ParameterSet([kf.Scalar("k", 2.0)]).save(folder / "late.dcm")
    (folder / "model.kf").write_text("y = k * x\n")
    (folder / "ecu.a2l").write_text("")
    (folder / "ecu.hex").write_text("")


def test_dropped_files_are_assigned_by_their_content() -> None:
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "../bench.csv", "free": True})
    folder = workspace.folder()
    assert folder.name == "bench"
    write_files(folder)
    files = ["bench.csv", "start.csv", "late.dcm", "model.kf", "more.csv", "ecu.hex", "ecu.a2l"]
    workspace.answer("add-files", {"files": files})
    assert workspace.session is not None
    settings = workspace.session.settings
    assert settings["dataset"] == [
        {"files": ["bench.csv"], "use": "training"},
        {"files": ["more.csv"], "use": "training"},
    ]
    assert settings["calibration"]["initial"] == ["start.csv", "late.dcm", {"a2l": "ecu.a2l", "hex": "ecu.hex"}]
    assert settings["model"]["file"] == "model.kf"
    assert workspace.session.undo() == "Added bench.csv, start.csv, late.dcm"


@pytest.mark.guests
def test_variables_of_a_dropped_model_are_not_initial_values() -> None:
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "exhaust.mdl", "free": True})
    names = ["exhaust.mdl", "exhaust.m", "drive_1.csv"]
    for name in names:
        shutil.copy(EXAMPLE / name, workspace.folder() / name)
    workspace.answer("add-files", {"files": names})
    assert workspace.session is not None
    settings = workspace.session.settings
    assert settings["model"] == {"file": "exhaust.mdl", "parameters": ["exhaust.m"]}
    assert "calibration" not in settings
    bind = [["model", "bind", "Sensor/Radiation"], "0.15 * (t_wand - 20)"]
    workspace.answer("set-keys", {"title": "bound", "changes": [bind]})
    proposals = workspace.answer("proposals", {}).head["proposals"]
    inputs = [f"{name} reads the channel" for name in ("Speed", "Load", "Ignition", "Vehicle")]
    assert [each["title"] for each in proposals] == [*inputs, "T_sensor follows the channel"]


def test_recordings_added_later_are_test_data() -> None:
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "bench.csv", "free": True})
    write_files(workspace.folder())
    for name in ("bench.csv", "more.csv"):
        workspace.answer("add-files", {"files": [name]})
    assert workspace.session is not None
    assert [entry["use"] for entry in workspace.session.settings["dataset"]] == ["training", "test"]


def test_databases_decode_the_recordings_that_come_with_them() -> None:
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "drive.mf4", "free": True})
    folder = workspace.folder()
    write_mf4(folder / "drive.mf4", drive())
    (folder / "engine.dbc").write_text(DBC)
    workspace.answer("add-files", {"files": ["drive.mf4", "engine.dbc"]})
    assert workspace.session is not None
    assert workspace.session.settings["dataset"] == [{"files": ["drive.mf4"], "dbc": ["engine.dbc"], "use": "training"}]
    (file,) = QUESTIONS["files"](workspace.session, {}).head["datasets"][0]["files"]
    groups = {channel["name"]: channel["group"] for channel in file["channels"]}
    assert (groups["Temp"], groups["Gear"]) == ("Engine", "Gearbox")
    assert (file["missing"], file["sparsest"]) == (0.0, "time")


def test_a_database_added_later_decodes_the_existing_logs() -> None:
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "drive.mf4", "free": True})
    folder = workspace.folder()
    write_mf4(folder / "drive.mf4", drive())
    workspace.answer("add-files", {"files": ["drive.mf4"]})
    assert workspace.session is not None
    (file,) = QUESTIONS["files"](workspace.session, {}).head["datasets"][0]["files"]
    assert "this is a bus log" in file["error"]
    (folder / "engine.dbc").write_text(DBC)
    workspace.answer("add-files", {"files": ["engine.dbc"]})
    (file,) = QUESTIONS["files"](workspace.session, {}).head["datasets"][0]["files"]
    assert file["channels"] != []
    (folder / "engine.dbc").write_text(DBC.replace("Temp", "Heat"))
    (file,) = QUESTIONS["files"](workspace.session, {}).head["datasets"][0]["files"]
    assert "Heat" in {channel["name"] for channel in file["channels"]}


def test_a_second_project_of_one_name_gets_a_number() -> None:
    workspace = AppWorkspace()
    for expected in ("bench", "bench-2"):
        workspace.answer("new", {"name": "bench.csv", "free": True})
        assert workspace.folder().name == expected


@pytest.mark.parametrize("name", ["../outside.csv", "/etc/passwd", "missing.csv"])
def test_files_outside_are_not_added(torque: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "outside.csv").write_text("x\n1\n")
    workspace = AppWorkspace(torque)
    with pytest.raises(ArgumentError):
        workspace.answer("add-files", {"files": [name]})
