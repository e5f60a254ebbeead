import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.graph.interpolation import (
    cell_weights,
    density,
    interpolate,
    position,
    smooth_weights,
    table_weights,
)
from kennfeld.graph.interpreter import evaluate
from tests.draws import few_or_many

POINTS = np.array([0.0, 10.0, 30.0])


@st.composite
def axes(draw, least=2):
    steps = draw(st.lists(st.floats(0.01, 100), min_size=least - 1, max_size=6))
    return np.cumsum([draw(st.floats(-100, 100)), *steps])


def test_a_position_counts_cells():
    x = np.array([0.0, 5.0, 10.0, 25.0, 30.0])
    assert position(x, POINTS, "clip").tolist() == [0.0, 0.5, 1.0, 1.75, 2.0]


def test_a_position_is_clipped_or_goes_on():
    x = np.array([-5.0, 40.0])
    assert position(x, POINTS, "clip").tolist() == [0.0, 2.0]
    assert position(x, POINTS, "linear").tolist() == [-0.5, 2.5]


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
def test_the_position_of_nan_is_nan(extrapolation):
    assert np.isnan(position(np.array([np.nan]), POINTS, extrapolation)).all()
    assert np.isnan(position(np.array([np.nan]), POINTS[:1], extrapolation)).all()


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
@pytest.mark.parametrize("points", [POINTS, POINTS[:1]])
def test_a_lookup_at_infinity_warns_of_nothing(points, extrapolation):
    place = position(np.array([np.inf, -np.inf]), points, extrapolation)
    interpolate(np.arange(1.0, points.size + 1), [cell_weights(place, points.size)[0]])
    density(np.array([np.inf, -np.inf]), points, extrapolation)


def test_a_table_that_holds_infinity_warns_of_nothing():
    weights, _ = cell_weights(np.array([1.0, 0.5]), 3)
    assert interpolate(np.array([2.0, 4.0, np.inf]), [weights]).tolist() == [4.0, 3.0]


def test_a_single_breakpoint_holds_everything():
    assert position(np.array([-3.0, 1.0, 1e9]), np.array([1.0]), "linear").tolist() == [0.0, 0.0, 0.0]
    assert density(np.array([-3.0, 1.0, 1e9]), np.array([1.0]), "linear").tolist() == [0.0, 0.0, 0.0]


def test_the_slope_of_a_position_is_zero_where_it_is_clipped():
    x = np.array([-1.0, 5.0, 20.0, 31.0])
    assert density(x, POINTS, "clip").tolist() == [0.0, 0.1, 0.05, 0.0]
    assert density(x, POINTS, "linear").tolist() == [0.1, 0.1, 0.05, 0.05]


def test_the_ends_of_an_axis_belong_to_its_cells():
    assert density(POINTS, POINTS, "clip").tolist() == [0.1, 0.05, 0.05]


@few_or_many(axes(), st.lists(st.floats(-200, 800), min_size=1, max_size=5), few=20, many=100)
def test_interpolation_is_that_of_numpy(points, xs):
    x = np.array(xs)
    values = np.sin(np.arange(points.size))
    weights, _ = cell_weights(position(x, points, "clip"), points.size)
    np.testing.assert_allclose(interpolate(values, [weights]), np.interp(x, points, values), atol=1e-9)


@few_or_many(axes(), st.floats(-200, 800), few=20, many=100)
def test_linear_extrapolation_reproduces_a_straight_line(points, x):
    weights, slopes = cell_weights(position(np.array([x]), points, "linear"), points.size)
    assert interpolate(points, [weights])[0] == pytest.approx(x, abs=1e-7)
    steep = (slopes * density(np.array([x]), points, "linear")[:, None]) @ points
    assert steep[0] == pytest.approx(1.0, rel=1e-9)


def test_weights_of_a_table_are_products_in_c_order():
    first, second = np.array([[0.25, 0.75]]), np.array([[0.1, 0.2, 0.7]])
    expected = np.outer(first[0], second[0]).ravel()
    np.testing.assert_allclose(table_weights([first, second], (2, 3))[0], expected)
    assert table_weights([], ()).tolist() == [[1.0]]


