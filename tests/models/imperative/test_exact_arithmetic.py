"""Functions of mathematics that keep all digits, against Python's own, and their slopes."""

import math

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.models.imperative import exact_arithmetic as exact
from kennfeld.models.imperative.path_facts import bound_of
from kennfeld.native.simulator import Simulator

SIZES = [0.0, 1e-300, 1e-17, 1e-10, 1e-3, 0.3, 0.9999, 1.0, 1.5, 7.3, 1e7, 1e9, 1e155, 1e300, math.inf]
ONE = {
    "log1p": math.log1p, "log2": math.log2, "asinh": math.asinh, "acosh": math.acosh, "atanh": math.atanh,
    "cube_root": math.cbrt, "round_to_even": np.rint,
}  # fmt: skip
SLOPES = {
    "log1p": lambda x: 1 / (1 + x), "log2": lambda x: 1 / (x * math.log(2)), "asinh": lambda x: 1 / math.hypot(1, x),
    "acosh": lambda x: 1 / math.sqrt((x - 1) * (x + 1)), "atanh": lambda x: 1 / ((1 - x) * (1 + x)),
    "cube_root": lambda x: 1 / (3 * math.cbrt(x) ** 2),
}  # fmt: skip


def values_of(function, *columns):
    b = GraphBuilder()
    names = [f"x{at}" for at in range(len(columns))]
    node = function(b, *(np.array([[b.input(name)]]) for name in names)).item()
    arrays = {name: np.asarray(column, float) for name, column in zip(names, columns, strict=True)}
    return evaluate(b.finish({"y": node}), arrays, ParameterSet())["y"]


def expected(function, *arguments):
    try:
        return float(function(*arguments))
    except ValueError:
        return math.nan


@pytest.mark.parametrize("name", ONE)
def test_functions_of_one_number_keep_their_digits(name):
    x = np.array([*SIZES, *(-size for size in SIZES), math.nan, 2.0**29, 2.5, 3.5, 2.0**52 + 1])
    wanted = np.array([expected(ONE[name], each) for each in x.tolist()])
    values = values_of(getattr(exact, name), x)
    infinite = {"log1p": -1.0, "atanh": 1.0, "log2": 0.0}.get(name)
    poles = np.abs(x) == np.abs(infinite) if infinite is not None else np.zeros(x.size, bool)
    np.testing.assert_allclose(values[~poles], wanted[~poles], rtol=1e-15)


@pytest.mark.parametrize("name", SLOPES)
@pytest.mark.parametrize("x", [1e-12, 1e-3, 0.4, 0.99, 1.5, 30.0, 1e6, 1e12, 1e200])
def test_slopes_are_those_of_the_functions(name, x):
    if (name == "acosh" and x <= 1) or (name == "atanh" and x >= 1):
        return
    b = GraphBuilder()
    graph = b.finish({"y": getattr(exact, name)(b, np.array([[b.lookup("p")]])).item()})
    parameters = ParameterSet([Scalar("p", x)])
    low = lower_lookups(graph, parameters, ())
    line = differentiate(low.graph, list(low.graph.names.values()), ("p",))
    rows = Interpreter(low, parameters, ()).rows(line, {"p": 0}, {"x": np.zeros(1)}, (0,))
    assert rows.jacobian[0, 0, 0] == pytest.approx(SLOPES[name](x), rel=1e-9)


def test_remainders_are_exact_up_to_the_largest_quotient():
    rng = np.random.default_rng(3)
    b = np.concatenate([rng.normal(0, 1, 300), rng.integers(1, 9, 300) / 10, [2.0, 360.0, math.inf]])
    a = np.concatenate([b[:-3] * rng.integers(-(2**40), 2**40, 600), [7.5, -725.5, -3.0]])
    assert values_of(exact.remainder, a, b).tolist() == np.fmod(a, b).tolist()
    assert np.isnan(values_of(exact.remainder, [1e17, 1.0, math.inf], [0.3, 0.0, 1.0])).all()


def test_the_sign_of_zero_is_copied():
    y = [-0.0, 0.0, -1e-310, -math.inf, math.inf]
    np.testing.assert_array_equal(values_of(exact.copy_sign, np.ones(5), y), np.copysign(1.0, y))


def test_hypotenuses_of_numbers_whose_squares_are_not_doubles():
    a, b = (each.ravel() for each in np.meshgrid([*SIZES, math.nan], [*SIZES, math.nan]))
    np.testing.assert_allclose(values_of(exact.hypotenuse, a, b), np.hypot(a, b), rtol=1e-15)


def test_a_side_that_is_nan_leaves_the_bounds_of_a_decision():
    b = GraphBuilder()
    limited = b.call("min", b.input("x"), b.const(5.0))
    for sides in ((limited, b.const(math.nan)), (b.const(math.nan), limited)):
        assert bound_of(b, b.call("select", b.input("c"), *sides), True) == 5.0


def test_machine_code_is_as_exact_as_the_interpreter():
    b = GraphBuilder()
    x, y = (np.array([[b.input(name)]]) for name in "xy")
    graph = b.finish({"r": exact.remainder(b, x, y).item(), "l": exact.log1p(b, x).item()})
    low = lower_lookups(graph, ParameterSet(), ())
    simulator = Simulator(low, [graph.names["r"], graph.names["l"]], ParameterSet())
    rng = np.random.default_rng(5)
    columns = {"x": np.abs(rng.normal(0, 1e3, 200)), "y": rng.integers(1, 9, 200) / 10}
    rests, logarithms = simulator.over(columns, 200, ParameterSet())
    # a product that is fused with the difference behind it would be exact, and its error be taken off twice
    np.testing.assert_array_equal(rests, np.fmod(columns["x"], columns["y"]))
    np.testing.assert_allclose(logarithms, np.log1p(columns["x"]), rtol=4e-16)
