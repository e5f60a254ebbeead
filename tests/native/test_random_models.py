"""Random models, native against the reference interpreter."""

import numpy as np
import pytest
from hypothesis import assume, event
from hypothesis import strategies as st

from kennfeld.graph import derivative
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.simulator import Simulator
from tests.draws import few_or_many
from tests.graph.noise import assert_close, spread, steady
from tests.graph.random_graphs import cases
from tests.native.reference import compiled, sums, weighted_rows


def assert_same_sums(got, expected):
    """Two ways to add up the same rows agree to rounding."""
    for a, b in zip(got, expected, strict=True):
        size = np.max(np.abs(b), initial=0.0)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * size + 1e-300)


def check_sums(made, widths=None):
    """Costs, gradient and matrix against direct sums over the rows of the native code and of the interpreter."""
    case, accumulator = made.case, made.accumulator(widths=widths)
    costs = accumulator.costs(made.values)
    plain = made.interpreter(() if widths is None else tuple(widths))
    with np.errstate(all="ignore"):
        exact = made.run(plain)
        change = spread(plain, made.run, exact)
    ok = steady(exact, change)
    event("steady" if ok.all() else "unsteady")
    direct = sums(case, exact)
    if ok.all():
        np.testing.assert_array_equal(np.isfinite(costs), np.isfinite(direct.costs))
    if not np.isfinite(costs).all():
        event("not finite")
        return
    residual, jacobian = (a.reshape(case.samples, len(case.criteria), -1) for a in accumulator.rows(made.values))
    # weights are monotone in the residual, so noise of rows is that of the weighted rows but for a factor
    expected_residual, expected_jacobian = weighted_rows(case, exact)
    scale = 10.0 * np.array([1 / c.scale for c in case.criteria])[None, :, None]
    finite = np.isfinite(exact).all(axis=2, keepdims=True)
    same = ok.all(axis=2, keepdims=True) & finite
    size = np.where(finite, np.abs(exact), 0).max(axis=2, keepdims=True)
    with np.errstate(over="ignore"):
        noise = scale * change.max(axis=2, keepdims=True) * (1 + size)
    assert_close(residual, expected_residual[:, :, None], noise, same, "residual")
    assert_close(jacobian, expected_jacobian, noise + 0 * jacobian, same & np.isfinite(expected_jacobian), "row")
    if not np.isfinite(jacobian).all():
        event("slopes not finite")
        return
    flat_r = residual.ravel()
    flat_j = jacobian.reshape(flat_r.size, made.kernel.values.free)
    own = (flat_j.T @ flat_r, flat_j.T @ flat_j)
    normal = accumulator.normal(made.values)
    assert_same_sums((normal.gradient, normal.matrix), own)
    np.testing.assert_array_equal(normal.matrix, normal.matrix.T)
    for sparse in (True, False):
        if made.kernel.pattern.carried and (not sparse or made.kernel.pattern.accumulates):
            event(f"sparse={sparse}")
            other = made.accumulator(widths=widths, sparse=sparse).normal(made.values)
            assert_same_sums((other.gradient, other.matrix), own)
    if ok.all() and np.isfinite(direct.costs).all():
        event("summed")
        with np.errstate(all="ignore"):
            np.testing.assert_allclose(costs, direct.costs, rtol=1e-9, atol=1e-10 + 1e3 * np.max(noise))
        assert accumulator.cost(made.values) == pytest.approx(costs.sum(), rel=1e-12)


@few_or_many(cases(), few=5, many=20)
def test_every_node_is_what_the_interpreter_computes(case):
    low = lower_lookups(case.graph, case.parameters)
    roots = list(range(len(low.graph.nodes)))
    simulator = Simulator(low, roots, case.parameters)
    got = simulator.over(case.columns, case.samples, case.parameters, case.starts)

    def run(interpreter):
        return np.array(interpreter.run(low.graph.nodes, low.graph.states, case.columns, case.starts))

    plain = Interpreter(low, case.parameters)
    exact = run(plain)
    change = spread(plain, run, exact)
    assert_close(got, exact, change, steady(exact, change))


@few_or_many(cases(states=False), few=3, many=25)
def test_sums_without_states(case):
    check_sums(compiled(case))


@few_or_many(cases(states=True, max_latency=1), few=2, many=20)
def test_sums_with_states(case):
    check_sums(compiled(case))


@few_or_many(cases(states=True), few=2, many=15)
def test_sums_with_delays(case):
    check_sums(compiled(case))


@few_or_many(cases(nested=True), st.data(), few=2, many=12)
def test_sums_of_smoothed_lookups(case, data):
    smooth = data.draw(st.sampled_from([tuple(case.parameters), case.free, ("K", "C", "M", "Q3", "B2")]))
    made = compiled(case, smooth=smooth)
    soft = [i for n in made.lowered.graph.nodes if n.op == "interpolate" for i in n.payload.smoothed]
    assume(any(soft))
    widths = np.array([data.draw(st.sampled_from([0.03, 0.3, 2.0])) for _ in made.lowered.axes])
    check_sums(made, widths)


@few_or_many(cases(nested=True), st.sampled_from([(), ("C", "M", "B2")]), few=2, many=20)
def test_sums_by_a_pull_back(case, smooth):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(derivative, "MAX_VISITS", -1)
        patch.setattr(derivative, "SHARED", 0.0)
        made = compiled(case, smooth)
    event(type(made.kernel.line.slopes).__name__)
    check_sums(made, np.full(len(made.lowered.axes), 0.3) if smooth else None)


@few_or_many(cases(), few=2, many=12)
def test_repeated_calls_see_the_values_of_now(case):
    made, other = compiled(case), case.with_other_values()
    accumulator = made.accumulator()
    values, others = made.values, made.kernel.values.pack(other.parameters)
    fresh = [(n.gradient.copy(), n.matrix.copy()) for n in (made.accumulator().normal(v) for v in (values, others))]
    for which, v in ((0, values), (1, others), (0, values)):
        normal = accumulator.normal(v)
        np.testing.assert_array_equal(normal.gradient, fresh[which][0])
        np.testing.assert_array_equal(normal.matrix, fresh[which][1])
    assert np.array_equal(accumulator.costs(others), made.accumulator().costs(others), equal_nan=True)
    normal = accumulator.normal(values)
    np.testing.assert_array_equal(normal.matrix, fresh[0][1])
