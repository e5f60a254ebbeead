"""Signals as values: operators that add nodes to a graph, choices between signals, and buses member by member."""

import numpy as np
import pytest

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    Bus,
    Signal,
    apply,
    constant,
    interpolate_line,
    map_members,
    select,
    select_by_index,
    staircase,
)
from kennfeld.models.imperative.evaluation_errors import EvaluationError


def values(signal):
    """Return the values of a signal of constants, which the builder folds."""
    return [signal.builder.value(node) for node in signal.flat]


def test_operators_act_element_by_element_with_numbers_as_constants():
    b = GraphBuilder()
    x, y = constant(b, 3.0, -2.0), constant(b, 4.0)
    assert values(x + y) == [7.0, 2.0]
    assert values(1.0 - x) == [-2.0, 3.0]
    assert values(np.float64(6.0) / x) == [2.0, -3.0]
    assert values(2.0 ** abs(x)) == [8.0, 4.0]
    assert values((x > 0.0) & ~(x >= 4.0) | (y < 0.0)) == [1.0, 0.0]
    assert values(-x % 2.0) == [1.0, 0.0]
    assert values(select(x <= 0.0, 0.0, x)) == [3.0, 0.0]
    assert (x + y).period == CONSTANT


def test_an_operation_has_the_shortest_sample_time_of_its_arguments():
    b = GraphBuilder()
    slow, fast = (Signal(np.array([b.input(name)]), period, builder=b) for name, period in (("s", 0.1), ("f", 0.01)))
    assert (slow * fast + 1.0).period == 0.01


def test_signals_of_different_sizes_do_not_match():
    b = GraphBuilder()
    with pytest.raises(EvaluationError, match="its inputs have the sizes 2, 3, which do not match"):
        apply("add", constant(b, 1.0, 2.0), constant(b, 1.0, 2.0, 3.0))


@pytest.mark.parametrize(("x", "chosen"), [(-1.0, 10.0), (0.4, 10.0), (0.5, 20.0), (1.5, 30.0), (9.0, 30.0)])
def test_an_index_selects_among_signals(x, chosen):
    b = GraphBuilder()
    assert values(select_by_index(constant(b, x), [constant(b, v) for v in (10.0, 20.0, 30.0)], 0.5)) == [chosen]


@pytest.mark.parametrize(("x", "expected"), [(-1.0, 5.0), (0.0, 6.0), (1.9, 6.0), (2.0, 7.0)])
def test_a_staircase_changes_at_its_limits(x, expected):
    b = GraphBuilder()
    assert values(staircase(constant(b, x), constant(b, 5.0), [(0.0, 6.0), (2.0, 7.0)])) == [expected]


def test_a_line_leads_through_two_points():
    b = GraphBuilder()
    xs, ys = ([constant(b, v) for v in pair] for pair in ((1.0, 3.0), (10.0, 20.0)))
    assert [values(interpolate_line(constant(b, x), xs, ys)) for x in (1.0, 2.0, 5.0)] == [[10.0], [15.0], [30.0]]


def test_a_rule_is_applied_to_each_member_of_equal_buses():
    b = GraphBuilder()
    one, two = (Bus({"n": constant(b, v), "in": Bus({"p": constant(b, -v)})}) for v in (1.0, 2.0))
    total = map_members(lambda x, y: x + y, "different", one, two)
    assert values(total.members["n"]) == [3.0]
    assert values(total.members["in"].members["p"]) == [-3.0]
    turned = Bus(dict(reversed(two.members.items())))
    assert map_members(lambda x, y: x, "different", one, turned).members.keys() == one.members.keys()
    for other, ordered in ((turned, True), (constant(b, 1.0), False)):
        with pytest.raises(EvaluationError, match="different"):
            map_members(lambda x, y: x, "different", one, other, ordered=ordered)
