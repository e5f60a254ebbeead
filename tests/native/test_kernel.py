from dataclasses import replace

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.graph import GraphBuilder
from tests.native.models import case, coupled, delayed, lag, static
from tests.native.reference import compiled


def test_values_are_packed_free_ones_first():
    code = compiled(case(static(), 5, free=("M",)))
    values = code.kernel.values
    assert values.offsets["M"] == 0
    assert (values.free, values.total) == (12, 17)
    packed = values.pack(code.case.parameters)
    for name, at in values.offsets.items():
        flat_values = code.case.parameters[name].values.ravel()
        np.testing.assert_array_equal(packed[at : at + flat_values.size], flat_values)


def test_parameters_that_reach_a_state_come_first():
    code = compiled(case(lag(), 5))
    values = code.kernel.values
    assert values.offsets["K"] == values.reach == 16
    assert values.free == 17


def test_unpacking_replaces_the_free_values_alone():
    code = compiled(case(static(), 5, free=("M", "K")))
    values = code.kernel.values
    flat = np.arange(values.total, dtype=float)
    parameters = values.unpack(flat, code.case.parameters)
    np.testing.assert_array_equal(values.pack(parameters)[: values.free], flat[: values.free])
    assert parameters["C"] == code.case.parameters["C"]
    assert list(parameters) == list(code.case.parameters)


def test_breakpoints_are_values_among_those_that_reach_a_state_or_not():
    b = GraphBuilder()
    state = b.state()
    b.close(state, b.const(0.0), b.call("mul", b.lookup("C", b.input("u")), b.const(0.5)))
    graph = b.finish({"y": b.call("add", state, b.lookup("D", b.input("v")))})
    axes = [Axis([-1.0, 0.0, 1.5], free=True) for _ in range(2)]
    parameters = ParameterSet([Curve(name, axis, [1.0, 2.0, 0.5]) for name, axis in zip("CD", axes, strict=True)])
    code = compiled(replace(case(graph, 5, values=parameters, free=("C", "D")), axes=tuple(free_axes(parameters))))
    values = code.kernel.values
    assert (values.offsets, values.reach, values.free) == ({"C": 0, "D": 6}, 6, 12)
    assert {str(key): at for key, at in values.moving.items()} == {"C.x": 3, "D.x": 9}
    flat = values.pack(parameters)
    assert flat.tolist() == [1.0, 2.0, 0.5, -1.0, 0.0, 1.5] * 2
    flat[10] = 0.25
    moved = values.unpack(flat, parameters)
    assert moved["D"].axes[0].breakpoints.tolist() == [-1.0, 0.25, 1.5]
    assert moved["C"] == parameters["C"]


def test_breakpoints_that_are_not_fitted_come_after_the_free_values():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("C", b.input("u"))})
    parameters = ParameterSet([Curve("C", Axis([-1.0, 0.0, 1.5], free=True), [1.0, 2.0, 0.5])])
    code = compiled(case(graph, 5, values=parameters, free=("C",)))
    assert (code.kernel.values.free, code.kernel.values.total) == (3, 6)


def test_the_pattern_marks_where_matrices_can_differ_from_zero():
    b = GraphBuilder()
    one, two = b.state(), b.state()
    b.close(one, b.const(0.0), b.call("mul", one, b.lookup("K")))
    b.close(two, b.const(0.0), one)
    graph = b.finish({"y": two, "z": b.call("add", one, b.lookup("K"))})
    code = compiled(case(graph, 5))
    first = graph.states.index(next(s for s in graph.states if graph.nodes[s.next].op == "mul"))
    second = 1 - first
    assert code.kernel.pattern.c == {0 * 2 + second, 1 * 2 + first}
    assert code.kernel.pattern.a == {first * 2 + first, second * 2 + first}


def test_rows_are_taken_where_a_step_touches_many_columns():
    kernel = compiled(case(coupled(3), 5)).kernel
    assert kernel.pattern.carried * kernel.entries.room >= kernel.values.free / 2
    assert not kernel.accumulates
    assert not compiled(case(delayed(), 5)).kernel.accumulates


def test_a_parameter_the_graph_does_not_use_may_be_called_free():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("K")})
    model = case(graph, 5, values=ParameterSet([Scalar("K", 1.0), Scalar("spare", 2.0)]))
    code = compiled(model)
    assert code.kernel.values.offsets == {"K": 0}
