from dataclasses import dataclass

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Cube, Curve, Map, Scalar
from kennfeld.optimize.problem.roughness_rows import CLOSE, roughness_rows, second_differences
from kennfeld.optimize.problem.table_penalties import Roughness

UNEVEN = np.array([0.0, 1.0, 1.5, 4.0, 9.0])


@dataclass(frozen=True)
class Packed:
    """Offsets of the values of each parameter, the free ones first."""

    offsets: dict[str, int]
    free: int


def roughness(table, *factors):
    """The penalty of a single free table."""
    parameters = ParameterSet([table])
    penalty = Roughness.of(parameters, Packed({table.name: 0}, table.size), {table.name: factors})
    return penalty, penalty.cost(table.values.ravel())


def by_definition(table, axis):
    """R of one axis, line by line, point by point, as docs/method.md writes it."""
    x = table.axes[axis].breakpoints
    x = x / ((x[-1] - x[0]) / (x.size - 1))
    total = 0.0
    for z in np.moveaxis(table.values, axis, -1).reshape(-1, x.size):
        for i in range(x.size - 2):
            above = (z[i + 2] - z[i + 1]) / (x[i + 2] - x[i + 1])
            below = (z[i + 1] - z[i]) / (x[i + 1] - x[i])
            total += (2 * (above - below) / (x[i + 2] - x[i])) ** 2
    return total / x.size


def table_of(axes, seed=0):
    shape = tuple(len(a) for a in axes)
    values = np.random.default_rng(seed).standard_normal(shape)
    if len(axes) == 1:
        return Curve("T", *axes, values)
    return Map("T", *axes, values) if len(axes) == 2 else Cube("T", axes, values)


@pytest.mark.parametrize(
    "axes",
    [[UNEVEN], [UNEVEN, 100 * UNEVEN[:4]], [UNEVEN, [3.0, 5.0], [1.0, 2.0, 2.5]], [[0.0, 1, 5], [0.0, 2, 3], UNEVEN]],
    ids=["curve", "map", "cube with a short axis", "cube"],
)
def test_the_penalty_is_the_mean_square_of_second_differences_along_each_axis(axes):
    table = table_of(axes)
    factors = [0.5 + i for i in range(len(axes))]
    expected = sum(s * by_definition(table, i) for i, s in enumerate(factors))
    assert roughness(table, *factors)[1] == pytest.approx(expected, rel=1e-12)


def test_a_factor_of_zero_excludes_an_axis():
    table = table_of([UNEVEN, UNEVEN])
    assert roughness(table, 0.0, 2.0)[1] == pytest.approx(2 * by_definition(table, 1), rel=1e-12)


def test_a_plane_has_no_roughness():
    x, y = UNEVEN, np.array([700.0, 1000.0, 4000.0])
    assert roughness(Map("T", x, y, 3 + 2 * x[:, None] - 0.01 * y), 1.0, 1.0)[1] == pytest.approx(0, abs=1e-20)


def test_the_penalty_does_not_depend_on_the_unit_of_an_axis():
    values = [1.0, -2.0, 0.5, 4.0, 1.0]
    fraction, rpm = (roughness(Curve("T", scale * UNEVEN, values), 1.0)[1] for scale in (0.01, 6000.0))
    assert fraction == pytest.approx(rpm, rel=1e-12)


def test_the_second_difference_on_an_even_axis_is_the_plain_one():
    assert second_differences(np.array([10.0, 12.0, 14.0, 16.0])).tolist() == [[1, -2, 1], [1, -2, 1]]


def test_half_the_spacing_makes_the_penalty_about_fifteen_times_smaller():
    coarse, fine = (Curve("T", x, np.sin(3 * x)) for x in (np.linspace(0, 1, 41), np.linspace(0, 1, 81)))
    assert roughness(coarse, 1.0)[1] / roughness(fine, 1.0)[1] == pytest.approx(15.5, abs=1.0)


@pytest.mark.parametrize("points", [1, 2])
def test_an_axis_of_two_points_has_no_roughness(points):
    table = Curve("T", np.arange(points), np.arange(points) ** 2)
    assert roughness(table, 5.0)[1] == 0.0


