import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve, Map, parameter
from kennfeld.graph import GraphBuilder
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.simulator import Simulator
from tests.draws import few_or_many

SPECIAL = [0.0, -0.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-310]


def both(parameters, columns, coordinates=None):
    """A table at the inputs, native and by the interpreter."""
    b = GraphBuilder()
    (name,) = parameters
    names = list(columns)
    graph = b.finish({"y": b.lookup(name, *(b.input(n) for n in coordinates or names))})
    low = lower_lookups(graph, parameters)
    simulator = Simulator(low, [low.graph.names["y"]], parameters)
    got = simulator.over(columns, len(columns[names[0]]), parameters)[0]
    with np.errstate(invalid="ignore"):
        return got, evaluate(graph, columns, parameters)["y"]


@st.composite
def lookups(draw):
    """A table of one to four axes and coordinates on, between and beyond its breakpoints."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    counts = draw(st.lists(st.integers(1, 6), min_size=1, max_size=4))
    axes = [np.cumsum(random.uniform(0.01, 3.0, count)) - 2.0 for count in counts]
    table = parameter(
        "T", random.standard_normal(counts), map(Axis, axes), extrapolation=draw(st.sampled_from(["clip", "linear"]))
    )
    columns = {}
    for number, points in enumerate(axes):
        x = [random.uniform(points[0] - 1, points[-1] + 1, 10), random.choice(points, 5), [points[0], points[-1]]]
        columns[f"x{number}"] = random.permutation(np.concatenate(x))
    return ParameterSet([table]), columns


@few_or_many(lookups(), few=12, many=40)
def test_lookups_are_those_of_the_interpreter(lookup):
    got, expected = both(*lookup)
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 64, 65, 1000])
def test_a_search_finds_every_breakpoint_whatever_came_before(extrapolation, count):
    points = np.cumsum(np.random.default_rng(count).uniform(0.1, 2.0, count))
    parameters = ParameterSet([Curve("C", points, np.arange(count, dtype=float) ** 1.5, extrapolation=extrapolation)])
    middle = 0.5 * (points[1:] + points[:-1])
    x = np.random.default_rng(0).permutation(np.concatenate([points, middle, points, [points[0] - 1, points[-1] + 1]]))
    got, expected = both(parameters, {"x": x})
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
@pytest.mark.parametrize("points", [[0.0, 1.0, 2.5], [0.5]])
def test_coordinates_that_are_not_ordinary_numbers(extrapolation, points):
    parameters = ParameterSet([Curve("C", points, np.arange(1.0, len(points) + 1), extrapolation=extrapolation)])
    got, expected = both(parameters, {"x": np.array([*SPECIAL, 1.2, *SPECIAL[::-1]])})
    np.testing.assert_array_equal(np.isfinite(got), np.isfinite(expected))
    np.testing.assert_allclose(got[np.isfinite(got)], expected[np.isfinite(expected)], rtol=1e-12)


def test_a_clipped_lookup_far_outside_is_the_end_itself():
    parameters = ParameterSet([Curve("C", [0.0, 1.0, 2.5], [0.1, 0.7, 0.3])])
    got, _ = both(parameters, {"x": np.array([-1e300, -np.inf, 1e300, np.inf, 2.5])})
    assert got.tolist() == [0.1, 0.1, 0.3, 0.3, 0.3]


def test_a_value_on_a_breakpoint_is_the_value_of_the_table():
    points = np.cumsum(np.random.default_rng(5).uniform(0.1, 1.0, 20))
    values = np.random.default_rng(6).standard_normal(20)
    got, expected = both(ParameterSet([Curve("C", points, values)]), {"x": points})
    np.testing.assert_array_equal(got, values)
    np.testing.assert_array_equal(expected, values)


def test_a_grid_point_of_weight_zero_does_not_count_whatever_it_holds():
    parameters = ParameterSet([Map("M", [0.0, 1.0, 2.0], [0.0, 1.0], [[1.0, 2.0], [3.0, 4.0], [np.nan, np.inf]])])
    got, expected = both(parameters, {"x": np.array([0.5, 1.0, 1.0, 1.5]), "y": np.array([0.0, 0.0, 0.5, 1.0])})
    assert expected[:3].tolist() == [2.0, 3.0, 3.5]
    np.testing.assert_array_equal(got, expected)


def test_a_block_is_read_by_position():
    parameters = ParameterSet([Block("B", [[1.0, 2.0, 3.0], [5.0, 7.0, 11.0]])])
    got, expected = both(
        parameters, {"i": np.array([0.0, 1.0, 1.0, 0.5, -3.0]), "j": np.array([2.0, 0.0, 1.0, 0.5, 9.0])}
    )
    assert got.tolist() == [3.0, 5.0, 7.0, 3.75, 3.0]
    assert expected.tolist() == got.tolist()


def test_a_table_along_one_input_twice():
    parameters = ParameterSet([Map("M", [0.0, 1.0], [0.0, 2.0], [[1.0, 2.0], [3.0, 5.0]])])
    x = np.linspace(-0.5, 2.5, 20)
    got, expected = both(parameters, {"x": x}, ("x", "x"))
    np.testing.assert_allclose(got, expected, rtol=1e-13)
