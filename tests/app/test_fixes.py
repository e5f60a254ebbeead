"""Fixes of messages: applied from any screen as one change, and never twice."""

from pathlib import Path

import pytest

from kennfeld.app.questions import COMMANDS
from kennfeld.app.questions.overview import FindingRow, overview
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import ArgumentError
from tests.app.shared_app import project_page


def broken(project: Path, *keys: str | int, value: object) -> Session:
    session = Session(project)
    session.do(SetKeys("broken", project.name, [(keys, value)]))
    return session


def errors(session: Session) -> list[FindingRow]:
    return [row for row in overview(session).findings if row.severity == "error"]


def test_a_fix_is_one_change_that_undo_takes_back(torque: Path) -> None:
    session = broken(torque, "dataset", 1, "files", value=["bensh.csv"])
    before = session.state.texts[torque.name]
    [row] = [row for row in errors(session) if "matches no file" in row.text]
    assert row.fixes[0].title == "Read bench.csv"
    COMMANDS["apply-fix"](session, {"finding": row.text, "fix": row.fixes[0].title})
    assert errors(session) == []
    assert session.history.undoable == "Read bench.csv"
    session.undo()
    assert session.state.texts[torque.name] == before


def test_a_choice_takes_one_of_its_options_only(torque: Path) -> None:
    session = broken(torque, "dataset", 1, "use", value="trainig")
    [row] = errors(session)
    [fix] = row.fixes
    with pytest.raises(ArgumentError, match="choose one of"):
        COMMANDS["apply-fix"](session, {"finding": row.text, "fix": fix.title, "option": "all"})
    COMMANDS["apply-fix"](session, {"finding": row.text, "fix": fix.title, "option": "training"})
    assert errors(session) == []
    assert session.history.undoable == "Set use training"


def test_a_second_click_does_not_remove_another_entry(torque: Path) -> None:
    session = Session(torque)
    number = len(session.settings["dataset"]) + 1
    session.do(SetKeys("broken", torque.name, [(("dataset", number), {"files": ["gone.xyz"]})]))
    [row] = errors(session)
    asked = {"finding": row.text, "fix": f"Remove dataset {number}"}
    COMMANDS["apply-fix"](session, asked)
    with pytest.raises(ArgumentError, match="nothing to fix any more"):
        COMMANDS["apply-fix"](session, asked)
    assert len(session.settings["dataset"]) == number - 1


def test_what_blocks_is_shown_and_fixed_on_every_screen(torque: Path) -> None:
    text = torque.read_text(encoding="utf-8")
    torque.write_text(text.replace('"bench.csv"', '"bensh.csv"'), encoding="utf-8")
    with project_page(torque) as page:
        for screen in ("data", "function", "parameters", "optimization", "results", "plots", "files", "control-unit"):
            page.click(f"[data-screen={screen}]")
            assert "matches no file" in page.inner_text("#blocking")
            assert page.is_visible("#blocking button:has-text('Read bench.csv')")
            assert page.is_disabled("#run")
            assert "Cannot run" in (page.get_attribute("#run", "title") or "")
        page.click("#blocking button:has-text('Read bench.csv')")
        page.wait_for_selector("#blocking", state="detached")
        page.wait_for_selector("#run:not([disabled])")
