from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import DynamicSurrogate, FilteredSurrogate, read_surrogate, write_surrogate
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty, LinearisedRun
from kennfeld.surrogate.recursion import UNLIMITED
from kennfeld.surrogate.surrogate_file import surrogate_notes
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty
from tests.surrogate.surrogates import dynamic_surrogate, random_expansion, tank_recording


def linear(*slopes, offset=0.0):
    return Expansion(offset, slopes, [], np.empty((0, len(slopes))), np.empty((0, len(slopes))))


def along(model, points, lags, limits=UNLIMITED):
    return LinearisedRun.along(model, points, lags, limits, shares=True)


def ensemble(model, lags, limits, process_noise, steps, runs=40_000):
    """Run copies of a model without inputs, disturbed at each step: Float[steps, runs]."""
    rng, back = np.random.default_rng(0), max(lags)
    y = np.zeros((back + steps, runs))
    for k in range(back, back + steps):
        x = np.stack([y[k - lag] for lag in lags], axis=-1)
        y[k] = np.clip(model(x) + process_noise * rng.normal(size=runs), *limits)
    return y[back:]


def path(model, lags, limits, steps):
    """The points of the undisturbed run: Float[steps, 1, lags]."""
    y, back = np.zeros(max(lags) + steps), max(lags)
    points = np.empty((steps, 1, len(lags)))
    for k in range(back, back + steps):
        points[k - back, 0] = [y[k - lag] for lag in lags]
        y[k] = np.clip(model(points[k - back]), *limits)[0]
    return points


def test_errors_of_a_first_order_model_grow_to_their_stationary_deviation():
    run = along(linear(0.9), np.zeros((200, 1, 1)), (1,))
    deviation = run.deviation(FreeRunUncertainty(0.0, 0.3, 0.1))[:, 0]
    k = np.arange(1, 201)
    np.testing.assert_allclose(deviation**2, 0.09 + 0.01 * (1 - 0.81**k) / (1 - 0.81), rtol=1e-12)


@pytest.mark.parametrize("lags", [(1,), (2,), (1, 4), (2, 3, 7)])
def test_errors_are_the_sum_of_all_disturbances_run_through_the_recursion(lags):
    rng, steps, runs, back = np.random.default_rng(0), 40, 3, max(lags)
    slopes = rng.uniform(-0.8, 0.8, (steps, runs, len(lags)))
    shares = rng.uniform(0, 1, (steps, runs))
    run = LinearisedRun(lags, UNLIMITED, np.zeros((steps, runs)), slopes, shares)
    unmeasured = rng.random((back, runs)) < 0.5
    # a column for each disturbance; the last one is common to all outputs that are not measured
    response = np.zeros((back + steps, runs, steps + 1))
    response[:back, :, -1] = unmeasured
    for k in range(steps):
        for i, lag in enumerate(lags):
            response[back + k] += slopes[k, :, i, None] * response[back + k - lag]
        response[back + k, :, k] += 1
    added = np.moveaxis(0.1**2 + (0.5 * shares) ** 2, 0, 1)
    disturbed = np.append(added, np.full((runs, 1), 0.7**2), axis=1)
    expected = np.sqrt(np.sum(response[back:] ** 2 * disturbed, axis=-1) + 0.3**2)
    np.testing.assert_allclose(run.deviation(FreeRunUncertainty(0.5, 0.3, 0.1, 0.7), unmeasured), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("slopes", "lags", "limits"),
    [
        ((1.2, -0.5), (1, 2), UNLIMITED),
        ((0.6, 0.3), (1, 4), UNLIMITED),
        ((0.8,), (1,), (-np.inf, 0.4)),
        ((0.7,), (1,), (0.2, 0.5)),
    ],
)
def test_errors_are_those_of_an_ensemble_of_disturbed_runs(slopes, lags, limits):
    model, steps = linear(*slopes, offset=0.08), 25 if limits == UNLIMITED else 8
    points = path(model, lags, limits, steps)
    runs = ensemble(model, lags, limits, 0.05, steps)
    deviation = along(model, points, lags, limits).deviation(FreeRunUncertainty(0.0, 0.0, 0.05))[:, 0]
    middle = np.clip(model(points), *limits)
    expected = np.sqrt(np.mean((runs - middle) ** 2, axis=1))
    np.testing.assert_allclose(deviation, expected, rtol=0.03 if limits == UNLIMITED else 0.3, atol=2e-3)


def test_two_deviations_of_the_output_stay_within_the_limits():
    run = along(linear(1.0), np.full((50, 1, 1), 0.4), (1,), (0.0, 1.0))
    deviation = run.deviation(FreeRunUncertainty(0.0, 0.0, 5.0))
    assert np.all(deviation <= 0.25 + 1e-12)
    assert np.all(run.deviation(FreeRunUncertainty(0.0, 0.0, 1e-3))[:9] > 1e-4)
    far_above = along(linear(1.0), np.full((5, 1, 1), 9.0), (1,), (0.0, 1.0))
    np.testing.assert_array_equal(far_above.deviation(FreeRunUncertainty(0.0, 0.1, 1.0)), 0.1)


