from dataclasses import replace

import numpy as np

from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Axis, Curve, Scalar
from kennfeld.graph import GraphBuilder
from tests.native.models import case, coupled, delayed, lag, static
from tests.native.reference import compiled


def test_values_are_packed_free_ones_first():
    made = compiled(case(static(), 5, free=("M",)))
    values = made.kernel.values
    assert values.offsets["M"] == 0
    assert (values.free, values.total) == (12, 17)
    packed = values.pack(made.case.parameters)
    for name, at in values.offsets.items():
        held = made.case.parameters[name].values.ravel()
        np.testing.assert_array_equal(packed[at : at + held.size], held)


def test_parameters_that_reach_a_state_come_first():
    made = compiled(case(lag(), 5))
    values = made.kernel.values
    assert values.offsets["K"] == values.reach == 16
    assert values.free == 17


def test_unpacking_replaces_the_free_values_alone():
    made = compiled(case(static(), 5, free=("M", "K")))
    values = made.kernel.values
    flat = np.arange(values.total, dtype=float)
    held = values.unpack(flat, made.case.parameters)
    np.testing.assert_array_equal(values.pack(held)[: values.free], flat[: values.free])
    assert held["C"] == made.case.parameters["C"]
    assert list(held) == list(made.case.parameters)


def test_breakpoints_are_values_among_those_that_reach_a_state_or_not():
    b = GraphBuilder()
    state = b.state()
    b.close(state, b.const(0.0), b.call("mul", b.lookup("C", b.input("u")), b.const(0.5)))
    graph = b.finish({"y": b.call("add", state, b.lookup("D", b.input("v")))})
    axes = [Axis([-1.0, 0.0, 1.5], free=True) for _ in range(2)]
    held = ParameterSet([Curve(name, axis, [1.0, 2.0, 0.5]) for name, axis in zip("CD", axes, strict=True)])
    made = compiled(replace(case(graph, 5, values=held, free=("C", "D")), axes=tuple(free_axes(held))))
    values = made.kernel.values
    assert (values.offsets, values.reach, values.free) == ({"C": 0, "D": 6}, 6, 12)
    assert {str(key): at for key, at in values.moving.items()} == {"C.x": 3, "D.x": 9}
    flat = values.pack(held)
    assert flat.tolist() == [1.0, 2.0, 0.5, -1.0, 0.0, 1.5] * 2
    flat[10] = 0.25
    moved = values.unpack(flat, held)
    assert moved["D"].axes[0].breakpoints.tolist() == [-1.0, 0.25, 1.5]
    assert moved["C"] == held["C"]


def test_breakpoints_that_are_not_fitted_come_after_the_free_values():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("C", b.input("u"))})
    held = ParameterSet([Curve("C", Axis([-1.0, 0.0, 1.5], free=True), [1.0, 2.0, 0.5])])
    made = compiled(case(graph, 5, values=held, free=("C",)))
    assert (made.kernel.values.free, made.kernel.values.total) == (3, 6)


def test_the_pattern_tells_where_matrices_can_differ_from_zero():
    b = GraphBuilder()
    one, two = b.state(), b.state()
    b.close(one, b.const(0.0), b.call("mul", one, b.lookup("K")))
    b.close(two, b.const(0.0), one)
    graph = b.finish({"y": two, "z": b.call("add", one, b.lookup("K"))})
    made = compiled(case(graph, 5))
    first = graph.states.index(next(s for s in graph.states if graph.nodes[s.next].op == "mul"))
    second = 1 - first
    assert made.kernel.pattern.c == {0 * 2 + second, 1 * 2 + first}
    assert made.kernel.pattern.a == {first * 2 + first, second * 2 + first}


def test_rows_are_taken_where_a_step_touches_many_columns():
    kernel = compiled(case(coupled(3), 5)).kernel
    assert kernel.pattern.carried * kernel.entries.room >= kernel.values.free / 2
    assert not kernel.accumulates
    assert not compiled(case(delayed(), 5)).kernel.accumulates


def test_a_parameter_the_graph_does_not_use_may_be_called_free():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("K")})
    model = case(graph, 5, values=ParameterSet([Scalar("K", 1.0), Scalar("spare", 2.0)]))
    made = compiled(model)
    assert made.kernel.values.offsets == {"K": 0}
