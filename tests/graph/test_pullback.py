import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph import GraphBuilder, derivative
from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.graph.derivative import Written, differentiate
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from tests.draws import few_or_many
from tests.graph.random_graphs import cases


def pulled(graph, outputs, free):
    """The linearization by a pull-back, however small the graph."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(derivative, "MAX_VISITS", -1)
        patch.setattr(derivative, "SHARED", 0.0)
        return differentiate(graph, outputs, free)


def scalars(expression, **values):
    """Slopes of one expression of scalars by a pull-back."""
    b = GraphBuilder()
    y = expression(b, *(b.lookup(name) for name in values))
    parameters = ParameterSet([Scalar(name, value) for name, value in values.items()])
    low = lower_lookups(b.finish({"y": y}), parameters)
    line = pulled(low.graph, [low.graph.names["y"]], tuple(values))
    assert isinstance(line.slopes, AdjointProgram)
    offsets = {name: at for at, name in enumerate(values)}
    return Interpreter(low, parameters).rows(line, offsets, {"x": np.zeros(1)}).jacobian[0, 0].tolist()


def chain(states):
    """States of which each follows the one before, on a chain of nodes that all of them see."""
    b = GraphBuilder()
    x = b.call("mul", b.lookup("K"), b.input("u"))
    for _ in range(200):
        x = b.call("sin", b.call("add", x, b.lookup("K")))
    y = x
    for _ in range(states):
        state = b.state()
        y = b.call("add", state, b.call("mul", b.const(0.5), b.call("sub", y, state)))
        b.close(state, x, y)
    low = lower_lookups(b.finish({"y": y}), ParameterSet([Scalar("K", 0.3)]))
    return differentiate(low.graph, [low.graph.names["y"]], ["K"])


def test_a_row_that_sees_nodes_alone_is_written_out():
    assert isinstance(chain(1).slopes, Written)


def test_nodes_do_not_multiply_with_the_rows():
    few, many = chain(60), chain(120)
    assert isinstance(few.slopes, AdjointProgram)
    assert isinstance(few.start_slopes, AdjointProgram)
    assert len(many.nodes) - len(few.nodes) < 60 * 20
    assert len(many.slopes.pulls) - len(few.slopes.pulls) < 60 * 20


def test_an_adjoint_that_is_only_handed_on_is_not_copied():
    b = GraphBuilder()
    y = b.lookup("K0")
    for i in range(1, 9):
        y = b.call("add", y, b.lookup(f"K{i}"))
    low = lower_lookups(b.finish({"y": y}), ParameterSet([Scalar(f"K{i}", 1.0) for i in range(9)]))
    line = pulled(low.graph, [low.graph.names["y"]], tuple(low.shapes))
    assert {pull.of for pull in line.slopes.pulls} == {low.graph.names["y"]}
    assert sorted(pull.onto for pull in line.slopes.pulls) == list(line.atoms)


def test_a_condition_is_a_factor_of_one_or_zero():
    def expression(b, x, k):
        return b.call("select", x, b.call("mul", k, k), k)

    assert scalars(expression, x=2.5, k=3.0) == [0.0, 6.0]
    assert scalars(expression, x=0.0, k=3.0) == [0.0, 1.0]
    assert scalars(expression, x=np.nan, k=3.0) == [0.0, 6.0]


def test_nothing_leaks_from_a_branch_not_taken():
    def expression(b, x, k):
        deep = b.call("mul", b.call("exp", b.call("div", k, b.call("sqrt", x))), b.call("log", x))
        return b.call("select", b.call("gt", x, b.const(0.0)), deep, k)

    assert scalars(expression, x=-1.0, k=3.0) == [0.0, 1.0]
    assert scalars(expression, x=0.0, k=3.0) == [0.0, 1.0]


@few_or_many(cases(), few=8, many=40)
def test_a_pull_back_equals_rows_written_out(case):
    low = lower_lookups(case.graph, case.parameters)
    roots = list(low.graph.names.values())
    offsets, at = {}, 0
    for name in case.free:
        offsets[name], at = at, at + case.parameters[name].size
    written, shared = (way(low.graph, roots, case.free) for way in (differentiate, pulled))
    assert written.atoms == shared.atoms
    assert [set(row) for row in written.slopes.reach] == [set(row) for row in shared.slopes.reach]
    plain = Interpreter(low, case.parameters)

    def jacobian(line):
        with np.errstate(all="ignore"):
            return plain.rows(line, offsets, case.columns, case.starts).jacobian

    expected, got = jacobian(written), jacobian(shared)
    finite = np.isfinite(expected).all(axis=(1, 2)) & np.isfinite(got).all(axis=(1, 2))
    size = np.max(np.abs(expected[finite]), initial=1.0)
    np.testing.assert_allclose(got[finite], expected[finite], rtol=1e-9, atol=1e-11 * size)
    # zero times infinity is NaN where rows are written out; beyond that both are finite in the same places
    assert np.isfinite(got[np.isfinite(expected)]).all()
