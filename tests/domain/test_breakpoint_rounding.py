"""Breakpoints are rounded to as many digits as their spacing warrants, and still cover the data."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld import ArgumentError, Axis
from kennfeld.domain.breakpoint_rounding import evenly_spaced, nice_step, rounded, separated
from tests.draws import few_or_many

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
moderate = st.floats(-1e6, 1e6, allow_nan=False, width=32)


def increasing(elements):
    return (
        arrays(np.float64, st.integers(2, 12), elements=elements).map(np.unique).filter(lambda points: points.size > 1)
    )


def round_list(*points):
    return rounded(np.array(points, dtype=float)).points.tolist()


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ((703.2, 805.9536, 836.145, 1502.7), [700, 806, 836, 1520]),
        ((-5.34, -1.234, 0.0, 7.77), [-5.4, -1.25, 0, 7.8]),
        ((-1502.7, -836.145, -703.2), [-1520, -835, -700]),
        ((1.23456e-6, 2.34567e-6, 9.87654e-6), [1.2e-6, 2.35e-6, 1e-5]),
        ((1.23456e12, 2.34567e12, 9.87654e12), [1.2e12, 2.35e12, 1e13]),
        ((1.2e-300, 2.34e-300, 9e-300), [1.2e-300, 2.35e-300, 9e-300]),
    ],
)
def test_a_step_suits_the_distance_to_the_nearer_neighbour(points, expected):
    assert round_list(*points) == expected


@pytest.mark.parametrize(
    "points", [(1, 2, 3, 4), (0.1, 0.2, 0.3), (700, 1000, 1500), (-0.3, 0.7), (0.0, 1750.0), (1000, 1750, 2500)]
)
def test_round_numbers_stay(points):
    result = rounded(np.array(points, dtype=float))
    assert result.points.tolist() == list(points)
    assert result.coarsest == 0


def test_a_single_breakpoint_has_no_spacing_and_stays():
    assert round_list(805.9536) == [805.9536]


@pytest.mark.parametrize("points", [(1e16, 1e16 + 2, 1e16 + 4), (5e-324, 1e-323), (-1.7e308, 1.7e308)])
def test_numbers_at_the_limits_of_a_double_stay(points):
    assert round_list(*points) == list(points)


@few_or_many(increasing(numbers), few=20, many=100)
def test_breakpoints_increase_and_cover_the_data_whatever_their_size(points):
    result = rounded(points).points
    assert np.all(np.isfinite(result))
    assert np.all(result[1:] > result[:-1])
    assert result[0] <= points[0]
    assert result[-1] >= points[-1]


@few_or_many(increasing(moderate), few=20, many=100)
def test_inner_breakpoints_move_by_at_most_half_a_step_and_ends_by_less_than_a_step(points):
    gaps = np.diff(points)
    nearer = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))
    moves = np.abs(rounded(points).points - points)
    slack = 1e-12 * np.abs(points)
    assert np.all(moves[1:-1] <= nearer[1:-1] / 40 * (1 + 1e-9) + slack[1:-1])
    assert np.all(moves <= nearer / 20 * (1 + 1e-9) + slack)


@few_or_many(increasing(moderate), few=20, many=100)
def test_rounded_numbers_have_few_digits(points):
    for number, distance in zip(
        rounded(points).points[1:-1], np.minimum(np.diff(points)[:-1], np.diff(points)[1:]), strict=True
    ):
        if (step := nice_step(float(distance))) > 1e-9 * abs(number):
            decimal = Decimal(repr(float(number)))
            assert 0 in (decimal % Decimal(repr(step)), decimal % (Decimal(repr(step)) / 2 * 5))


@few_or_many(increasing(numbers), few=20, many=100)
def test_separated_breakpoints_are_a_subset_with_both_ends(points):
    result = separated(points)
    assert np.isin(result, points).all()
    assert result[0] == points[0]
    assert result.size == 1 or result[-1] == points[-1]


def test_a_wrong_sample_at_an_end_merges_no_others():
    points = np.array([0.0, 1000, 2000, 3000, 4000, 1e12])
    assert separated(points).tolist() == points.tolist()


def test_a_constant_with_rounding_errors_is_one_breakpoint():
    assert separated(800 + np.array([-1e-12, 0, 1e-12, 2e-12])).size == 1


def test_noise_around_zero_is_one_breakpoint():
    assert separated(np.array([-1e-12, 0, 1e-12, 20, 40, 60, 80])).tolist() == [-1e-12, 20, 40, 60, 80]


class TestAxis:
    def test_quantiles_of_data_are_rounded(self):
        axis = Axis.of_quantiles([703.2, 805.9536, np.nan, 836.145, 1502.7], 4, "Speed", "rpm", name="AxisSpeed")
        assert axis == Axis([700, 806, 836, 1520], "Speed", "rpm", "AxisSpeed")

    def test_quantiles_can_be_used_as_computed(self):
        assert Axis.of_quantiles([0.123, 1.234, 2.345], 3, round=False).breakpoints.tolist() == [0.123, 1.234, 2.345]

    def test_few_distinct_values_give_few_breakpoints(self):
        assert Axis.of_quantiles([1, 1, 1, 1, 1, 1, 2], 3).breakpoints.tolist() == [1, 2]

    def test_a_constant_channel_gives_a_single_breakpoint(self):
        assert Axis.of_quantiles(np.full(9, 805.9536), 5).breakpoints.tolist() == [805.9536]

    @pytest.mark.parametrize(("values", "count"), [([np.nan], 3), ([1.0, 2.0], 1)])
    def test_quantiles_of_nothing_are_an_error(self, values, count):
        with pytest.raises(ArgumentError, match="quantiles require"):
            Axis.of_quantiles(values, count)

    def test_a_fitted_axis_is_rounded_and_fixed(self):
        axis = Axis([0.0, 12.9973, 20.0], input="Load", free=True, min_distance=0.5, range=(0, 20))
        assert axis.rounded() == Axis([0, 13, 20], input="Load")


@few_or_many(st.integers(-999, 999), st.integers(1, 999), st.integers(1, 40), few=20, many=500)
def test_evenly_spaced_decimals_are_the_numbers_that_one_writes(begin, step, cells):
    points = evenly_spaced(begin / 100, (begin + step * cells) / 100, cells + 1)
    assert points.tolist() == [float(Decimal(begin + step * k) / 100) for k in range(cells + 1)]


@few_or_many(moderate, moderate, st.integers(2, 40), few=20, many=500)
def test_evenly_spaced_breakpoints_are_those_of_numpy_but_for_rounding(begin, end, count):
    points, exact = evenly_spaced(begin, end, count), np.linspace(begin, end, count)
    assert np.abs(points - exact).max() <= 1e-15 * max(abs(begin), abs(end))
    assert (points[0], points[-1]) == (begin, end)
