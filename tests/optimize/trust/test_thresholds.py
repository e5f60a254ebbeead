"""Thresholds: what a descent says of them, and how well a global search knows them."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.trust.flat_intervals import flat_intervals

TEXT = "y = PT1(k * hysteresis(u, on, off), T)"


def relay_data(samples=600):
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(samples)
    u = 5 + 4 * np.sin(0.7 * time) + rng.normal(0, 0.3, samples)
    truth = {"k": 3.0, "on": 6.2, "off": 3.9, "T": 0.8}
    clean = kf.simulate(TEXT, kf.Dataset.of("d", {"u": u}, time=time), truth)["y"].values
    return u, kf.Dataset.of("d", {"u": u, "z": clean + rng.normal(0, 0.02, samples)}, time=time)


def start(on, off):
    return kf.ParameterSet(
        [
            kf.Scalar("k", 3.0, lower=0.0, upper=10.0),
            kf.Scalar("on", on, lower=5.0, upper=10.0),
            kf.Scalar("off", off, lower=0.0, upper=5.0),
            kf.Scalar("T", 0.8, lower=0.05, upper=5.0),
        ]
    )


def test_a_descent_warns_that_the_cost_jumps():
    result = kf.calibrate(TEXT, relay_data()[1], start(8.0, 2.0), target="z")
    warning, short = result.warnings
    assert "time constant of PT1 that depends on T is below 5 steps" in short.message
    assert warning.message == "y (>=, <=) jumps depending on on, off; derivatives do not account for that"
    assert warning.remedy == 'Write method = "global", and bounds for on, off.'
    sentences = [direction.sentence for direction in result.trust.directions]
    assert "The cost jumps as on changes, which derivatives do not show; kept at its start value." in sentences, (
        sentences
    )
    assert not any("Not determined by data" in sentence for sentence in sentences)


def test_a_smooth_function_has_no_such_warning():
    result = kf.calibrate("y = PT1(k * u, T)", relay_data()[1], {"k": 1.0, "T": 0.5}, target="z")
    assert not any("jump" in finding.message for finding in result.warnings)


@pytest.mark.slow
def test_a_threshold_of_a_global_search_is_known_between_samples():
    u, data = relay_data()
    options = kf.Options(method="global", max_evaluations=400)
    result = kf.calibrate(TEXT, data, start(6.5, 3.5), target="z", options=options)
    assert result.warnings == ()
    intervals = [direction for direction in result.trust.directions if "between" in direction.sentence]
    for direction in intervals:
        (name,) = direction.parts
        words = direction.sentence.split()
        low, high = (float(words[words.index("between") + i].rstrip(";")) for i in (1, 3))
        assert low < result.parameters[name].value < high
        assert np.abs(u - low).min() < 1e-4
        assert np.abs(u - high).min() < 1e-4
    assert {name for direction in intervals for name in direction.parts} == {"on", "off"}


def test_the_interval_of_a_step_lies_between_its_neighbours():
    steps = np.array([0.3, 0.41, 0.77])

    def cost(values):
        return float((values[0] > steps).sum()) + 0.0 * values[1]

    bounds = np.array([[0.0, -1.0], [1.0, 1.0]])
    low, high = flat_intervals(cost, np.array([0.5, 0.0]), [0, 1], bounds)
    assert [low[0], high[0]] == pytest.approx([0.41, 0.77], abs=1e-5)
    assert np.isnan([low[1], high[1]]).all()
    low, high = flat_intervals(cost, np.array([0.9, 0.0]), [0], bounds)
    assert [low[0], high[0]] == pytest.approx([0.77, 1.0], abs=1e-5)