def test_a_grid_point_of_weight_zero_does_not_count():
    weights, _ = cell_weights(np.array([1.0, 0.5]), 3)
    values = interpolate(np.array([2.0, 4.0, np.nan]), [weights])
    assert values.tolist() == [4.0, 3.0]


@settings(deadline=None, max_examples=20)
@given(axes(), st.floats(-0.5, 1.5), st.floats(0.01, 0.5), st.sampled_from(["clip", "linear"]))
def test_smoothed_weights_sum_to_one_and_their_slopes_to_zero(points, place, width, extrapolation):
    span = points[-1] - points[0]
    x = np.array([points[0] + place * span])
    weights, slopes = smooth_weights(x, points, extrapolation, width * span)
    assert weights.sum() == pytest.approx(1.0, abs=1e-11)
    assert slopes.sum() * span == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
@pytest.mark.parametrize("x", [-3.0, 0.4, 9.0, 15.0, 29.0, 34.0])
def test_smoothing_is_the_convolution_with_a_gaussian(x, extrapolation):
    values, width = np.array([1.0, -2.0, 5.0]), 2.0

    def exact(at):
        return interpolate(values, [cell_weights(position(np.array([at]), POINTS, extrapolation), 3)[0]])[0]

    def integrand(s):
        return exact(x - s) * np.exp(-0.5 * (s / width) ** 2) / (width * np.sqrt(2 * np.pi))

    kinks = [x - p for p in POINTS if abs(x - p) < 8 * width]
    expected, _ = scipy.integrate.quad(integrand, -8 * width, 8 * width, points=kinks, limit=200)
    weights, _ = smooth_weights(np.array([x]), POINTS, extrapolation, width)
    assert interpolate(values, [weights])[0] == pytest.approx(expected, abs=2e-4)  # the kernel is cut off at 4


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
def test_slopes_of_smoothed_weights_are_those_of_finite_differences(extrapolation):
    x, h = np.array([-3.0, 0.4, 9.0, 15.0, 29.0, 34.0]), 1e-5
    _, slopes = smooth_weights(x, POINTS, extrapolation, 2.0)
    up, down = (smooth_weights(x + sign * h, POINTS, extrapolation, 2.0)[0] for sign in (1, -1))
    np.testing.assert_allclose(slopes, (up - down) / (2 * h), atol=1e-8)


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
def test_width_zero_is_the_exact_lookup(extrapolation):
    x = np.array([-3.0, 0.4, 9.0, 29.0, 34.0])
    weights, _ = smooth_weights(x, POINTS, extrapolation, 0.0)
    np.testing.assert_allclose(weights, cell_weights(position(x, POINTS, extrapolation), 3)[0])


@pytest.mark.parametrize("values", [[0, 1, 1], [1, 1, 3], [2, 1, -1], [-1, 1, -1]])
def test_a_lookup_at_infinity_is_that_of_machine_code_without_a_warning(values):
    data = {"x": np.array([-1.0, 1.0, 1.0, -1.0, 0.0, 3.0]), "z": np.array([0.0, 0.0, 1e-308, 1e-308, 0.0, 2.0])}
    with np.errstate(divide="ignore", invalid="ignore"):
        places = data["x"] / data["z"]
    for extrapolation, finite in (("clip", [True] * 4), ("linear", [False] * 2)):
        curve = kf.Curve("C", [0.0, 1.0, 2.0], values, extrapolation=extrapolation)
        simulated = kf.simulate("y = C(x / z)", data, [curve])["y"].values
        np.testing.assert_array_equal(curve(places), simulated)
        graph = kf.formula("y = C(x / z)", parameters=["C"]).graph
        np.testing.assert_array_equal(evaluate(graph, data, kf.ParameterSet([curve]))["y"], simulated)
        assert np.isfinite(simulated[: len(finite)]).tolist() == finite
