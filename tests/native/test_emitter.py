import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native import emitter
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.simulator import Simulator
from tests.draws import few_or_many, mostly_slow
from tests.graph.noise import assert_close, spread, steady
from tests.graph.random_graphs import cases
from tests.native.models import MODELS, case
from tests.native.reference import compiled
from tests.native.segments import cut_code


def results(made):
    summed = made.accumulator()
    costs = summed.costs(made.values)
    normal = summed.normal(made.values)
    return [costs, normal.gradient.copy(), normal.matrix.copy(), *summed.rows(made.values)]


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.parametrize("segment", mostly_slow([1, 7, 30], 1))
def test_code_cut_into_functions_gives_what_one_function_gives(model, segment, monkeypatch):
    graph = MODELS[model]()
    whole = results(compiled(case(graph, 40, (0, 25))))
    cut_code(monkeypatch, segment)
    for a, b in zip(results(compiled(case(graph, 40, (0, 25)))), whole, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13 * np.max(np.abs(b)))


@pytest.mark.parametrize(
    "segment",
    [
        *range(1, 25, 4),
        *(pytest.param(segment, marks=pytest.mark.slow) for segment in range(3, 25, 4)),
    ],
)
def test_an_output_may_stand_in_another_function_than_its_entries(segment, monkeypatch):
    b = GraphBuilder()
    total = b.lookup("C", b.input("u"))
    for coordinate in ("v", "w"):
        total = b.call("add", total, b.lookup("C", b.input(coordinate)))
    graph = b.finish({"y": total})
    whole = results(compiled(case(graph, 20)))
    cut_code(monkeypatch, segment)
    for a, b_ in zip(results(compiled(case(graph, 20))), whole, strict=True):
        np.testing.assert_allclose(a, b_, rtol=0, atol=1e-13 * np.max(np.abs(b_)))


@few_or_many(cases(operations=6, max_outputs=2), st.sampled_from([1, 3, 7]), few=2, many=10)
def test_random_models_do_not_depend_on_where_the_code_is_cut(case, segment):
    low = lower_lookups(case.graph, case.parameters)
    roots = list(range(len(low.graph.nodes)))

    def run():
        simulator = Simulator(low, roots, case.parameters)
        return simulator.over(case.columns, case.samples, case.parameters, case.starts)

    plain = compiled(case).interpreter()

    def reference(interpreter):
        return np.array(interpreter.run(low.graph.nodes, low.graph.states, case.columns, case.starts))

    exact = reference(plain)
    change = spread(plain, reference, exact)
    with pytest.MonkeyPatch.context() as patch:
        cut_code(patch, segment)
        assert_close(run(), exact, change, steady(exact, change))
        made = compiled(case)
        made.accumulator().costs(made.values)


@pytest.mark.slow
def test_a_model_of_thousands_of_nodes():
    b = GraphBuilder()
    random = np.random.default_rng(3)
    u, v = b.input("u"), b.input("v")
    pool = [u, v]
    for number in range(1100):  # the last hundred see parameters
        pool += [b.lookup("M", u, v), b.lookup("C", u), b.lookup("K")] if number == 1000 else []
        x, y = (pool[i] for i in random.integers(max(0, len(pool) - 60), len(pool), 2))
        sum_ = b.call("add", x, b.call("mul", b.const(float(random.uniform(0.3, 0.9))), y))
        pool.append(b.call("sin", sum_) if number % 20 == 0 else b.call("mul", b.const(0.8), sum_))
    total = pool[-1]
    for at in pool[2:-1]:
        total = b.call("add", total, at)
    state = b.state()
    b.close(state, b.const(0.0), b.call("sin", b.call("add", b.call("mul", b.const(0.01), total), state)))
    graph = b.finish({"y": b.call("add", b.call("mul", b.const(0.01), total), state)})
    made = compiled(case(graph, 6, (0, 4)))
    assert len(graph.nodes) > 4000
    assert len(made.kernel.line.nodes) > emitter.SEGMENT
    plain = made.interpreter()
    exact = made.run(plain)
    residual, jacobian = made.accumulator().rows(made.values)
    criterion = made.case.criteria[0]
    root = np.sqrt(np.repeat(criterion.scores, np.diff([*made.case.starts, 6])))
    on = ~np.isnan(criterion.target)
    expected = root * (exact[:, 0, 0] - criterion.target) / criterion.scale
    np.testing.assert_allclose(residual[on], expected[on], rtol=1e-9)
    rows = root[:, None] * exact[:, 0, 1:] / criterion.scale
    np.testing.assert_allclose(jacobian[on], rows[on], rtol=1e-7, atol=1e-9 * np.max(np.abs(rows)))


def test_a_layout_counts_where_things_lie():
    layout = MemoryLayout({}, {"M": 0}, {"M": (2, 3, 4)}, (np.arange(3.0), np.arange(5.0)), (1, 3, 2))
    assert layout.axis_offsets == (0, 3)
    assert layout.memory_offsets == (0, 1, 4)
    assert layout.memory == 6
    assert layout.strides("M") == [12, 4, 1]


def test_a_graph_of_a_constant_alone():
    low = lower_lookups(constant(), ParameterSet())
    assert Simulator(low, [0], ParameterSet()).over({}, 3, ParameterSet()).tolist() == [[2.5] * 3]


def constant():
    b = GraphBuilder()
    return b.finish({"y": b.const(2.5)})


def test_a_model_without_inputs():
    b = GraphBuilder()
    state = b.state()
    b.close(state, b.const(0.0), b.call("add", state, b.lookup("K")))
    graph = b.finish({"y": state})
    held = ParameterSet([Scalar("K", 2.0)])
    low = lower_lookups(graph, held)
    run = Simulator(low, [low.graph.names["y"]], held).over({}, 4, held, (0, 3))
    assert run.tolist() == [[0.0, 2.0, 4.0, 0.0]]
