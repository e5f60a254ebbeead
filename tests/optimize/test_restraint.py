"""The slight penalty of tables with automatic smoothness: its rows, and what it leaves alone."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.problem.table_penalties import PULL, Restraint, move_determined, penalty_of

MAP = kf.Map("M", range(4), range(3), np.arange(12.0).reshape(4, 3))
CURVE = kf.Curve("C", range(5), np.ones(5))
CURVATURE = np.array([9.0, 8, 0, 7, 6, 0, 5, 4, 0, 3, 2, 0])


@dataclass(frozen=True)
class Packed:
    """A curve that is not restrained, and a map behind it."""

    offsets: dict[str, int] = field(default_factory=lambda: {"C": 0, "M": 5})
    free: int = 17
    moving: dict[str, int] = field(default_factory=dict)


def restraint(values=None, curvature=CURVATURE, variance=0.5):
    return Restraint.of(MAP.values, np.arange(12.0) if values is None else values, curvature, variance)


def penalty(**arguments):
    parameters, factors = kf.ParameterSet([CURVE, MAP]), {"C": (2.0,), "M": (3.0, 0.5)}
    return penalty_of(parameters, Packed(), factors, {"M": restraint(**arguments)})


def test_only_differences_at_grid_points_without_data_are_resisted():
    edges = restraint().edges.tolist()
    along_x = [[2, 5], [5, 8], [8, 11]]
    along_y = [[1, 2], [4, 5], [7, 8], [10, 11]]
    assert sorted(edges) == sorted(along_x + along_y)


def test_a_difference_counts_as_one_sample_of_a_difference_of_zero():
    """The values with data reach from 0 to 10, over three cells along x and two along y."""
    pull = restraint(variance=0.5)
    span = 10.0**2 + 0.5 / 5.5
    cells = np.where(np.diff(pull.edges, axis=1).ravel() == 1, 2, 3)
    assert pull.stiffness == pytest.approx(0.5 * cells**2 / span)


def test_values_with_data_are_hardly_pulled_and_those_without_not_at_all():
    assert restraint().weights == pytest.approx(PULL * CURVATURE)


def test_the_stiffness_of_a_flat_table_is_bounded():
    flat = restraint(values=np.ones(12))
    assert np.all(np.isfinite(flat.stiffness))
    assert flat.stiffness.max() == pytest.approx(9 * CURVATURE[CURVATURE > 0].mean())


def test_a_table_without_data_has_no_restraint():
    none = restraint(curvature=np.zeros(12))
    assert not none.weights.any()
    assert none.edges.shape == (0, 2)


def test_value_gradient_matrix_and_rows_agree():
    roughness = penalty()
    rng = np.random.default_rng(0)
    values, change = rng.normal(size=17), 1e-6 * rng.normal(size=17)
    gradient, matrix = np.zeros(17), np.zeros((17, 17))
    roughness.add(values, gradient, matrix)
    residual, jacobian = roughness.rows(values)
    assert residual @ residual == pytest.approx(roughness.cost(values))
    assert jacobian.T @ residual == pytest.approx(gradient)
    assert jacobian.T @ jacobian == pytest.approx(matrix)
    moved = roughness.cost(values + change) - roughness.cost(values - change)
    assert moved == pytest.approx(4 * gradient @ change, rel=1e-6)


def test_without_restraints_the_penalty_is_the_roughness():
    parameters, factors = kf.ParameterSet([CURVE, MAP]), {"C": (2.0,), "M": (3.0, 0.5)}
    values = np.random.default_rng(1).normal(size=17)
    rough = penalty_of(parameters, Packed(), factors, {})
    roughness = penalty()
    assert rough.cost(values) == roughness.roughness.cost(values) < roughness.cost(values)


def test_the_start_moves_only_in_directions_of_the_data():
    """The data determine a sum of equal weights and a value; the difference of the first two and the last stay."""
    rows = np.array([[3.0, 3.0, 0, 0], [0, 0, 2.0, 0]])
    start, values, measured = np.array([1.0, 2, 3, 4]), np.array([10.0, 0, -3, 7]), np.array([12.0, 8.0])
    gradient = rows.T @ (rows @ values - measured)
    moved = move_determined(start, values, gradient, rows.T @ rows)
    assert moved == pytest.approx([1.5, 2.5, 4.0, 4.0], rel=1e-12)
