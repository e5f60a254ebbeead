import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import OPERATIONS, GraphBuilder
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.elementwise import CONDITIONS, ELEMENTARY, VALUES
from kennfeld.native.simulator import Simulator

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, 0.49999999999999994, 3.0, 7.3, -0.3, 1e-310, -1e-310, 1e-8]
SPECIAL += [1e8, -1e8, 1e17, 4503599627370497.0, 1e300, -1e300, np.inf, -np.inf, np.nan]
NUMBERS = np.array(SPECIAL)
# of single precision: halves, the ends of the range, denormal ones
SINGLE = [1 + n * 2.0**-24 for n in range(-3, 6)] + [2.0**128 - 2.0**n for n in (102, 103, 104, 105)]
SINGLE += [n * 2.0**-150 for n in range(8)] + [2.0**-126 - 2.0**-150, 2.0**-126 - 2.0**-149, 16777217.0, 0.1, 1 / 3]


def native(build, *columns):
    """The node that `build(builder, *inputs)` gives, for columns of inputs."""
    b = GraphBuilder()
    names = [f"x{i}" for i in range(len(columns))]
    graph = b.finish({"y": build(b, *(b.input(name) for name in names))})
    low = lower_lookups(graph, ParameterSet())
    simulator = Simulator(low, [low.graph.names["y"]], ParameterSet())
    return simulator.over(dict(zip(names, columns, strict=True)), len(columns[0]), ParameterSet())[0]


def combinations(arity):
    return [grid.ravel() for grid in np.meshgrid(*[NUMBERS] * arity)]


def test_every_operation_can_be_emitted():
    assert set(OPERATIONS) == {*VALUES, *CONDITIONS, "and", "or", "not", "select"}


@pytest.mark.parametrize("op", sorted(set(OPERATIONS) - set(ELEMENTARY)))
def test_an_operation_agrees_with_the_interpreter_bit_for_bit(op):
    columns = combinations(OPERATIONS[op].arity)
    got, expected = native(lambda b, *x: b.call(op, *x), *columns), OPERATIONS[op].evaluate(*columns)
    np.testing.assert_array_equal(got, expected)
    if op not in ("sign", "min", "max", "sub", "add"):  # which of two zeros, IEEE leaves open there
        numbers = ~np.isnan(expected)
        np.testing.assert_array_equal(np.signbit(got)[numbers], np.signbit(expected)[numbers])


def test_numbers_are_rounded_to_single_precision_as_the_interpreter_rounds_them():
    random = np.random.default_rng(2)
    drawn = random.standard_normal(500) * 10.0 ** random.uniform(-48, 40, 500)
    numbers = np.concatenate([NUMBERS, SINGLE, np.negative(SINGLE), drawn])
    got, expected = native(lambda b, x: b.call("single", x), numbers), OPERATIONS["single"].evaluate(numbers)
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(np.signbit(got)[~np.isnan(got)], np.signbit(expected)[~np.isnan(got)])
    assert not np.array_equal(got, numbers, equal_nan=True)


@pytest.mark.parametrize("op", ["add", "sub", "mul", "div"])
def test_results_of_single_precision_are_those_of_float32(op):
    random = np.random.default_rng(3)
    a, b = (random.standard_normal(1000) * 10.0 ** random.uniform(-3, 3, 1000) for _ in "ab")

    def rounded(builder, x, y):
        x, y = builder.call("single", x), builder.call("single", y)
        return builder.call("single", builder.call(op, x, y))

    function = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide}[op]
    np.testing.assert_array_equal(native(rounded, a, b), function(np.float32(a), np.float32(b)).astype(np.float64))


@pytest.mark.parametrize("op", sorted(ELEMENTARY))
def test_an_elementary_function_agrees_to_the_last_places(op):
    random = np.random.default_rng(1)
    columns = combinations(OPERATIONS[op].arity)
    columns = [np.concatenate([c, random.uniform(-0.99, 0.99, 500), random.uniform(0, 30, 500)]) for c in columns]
    got, expected = native(lambda b, *x: b.call(op, *x), *columns), OPERATIONS[op].evaluate(*columns)
    np.testing.assert_allclose(got, expected, rtol=1e-15, atol=5e-324)


@pytest.mark.parametrize("exponent", [*range(-17, 18), 0.5, -2.5, np.inf, np.nan])
def test_a_power_with_a_constant_exponent(exponent):
    bases = np.array([0.0, -0.0, 1.0, -1.0, 0.3, -1.7, 12.5, np.inf, -np.inf, np.nan])
    got = native(lambda b, x: b.call("pow", x, b.const(exponent)), bases)
    np.testing.assert_allclose(got, OPERATIONS["pow"].evaluate(bases, np.full(10, exponent)), rtol=1e-14)


def test_a_constant_keeps_its_bits():
    for value in SPECIAL:
        got = native(lambda b, x, value=value: b.call("select", x, b.const(value), b.const(0.0)), np.ones(1))
        np.testing.assert_array_equal(got, [value])


def test_truth_can_be_calculated_with():
    x = np.array([-1.0, 0.0, 2.0, np.nan])
    got = native(lambda b, v: b.call("mul", b.call("gt", v, b.const(0.0)), b.const(3.0)), x)
    assert got.tolist() == [0.0, 0.0, 3.0, 0.0]
