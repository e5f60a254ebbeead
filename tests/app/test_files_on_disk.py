"""Files that another program, or another app, writes are not overwritten unseen."""

import itertools
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.errors import InputError
from tests.app.browser import browser_page
from tests.app.serving import served
from tests.project.hostile_projects import write_project


def ask(session: Session, question: str, **arguments: Any) -> dict[str, Any]:
    return dict((QUESTIONS.get(question) or COMMANDS[question])(session, arguments).head)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: tmp_path / "home"))
    return write_project(tmp_path / "project")


def set_seed(session: Session, seed: int) -> None:
    ask(session, "set-keys", title="seed", changes=[[["optimizer", "seed"], seed]])


def set_formula(session: Session, text: str) -> None:
    ask(session, "set-text", title="formula", file="function.kf", text=text)


def set_value(session: Session, value: float) -> None:
    ask(session, "set-values", title="value", name="K", cells=[0], values=[value])


def test_a_file_that_changed_meanwhile_is_shown_and_not_overwritten(project: Path) -> None:
    session = Session(project)
    set_seed(session, 5)
    project.write_text(f"{project.read_text('utf-8')}# mine\n", encoding="utf-8")
    [conflict] = ask(session, "save")["conflicts"]
    assert conflict["file"] == "kennfeld.toml"
    assert conflict["disk"].endswith("# mine\n")
    assert "seed = 5" in conflict["own"]
    assert "seed" not in project.read_text("utf-8")
    with pytest.raises(InputError, match="another program has changed it since it was read"):
        session.save()
    assert ask(session, "save", force=True) == {}
    assert "seed = 5" in project.read_text("utf-8")
    assert session.conflicts == []


def test_a_formula_that_changed_meanwhile_is_a_conflict(project: Path) -> None:
    session, file = Session(project), project.with_name("function.kf")
    assert ask(session, "settings")["function"] == "y = K * u\n"
    file.write_text("y = K * u # theirs\n")
    set_formula(session, "y = K * u # mine\n")
    assert session.changed_on_disk
    [conflict] = ask(session, "save")["conflicts"]
    assert (conflict["file"], conflict["disk"]) == ("function.kf", "y = K * u # theirs\n")
    ask(session, "reload")
    assert session.text_of("function.kf") == "y = K * u # theirs\n"
    assert not session.changed_on_disk
    ask(session, "undo")
    assert session.text_of("function.kf") == "y = K * u # mine\n"
    assert ask(session, "save") == {}
    assert file.read_text() == "y = K * u # mine\n"


def test_the_same_change_is_not_a_conflict(project: Path) -> None:
    session = Session(project)
    set_formula(session, "y = K * u + 1\n")
    project.with_name("function.kf").write_text("y = K * u + 1\n")
    assert ask(session, "save") == {}


def test_two_apps_do_not_overwrite_files_of_each_other(project: Path) -> None:
    first, second = Session(project), Session(project)
    set_seed(first, 1)
    set_value(second, 7.0)
    assert ask(first, "save") == {}
    assert [each["file"] for each in ask(second, "save")["conflicts"]] == ["kennfeld.toml"]
    ask(second, "reload")
    assert ask(second, "save") == {}
    text = project.read_text("utf-8")
    assert "seed = 1" in text
    assert "values.json" in text
    third, fourth = Session(project), Session(project)
    set_value(third, 8.0)
    set_value(fourth, 9.0)
    assert ask(third, "save") == {}
    assert [each["file"] for each in ask(fourth, "save")["conflicts"]] == ["values.json"]
    assert float(Session(project).parameters["K"].values) == 8.0


def test_recovered_edits_do_not_overwrite_changes_before_the_restart(project: Path) -> None:
    set_seed(Session(project), 5)
    project.write_text(project.read_text("utf-8").replace("initial = 1.0", "initial = 2.0"), encoding="utf-8")
    session = Session(project)
    ask(session, "recover")
    assert session.changed_on_disk
    [conflict] = ask(session, "save")["conflicts"]
    assert "initial = 2.0" in conflict["disk"]
    assert "initial = 1.0" in conflict["own"]
    assert "initial = 2.0" in project.read_text("utf-8")


def test_recovered_edits_are_saved_if_nothing_changed(project: Path) -> None:
    session = Session(project)
    set_seed(session, 5)
    set_formula(session, "y = K * u + 1\n")
    session = Session(project)
    ask(session, "recover")
    assert session.text_of("function.kf") == "y = K * u + 1\n"
    assert ask(session, "save") == {}
    assert project.with_name("function.kf").read_text() == "y = K * u + 1\n"


@pytest.mark.parametrize("name", ["../outside.kf", "calibrate.py", ".git/hooks/pre-commit", "/tmp/outside.kf"])
def test_a_recovery_file_of_a_stranger_edits_formulas_alone(project: Path, name: str) -> None:
    session = Session(project)
    set_seed(session, 5)
    recovery = session.recovery.path
    recovery.write_text(recovery.read_text().replace('"kennfeld.toml"', f'"{name}"', 1))
    session = Session(project)
    ask(session, "recover")
    assert name not in session.state.texts
    assert ask(session, "save") == {}


def test_files_of_a_recovery_without_their_beginning_are_compared(project: Path) -> None:
    session = Session(project)
    set_seed(session, 5)
    recovery = session.recovery.path
    content = recovery.read_text()
    recovery.write_text(content[: content.index(', "known"')] + "}")
    session = Session(project)
    ask(session, "recover")
    assert [each["file"] for each in ask(session, "save")["conflicts"]] == ["kennfeld.toml"]


@pytest.mark.slow
def test_the_page_shows_both_texts_and_asks(project: Path) -> None:
    with served(project) as server, browser_page(f"http://{server.host}/?token={server.token}") as page:
        with server.page() as other:
            other.ask("set-keys", title="seed", changes=[[["optimizer", "seed"], 5]])
        project.write_text(f"{project.read_text('utf-8')}# theirs\n", encoding="utf-8")
        page.wait_for_selector("#changed-on-disk")
        page.click("#save")
        dialog = page.locator(".conflicts")
        dialog.wait_for()
        assert "# theirs" in dialog.inner_text()
        assert "seed = 5" in dialog.inner_text()
        assert "seed" not in project.read_text("utf-8")
        page.click("#replace-disk")
        dialog.wait_for(state="detached")
        assert "seed = 5" in project.read_text("utf-8")


def test_a_clock_that_goes_backwards_loses_no_change(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = itertools.count(2_000_000_000, -3600)
    monkeypatch.setattr("time.time", lambda: float(next(now)))
    monkeypatch.setattr("time.time_ns", lambda: next(now) * 1_000_000_000)
    for seed in (1, 2):
        workspace = AppWorkspace(project)
        assert workspace.session is not None
        set_seed(workspace.session, seed)
        set_value(workspace.session, float(seed))
        workspace.answer("save", {})
        workspace.close()
        assert f"seed = {seed}" in project.read_text("utf-8")
    session = Session(project)
    assert float(session.parameters["K"].values) == 2.0
    set_seed(session, 3)
    again = Session(project)
    ask(again, "recover")
    assert again.settings["optimizer"]["seed"] == 3
