"""Runs of the app: resumed after an interruption, through steps, cross-validated, and what they say at their end."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.optimize.fit.result import Checkpoint, StartResult
from kennfeld.project import Project
from tests.app.questions import ask

pytestmark = pytest.mark.usefixtures("forked_workers")


def wait_until(session: Session, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
        session.pump()


def wait_for_end(session: Session) -> None:
    wait_until(session, lambda: session.job.state not in ("running", "stopping"))


def set_keys(session: Session, **optimizer: Any) -> None:
    changes = [[["optimizer", key], value] for key, value in optimizer.items()]
    ask(session, "set-keys", changes=changes, title="Optimizer")


def interrupt(path: Path, **optimizer: Any) -> None:
    """Leave a run of many starts behind whose process was killed."""
    session = Session(path)
    set_keys(session, starts=60, **optimizer)
    ask(session, "save")
    ask(session, "run", workers=1)
    wait_until(session, lambda: bool(session.checkpoints.describe()))
    session.close()
    wait_for_end(session)
    assert session.job.state == "failed"


@pytest.mark.parametrize(
    ("every", "folder"), [(0, ".kennfeld/kennfeld/saves"), pytest.param(2, "results/saves", marks=pytest.mark.slow)]
)
def test_an_interrupted_run_is_resumed_in_another_session(torque: Path, every: int, folder: str) -> None:
    interrupt(torque, save_every=every or None)
    assert list((torque.parent / folder).glob("1-*.json"))
    session = Session(torque)
    assert ask(session, "outcome").head["resumable"].startswith("A run was interrupted: ")
    ask(session, "run", resume=True, workers=1)
    wait_until(session, lambda: bool(session.job.trace))
    ask(session, "stop")
    wait_for_end(session)
    (result,) = [run.result for run in session.runs]
    assert result.resumed[0].startswith("saves/1-")
    assert ask(session, "outcome").head["result"]["resumed"] == list(result.resumed)


def test_the_command_line_resumes_a_run_of_the_app(torque: Path) -> None:
    interrupt(torque, save_every=1)
    points = Project.read(torque).saves().resume_points()
    assert 1 in points.states
    assert points.findings == ()


def test_a_converged_run_cannot_be_resumed(exhaust: Path) -> None:
    session = Session(exhaust)
    ask(session, "run")
    wait_for_end(session)
    assert session.job.state == "converged"
    assert ask(session, "outcome").head["resumable"] == ""
    assert not (exhaust.parent / ".kennfeld" / "kennfeld" / "saves").exists()
    with pytest.raises(InputError, match="no checkpoint"):
        ask(session, "run", resume=True)
    assert session.job.state == "converged"


def test_cross_validation_scores_held_out_data_and_keeps_the_values(exhaust: Path) -> None:
    session = Session(exhaust)
    before = session.state
    ask(session, "run", folds=2, parts="blocks")
    wait_for_end(session)
    assert session.job.state == "validated"
    assert session.state is before
    assert session.runs == []
    folds = ask(session, "outcome").head["validation"]
    assert [row[1] for row in folds["table"][1:]] == ["block 1", "block 2"]
    assert "on held-out data" in folds["summary"][0]


@pytest.mark.parametrize("settings", [{"folds": 1}, {"folds": 3, "parts": "halves"}, {"workers": 0}])
def test_invalid_settings_of_a_run_are_refused(torque: Path, settings: dict[str, Any]) -> None:
    session = Session(torque)
    with pytest.raises(ArgumentError):
        ask(session, "run", **settings)
    assert session.job.state == "idle"


def test_every_step_of_a_sequence_has_a_row(exhaust: Path) -> None:
    session = Session(exhaust)
    steps = [{"name": "coarse", "grid_reduction": 2, "max_iterations": 5}, {"name": "fine"}]
    ask(session, "set-keys", changes=[[["step"], steps]], title="Steps")
    assert [row["state"] for row in ask(session, "progress").head["steps"]] == ["waiting", "waiting"]
    ask(session, "run")
    wait_for_end(session)
    rows = ask(session, "progress").head["steps"]
    assert [(row["name"], row["state"]) for row in rows] == [("coarse", "done"), ("fine", "done")]
    assert all(row["iterations"] > 0 and row["rmse"] > 0 for row in rows)


def test_the_outcome_has_the_messages_of_the_command_line(exhaust: Path) -> None:
    session = Session(exhaust)
    ask(session, "set-keys", changes=[[["parameters", "MapSettled", "smoothness"], "auto"]], title="auto")
    ask(session, "run")
    wait_for_end(session)
    result, head = session.runs[-1].result, ask(session, "outcome").head["result"]
    assert head["quality"] == [list(row) for row in result.table()]
    assert head["message"] == result.message
    assert head["smoothness"] == [{"parameter": "MapSettled", "factors": dict(result.smoothness["MapSettled"])}]


@pytest.mark.parametrize("every", [0, 1])
def test_finished_starts_of_a_run_that_died_can_be_resumed(torque: Path, every: int) -> None:
    session = Session(torque)
    set_keys(session, starts=2, save_every=every or None)
    ask(session, "save")
    saves = session.checkpoints.saves()
    ended = StartResult(1, "converged", "", 2.0, 1.0, 3, 4)
    values = {name: session.parameters[name].values for name in session.require_view().model.problem.free_names}
    saves.keep(Checkpoint(1, 0, 3, "", 1.0, values, ended), session.parameters)
    assert ask(session, "outcome").head["resumable"].startswith("A run was interrupted: 1 of 2 starts finished, ")
    saves.keep(Checkpoint(2, 0, 3, "", 1.0, values, replace(ended, start=2)), session.parameters)
    resumable = ask(session, "outcome").head["resumable"]
    # with save_every, the files of a whole run stay
    assert resumable.startswith("A run was interrupted: 2 of 2 starts finished, ") if every == 0 else resumable == ""
    session.job.state = "failed"
    assert ask(session, "outcome").head["resumable"]