def test_a_run_is_linearised_according_to_its_expansion():
    for model in (random_expansion(0, 3, 5), linear(0.3, 0.2, 0.1)):
        points = np.random.default_rng(1).normal(size=(20, 2, 3))
        run = along(model, points, (1, 4))
        np.testing.assert_allclose(run.free, model(points), rtol=1e-12)
        np.testing.assert_allclose(run.slopes, model.gradient(points)[..., :2], rtol=1e-10, atol=1e-12)
    bells = random_expansion(0, 3, 5)
    share = Deviation(bells, Uncertainty(1.0, 0.0, np.full(5, 1e-8)))(points)
    np.testing.assert_allclose(along(bells, points, (1,)).shares, share, rtol=1e-6)


def test_the_deviation_grows_away_from_the_centres():
    model = random_expansion(0, 1, 5)
    points = np.concatenate([model.centres, [[30.0]]])[None]
    deviation = along(model, points, (1,)).deviation(FreeRunUncertainty(2.0, 0.1, 0.0))[0]
    assert np.all(deviation[:5] < 0.11)
    assert deviation[5] > 2


def test_errors_of_an_unstable_model_become_infinite_without_a_warning():
    for lags in ((1,), (1, 3)):
        run = along(linear(*[1e3] * len(lags)), np.zeros((200, 1, len(lags))), lags)
        deviation = run.deviation(FreeRunUncertainty(0.0, 0.1, 0.1))[:, 0]
        assert np.isinf(deviation[-1])
        assert not np.isnan(deviation).any()


def test_many_steps_stay_bounded_and_a_gap_has_no_deviation():
    surrogate = dynamic_surrogate(uncertainty=FreeRunUncertainty(0.1, 0.2, 0.05, 1.0))
    u = np.random.default_rng(0).normal(size=(100_000, 2))
    deviation = surrogate.deviation(u)
    assert deviation.min() > 0.2
    assert deviation.max() < 2
    u[50_000] = np.nan
    cut = surrogate.deviation(u)
    np.testing.assert_array_equal(cut[:50_000], deviation[:50_000])
    assert np.isnan(cut[50_000:]).all()


def test_the_deviation_grows_from_the_first_free_sample_as_far_as_outputs_are_measured():
    uncertainty = FreeRunUncertainty(0.0, 0.01, 0.02, 3.0)
    model = DynamicSurrogate("lag", ("u",), ((0,),), "y", (1, 3), 0.1, linear(0.5, 0.4, 0.1), uncertainty=uncertainty)
    u = np.ones((400, 1))
    measured, unmeasured, partly = (model.deviation(u, y0) for y0 in ([0.5, 0.4, 0.3], None, [0.5]))
    np.testing.assert_array_equal(measured[:3], 0)
    assert measured[3] == pytest.approx(np.hypot(0.01, 0.02))
    assert np.all(np.diff(measured[3:]) > -1e-12)
    assert unmeasured[0] == pytest.approx(np.sqrt(0.01**2 + 0.02**2 + (0.9 * 3) ** 2))
    assert partly[0] == 0
    assert partly[1] == pytest.approx(np.sqrt(0.01**2 + 0.02**2 + (0.4 * 3) ** 2))
    assert measured[-1] == pytest.approx(unmeasured[-1]) == pytest.approx(partly[-1])
    np.testing.assert_array_equal(model.deviation(u[:2], [1.0, 2.0]), 0)


def test_points_of_runs_side_by_side_may_be_repeated():
    model = dynamic_surrogate(uncertainty=FreeRunUncertainty(0.1, 0.2, 0.05, 1.0))
    points = np.random.default_rng(0).normal(size=(1, 3, 5))
    repeated = model.deviation_along(points, measured=False, repeats=6)
    np.testing.assert_array_equal(repeated, model.deviation_along(np.repeat(points, 6, axis=0), measured=False))
    assert np.all(repeated[0] > model.deviation_along(points, repeats=6)[0])


def test_deviations_that_do_not_fit_are_refused():
    with pytest.raises(ArgumentError, match=r"process_noise=-1 of an uncertainty must be a finite number >= 0"):
        FreeRunUncertainty(1.0, 1.0, -1)
    with pytest.raises(ArgumentError, match=r"noise=nan"):
        FreeRunUncertainty(1.0, np.nan, 0.0)
    e = random_expansion(1, 5, 4)
    wide = replace(e, widths=e.widths * np.arange(1, 5)[:, None])
    with pytest.raises(ArgumentError, match=r"signal of an uncertainty must be 0 if the widths"):
        dynamic_surrogate(expansion=wide, uncertainty=FreeRunUncertainty(1.0, 1.0, 0.0))
    known = dynamic_surrogate(expansion=wide, uncertainty=FreeRunUncertainty(0.0, 1.0, 0.1))
    assert np.all(known.deviation(np.zeros((9, 2))) > 1)


