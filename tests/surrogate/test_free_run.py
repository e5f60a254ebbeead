import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.surrogate.narx_training import (
    TrainedValues,
    TrainingSettings,
    _evaluate,
    _normal,
    free_run_rmse,
    train_free_run,
)
from kennfeld.surrogate.recursion import Lags, Recording, Runs, simulate
from tests.draws import mostly_slow
from tests.surrogate.surrogates import random_expansion

LAGS = Lags((1, 3), ((0, 2),))


def pieces(seed=0, lengths=(30, 30, 12)):
    rng = np.random.default_rng(seed)
    return [Recording(rng.normal(size=(n, 1)), 0.3 * rng.normal(size=n)) for n in lengths]


def by_hand(expansion, lags, run, limits=(-np.inf, np.inf)):
    y = run.y.copy()
    for k in range(lags.longest, len(y)):
        x = [y[k - lag] for lag in lags.output] + [
            run.u[k - lag, j] for j, chosen in enumerate(lags.inputs) for lag in chosen
        ]
        y[k] = np.clip(expansion(np.array(x)), *limits)
    return y[lags.longest :]


@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-0.2, 0.2)])
def test_pieces_side_by_side_run_as_each_does_alone(limits):
    expansion = random_expansion(0, 4, 5)
    runs = Runs.of(pieces(), LAGS)
    y = simulate(expansion, runs, limits).y
    for i, piece in enumerate(pieces()):
        expected = by_hand(expansion, LAGS, piece, limits)
        np.testing.assert_allclose(y[: expected.size, i], expected, rtol=1e-12, atol=1e-14)
        assert runs.scored[:, i].sum() == expected.size


def test_blocks_do_not_change_a_run(monkeypatch):
    expansion, runs = random_expansion(0, 4, 5), Runs.of(pieces(), LAGS)
    whole = simulate(expansion, runs)
    monkeypatch.setattr("kennfeld.surrogate.recursion.BLOCK", 40)
    np.testing.assert_allclose(simulate(expansion, runs).y, whole.y, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("moves_centres", [False, True])
@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-0.3, 0.3)])
def test_sensitivities_through_the_recursion_agree_with_differences(moves_centres, limits, monkeypatch):
    monkeypatch.setattr("kennfeld.surrogate.narx_training.BLOCK", 500)
    runs = Runs.of(pieces(), LAGS)
    settings = TrainingSettings(moves_centres=moves_centres, limits=limits, hold=0.5)
    values = TrainedValues(random_expansion(2, 4, 4), runs, settings)
    at = values.first + 0.01
    expansion, run, _ = _evaluate(values, at, runs, settings)
    gradient = _normal(values, expansion, run, runs)[1] + values.hold * (at - values.goal)
    differences = [
        (_evaluate(values, at + h, runs, settings)[2] - _evaluate(values, at - h, runs, settings)[2]) / 4e-6
        for h in 1e-6 * np.eye(at.size)
    ]
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-5 * np.abs(gradient).max())


def test_training_starts_at_the_specified_expansion():
    runs, start = Runs.of(pieces(), LAGS), random_expansion(3, 4, 4)
    values = TrainedValues(start, runs, TrainingSettings(moves_centres=True))
    same = values.expansion(values.first)
    x = np.random.default_rng(0).normal(size=(20, 4))
    np.testing.assert_allclose(same(x), start(x), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("moves_centres", mostly_slow([False, True], [True]))
def test_training_recovers_a_model_from_its_own_free_run(moves_centres):
    truth, rng = random_expansion(5, 4, 6), np.random.default_rng(1)
    recordings = []
    for run in pieces(4, (150, 150)):
        y = np.concatenate([run.y[:3], by_hand(truth, LAGS, run)])
        recordings.append(Recording(run.u, y))
    runs = Runs.of(recordings, LAGS)
    start = type(truth)(
        truth.offset, truth.slopes, truth.weights + 0.05 * rng.normal(size=6), truth.centres, truth.widths
    )
    before = free_run_rmse(start, runs)
    settings = TrainingSettings(hold=1e-9, moves_centres=moves_centres, iterations=25, tolerance=1e-12)
    errors = []
    trained = train_free_run(start, runs, settings, lambda step, rmse: errors.append(rmse))
    assert free_run_rmse(trained, runs) < 1e-3 * before
    assert errors[-1] == pytest.approx(free_run_rmse(trained, runs), rel=1e-6)


def test_what_is_held_firmly_becomes_its_goal():
    runs, start = Runs.of(pieces(), LAGS), random_expansion(3, 4, 4)
    stays = train_free_run(start, runs, TrainingSettings(hold=1e9, toward_plane=False))
    np.testing.assert_allclose(stays.weights, start.weights, atol=1e-6)
    flat = train_free_run(start, runs, TrainingSettings(hold=1e9, toward_plane=True))
    np.testing.assert_allclose(flat.weights, 0.0, atol=1e-6)


def test_a_model_that_runs_away_costs_infinitely_and_raises_nothing():
    wild = random_expansion(0, 4, 3)
    wild = type(wild)(wild.offset, [30.0, 0, 0, 0], wild.weights, wild.centres, wild.widths)
    runs = Runs.of([Recording(np.ones((900, 1)), np.ones(900))], LAGS)
    assert free_run_rmse(wild, runs) == np.inf
    assert train_free_run(wild, runs, TrainingSettings()) is not None


def test_samples_that_do_not_count_are_run_through():
    run = pieces()[0]
    counted = np.arange(30) % 2 == 0
    runs = Runs.of([Recording(run.u, run.y, counted)], LAGS)
    assert runs.scored.sum() == len(runs.points) == counted[3:].sum()
    np.testing.assert_array_equal(
        simulate(random_expansion(0, 4, 5), runs).y, simulate(random_expansion(0, 4, 5), Runs.of([run], LAGS)).y
    )


def test_lags_that_cannot_be_are_named():
    with pytest.raises(ArgumentError, match=r"output_lags=\(0,\) must be whole numbers from 1 on"):
        Lags((0,), ())
    with pytest.raises(ArgumentError, match=r"lags=\(-1,\) must be whole numbers from 0 on"):
        Lags((1,), ((-1,),))
    with pytest.raises(ArgumentError, match="at least one lag"):
        Lags((), ((0,),))
    with pytest.raises(ArgumentError, match="longer than 3 samples"):
        Runs.of([Recording(np.zeros((3, 1)), np.zeros(3))], LAGS)
