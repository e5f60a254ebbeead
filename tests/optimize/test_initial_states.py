"""Begins of memories: at the first input, at an expression, or at values that are fitted like any other."""

import numpy as np
import pytest

import kennfeld as kf

STEP, SAMPLES, LAG = 0.1, 600, 3.0


def recording(first, seed, **columns):
    """A lag that begins at `first`, with a little noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=SAMPLES // 50), 50)
    y, states = first, []
    for x in u:
        y += STEP / (LAG + STEP) * (x - y)
        states.append(y)
    measured = np.array(states) + rng.normal(0.0, 0.01, SAMPLES)
    return {"u": u, "m": measured, **{name: np.full(SAMPLES, value) for name, value in columns.items()}}


def dataset(*recordings, **attributes):
    columns = {name: np.concatenate([one[name] for one in recordings]) for name in recordings[0]}
    time = np.tile(STEP * np.arange(SAMPLES), len(recordings))
    starts = SAMPLES * np.arange(len(recordings))
    return kf.Dataset.of("drives", columns, time=time, piece_starts=starts, **attributes)


def test_an_initial_state_is_fitted_like_any_other_value():
    data = dataset(recording(5.0, 0))
    result = kf.calibrate("y = PT1(u, T, first)", data, {"T": 1.0, "first": 0.0}, "m")
    assert result.parameters["first"].value == pytest.approx(5.0, abs=0.02)
    assert result.parameters["T"].value == pytest.approx(LAG, rel=0.01)


def test_each_recording_may_have_a_fitted_initial_state_of_its_own():
    truth = [5.0, -2.0, 1.0]
    data = dataset(*(recording(first, run, run=run) for run, first in enumerate(truth, 1)))
    start = kf.ParameterSet([kf.Scalar("T", 1.0), kf.Curve("First", [1, 2, 3], [0.0, 0.0, 0.0])])
    result = kf.calibrate("y = PT1(u, T, First(run))", data, start, "m")
    assert result.parameters["First"].values == pytest.approx(truth, abs=0.02)
    assert result.quality[0].rmse_after == pytest.approx(0.01, rel=0.1)


def test_an_initial_state_may_be_an_expression_over_channels():
    data = dataset(recording(5.0, 0, cold=2.0))
    result = kf.calibrate("y = PT1(u, T, 2 * cold + 1)", data, {"T": 1.0}, "m")
    assert result.parameters["T"].value == pytest.approx(LAG, rel=0.01)
    assert result.quality[0].rmse_after == pytest.approx(0.01, rel=0.1)


def test_a_warmup_excludes_samples_with_an_unknown_state():
    spoilt = kf.calibrate("y = PT1(u, T)", dataset(recording(5.0, 0)), {"T": 1.0}, "m")
    warm = kf.calibrate("y = PT1(u, T)", dataset(recording(5.0, 0), warmup=8 * LAG), {"T": 1.0}, "m")
    assert warm.quality[0].samples == SAMPLES - round(8 * LAG / STEP)
    assert warm.parameters["T"].value == pytest.approx(LAG, rel=0.01)
    assert abs(spoilt.parameters["T"].value - LAG) > 10 * abs(warm.parameters["T"].value - LAG)


def test_samples_that_are_not_scored_are_simulated():
    columns = recording(0.0, 3)
    counted = np.arange(SAMPLES) % 50 > 25  # what follows a step at once is masked, the state carries it on
    wrong = np.where(counted, columns["m"], 99.0)
    data = dataset(columns | {"m": wrong}, scored=counted)
    result = kf.calibrate("y = PT1(u, T, 0)", data, {"T": 1.0}, "m")
    assert result.parameters["T"].value == pytest.approx(LAG, rel=0.02)
