"""Persistence of errors, against processes whose answer is known."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.trust.persistence import LaggedProducts, inflation, lagged_products, persistence
from tests.draws import mostly_slow


def recordings(memory, samples, count, seed=0):
    """So many errors that each remember a share of the one before; stationary from the first sample."""
    white = np.random.default_rng(seed).normal(size=(samples, count))
    errors = white.copy()
    errors[0] /= np.sqrt(1 - memory**2)
    for k in range(1, samples):
        errors[k] += memory * errors[k - 1]
    return errors.T


def truth(memory, samples, share=1.0):
    """The variance of a sum of so many samples, of which a share is known, over that of independent ones."""
    lags = np.arange(1, samples)
    return 1 + 2 * share * float(np.sum((1 - lags / samples) * memory**lags))


def agrees(lengths, expected, bias=0.0):
    """Return whether their mean is the expected one, within four standard errors and a known bias."""
    lengths = np.array(lengths)
    return abs(lengths.mean() - expected) < 4 * lengths.std() / np.sqrt(lengths.size) + (0.01 + bias) * expected


SHORT = [(0.0, 300), (0.5, 200), (0.9, 200), (0.9, 500)]
LONG = [(0.0, 5000), (0.5, 5000), (0.9, 5000), (0.99, 5000), (0.99, 20_000)]


@pytest.mark.parametrize(
    ("memory", "samples"),
    [(0.0, 5000), (0.9, 500), (0.99, 5000)]
    + [pytest.param(*case, marks=pytest.mark.slow) for case in (*SHORT[:3], *LONG[1:3], LONG[4])],
)
def test_decaying_errors_have_their_exact_persistence(memory, samples):
    lengths = [persistence(error)[0] for error in recordings(memory, samples, 60)]
    assert agrees(lengths, (1 + memory) / (1 - memory))


def test_a_recording_of_five_independent_samples_has_about_five():
    lengths = [persistence(error)[0] for error in recordings(0.99, 1000, 60)]
    assert 0.5 * 199 < np.mean(lengths) < 1.2 * 199


@pytest.mark.parametrize("weight", [0.5, 1.0, -0.5])
def test_errors_of_a_moving_mean_have_their_exact_persistence(weight):
    white = np.random.default_rng(1).normal(size=(40, 4001))
    lengths = [persistence(error)[0] for error in white[:, 1:] + weight * white[:, :-1]]
    assert agrees(lengths, max(1 + 2 * weight / (1 + weight**2), 1.0), 0.02)  # never less than 1


@pytest.mark.parametrize(("samples", "pieces"), [(12, 100), (25, 80), (100, 20)])
def test_persistence_ends_with_a_piece(samples, pieces):
    starts = samples * np.arange(pieces)
    lengths = [persistence(recordings(0.9, samples, pieces, seed).ravel(), starts)[0] for seed in range(30)]
    assert agrees(lengths, truth(0.9, samples), 0.04)


@pytest.mark.parametrize("lost", [0.3, 0.8])
def test_missing_samples_have_no_neighbours(lost):
    errors = recordings(0.9, 5000, 30)
    errors[np.random.default_rng(7).random(errors.shape) < lost] = np.nan
    lengths = [persistence(error) for error in errors]
    assert [count for _, count in lengths] == np.isfinite(errors).sum(axis=1).tolist()
    assert agrees([length for length, _ in lengths], truth(0.9, 5000, 1 - lost), 0.06)


def test_the_other_samples_are_neighbours_if_every_second_one_is_missing():
    errors = recordings(0.9, 8000, 20)
    errors[:, 1::2] = np.nan
    assert agrees([persistence(error)[0] for error in errors], (1 + 0.81) / (1 - 0.81), 0.02)


@pytest.mark.parametrize("residual", [np.ones(3), np.zeros(100), np.full(50, np.nan), np.full(40, 3.0)])
def test_short_constant_and_unknown_residuals_persist_for_a_sample(residual):
    assert persistence(residual) == (1.0, np.isfinite(residual).sum())


def test_a_jump_between_pieces_does_not_count_as_correlation():
    white = np.random.default_rng(0).normal(size=4000)
    assert persistence(white, np.arange(0, 4000, 40))[0] == pytest.approx(1.0, abs=0.1)


def test_products_by_blocks_are_those_of_the_definition():
    values = np.random.default_rng(0).normal(size=70_000)
    products = lagged_products(values, 3)
    assert products == pytest.approx([values[: values.size - k] @ values[k:] for k in range(4)])


def test_products_of_pieces_are_the_sums_of_those_of_each():
    errors = np.random.default_rng(0).normal(size=1000)
    starts, lags = [0, 300, 600, 640, 641, 800], 250
    pieces = np.split(errors, starts[1:])
    expected = np.array(
        [sum(piece[: piece.size - k] @ piece[k:] for piece in pieces if k < piece.size) for k in range(lags + 1)]
    )
    products = LaggedProducts.of(errors, starts, 0.0, lags)
    np.testing.assert_allclose(products.sums, expected, atol=1e-10)
    assert products.pairs.tolist() == [sum(max(piece.size - k, 0) for piece in pieces) for k in range(lags + 1)]


def test_an_exact_correlation_gives_the_exact_sum():
    """No mean was taken off a recording that is so long that its share is nothing."""
    pairs = np.full(200, 1e12)
    assert inflation(0.9 ** np.arange(200) * pairs, pairs) == pytest.approx(19.0, rel=1e-6)


def test_a_fit_reports_the_persistence_of_its_errors_and_widens_its_deviations():
    (error,) = recordings(0.9, 20_000, 1, seed=5)
    data = kf.Dataset.of("drive", {"y": 3 + error}, time=0.1 * np.arange(error.size))
    trust = kf.calibrate("m = a", data, {"a": 0.0}, target="y").trust
    assert trust.persistence["m"] == pytest.approx(19.0, rel=0.25)
    independent = float(np.std(error)) / np.sqrt(error.size)
    assert float(trust.deviation["a"]) == pytest.approx(independent * np.sqrt(19.0), rel=0.15)


def fitted_curve(samples, breakpoints, seed, *, steady):
    """Fit a curve of an input that moves slowly, or at random, to errors of persistence 19."""
    (error,) = recordings(0.9, samples, 1, seed=seed)
    rng = np.random.default_rng(seed)
    u = np.linspace(0, 1, samples) if steady else rng.uniform(0, 1, samples)
    grid = np.linspace(0, 1, breakpoints)
    data = kf.Dataset.of(
        "drive", {"u": u, "y": np.interp(u, grid, np.sin(6 * grid)) + error}, time=0.1 * np.arange(samples)
    )
    start = kf.ParameterSet([kf.Curve("C", grid, np.zeros(breakpoints))])
    result = kf.calibrate("m = C(u)", data, start, target="y")
    away = np.abs(result.parameters["C"].values - np.sin(6 * grid))
    return result.trust, np.mean(away < 2 * result.trust.deviation["C"])


@pytest.mark.slow
@pytest.mark.parametrize("steady", mostly_slow([True, False], 1))
def test_persistence_does_not_depend_on_the_number_of_fitted_values(steady):
    trusts = [fitted_curve(1500, 8, seed, steady=steady)[0] for seed in range(8)]
    assert np.mean([trust.persistence["m"] for trust in trusts]) == pytest.approx(19.0, rel=0.15)
    variance = [trust.noise["m"] ** 2 * trust.persistence["m"] for trust in trusts]
    assert np.mean(variance) == pytest.approx(19.0 / (1 - 0.81), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "breakpoints"), [(3000, 8), (5000, 20)])
def test_two_deviations_contain_values_fitted_to_persistent_errors(samples, breakpoints):
    inside = [fitted_curve(samples, breakpoints, seed, steady=True)[1] for seed in range(60)]
    assert 0.93 < np.mean(inside) < 0.975


def test_a_limit_that_is_not_reached_does_not_change_persistence():
    (error,) = recordings(0.9, 1500, 1)
    u = np.linspace(0, 1, 1500)
    data = kf.Dataset.of("drive", {"u": u, "y": u + error}, time=0.1 * np.arange(1500))
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 8), np.zeros(8))])
    free = kf.calibrate("m = C(u)", data, start, target="y").trust
    top = float(kf.calibrate("m = C(u)", data, start, target="y").parameters["C"].values.max())
    limited = kf.calibrate("m = C(u)", data, start, target="y", limits=[kf.Limit("m", upper=top * (1 + 1e-7))]).trust
    assert limited.holdings
    assert limited.persistence["m"] == pytest.approx(free.persistence["m"], rel=1e-3)


@pytest.mark.parametrize("gaps", [False, True])
def test_products_of_parts_about_their_own_means_add_up_to_those_of_the_whole(gaps):
    errors = np.cumsum(np.random.default_rng(0).normal(size=60)) + 40
    if gaps:
        errors[[3, 17, 18, 41]] = np.nan
    starts, mean = [0, 20, 50], float(np.nanmean(errors))
    whole = LaggedProducts.of(errors, starts, mean, 29)
    parts = [LaggedProducts.of(errors[a:b], [0], 38.0 + a / 10, b - a - 1) for a, b in ((0, 20), (20, 50), (50, 60))]
    for later in parts[1:]:
        parts[0].merge(later)
    merged = parts[0].centred
    assert merged.mean == pytest.approx(mean)
    np.testing.assert_allclose(merged.pairs, whole.pairs)
    np.testing.assert_allclose(merged.sums, whole.sums, atol=1e-9)
    np.testing.assert_allclose(merged.ends, whole.ends, atol=1e-9)
