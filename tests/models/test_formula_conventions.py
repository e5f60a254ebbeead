"""Rounding, remainders and time steps as in the manual, in compiled code and in the interpreter."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.interpreter import evaluate

ROUNDED = [
    (2.5, 3),
    (-2.5, -3),
    (0.5, 1),
    (-0.5, -1),
    (1.5, 2),
    (2.4, 2),
    (-2.6, -3),
    (0.49999999999999994, 0),
    (4503599627370497.0, 4503599627370497.0),
    (np.inf, np.inf),
    (np.nan, np.nan),
]
REMAINDERS = [
    (7, 3, 1),
    (-7, 3, 2),
    (7, -3, -2),
    (-7, -3, -1),
    (6, 3, 0),
    (-6, 3, 0),
    (5.5, 2, 1.5),
    (-0.5, 2, 1.5),
    (7, 0, 7),
    (-7, 0, -7),
    (np.nan, 3, np.nan),
]


def both_ways(text, **inputs):
    """The node y of one sample, compiled and interpreted; inputs that are not finite reach no compiled step."""
    model = kf.formula(text)
    interpreted = evaluate(model.graph, {n: np.array([x], dtype=float) for n, x in inputs.items()}, kf.ParameterSet())
    results = [float(np.ravel(interpreted["y"])[0])]
    if np.all(np.isfinite(list(inputs.values()))):
        results += kf.simulate(model, {name: [x] for name, x in inputs.items()}, {})["y"].values.tolist()
    return results


@pytest.mark.parametrize(("x", "expected"), ROUNDED)
def test_halves_are_rounded_away_from_zero(x, expected):
    results = both_ways("y = round(x)", x=x)
    np.testing.assert_array_equal(results, [expected] * len(results))


@pytest.mark.parametrize(("a", "b", "expected"), REMAINDERS)
def test_a_remainder_has_the_sign_of_the_divisor(a, b, expected):
    results = both_ways("y = mod(a, b)", a=a, b=b)
    np.testing.assert_array_equal(results, [expected] * len(results))


def test_parameters_are_rounded_and_divided_alike():
    """Not known before the run, so that nothing is computed ahead."""
    text = "y = round(k * u) + 100 * mod(k * u, c)"
    for k, c, expected in ((-2.5, 3.0, -3 + 50), (-7.0, -3.0, -7 - 100), (2.5, 0.0, 3 + 250)):
        y = kf.simulate(text, {"u": [1.0]}, {"k": k, "c": c})["y"].values
        assert y.tolist() == [expected]


@pytest.mark.parametrize(
    ("time", "starts", "expected"),
    [
        ([0, 1, 3, 6], [0], [1, 1, 2, 3]),
        ([0, 1, 3, 10, 12, 14], [0, 3], [1, 1, 2, 2, 2, 2]),
        ([0, 2, 4, 9, 20, 22], [0, 3, 4], [2, 2, 2, 2, 2, 2]),
        ([0, 2, 5, 9], [0, 3], [2, 2, 3, 2.5]),
        ([0, 5, 9], [0, 1, 2], [1, 1, 1]),
        ([7], [0], [1]),
    ],
)
def test_the_first_step_of_a_piece_is_as_long_as_the_next_and_that_of_a_single_sample_the_median(
    time, starts, expected
):
    data = kf.Dataset.of("d", {"u": np.zeros(len(time))}, time=time, piece_starts=starts)
    assert kf.simulate("y = dt + u", data, {})["y"].values.tolist() == expected
