"""Linked evidence: grid points and the samples that inform them."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.session.evidence import corrections
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables, SetValues


@pytest.mark.parametrize("name", ["MapOptTorque", "MapDragTorque"])
def test_samples_that_inform_a_value_are_those_whose_result_moves_with_it(torque: Path, name: str) -> None:
    session = Session(torque)
    view = session.require_view()
    value = session.parameters[name].size // 2
    informing = {part.dataset: part for part in view.evidence.informing(name, value)}
    before = view.now.errors
    values = session.parameters[name].values.copy()
    values.flat[value] += 5.0
    session.do(SetValues("raised", name, values))
    for recording, old, new in zip(view.model.recordings, before, session.require_view().now.errors, strict=True):
        samples = np.flatnonzero(np.abs(np.nan_to_num(new - old)).max(axis=0) > 1e-9)
        assert set(samples) <= set(informing[recording.number].samples.tolist())
        assert informing[recording.number].weights.max(initial=0.0) <= 1.0


def test_the_weights_of_a_stretch_add_up_to_its_samples(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording = view.model.recordings[0]
    chosen = (recording.position >= 100.0) & (recording.position <= 180.0)
    weights = view.evidence.passed(recording, chosen)
    assert weights["MapSettled"].sum() == pytest.approx(chosen.sum())
    assert weights["MapSettled"].shape == (12, 12)


def test_stretches_are_runs_of_samples_the_longest_first(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    part = view.evidence.informing("MapSettled", 60)[0]
    members = np.concatenate([np.arange(first, last + 1) for first, last in part.stretches])
    np.testing.assert_array_equal(np.sort(members), part.samples)
    lengths = [last - first for first, last in part.stretches]
    assert lengths == sorted(lengths, reverse=True)


def test_the_samples_of_a_value_are_found_once_until_lookups_move(torque: Path) -> None:
    session = Session(torque)
    view = session.require_view()
    first, again = (view.evidence.informing("CurveEtaDeltaSpark", 3) for _ in range(2))
    assert again is first
    session.do(SetTables("edited", {"MapOptIgnition": session.parameters["MapOptIgnition"].values + 5}))
    moved = view.evidence.informing("CurveEtaDeltaSpark", 3)
    assert not np.array_equal(moved[0].samples, first[0].samples)
    assert view.evidence.informing("CurveEtaDeltaSpark", 4)[0].samples is not moved[0].samples


def test_counts_agree_with_those_of_the_trust(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    counts = view.samples["MapSettled"]
    value = int(np.argmax(counts))
    training = [
        p for p in view.evidence.informing("MapSettled", value) if view.model.recordings[p.dataset].use == "training"
    ]
    assert sum(part.samples.size for part in training) == counts.flat[value]


@pytest.mark.slow
def test_a_correction_takes_the_error_away(torque: Path) -> None:
    session = Session(torque)
    view, name = session.require_view(), "MapOptTorque"
    table = session.parameters[name]
    sample, step = 1000, 1e-3
    error = view.now.errors[0][0][sample]
    slope = np.zeros(table.values.shape)
    for part in np.ndindex(table.values.shape):
        raised = table.values.copy()
        raised[part] += step
        moved = view.model.evaluate(session.parameters.with_parameters(table.with_values(raised))).errors[0][0][sample]
        slope[part] = (moved - error) / step
    [correction] = corrections(error, {name: np.where(abs(slope) > 1e-9, slope, 0.0)}, session.parameters)
    moved = table.with_values(table.values + np.where(abs(slope) > 1e-9, correction.change, 0.0))
    after = view.model.evaluate(session.parameters.with_parameters(moved)).errors[0][0][sample]
    assert abs(after) < 1e-6 * abs(error) + 1e-6


def test_a_table_without_effect_has_no_correction(torque: Path) -> None:
    parameters = Session(torque).parameters
    [correction] = corrections(1.0, {"MapOptTorque": np.zeros(parameters["MapOptTorque"].values.shape)}, parameters)
    assert correction.obstacle == "does not act"


def test_the_mean_error_at_a_grid_point_is_that_of_its_samples(exhaust: Path) -> None:
    session = Session(exhaust)
    view = session.require_view()
    errors = view.now.errors[0][0]
    answer = QUESTIONS["coverage"](session, {"name": "MapSettled", "criterion": 0})
    value = int(np.argmax(view.samples["MapSettled"]))
    part = view.evidence.informing("MapSettled", value)[0]
    own, scored = errors[part.samples], np.isfinite(errors[part.samples])
    expected = np.average(own[scored], weights=part.weights[scored])
    assert answer.arrays["error"][value] == pytest.approx(expected, rel=1e-4)
    without = view.samples["MapSettled"].ravel() == 0
    assert np.isnan(answer.arrays["error"][without]).all()


def test_data_points_of_a_table_are_lookups_of_samples(exhaust: Path) -> None:
    session = Session(exhaust)
    answer = QUESTIONS["coverage"](session, {"name": "MapSettled"})
    channels = session.require_view().model.recordings[0]
    recorded = np.column_stack([channels.channel("Speed"), channels.channel("Injection")])
    axes = session.parameters["MapSettled"].axes
    recorded = np.clip(recorded, [axis.breakpoints[0] for axis in axes], [axis.breakpoints[-1] for axis in axes])
    points = np.column_stack([answer.arrays["x"], answer.arrays["y"]])
    assert 500 < len(points) <= 2500
    for point in points[::100]:
        assert np.abs(recorded - point).max(axis=1).min() < 1e-2


def test_training_and_test_samples_of_a_value_are_counted_apart_and_training_is_shown(exhaust: Path) -> None:
    session = Session(exhaust)
    view = session.require_view()
    by_use = {
        use: sum(
            part.samples.size > 0
            for part in view.evidence.informing("MapSettled", 60)
            if view.model.recordings[part.dataset].use == use
        )
        for use in ("training", "test")
    }
    assert by_use == {"training": 1, "test": 1}
    head = QUESTIONS["informing"](session, {"name": "MapSettled", "cell": 60}).head
    rows = {row["use"]: row for row in head["datasets"]}
    assert rows["training"]["samples"] == view.samples["MapSettled"].ravel()[60]
    assert head["most"] == rows["training"]["number"]
