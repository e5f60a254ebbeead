import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.domain.axis import Axis
from kennfeld.domain.free_axes import AxisKey, with_breakpoints
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.problem.table_penalties import MovingRoughness, Roughness, roughness_of
from tests.draws import few_or_many

FACTORS = {"M": (0.7, 0.0), "C": (3.0,)}
X, Y = AxisKey("A"), AxisKey("M", "y")
PLACES = {X: ("M", 0), Y: ("M", 1)}


def tables(seed, nx=5, ny=4):
    random = np.random.default_rng(seed)
    x = Axis(np.cumsum(random.uniform(0.5, 2.0, nx)), name="A", free=True)
    y = Axis(np.cumsum(random.uniform(0.5, 2.0, ny)), free=True)
    return ParameterSet([Map("M", x, y, random.standard_normal((nx, ny))), Curve("C", x, random.standard_normal(nx))])


def order(nx=5, ny=4):
    at = nx * ny
    return ValueLayout({"M": 0, "C": at}, at + 2 * nx + ny, 0, at + 2 * nx + ny, {X: at + nx, Y: at + 2 * nx}, PLACES)


def still(parameters, values, factors=FACTORS):
    """The penalty of tables whose axes stand still where they are now."""
    return Roughness.of(parameters, values, factors).cost(values.pack(parameters))


@pytest.mark.parametrize("factors", [FACTORS, {"M": (0.7, 2.0)}, {"C": (1.0,)}])
def test_the_cost_is_that_of_the_breakpoints_as_they_are(factors):
    values = order()
    moving = roughness_of(tables(0), values, factors)
    assert isinstance(moving, MovingRoughness)
    for parameter_set in (tables(0), tables(1)):
        assert moving.cost(values.pack(parameter_set)) == pytest.approx(
            still(parameter_set, values, factors), rel=1e-12
        )


@few_or_many(st.integers(0, 10**6), st.integers(2, 6), st.integers(2, 5), few=10, many=100)
def test_slopes_are_those_of_finite_differences(seed, nx, ny):
    parameter_set, values = tables(seed, nx, ny), order(nx, ny)
    roughness = roughness_of(parameter_set, values, {"M": (0.7, 0.4), "C": (3.0,)})
    at, h = values.pack(parameter_set), 1e-6
    residual, jacobian = roughness.rows(at)
    for i in range(at.size):
        move = np.where(np.arange(at.size) == i, h, 0.0)
        slope = (roughness.rows(at + move)[0] - roughness.rows(at - move)[0]) / (2 * h)
        np.testing.assert_allclose(jacobian[:, i], slope, atol=1e-6 * (1 + np.abs(jacobian).max(initial=0.0)))
    gradient, matrix = np.zeros(at.size), np.zeros((at.size, at.size))
    roughness.add(at, gradient, matrix)
    np.testing.assert_allclose(gradient, jacobian.T @ residual, atol=1e-9 * (1 + np.abs(gradient).max()))
    np.testing.assert_allclose(matrix, jacobian.T @ jacobian, atol=1e-9 * (1 + np.abs(matrix).max()))
    assert roughness.cost(at) == pytest.approx(residual @ residual, rel=1e-12)


def test_a_straight_surface_has_no_roughness_at_any_breakpoints():
    x = Axis([0.0, 1.0, 4.0, 5.0], free=True)
    parameter_set = ParameterSet([Curve("C", x, 2 * x.breakpoints + 1)])
    key = AxisKey("C", "x")
    values = ValueLayout({"C": 0}, 8, 0, 8, {key: 4}, {key: ("C", 0)})
    roughness = roughness_of(parameter_set, values, {"C": (1.0,)})
    other = with_breakpoints(parameter_set, {AxisKey("C", "x"): np.array([0.0, 3.0, 4.5, 5.0])})
    straight = other.with_parameters(other["C"].with_values(2 * other["C"].axes[0].breakpoints + 1))
    assert roughness.cost(values.pack(straight)) == pytest.approx(0.0, abs=1e-24)


def test_fixed_axes_keep_the_plain_form():
    parameter_set = tables(0)
    assert isinstance(roughness_of(parameter_set, ValueLayout({"M": 0, "C": 20}, 25, 0, 25), FACTORS), Roughness)
    assert isinstance(roughness_of(parameter_set, order(), {"M": (0.0, 0.0)}), Roughness)