def test_gradient_matrix_and_rows_belong_to_the_same_penalty():
    table = table_of([UNEVEN, [0.0, 1.0, 5.0, 6.0]])
    penalty, cost = roughness(table, 0.3, 2.0)
    z = table.values.ravel()
    gradient, matrix = np.zeros(z.size), np.zeros((z.size, z.size))
    penalty.add(z, gradient, matrix)
    residual, jacobian = penalty.rows(z)
    assert residual @ residual == pytest.approx(cost, rel=1e-12)
    np.testing.assert_allclose(jacobian.T @ residual, gradient, atol=1e-12)
    np.testing.assert_allclose(jacobian.T @ jacobian, matrix, atol=1e-12)
    assert z @ gradient == pytest.approx(cost, rel=1e-12)


def test_parameters_that_are_not_free_have_no_penalty():
    table = table_of([UNEVEN])
    penalty = Roughness.of(ParameterSet([Scalar("K", 1.0), table]), Packed({"K": 0, "T": 1}, 1), {"T": (1.0,)})
    assert penalty.cost(np.ones(1)) == 0.0
    assert penalty.rows(np.ones(1))[1].shape == (0, 1)


def with_pairs(*places):
    """Breakpoints whose mean spacing is about 1; each place gets a second one, 2e-7 behind the first."""
    x = np.array([0.0, 1.1, 1.9, 3.0, 4.2, 5.0, 5.8])
    return np.sort(np.concatenate([x, x[list(places)] + 2e-7]))


@pytest.mark.parametrize("places", [[3], [0], [6], [0, 6], [2, 3], [1, 4, 5]], ids=str)
def test_pairs_of_close_breakpoints_have_the_cost_of_the_formula_at_its_least_slope(places):
    x = with_pairs(*places)
    rng = np.random.default_rng(3)
    slopes = rng.standard_normal(x.size - 1)
    # the formula over slopes: those within pairs take the values of least cost
    rows = 2 * np.diff(np.eye(x.size - 1), axis=0) / (x[2:] - x[:-2])[:, None]
    within = np.diff(x) < CLOSE
    slopes[within] = np.linalg.lstsq(rows[:, within], -rows[:, ~within] @ slopes[~within], rcond=None)[0]
    expected = np.sum((rows @ slopes) ** 2) * ((x[-1] - x[0]) / (x.size - 1)) ** 4
    table = Curve("T", x, np.append(0, np.cumsum(slopes * np.diff(x))))
    assert roughness(table, float(x.size))[1] == pytest.approx(expected, rel=1e-6)


def test_values_of_close_breakpoints_are_tied_far_more_strongly_than_by_data():
    x = with_pairs(3)
    jump = (np.arange(x.size) > 3) * 1.0
    rows = roughness_rows(x)
    assert np.sum((rows.coefficients * jump[rows.points]).sum(axis=1) ** 2) > 1e11


@pytest.mark.parametrize(
    ("gap", "factor"),
    [
        (2e-16, 0.1),
        (2e-9, 1e3),
        (1e-4, 1e3),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((2e-16, 1e3), (1e-12, 0.1), (1e-8, 0.1), (1e-8, 1e3), (1e-6, 0.1), (1e-6, 1e3), (1e-4, 0.1))
        ),
    ],
)
def test_a_fit_on_nearly_equal_breakpoints_is_that_on_one_of_them(gap, factor):
    u = np.linspace(0, 0.6, 301)
    y = np.sin(8 * u) + 0.3 * np.random.default_rng(4).standard_normal(u.size)
    pair = np.array([0, 0.1, 0.2, 0.3, 0.3 + 0.6 * gap, 0.5, 0.6])
    result = kf.calibrate("y = C(u)", {"u": u, "y": y}, kf.ParameterSet([Curve("C", pair, np.zeros(7))]), "y",
                          smoothness=factor)  # fmt: skip
    assert result.status == "converged"
    # the slopes themselves as unknowns: z = T s has no large coefficients
    steps = np.tril(np.ones((7, 7)), -1)[:, :6] * np.diff(pair)
    basis = np.column_stack([np.ones(7), steps])
    slopes = np.column_stack([np.zeros(6), np.eye(6)])
    spacing = (pair[-1] - pair[0]) / 6
    rough = 2 * spacing**2 * np.diff(slopes, axis=0) / (pair[2:] - pair[:-2])[:, None] * (factor / 7) ** 0.5
    hats = np.column_stack([np.interp(u, pair, hat) for hat in np.eye(7)])
    unknowns = np.linalg.lstsq(np.vstack([hats @ basis, rough]), np.append(y, np.zeros(5)), rcond=None)[0]
    np.testing.assert_allclose(result.parameters["C"].values, basis @ unknowns, atol=1e-6)
