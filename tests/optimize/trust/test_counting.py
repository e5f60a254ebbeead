"""Samples that count as training samples of a value."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.dataset import Settling

GRID = np.arange(5.0)


def counted(text, data, **curves):
    start = kf.ParameterSet([kf.Curve(name, GRID, np.full(5, value)) for name, value in curves.items()])
    return kf.calibrate(text, data, start, target="y", smoothness=1e-3).trust.samples


def points(settling, **more):
    u = np.array([0.5, 0.5, 1.5, 2.5, 2.5, 2.5])
    return kf.Dataset.of("d", {"u": u, "y": 2 + u} | more, settling=settling)


@pytest.mark.parametrize("average", [0.0, 1.0])
def test_a_held_point_counts_once(average):
    counts = counted("m = PT1(G(u), 0.5)", points(Settling(5.0, average, step=0.1)), G=1.0)
    assert counts["G"].tolist() == [2, 3, 4, 3, 0]


@pytest.mark.slow
@pytest.mark.parametrize(("average", "expected"), [(0.0, [0, 0, 0, 6, 6]), (2.05, [0, 0, 6, 6, 6])])
def test_a_held_point_counts_for_all_values_that_its_average_reads(average, expected, monkeypatch):
    """The ramp is looked up at 1.9, 2.0, ..., 4 s within the last two seconds."""
    monkeypatch.setattr("kennfeld.native.accumulator.TAPE_BYTES", 1)
    data = points(Settling(3.95, average, step=0.05))
    counts = counted("m = PT1(G(ramp), 0.05)\nramp = prev(ramp, 0) + dt", data, G=1.0)
    assert counts["G"].tolist() == expected


def test_a_point_without_a_target_does_not_count():
    y = np.array([1.0, np.nan, 2.0, 3.0, np.nan, 3.0])
    counts = counted("m = PT1(G(u), 0.5)", points(Settling(5.0, 1.0, step=0.1), y=y), G=1.0)
    assert counts["G"].tolist() == [1, 2, 3, 2, 0]


def test_recorded_samples_count_if_they_are_scored():
    u = np.repeat([0.5, 1.5, 2.5, 3.5], 50)
    scored = np.ones(200, dtype=bool)
    scored[:30] = False
    y = 1 + u
    y[160:] = np.nan
    data = kf.Dataset.of("d", {"u": u, "y": y}, time=0.1 * np.arange(200), scored=scored)
    counts = counted("m = PT1(G(u), T(u))", data, G=1.0, T=0.5)
    assert counts["G"].tolist() == [20, 70, 100, 60, 10]


def test_values_reached_only_by_unscored_samples_do_not_count_as_smoothed():
    """The first half is not scored, but the state remembers it."""
    u = np.repeat([0.5, 2.5], 50)
    scored = np.arange(100) >= 50
    y = 3.0 - np.exp(-0.1 * np.arange(100)) + np.random.default_rng(0).normal(0, 0.01, 100)
    data = kf.Dataset.of("d", {"u": u, "y": y}, time=0.1 * np.arange(100), scored=scored)
    start = kf.ParameterSet([kf.Curve("G", GRID, np.ones(5))])
    trust = kf.calibrate("m = PT1(G(u), 3)", data, start, target="y", smoothness=1e-3).trust
    assert trust.samples["G"].tolist() == [0, 0, 50, 50, 0]
    assert trust.by_smoothness["G"].tolist() == [False, False, False, False, True]
