import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import OPERATIONS, GraphBuilder
from kennfeld.graph.interpreter import evaluate

STEPS = ("floor", "ceil", "round", "sign", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not")
# points where each operation is smooth; default: far from kinks on both sides of zero
POINTS = {
    "log": [(0.3,), (2.0,), (7.5,)],
    "log10": [(0.3,), (2.0,), (7.5,)],
    "sqrt": [(0.3,), (2.0,), (7.5,)],
    "asin": [(-0.8,), (0.1,), (0.9,)],
    "acos": [(-0.8,), (0.1,), (0.9,)],
    "pow": [(0.3, 2.5), (2.0, -1.5), (1.7, 3.0)],
    "mod": [(5.3, 2.0), (-5.3, 2.0), (5.3, -2.2), (0.7, 3.0)],
    "select": [(1.0, 0.3, -2.0), (0.0, 0.3, -2.0), (-0.5, 4.0, 2.0)],
}
ORDINARY = {1: [(-1.7,), (0.35,), (1.2,)], 2: [(-1.7, 0.6), (0.35, 2.2), (1.2, -0.8), (0.9, 0.1)]}


def value(op, *args):
    return float(OPERATIONS[op].evaluate(*args))


def slope(op, args, which):
    """The partial derivative that the operation's rule writes."""
    b = GraphBuilder()
    nodes = [b.input(f"x{i}") for i in range(len(args))]
    y = b.call(op, *nodes)
    partial = OPERATIONS[op].partials[which]
    if partial is None:
        return 0.0
    derivative = partial(b, tuple(nodes), y)
    branches = OPERATIONS[op].branches
    condition = branches(b, tuple(nodes))[which] if branches else None
    if condition is not None:
        derivative = b.call("select", condition, derivative, b.const(0.0))
    columns = {f"x{i}": [x] for i, x in enumerate(args)}
    return float(evaluate(b.finish({"d": derivative}), columns, ParameterSet())["d"][0])


# `single` moves in steps that are larger than those of the differences
@pytest.mark.parametrize("op", sorted(set(OPERATIONS) - {"single"}))
def test_partials_are_those_of_finite_differences(op):
    rule = OPERATIONS[op]
    assert len(rule.partials) == rule.arity
    for args in POINTS.get(op, ORDINARY.get(rule.arity, [])):
        for which in range(rule.arity):
            if op == "select" and which == 0:
                continue
            h = 1e-6
            up, down = ([a + sign * h * (i == which) for i, a in enumerate(args)] for sign in (1, -1))
            expected = (value(op, *up) - value(op, *down)) / (2 * h)
            assert slope(op, args, which) == pytest.approx(expected, rel=1e-7, abs=1e-8), (args, which)


@pytest.mark.parametrize("op", STEPS)
def test_steps_have_slope_zero(op):
    assert OPERATIONS[op].partials == (None,) * OPERATIONS[op].arity


def test_rounding_to_single_precision_has_the_slope_of_what_it_rounds():
    assert len(OPERATIONS["single"].partials) == OPERATIONS["single"].arity == 1
    assert [slope("single", (x,), 0) for x in (-0.1, 0.0, 1e-50, 0.1, 1e300)] == [1.0] * 5


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        (0.1, 0.10000000149011612),
        (1 + 2.0**-24, 1.0),  # halves go to the even mantissa
        (1 + 3 * 2.0**-24, 1 + 2.0**-22),
        (1 + 2.0**-24 + 2.0**-50, 1 + 2.0**-23),
        (2.0**128 - 2.0**104, 2.0**128 - 2.0**104),  # the largest one
        (2.0**128 - 2.0**103, np.inf),
        (-1e300, -np.inf),
        (2.0**-149, 2.0**-149),  # the smallest one
        (2.0**-150, 0.0),
        (3 * 2.0**-150, 2.0**-148),
        (np.inf, np.inf),
        (np.nan, np.nan),
    ],
)
def test_single_rounds_to_the_nearest_number_of_single_precision(x, expected):
    assert np.array_equal(value("single", x), expected, equal_nan=True)


def test_single_keeps_the_sign_of_a_number_that_it_rounds_to_zero():
    assert np.signbit(value("single", -1e-50))


def test_the_slope_of_abs_at_zero_is_zero():
    assert [slope("abs", (x,), 0) for x in (-2.0, 0.0, 2.0)] == [-1.0, 0.0, 1.0]


