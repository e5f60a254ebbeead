"""Answers about runs: comparison of two sets of values, and export of the last result."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.analysis.validation_result import CrossValidation, FoldQuality
from kennfeld.app.questions import COMMANDS, QUESTIONS, overview
from kennfeld.app.session.live_model import LiveModel
from kennfeld.app.session.run_job import Ended
from kennfeld.app.session.runs import Job, Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetValues
from kennfeld.optimize.fit.result import TraceLine
from kennfeld.optimize.quality.quality import Scorer


@pytest.fixture
def ended(exhaust: Path) -> Session:
    """Return a session with one run, whose values are not accepted."""
    session = Session(exhaust)
    assert session.project is not None
    session.runs.append(Run(1, session.parameters, session.project.calibrate()))
    return session


def counted(monkeypatch: pytest.MonkeyPatch, kind: type, method: str) -> list[object]:
    """Return a list that grows with each call of a method."""
    calls: list[object] = []
    plain = getattr(kind, method)

    def record(self: object, *arguments: Any) -> object:
        calls.append(arguments)
        return plain(self, *arguments)

    monkeypatch.setattr(kind, method, record)
    return calls


def test_start_and_present_values_are_compared_without_another_evaluation(
    ended: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = ended.require_view().model.problem.free_names[0]
    ended.do(SetValues("raise", name, ended.parameters[name].values + 1.0))
    calls = counted(monkeypatch, LiveModel, "evaluate")
    head = QUESTIONS["compare"](ended, {"first": {"from": "start"}, "second": {"from": "now"}}).head
    assert calls == []
    assert [row["name"] for row in head["changes"] if row["largest"]] == [name]
    view = ended.require_view()
    assert [row["first"] for row in head["scores"]] == [score.rmse for score in view.start.scores if score.samples]
    assert [row["second"] for row in head["scores"]] == [score.rmse for score in view.now.scores if score.samples]


def test_a_run_is_compared_with_its_own_values(ended: Session) -> None:
    head = QUESTIONS["compare"](ended, {"first": {"from": "now"}, "second": {"from": 1}}).head
    rows = {row["name"]: row for row in head["changes"]}
    result = ended.runs[-1].result.parameters
    for name in ended.require_view().model.problem.free_names:
        assert rows[name]["second"] == result[name].values.ravel().tolist()
    assert all(row["second"] < row["first"] for row in head["scores"] if row["use"] == "training")


def test_report_and_results_of_an_export_share_one_simulation(ended: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch, Scorer, "scores")
    answer = QUESTIONS["export"](ended, {"whole": True, "report": True})
    assert len(calls) == 1
    assert {"report.html", "result.json"} <= {Path(path).name for path in answer.head["files"]}


def set_bounds(session: Session, name: str, lower: float, upper: float | str) -> None:
    change = [["parameters", name, "bounds"], [lower, upper]]
    COMMANDS["set-keys"](session, {"title": "bounds", "changes": [change]})


def test_values_at_a_bound_are_those_that_the_calibration_could_move(exhaust: Path) -> None:
    session = Session(exhaust)
    name = session.require_view().model.problem.free_names[0]
    values = session.parameters[name].values
    least = float(values.min())
    set_bounds(session, name, least, "inf")
    rows = {row.name: row for row in overview.overview(session).parameters}
    changes = {
        row["name"]: row
        for row in QUESTIONS["compare"](session, {"first": {"from": "start"}, "second": {"from": "now"}}).head[
            "changes"
        ]
    }
    count = int(np.count_nonzero(values == least))
    assert rows[name].at_bound == changes[name]["atBound"] == len(changes[name]["bound"]) == count > 0

    set_bounds(session, name, least, least)
    session.do(SetValues("level", name, np.full_like(values, least)))
    rows = {row.name: row for row in overview.overview(session).parameters}
    assert rows[name].at_bound == 0


def test_axes_are_described_with_the_inputs_of_the_function(torque: Path) -> None:
    session = Session(torque)
    axes = QUESTIONS["table"](session, {"name": "MapOptTorque"}).head["table"]["axes"]
    assert [axis["input"] for axis in axes] == ["Speed", "Rel_Airmass"]
    assert [len(axis["points"]) for axis in axes] == list(session.parameters["MapOptTorque"].values.shape)


def test_the_folds_of_a_cross_validation_are_drawn_apart(torque: Path) -> None:
    session = Session(torque)
    stages = [("fold 1 descent", 5.0), ("fold 1 descent", 4.0), ("fold 2 descent", 6.0)]
    lines = [TraceLine(k, 0, stage, rmse**2, rmse, 1.0, 0.1, 0, 0.1) for k, (stage, rmse) in enumerate(stages)]
    session._runner.job = Job("running", "", trace=lines, validates=True)
    answer = QUESTIONS["progress"](session, {})
    assert {name: values.tolist() for name, values in answer.arrays.items() if "rmse" in name} == {
        "rmse 1": [5.0, 4.0],
        "rmse 2": [6.0],
    }


def test_a_cross_validation_is_an_entry_of_the_history_and_no_run(torque: Path) -> None:
    session = Session(torque)
    session._end(Ended(None, reason="No fold could be scored."))
    session.job.validates = True
    assert overview.overview(session).job.validates
    row = FoldQuality(1, "bench", "TorquePredict", 10, 1.0, 3.0, "converged")
    session._end(Ended(None, validation=CrossValidation((row,))))
    rows = QUESTIONS["sets"](session, {}).head["rows"]
    assert [each["title"] for each in rows] == ["now", "cross-validation", "start"]
    assert rows[1]["scores"][0] == {"criterion": "TorquePredict", "unit": "Nm", "training": 1.0, "test": 3.0}
    assert QUESTIONS["outcome"](session, {}).head["files"] == 2
    assert session.runs == []


def test_the_history_says_how_long_a_run_took(ended: Session) -> None:
    (run,) = ended.runs
    row = next(each for each in QUESTIONS["sets"](ended, {}).head["rows"] if each["title"] == "run 1")
    assert row["detail"].endswith(f" · {run.result.seconds.total:.2f} s")  # without its parts once more
    ended.runs[0] = replace(run, seconds=12.3456)  # with the process that it ran in
    row = next(each for each in QUESTIONS["sets"](ended, {}).head["rows"] if each["title"] == "run 1")
    assert row["detail"].endswith(" · 12.35 s")
