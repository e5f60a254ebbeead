"""Surrogates on the Function screen: their state, their training in a process of its own, and where they hold."""

from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import overview
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetText
from kennfeld.base.errors import ArgumentError
from tests.app.questions import WaitingSession

pytestmark = pytest.mark.usefixtures("forked_workers")


@pytest.fixture
def bench(torque: Path) -> WaitingSession:
    """Return a session of the torque demo with a training file for an engine of few centres, which nothing calls."""
    own = WaitingSession(torque)
    arguments = {"name": "engine", "inputs": ["Speed", "Rel_Airmass", "Ignition"], "output": "Torque"}
    COMMANDS["new-surrogate"](own.session, arguments)
    path = torque.parent / "engine.toml"
    path.write_text(
        path.read_text("utf-8").replace("[surrogate]\n", '[surrogate]\nmethod = "expansion"\ncentres = 5\n')
    )
    return own


def rows(session: Session) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in QUESTIONS["surrogates"](session, {}).head["surrogates"]}


def test_a_new_surrogate_has_a_training_file_with_the_data_of_the_project(bench: WaitingSession) -> None:
    row = rows(bench.session)["engine"]
    assert (row["state"], row["file"], row["training"]) == ("not trained", "engine.json", "engine.toml")
    assert row["trainingProblem"] == ""
    assert bench.session.settings["surrogates"] == {"engine": "engine.json"}
    with pytest.raises(ArgumentError, match="exists already"):
        COMMANDS["new-surrogate"](bench.session, {"name": "engine", "inputs": ["Speed"], "output": "Torque"})
    with pytest.raises(ArgumentError, match="a name that formula text can call"):
        COMMANDS["new-surrogate"](bench.session, {"name": "../x", "inputs": ["Speed"], "output": "Torque"})


def test_training_ends_with_a_surrogate_that_the_formula_can_call(bench: WaitingSession) -> None:
    session = bench.session
    assert any("engine.json" in str(finding) for finding in session.findings)
    COMMANDS["train-surrogate"](session, {"file": "engine.toml"})
    with pytest.raises(ArgumentError, match="in progress"):
        COMMANDS["train-surrogate"](session, {"file": "engine.toml"})
    assert bench.wait(bench.session.training) == "trained"
    assert "5 centres" in overview(session).training.lines[-1]
    row = rows(session)["engine"]
    assert (row["state"], row["centres"]) == ("trained", 5)
    assert {line["use"] for line in row["quality"]} == {"training", "test"}
    assert row["deviation"].startswith("deviation of a new measurement: ")
    assert not session.stale, session.findings
    text = session.text_of(session.formula_file)
    session.do(SetText("called", session.formula_file, f"{text}\ny = engine(Speed, Rel_Airmass, 2 * Ignition)\n"))
    assert not session.stale, session.findings
    [training, *_] = QUESTIONS["validity"](session, {}).head["rows"]
    assert 0 < training["share"] <= 1
    assert "outside its training data" in training["text"]


def test_a_training_that_is_stopped_writes_no_surrogate(bench: WaitingSession) -> None:
    session = bench.session
    COMMANDS["train-surrogate"](session, {"file": "engine.toml"})
    COMMANDS["stop-training"](session, {})
    assert session.training.state == "stopped"
    assert not (session.path.parent / "engine.json").exists()
    COMMANDS["train-surrogate"](session, {"file": "engine.toml"})
    assert bench.wait(bench.session.training) == "trained"


def test_a_training_that_fails_shows_the_reason(bench: WaitingSession) -> None:
    path = bench.session.path.parent / "engine.toml"
    path.write_text(path.read_text("utf-8").replace('"Speed"', '"Sped"'))
    COMMANDS["train-surrogate"](bench.session, {"file": "engine.toml"})
    assert bench.wait(bench.session.training) == "failed"
    assert "Did you mean Speed?" in bench.session.training.lines[-1]


@pytest.mark.slow
def test_a_worker_that_dies_is_reported(bench: WaitingSession) -> None:
    session = bench.session
    COMMANDS["train-surrogate"](session, {"file": "engine.toml"})
    process = session.training._process
    assert process is not None
    process.kill()
    assert bench.wait(bench.session.training) == "failed"
    assert "ended unexpectedly" in session.training.lines[-1]


def test_files_that_are_damaged_or_have_no_entry_are_listed(bench: WaitingSession) -> None:
    session, folder = bench.session, bench.session.path.parent
    (folder / "engine.json").write_text("{}")
    (folder / "other.toml").write_text("[surrogate]\ninputs = 3\n")
    assert rows(session)["engine"]["state"] == "unreadable"
    session.do(SetKeys("removed", session.path.name, [(("surrogates", "engine"), None)]))
    listed = QUESTIONS["surrogates"](session, {}).head["surrogates"]
    assert {row["training"] for row in listed} == {"engine.toml", "other.toml"}
    assert "inputs" in next(row for row in listed if row["training"] == "other.toml")["trainingProblem"]


@pytest.mark.slow
def test_only_training_files_of_the_project_folder_are_trained(bench: WaitingSession) -> None:
    with pytest.raises(ArgumentError, match="outside"):
        COMMANDS["train-surrogate"](bench.session, {"file": "../../engine.toml"})
