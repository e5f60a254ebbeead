"""The error at one sample: its nodes, and what would take it away."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.answer import finite
from kennfeld.app.questions import QUESTIONS
from kennfeld.app.questions.error_split import nearest, worst_samples
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetTables
from tests.draws import mostly_slow


def split_at(session: Session, sample: int) -> dict[str, object]:
    position = session.require_view().model.recordings[0].position[sample]
    return dict(QUESTIONS["split"](session, {"dataset": 0, "position": float(position)}).head)


@pytest.mark.parametrize("name", mostly_slow(["torque", "exhaust"], 1))
def test_nodes_and_error_are_those_of_the_evaluation(name: str, request: pytest.FixtureRequest) -> None:
    session = Session(request.getfixturevalue(name))
    view = session.require_view()
    names, recording = list(view.model.problem.model.graph.names), view.model.recordings[0]
    nodes = view.model.nodes(recording, names, session.parameters)
    for sample in (40, recording.count // 2, recording.count - 1):
        answer = split_at(session, sample)
        assert [node["now"] for node in answer["nodes"]] == pytest.approx(nodes[:, sample], rel=1e-9)
        assert answer["difference"]["now"] == finite(view.now.errors[0][0][sample])
        assert answer["sample"] == sample


@pytest.mark.parametrize("name", ["torque", pytest.param("exhaust", marks=pytest.mark.slow)])
def test_a_change_takes_the_error_away(name: str, request: pytest.FixtureRequest) -> None:
    session = Session(request.getfixturevalue(name))
    view = session.require_view()
    sample = view.model.recordings[0].count - 1
    answer = split_at(session, sample)
    table = next(row for row in answer["corrections"] if row["parameter"] in ("MapOptTorque", "MapSettled"))
    assert table["obstacle"] == ""
    values = session.parameters[table["parameter"]].values + table["change"]
    session.do(SetTables("raised", {table["parameter"]: values}))
    after = session.require_view().now.errors[0][0][sample]
    assert abs(after) < 2e-3 * abs(answer["difference"]["now"])


def test_tables_that_are_locked_or_at_their_bounds_have_no_correction(torque: Path) -> None:
    session = Session(torque)
    keys = [
        (("parameters", "MapOptTorque", "lock"), True),
        (("parameters", "MapDragTorque", "bounds"), [19.0, 21.0]),
    ]
    session.do(SetKeys("limited", "kennfeld.toml", keys))
    assert not session.stale, session.findings
    rows = {row["parameter"]: row for row in split_at(session, 1000)["corrections"]}
    assert rows["MapOptTorque"]["obstacle"] == "locked"
    assert rows["MapDragTorque"]["obstacle"] == "bounds"
    assert abs(rows["MapDragTorque"]["allowed"]) == pytest.approx(1.0)
    assert rows["MapOptTorque"]["nodes"] == ["trqOpt"]


def test_worst_samples_are_the_largest_errors_of_different_places(torque: Path) -> None:
    session = Session(torque)
    error = session.require_view().now.errors[0][0]
    rows = QUESTIONS["worst"](session, {"dataset": 0}).head["samples"]
    assert abs(rows[0]["error"]) == np.nanmax(np.abs(error))
    samples = [row["sample"] for row in rows]
    assert len(set(samples)) == len(samples) == 8


def test_samples_that_are_not_scored_are_never_the_worst() -> None:
    assert worst_samples(np.full(1000, np.nan), 4) == []
    assert worst_samples(np.zeros(0), 4) == []


def test_a_position_between_two_samples_is_that_of_the_nearer_one(exhaust: Path) -> None:
    recording = Session(exhaust).require_view().model.recordings[0]
    first, second = recording.position[100:102]
    assert nearest(recording, first + 0.4 * (second - first)) == 100
    assert nearest(recording, first + 0.6 * (second - first)) == 101
    assert nearest(recording, -1e9) == 0
    assert nearest(recording, 1e9) == recording.count - 1
