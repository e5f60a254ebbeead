import numpy as np
import pytest

from kennfeld.surrogate.baselines import arx, free_run_rmse, plane
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording


def test_a_plane_is_that_of_least_squares():
    rng = np.random.default_rng(0)
    x, y = 100 + rng.normal(size=(60, 3)), rng.normal(size=60)
    expected = np.linalg.lstsq(np.column_stack([np.ones(60), x]), y, rcond=None)[0]
    flat = plane(x, y)
    np.testing.assert_allclose([flat.offset, *flat.slopes], expected, rtol=1e-8)


def test_a_constant_or_doubled_input_leaves_a_plane():
    x = np.column_stack([np.arange(9.0), np.full(9, 5.0), np.arange(9.0)])
    np.testing.assert_allclose(plane(x, 2 * np.arange(9.0) + 1)(x), 2 * np.arange(9.0) + 1, atol=1e-12)


def second_order(samples=250, seed=0):
    u, y = np.random.default_rng(seed).normal(size=(samples, 1)), np.zeros(samples)
    for k in range(2, samples):
        y[k] = 1.2 * y[k - 1] - 0.5 * y[k - 2] + 0.8 * u[k - 1, 0] - 0.3 * u[k - 2, 0] + 0.1
    return Recording(u, y)


def test_a_linear_system_is_met_exactly_in_free_run():
    model = arx([second_order()])
    assert free_run_rmse(model, [second_order(seed=1)], UNLIMITED) < 1e-10


def test_specified_lags_are_tried_as_well():
    u, y = np.random.default_rng(0).normal(size=(300, 1)), np.zeros(300)
    for k in range(1, 300):
        y[k] = 0.9 * y[k - 1] + u[max(k - 20, 0), 0]
    late = Lags((1,), ((20,),))
    model = arx([Recording(u, y)], UNLIMITED, [late])
    assert model.lags == late
    np.testing.assert_allclose(model.expansion.slopes, [0.9, 1.0], rtol=1e-8)


def test_a_short_recording_has_a_model_of_first_order():
    assert arx([Recording(np.arange(4.0)[:, None], np.arange(4.0))]).lags.output == (1,)


@pytest.mark.parametrize("limits", [UNLIMITED, (-0.5, 0.5)])
def test_samples_at_a_limit_do_not_spoil_the_coefficients(limits):
    piece = second_order()
    clipped = Recording(piece.u, np.clip(piece.y, *limits))
    inside = arx([clipped], limits)
    assert np.isfinite(free_run_rmse(inside, [clipped], limits))