@pytest.mark.parametrize("op", ["min", "max"])
def test_a_tie_takes_the_first_argument(op):
    assert (slope(op, (2.0, 2.0), 0), slope(op, (2.0, 2.0), 1)) == (1.0, 0.0)


@pytest.mark.parametrize("op", ["min", "max"])
@pytest.mark.parametrize("args", [(np.nan, 1.0), (1.0, np.nan), (np.nan, np.nan)])
def test_extremes_propagate_nan(op, args):
    assert np.isnan(value(op, *args))


def test_a_power_of_exponent_zero_has_slope_zero_in_its_base_even_at_zero():
    assert slope("pow", (0.0, 0.0), 0) == 0.0


def test_a_power_of_base_zero_has_slope_zero_in_its_exponent():
    assert slope("pow", (0.0, 2.0), 1) == 0.0


@pytest.mark.parametrize(
    ("x", "expected"),
    [(0.5, 1), (-0.5, -1), (1.5, 2), (2.5, 3), (-2.5, -3), (0.49999999999999994, 0), (-0.3, 0), (2**52 + 1, 2**52 + 1)],
)  # fmt: skip
def test_round_takes_halves_away_from_zero(x, expected):
    assert value("round", x) == expected


@pytest.mark.parametrize(
    ("a", "b", "expected"), [(5, 3, 2), (-5, 3, 1), (5, -3, -1), (-5, -3, -2), (5, 0, 5), (0.5, 0, 0.5)]
)
def test_mod_has_the_sign_of_the_divisor_and_leaves_a_by_zero(a, b, expected):
    assert value("mod", a, b) == expected


@pytest.mark.parametrize("x", [2.0, -0.1, np.nan, np.inf])
def test_every_value_but_zero_is_true(x):
    assert value("not", x) == 0.0
    assert value("and", x, 1.0) == 1.0
    assert value("or", x, 0.0) == 1.0
    assert value("select", x, 3.0, 4.0) == 3.0


@pytest.mark.parametrize("x", [0.0, -0.0])
def test_zero_is_false(x):
    assert value("not", x) == 1.0
    assert value("and", x, 1.0) == 0.0
    assert value("or", x, 0.0) == 0.0
    assert value("select", x, 3.0, 4.0) == 4.0


@pytest.mark.parametrize("op", ["lt", "le", "gt", "ge", "eq"])
def test_comparisons_with_nan_are_false(op):
    assert value(op, np.nan, 1.0) == 0.0
    assert value(op, 1.0, np.nan) == 0.0
    assert value(op, np.nan, np.nan) == 0.0


def test_not_a_number_differs_from_everything():
    assert value("ne", np.nan, np.nan) == 1.0


def test_guard_keeps_zero_times_infinity_at_zero():
    assert value("guard", 0.0, np.inf) == 0.0
    assert value("guard", 0.0, np.nan) == 0.0
    assert value("guard", 2.0, 3.0) == 6.0
    assert np.isnan(value("guard", np.inf, 0.0))


@pytest.mark.parametrize(
    ("op", "args", "expected"),
    [
        ("div", (1.0, 0.0), np.inf),
        ("div", (-1.0, 0.0), -np.inf),
        ("div", (0.0, 0.0), np.nan),
        ("log", (0.0,), -np.inf),
        ("log", (-1.0,), np.nan),
        ("sqrt", (-1.0,), np.nan),
        ("asin", (1.5,), np.nan),
        ("exp", (1000.0,), np.inf),
        ("pow", (-8.0, 1 / 3), np.nan),
        ("pow", (0.0, -1.0), np.inf),
        ("pow", (0.0, 0.0), 1.0),
        ("atan2", (0.0, -1.0), np.pi),
    ],
)
def test_an_operation_without_a_value_warns_of_nothing(op, args, expected):
    assert np.array_equal(value(op, *args), expected, equal_nan=True)


@pytest.mark.parametrize("op", sorted(OPERATIONS))
def test_operations_take_arrays_and_numbers_alike(op):
    rule = OPERATIONS[op]
    args = POINTS.get(op, ORDINARY.get(rule.arity))
    whole = rule.evaluate(*np.array(args).T)
    one = [float(rule.evaluate(*point)) for point in args]
    # numpy's vectorised functions may round the last place otherwise than its scalar ones
    np.testing.assert_allclose(whole, one, rtol=4e-16, atol=0)
    assert whole.dtype == np.float64