def filtered_surrogate(**changes):
    e = random_expansion(2, 4, 3)
    return FilteredSurrogate("slow", ("a", "b"), "y", 0.1, (1.0,), e, **changes)


def test_the_deviation_is_stored(tmp_path):
    u = np.random.default_rng(0).normal(size=(30, 2))
    recursion = dynamic_surrogate(uncertainty=FreeRunUncertainty(0.5, 1 / 3, 0.1, 0.7))
    filtered = filtered_surrogate(uncertainty=Uncertainty(0.5, 1 / 3, np.full(3, 1e-8)))
    for surrogate in (recursion, filtered):
        write_surrogate(surrogate, tmp_path / "f.json")
        stored = read_surrogate(tmp_path / "f.json")
        np.testing.assert_array_equal(stored.deviation(u), surrogate.deviation(u))
        assert np.all(stored.deviation(u, [1.0, 2.0])[2:] >= 1 / 3)
        np.testing.assert_array_equal(stored.deviation(u, [1.0, 2.0])[:2], 0)
    assert (
        "deviation of a new measurement from a free run: 0.348 rpm at its first step" in surrogate_notes(recursion)[1]
    )
    assert "deviation of a new measurement: 0.333 amidst the training data" in surrogate_notes(filtered)[1]


def test_a_model_without_a_known_uncertainty_has_no_deviation(tmp_path):
    u = np.zeros((5, 2))
    for surrogate in (dynamic_surrogate(), filtered_surrogate()):
        write_surrogate(surrogate, tmp_path / "f.json")
        stored = read_surrogate(tmp_path / "f.json")
        assert np.isnan(stored.deviation(u)).all()
        assert np.isnan(stored.deviation(u, [0.0])).all()
        assert "deviation of a new measurement: not known" in surrogate_notes(stored)


TANK = SurrogateSettings(
    "tank", ("u",), "level", kind="dynamic", centres=8, lags={"u": (1,)}, output_lags=(1,), hold=1.0, iterations=4
)


def covered(surrogate, recording):
    u, y = recording["u"].values[:, None], recording["level"].values
    free, deviation = surrogate.simulate(u, y[:1]), surrogate.deviation(u, y[:1])
    return float(np.mean(np.abs(free - y)[1:] <= 2 * deviation[1:]))


@pytest.mark.slow
def test_two_deviations_cover_measurements_of_another_recording():
    tank = train_surrogate([tank_recording("tank", 0, 300)], TANK)
    assert 0.88 < covered(tank, tank_recording("other", 1, 600)) <= 1
    assert tank.uncertainty.noise < 0.05  # the level has 0.01
    level = tank_recording("tank", 0, 300)["level"].values
    assert tank.uncertainty.start == pytest.approx(np.sqrt(np.mean((level - tank.start) ** 2)))


def test_moved_centres_have_a_deviation_which_does_not_grow_outside_the_data():
    tank = train_surrogate([tank_recording("tank", 0, 200)], replace(TANK, moves_centres=True, iterations=2))
    assert tank.uncertainty.signal == 0
    assert tank.uncertainty.first > 0


def test_too_short_recordings_have_no_deviation():
    assert train_surrogate([tank_recording("tank", 0, 25)], TANK).uncertainty is None


def narx_recording(name, seed, use):
    """A recursion with noise of the process and of the measurement, driven by steps."""
    rng, samples = np.random.default_rng(seed), 800
    u = np.repeat(rng.uniform(-1, 1, samples // 20), 20)
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.85 * y[k - 1] - 0.1 * y[k - 1] ** 3 + 0.3 * np.tanh(2 * u[k - 1]) + 0.02 * rng.normal()
    channels = {"u": u, "level": y + 0.02 * rng.normal(size=samples)}
    return Dataset.of(name, channels, time=np.arange(float(samples)), use=use)


@pytest.mark.slow
def test_two_deviations_cover_new_recordings_of_drawn_systems():
    settings = replace(TANK, lags={"u": (0, 1)}, output_lags=(1, 2), hold=30.0)
    shares = []
    for seed in range(10):
        surrogate = train_surrogate([narx_recording("drawn", seed, "training")], settings)
        shares += [covered(surrogate, narx_recording("new", 100 + seed, "test"))]
    assert 0.9 <= np.mean(shares) <= 0.98
    assert min(shares) > 0.8
