"""Values that end at a kink of the function, and the others beside them."""

from operator import attrgetter

import numpy as np
import pytest

import kennfeld as kf

RANDOM = np.random.default_rng(0)
X, Z = RANDOM.uniform(0, 5, 100), RANDOM.uniform(-1, 1, 100)
Y = -2 * X + 3 * Z + 1 + 0.1 * RANDOM.normal(size=100)  # falls with x, which abs(a)*x cannot


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("y = abs(a)*x + b*z + c", {"a": 1.0, "b": 0.0, "c": 0.0}),
        ("y = abs(a)*x + b*z + c", {"a": 0.0, "b": 0.0, "c": 0.0}),
        pytest.param("y = abs(a*x) + b*z + c", {"a": -0.3, "b": 1.0, "c": 5.0}, marks=pytest.mark.slow),
        pytest.param(
            "y = abs(a)*x + abs(d)*x^2 + b*z + c", {"a": 1.0, "d": 0.7, "b": 0.0, "c": 0.0}, marks=pytest.mark.slow
        ),
        ("y = sqrt(a)*x + b*z + c", {"a": 1.0, "b": 0.0, "c": 0.0}),
    ],
    ids=["abs", "abs from 0", "abs of a product", "two of them", "sqrt"],
)
def test_the_other_values_are_optimal_if_one_is_at_a_kink(text, start):
    result = kf.calibrate(text, {"x": X, "z": Z, "m": Y}, start, target="m")
    plane = np.stack([Z, np.ones(100)], axis=1)
    best, *_ = np.linalg.lstsq(plane, Y, rcond=None)
    assert result.converged
    assert result.parameters["a"].value == pytest.approx(0, abs=1e-6)
    # a cost within a millionth of the least leaves the third digit of the values open
    assert [result.parameters[name].value for name in "bc"] == pytest.approx(best, abs=3e-3)
    assert result.quality[0].rmse_after == pytest.approx(np.sqrt(np.mean((plane @ best - Y) ** 2)), rel=1e-6)
    assert result.certificate.predicted_decrease < 1e-6
    (warning,) = result.warnings
    assert warning.message.startswith("a")
    assert "kink" in warning.message


def test_a_smooth_minimum_does_not_count_as_a_kink():
    result = kf.calibrate("y = a^2*x + b*z + c", {"x": X, "z": Z, "m": Y}, {"a": 1.0, "b": 0.0, "c": 0.0}, target="m")
    assert not result.warnings


def test_a_value_can_leave_the_edge_of_the_domain_of_a_function():
    """The search first runs against b = -1, from which the cost falls once the other values have moved."""
    x = np.linspace(1, 20, 80)
    data = {"x": x, "q": 0.65 * (x + 0.6) ** 1.7 + 3}
    # the way past the edge is so steep that rounding decides where it leads: one of three starts ends there
    starts = [{"a": a, "b": 0.115, "n": 17.9, "c": 15.5} for a in (0.82 + 1e-9, 0.82, 0.82 - 1e-9)]
    results = (kf.calibrate("y = a*(x + b)^n + c", data, start, target="q") for start in starts)
    result = next(filter(attrgetter("converged"), results), None)
    assert result is not None
    assert result.parameters["b"].value == pytest.approx(0.6)
