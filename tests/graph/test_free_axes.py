import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.axis import Axis
from kennfeld.domain.free_axes import AxisKey, free_axes, key_of, with_breakpoints, with_free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.graph.partition import partition_graph

SPEED = AxisKey("AxisSpeed")


def shared(free=True):
    speed = Axis([0, 1, 3], name="AxisSpeed", free=free)
    return ParameterSet(
        [
            Map("M", speed, Axis([0, 1]), [[0, 1], [2, 3], [4, 5]]),
            Curve("C", Axis([0, 1, 3], name="AxisSpeed"), [1, 2, 3]),
            Curve("D", Axis([0, 1, 3]), [1, 2, 3]),
        ]
    )


def test_a_group_axis_is_free_in_all_its_tables_if_it_is_in_one():
    shared_axes = free_axes(shared())
    assert list(shared_axes) == [SPEED]
    assert shared_axes[SPEED].places == (("M", 0), ("C", 0))
    assert shared_axes[SPEED].axis.free


def test_an_axis_of_one_breakpoint_cannot_move():
    assert free_axes(ParameterSet([Curve("C", Axis([1.0], free=True), [2.0])])) == {}


def test_a_group_axis_moves_in_all_its_tables_at_once_and_other_axes_stay():
    moved = with_breakpoints(shared(), {SPEED: np.array([0.0, 2.0, 3.0])})
    assert [moved[name].axes[0].breakpoints[1] for name in "MCD"] == [2.0, 2.0, 1.0]
    assert moved["M"].axes[0].free
    np.testing.assert_array_equal(moved["M"].values, shared()["M"].values)


def test_a_table_may_have_one_free_group_axis_twice():
    axis = Axis([0, 1, 2], name="A", free=True)
    parameters = ParameterSet([Map("M", axis, axis, np.zeros((3, 3)))])
    moved = with_breakpoints(parameters, {AxisKey("A"): np.array([0.0, 0.5, 2.0])})
    assert moved["M"].axes[0] == moved["M"].axes[1]


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (["AxisSpeed"], {"AxisSpeed"}),
        (["D.x", "M.y"], {"D.x", "M.y"}),
        (["*"], {"AxisSpeed", "M.y", "D.x"}),
        ([], set()),
    ],
)
def test_axes_are_freed_by_name_or_pattern(patterns, expected):
    assert {str(key) for key in free_axes(with_free_axes(shared(free=False), patterns))} == expected


def test_a_pattern_that_matches_no_axis_is_an_error_with_the_nearest():
    with pytest.raises(ArgumentError, match=r"free_axes: AxisSped matches no axis. Did you mean AxisSpeed\?"):
        with_free_axes(shared(), ["AxisSped"])


def test_keys_name_the_group_else_table_and_direction():
    tables = shared()
    assert [str(key_of(tables[name], i)) for name, i in (("M", 0), ("M", 1), ("D", 0))] == ["AxisSpeed", "M.y", "D.x"]


def test_free_axes_that_are_equal_at_the_start_stay_apart():
    axis = Axis([0, 1, 2], free=True)
    b = GraphBuilder()
    x = b.input("x")
    graph = b.finish({"y": b.call("add", b.lookup("C", x), b.lookup("D", x))})
    low = lower_lookups(graph, ParameterSet([Curve("C", axis, [1, 2, 3]), Curve("D", axis, [1, 2, 3])]))
    assert len(low.axes) == 2


def test_a_search_in_a_moved_axis_gives_what_the_moved_table_gives():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("M", b.input("x"), b.input("z"))})
    columns = {"x": np.array([-1.0, 0.5, 1.5, 2.5, 9.0]), "z": np.full(5, 0.3)}
    moved = with_breakpoints(shared(), {SPEED: np.array([0.0, 2.0, 3.0])})
    low = lower_lookups(graph, shared())
    output = Interpreter(low, moved).run(low.graph.nodes, (), columns)[low.graph.names["y"]]
    np.testing.assert_allclose(output, evaluate(graph, columns, moved)["y"], rtol=1e-15)


def rows(extrapolation, x):
    """Slopes with respect to the breakpoints 0, 1, 3 of a curve 0, 2, 12 at x."""
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("C", b.input("x"))})
    parameters = ParameterSet([Curve("C", Axis([0, 1, 3], free=True), [0, 2, 12], extrapolation=extrapolation)])
    low = lower_lookups(graph, parameters)
    key = AxisKey("C", "x")
    line = differentiate(low.graph, [low.graph.names["y"]], [key])
    return Interpreter(low, parameters).rows(line, {key: 0}, {"x": np.array([x])}).jacobian[0, 0].tolist()


def test_the_slopes_of_breakpoints_are_minus_the_slope_of_the_curve_times_their_weights():
    assert rows("clip", 0.25) == [-2 * 0.75, -2 * 0.25, 0.0]
    assert rows("clip", 2.0) == [0.0, -5 * 0.5, -5 * 0.5]


@pytest.mark.parametrize("x", [-1.0, 4.0])
def test_where_a_lookup_is_clipped_breakpoints_have_slope_zero(x):
    assert rows("clip", x) == [0.0, 0.0, 0.0]


def test_beyond_the_ends_a_straight_line_goes_on_and_has_its_slopes():
    assert rows("linear", 4.0) == [0.0, -5 * -0.5, -5 * 1.5]
    assert rows("linear", -1.0) == [-2 * 2.0, -2 * -1.0, 0.0]


def test_nodes_that_depend_on_a_free_axis_are_not_precomputed():
    b = GraphBuilder()
    costly = b.call("exp", b.lookup("C", b.input("x")))
    graph = b.finish({"y": b.call("mul", costly, b.lookup("K"))})
    parameters = ParameterSet([Curve("C", Axis([0, 1, 3], free=True), [0, 2, 12]), Scalar("K", 1.0)])
    low = lower_lookups(graph, parameters)
    assert len(partition_graph(low.graph, ["y"], ["K"]).columns) == 1
    assert not partition_graph(low.graph, ["y"], ["K", AxisKey("C", "x")]).columns
