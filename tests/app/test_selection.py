"""Brushes: the samples that they select, and the conditions that say the same in the project file."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.session.selection import condition
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SampleSelection, SignalName, SignalRange
from kennfeld.app.session.state import SetKeys, SetValues
from kennfeld.app.session.strips import strip
from kennfeld.app.wire import from_json
from kennfeld.base.errors import ArgumentError
from kennfeld.preprocessing.sample_weights import sample_weights

SPEED = {"kind": "channel", "name": "Speed"}
RECTANGLE = {
    "ranges": [
        {"signal": SPEED, "least": 1500, "greatest": 2500},
        {"signal": {"kind": "target", "name": "0"}, "least": 300, "greatest": 500},
    ]
}


def selection_of(arguments: dict) -> SampleSelection:
    selection: SampleSelection = from_json(SampleSelection, arguments, "brush")
    return selection


def ask(session: Session, question: str, **arguments: object) -> tuple[dict, dict]:
    answer = QUESTIONS[question](session, {"dataset": 0, **arguments})
    return dict(answer.head), dict(answer.arrays)


def limit(session: Session, number: int, where: str) -> None:
    session.do(SetKeys("limited", session.path.name, [(("dataset", number + 1, "where"), where)]))


@pytest.mark.parametrize("key", ["where", "outside"])
def test_a_rectangle_as_a_condition_scores_the_samples_within_or_beyond(exhaust: Path, key: str) -> None:
    session = Session(exhaust)
    view = session.require_view()
    recording, selection = view.model.recordings[0], selection_of(RECTANGLE)
    scored = np.isfinite(view.now.errors[0][0])
    chosen = view.signals.selected(recording, selection)
    expected = scored & (chosen if key == "where" else ~chosen)
    head, _ = ask(session, "conditions", brush=RECTANGLE)
    limit(session, 0, head[key])
    assert 100 < expected.sum() < scored.sum()
    np.testing.assert_array_equal(np.isfinite(session.require_view().now.errors[0][0]), expected)


@pytest.mark.slow
def test_a_stretch_as_a_condition_scores_its_samples_and_keeps_the_former_condition(exhaust: Path) -> None:
    session = Session(exhaust)
    limit(session, 0, "Speed > 1500 or Speed < 900")
    view = session.require_view()
    scored, position = np.isfinite(view.now.errors[0][0]), view.model.recordings[0].position
    brush = {"begin": float(position[500]), "end": float(position[2500])}
    head, _ = ask(session, "conditions", brush=brush)
    assert head["where"].startswith("(Speed > 1500 or Speed < 900) and t >= ")
    limit(session, 0, head["where"])
    inside = (position >= brush["begin"]) & (position <= brush["end"])
    np.testing.assert_array_equal(np.isfinite(session.require_view().now.errors[0][0]), scored & inside)


def test_a_region_gives_the_samples_a_weight(exhaust: Path) -> None:
    session = Session(exhaust)
    head, _ = ask(session, "conditions", brush=RECTANGLE)
    regions = [{"where": head["region"], "weight": 3.0}]
    session.do(SetKeys("weighted", session.path.name, [(("criterion", 1, "regions"), regions)]))
    view = session.require_view()
    recording = view.model.recordings[0]
    weights = sample_weights(view.model.problem.criteria[0], recording.bound.dataset)
    chosen = view.signals.selected(recording, selection_of(RECTANGLE))
    np.testing.assert_array_equal(weights, np.where(chosen, 3.0, 1.0))


def test_outputs_of_the_function_cannot_be_a_condition(exhaust: Path) -> None:
    head, _ = ask(
        Session(exhaust),
        "conditions",
        brush={"ranges": [{"signal": {"kind": "error", "name": "0"}, "least": 5, "greatest": 9}]},
    )
    assert head["where"] == head["region"] == ""
    assert head["reason"] == (
        "A condition reads recorded channels; the error of TemperaturePredict is computed by the function."
    )


def test_a_stretch_of_points_without_time_cannot_be_a_condition(torque: Path) -> None:
    session = Session(torque)
    recording = session.require_view().model.recordings[0]
    assert not recording.timed
    with pytest.raises(ArgumentError, match="no time stamps"):
        condition(SampleSelection(begin=3, end=9), recording, session.require_view().model.problem)


def test_a_stretch_of_several_recordings_cannot_be_a_condition(exhaust: Path) -> None:
    shutil.copy(exhaust.with_name("drive.csv"), exhaust.with_name("again.csv"))
    exhaust.write_text(
        exhaust.read_text(encoding="utf-8").replace('files = ["drive.csv"]', 'files = ["drive.csv", "again.csv"]'),
        encoding="utf-8",
    )
    session = Session(exhaust)
    recording = session.require_view().model.recordings[0]
    assert recording.starts.size > 1
    head, _ = ask(session, "conditions", brush={"begin": 10.0, "end": 20.0})
    assert "several such pieces" in head["reason"]


def test_a_stretch_cannot_be_a_region_if_other_datasets_share_the_criterion(exhaust: Path) -> None:
    session = Session(exhaust)
    assert len(session.require_view().model.recordings) > 1
    head, _ = ask(session, "conditions", brush={"begin": 10.0, "end": 20.0})
    assert head["where"]
    assert head["region"] == ""
    assert "all datasets" in head["regionReason"]


def test_names_that_formula_text_cannot_spell_are_quoted(exhaust: Path) -> None:
    session = Session(exhaust)
    selection = SampleSelection((SignalRange(SignalName("channel", "Speed [rpm]"), 1.0, 2.0),))
    text = condition(selection, session.require_view().model.recordings[0], session.require_view().model.problem)
    assert text == "%Speed [rpm]% >= 1 and %Speed [rpm]% <= 2"


def test_a_view_of_some_samples_leaves_gaps_for_the_others(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording, speed = view.model.recordings[0], SignalName("channel", "Speed")
    only = SampleSelection((SignalRange(speed, 1500.0, 2500.0),))
    section = strip(view.signals, recording, [speed], 100.0, 140.0, 2000, only)
    values = section.lines[0]
    assert np.isnan(values).any()
    assert values[np.isfinite(values)].min() >= 1500.0


def test_a_brush_of_errors_follows_an_edit(exhaust: Path) -> None:
    session = Session(exhaust)
    view = session.require_view()
    brush = SampleSelection((SignalRange(SignalName("error", "0"), -1e9, -50.0),))
    before = int(view.signals.selected(view.model.recordings[0], brush).sum())
    values = session.parameters["MapSettled"].values + 100.0
    session.do(SetValues("raised", "MapSettled", values))
    assert int(view.signals.selected(view.model.recordings[0], brush).sum()) < before


def test_brushed_samples_are_highlighted_in_a_scatter(exhaust: Path) -> None:
    session = Session(exhaust)
    arguments = {"signals": [SPEED, {"kind": "error", "name": "0"}, {"kind": "channel", "name": "nothing"}]}
    head, arrays = ask(session, "points", **arguments, brush=RECTANGLE, most=500)
    lit = arrays["lit"] > 0
    assert 0 < lit.sum() < lit.size
    assert arrays["0"][lit].min() >= 1500
    assert arrays["0"][lit].max() <= 2500
    assert "2" not in arrays
    recording = session.require_view().model.recordings[0]
    at = np.searchsorted(recording.position, arrays["position"] + head["begin"] - 1e-9)
    np.testing.assert_array_equal(recording.channel("Speed")[at], arrays["0"])


def test_the_histogram_of_a_brush_counts_its_samples(exhaust: Path) -> None:
    session = Session(exhaust)
    _, arrays = ask(session, "scatter", criterion=0, brush=RECTANGLE)
    chosen = session.require_view().signals.selected(
        session.require_view().model.recordings[0], selection_of(RECTANGLE)
    )
    errors = session.require_view().now.errors[0][0]
    assert arrays["brushed"].sum() == np.isfinite(errors[chosen]).sum()
    assert arrays["after"].sum() == np.isfinite(errors).sum()
    _, arrays = ask(session, "scatter", criterion=0, only=RECTANGLE)
    assert arrays["after"].sum() == np.isfinite(errors[chosen]).sum()


def test_statistics_of_a_brush_are_those_of_its_samples(exhaust: Path) -> None:
    session = Session(exhaust)
    head, _ = ask(session, "statistics", brush=RECTANGLE, signals=[SPEED, {"kind": "node", "name": "nothing"}])
    speed, missing = head["statistics"]
    assert 1500 <= speed["least"] < speed["mean"] < speed["greatest"] <= 2500
    assert missing["samples"] == 0


def test_the_cursor_moves_sample_by_sample(exhaust: Path) -> None:
    session = Session(exhaust)
    position = session.require_view().model.recordings[0].position
    near = float(0.6 * position[100] + 0.4 * position[101])
    for step, expected in ((0, 100), (1, 101), (-10, 90), (-1000, 0), (10**9, position.size - 1)):
        head, _ = ask(session, "cursor", position=near, step=step, signals=[SPEED])
        assert head["sample"] == expected
        assert head["position"] == position[expected]
        assert head["values"] == [session.require_view().model.recordings[0].channel("Speed")[expected]]


def test_a_channel_that_the_project_does_not_use_can_be_drawn(exhaust: Path) -> None:
    file = exhaust.with_name("drive.csv")
    header, units, *rows = file.read_text().splitlines()
    text = [f"{header},Boost", f"{units},bar", *(f"{row},{0.5 * number}" for number, row in enumerate(rows))]
    file.write_text("\n".join(text))
    session = Session(exhaust)
    head, _ = ask(session, "signals")
    assert {"kind": "channel", "name": "Boost", "unit": "bar", "label": "Boost", "group": "channel, not used"} in head[
        "signals"
    ]
    boost, nothing = {"kind": "channel", "name": "Boost"}, {"kind": "channel", "name": "nothing"}
    head, arrays = ask(session, "strip", signals=[nothing, boost], begin=0.0, end=1e9, pixels=200)
    assert list(head["missing"]) == [0]
    assert np.nanmax(arrays["1"]) == (len(rows) - 1) * 0.5
