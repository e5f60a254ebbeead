import numpy as np
import pytest

from kennfeld.errors import ArgumentError
from kennfeld.rbf import Expansion
from kennfeld.surrogate import DynamicSurrogate, FilteredSurrogate, read_surrogate, write_surrogate
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty, free_run_deviation
from kennfeld.surrogate.surrogate_file import surrogate_notes
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.uncertainty import Uncertainty
from tests.surrogate.surrogates import dynamic_surrogate, random_expansion, tank_recording

NONE = (-np.inf, np.inf)


def linear(*slopes, offset=0.0):
    return Expansion(offset, slopes, [], np.empty((0, len(slopes))), np.empty((0, len(slopes))))


def ensemble(model, lags, limits, process_noise, steps, runs=40_000):
    """Run copies of a model without inputs, disturbed at each step: Float[lags + steps, runs]."""
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
    uncertainty = FreeRunUncertainty(0.0, 0.3, 0.1, [])
    deviation = free_run_deviation(linear(0.9), uncertainty, np.zeros((200, 1, 1)), (1,), NONE)[:, 0]
    k = np.arange(1, 201)
    np.testing.assert_allclose(deviation**2, 0.09 + 0.01 * (1 - 0.81**k) / (1 - 0.81), rtol=1e-12)


@pytest.mark.parametrize(
    ("slopes", "lags", "limits"),
    [
        ((1.2, -0.5), (1, 2), NONE),
        ((0.6, 0.3), (1, 4), NONE),
        ((0.8,), (1,), (-np.inf, 0.4)),
        ((0.7,), (1,), (0.2, 0.5)),
    ],
)
def test_errors_are_those_of_an_ensemble_of_disturbed_runs(slopes, lags, limits):
    model, steps = linear(*slopes, offset=0.08), 25 if limits == NONE else 8
    points = path(model, lags, limits, steps)
    runs = ensemble(model, lags, limits, 0.05, steps)
    deviation = free_run_deviation(model, FreeRunUncertainty(0.0, 0.0, 0.05, []), points, lags, limits)[:, 0]
    middle = np.clip(model(points), *limits)
    expected = np.sqrt(np.mean((runs - middle) ** 2, axis=1))
    np.testing.assert_allclose(deviation, expected, rtol=0.03 if limits == NONE else 0.25, atol=1e-3)


def test_the_deviation_grows_away_from_the_centres():
    model = random_expansion(0, 1, 5)
    points = np.concatenate([model.centres, [[30.0]]])[None]
    deviation = free_run_deviation(model, FreeRunUncertainty(2.0, 0.1, 0.0, np.full(5, 1e-8)), points, (1,), NONE)[0]
    assert np.all(deviation[:5] < 0.11)
    assert deviation[5] > 2


def test_errors_of_an_unstable_model_become_infinite_without_a_warning():
    uncertainty = FreeRunUncertainty(0.0, 0.1, 0.1, [])
    deviation = free_run_deviation(linear(1e3), uncertainty, np.zeros((100, 1, 1)), (1,), NONE)[:, 0]
    assert np.isinf(deviation[-1])
    assert not np.isnan(deviation).any()


def test_deviations_that_do_not_fit_are_refused():
    with pytest.raises(ArgumentError, match=r"process_noise=-1 of an uncertainty must be a finite number >= 0"):
        FreeRunUncertainty(1.0, 1.0, -1, [])
    with pytest.raises(ArgumentError, match=r"noise=nan"):
        FreeRunUncertainty(1.0, np.nan, 0.0, [])
    with pytest.raises(ArgumentError, match=r"one number per centre, 4"):
        dynamic_surrogate(uncertainty=FreeRunUncertainty(1.0, 1.0, 0.0, [1.0]))


def filtered_surrogate(**changes):
    e = random_expansion(2, 4, 3)
    return FilteredSurrogate("slow", ("a", "b"), "y", 0.1, (1.0,), e, **changes)


def test_the_deviation_is_stored(tmp_path):
    u = np.random.default_rng(0).normal(size=(30, 2))
    recursion = dynamic_surrogate(uncertainty=FreeRunUncertainty(0.5, 1 / 3, 0.1, np.full(4, 1e-8)))
    filtered = filtered_surrogate(uncertainty=Uncertainty(0.5, 1 / 3, np.full(3, 1e-8)))
    y = recursion.simulate(u)
    for made, arguments in ((recursion, (u, y)), (filtered, (u,))):
        write_surrogate(made, tmp_path / "f.json")
        read = read_surrogate(tmp_path / "f.json")
        np.testing.assert_array_equal(read.deviation(*arguments), made.deviation(*arguments))
        assert np.all(read.deviation(*arguments) >= 1 / 3)
        assert any(line.startswith("deviation of a new measurement") for line in surrogate_notes(read))


def test_a_model_without_a_known_uncertainty_has_no_deviation():
    u = np.zeros((5, 2))
    assert np.isnan(dynamic_surrogate().deviation(u, np.zeros(5))).all()
    assert np.isnan(filtered_surrogate().deviation(u)).all()


def covered(surrogate, recording):
    u, y = recording["u"].values[:, None], recording["level"].values
    if isinstance(surrogate, DynamicSurrogate):
        free = surrogate.simulate(u, y[: max(surrogate.output_lags)])
        deviation = surrogate.deviation(u, free)
    else:
        free, deviation = surrogate.simulate(u), surrogate.deviation(u)
    return float(np.mean(np.abs(free - y) < 2 * deviation))


TANK = SurrogateSettings(
    "tank", ("u",), "level", kind="dynamic", centres=8, lags={"u": (1,)}, output_lags=(1,), hold=1.0, iterations=4
)


def test_two_deviations_cover_measurements_of_another_recording():
    tank = train_surrogate([tank_recording("tank", 0, 300)], TANK)
    assert 0.88 < covered(tank, tank_recording("other", 1, 600)) <= 1
    assert tank.uncertainty.noise < 0.05  # the level has 0.01
