import numpy as np
import pytest

from kennfeld.optimize.solver.costs_beside import certificate_of_costs
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows


def certificate(cost, value, limits=None, size=1.0):
    """The certificate along the first of two values; the second one is 5."""
    values = np.array([value, 5.0])
    return certificate_of_costs(cost, values, cost(values), np.array([size, 5.0]), [0], limits or LinearLimits.none(2))


def test_the_predicted_decrease_is_that_of_a_parabola():
    near = certificate(lambda p: 10 + (p[0] - 1) ** 2, 1 + 1e-5)
    assert near.predicted_decrease == pytest.approx(1e-11, rel=1e-3)
    assert near.gradient == pytest.approx(np.sqrt(1e-11), rel=1e-3)


def test_a_flat_minimum_is_detected_by_longer_distances():
    assert certificate(lambda p: 1 + p[0] ** 4, 0.0).predicted_decrease == 0.0


@pytest.mark.parametrize("value", [-3.0, 0.0, 1.2, 2.0])
def test_a_value_next_to_a_lower_cost_is_not_at_a_minimum(value):
    # the costs at twice the value and at 0 are higher than that at 1.2
    assert certificate(lambda p: (p[0] - 1) ** 2 + 1e-3, value, size=max(abs(value), 1.0)) is None


def test_values_beyond_the_bounds_are_not_evaluated():
    tried = []

    def cost(values):
        tried.append(values[0])
        return 1 + (values[0] - 1) ** 2

    limits = LinearLimits(np.array([1 - 3e-6, -np.inf]), np.array([1 + 5e-5, np.inf]))
    assert certificate(cost, 1 + 1e-6, limits).predicted_decrease == pytest.approx(1e-12, rel=1e-2)
    assert min(tried) >= limits.lower[0]
    assert max(tried) <= limits.upper[0]


def test_a_touched_bound_and_a_violated_row_predict_no_decrease():
    lower = LinearLimits(np.array([1.0, -np.inf]), np.full(2, np.inf))
    row = LinearRows.of(np.array([[1.0, 1.0]]), np.array([6.0]), np.array([np.inf]))  # p0 + p1 >= 6
    rows = LinearLimits(np.full(2, -np.inf), np.full(2, np.inf), row)
    for limits in lower, rows:
        assert certificate(lambda p: 1 + p[0] ** 2, 1.0, limits) == (0.0, 0.0, 0.0)
        assert certificate(lambda p: 9 - p[0] ** 2, 1.0, limits) is None


def test_values_outside_the_domain_of_the_model_predict_no_decrease():
    def cost(values):
        return 1 + (values[0] - 1) ** 2 if values[0] >= 1 - 1e-6 else np.nan

    assert certificate(cost, 1.0).predicted_decrease == 0.0
    assert certificate(lambda p: 1.0 if p[0] == 1 else np.inf, 1.0) is None  # nothing is known beside it
