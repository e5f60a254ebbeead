import numpy as np
import pytest

from kennfeld.graph import GraphBuilder, derivative
from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.graph.derivative import Written
from kennfeld.native.sweeps import sweeps
from kennfeld.native.tape_layout import MANY, TapeLayout
from tests.native.models import case
from tests.native.reference import compiled, sums, weighted_rows


def chain(latencies):
    """States one behind the other, the first driven by a lookup, each seen by the output and the one behind it."""
    b = GraphBuilder()
    before = b.lookup("M", b.input("u"), b.input("v"))
    total = before
    for latency in latencies:
        state = b.state(latency)
        moved = b.call("add", b.call("mul", b.const(0.6), state), b.call("mul", b.lookup("C", b.input("w")), before))
        b.close(state, b.lookup("K"), b.call("sin", moved))
        total = b.call("add", b.call("mul", b.lookup("L"), total), state)
        before = state
    return b.finish({"y": total})


@pytest.mark.parametrize("latencies", [(1,) * 9, (1, 2, 3) * 3, (3, 1, 1) * 3])
def test_rows_of_many_states_are_those_of_the_interpreter(latencies):
    code = compiled(case(chain(latencies), 60, (0, 25)))
    assert code.kernel.pattern.carried > MANY
    direct = sums(code.case, code.run(code.interpreter()))
    normal = code.accumulator().normal(code.values)
    for got, expected in ((normal.gradient, direct.gradient), (normal.matrix, direct.matrix)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


def register(cells, latency=1, conditional=False):
    """A shift register of what a lookup gives, read at a place that moves; where `held`, it stands still at times."""
    b = GraphBuilder()
    states = [b.state(latency if at % 3 == 1 else 1) for at in range(cells)]
    written = b.call("mul", b.lookup("M", b.input("u"), b.input("v")), b.call("exp", b.input("w")))
    place = b.call("mul", b.const(cells / 6), b.call("add", b.lookup("C", b.input("u")), b.const(3.0)))
    total = written
    for at, state in enumerate(states):
        total = b.call("select", b.call("gt", place, b.const(float(at))), b.call("mul", state, b.lookup("L")), total)
        before = written if at == 0 else states[at - 1]
        following = b.call("select", b.call("gt", b.input("v"), b.const(0.0)), before, state) if conditional else before
        b.close(state, b.lookup("K"), following)
    return b.finish({"y": b.call("mul", total, place), "last": states[-1]})


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(
    ("cells", "latency", "conditional"),
    [
        (9, 1, False),
        pytest.param(24, 1, False, marks=pytest.mark.slow),
        (9, 3, False),
        (9, 2, True),
        pytest.param(20, 2, True, marks=pytest.mark.slow),
    ],
)
def test_rows_of_a_shift_register_are_those_of_the_interpreter(cells, latency, conditional, shared, monkeypatch):
    if shared:
        monkeypatch.setattr(derivative, "MAX_VISITS", -1)
        monkeypatch.setattr(derivative, "SHARED", 0.0)
    code = compiled(case(register(cells, latency, conditional), 60, (0, 25)))
    assert isinstance(code.kernel.line.slopes, AdjointProgram if shared else Written)
    pattern = code.kernel.pattern
    assert pattern.carried == cells
    assert len(pattern.copies) == (0 if conditional else cells - 1)
    assert pattern.cells == (2 * cells - 1 if conditional else 0)
    exact = code.run(code.interpreter())
    direct, normal = sums(code.case, exact), code.accumulator().normal(code.values)
    for got, expected in ((normal.gradient, direct.gradient), (normal.matrix, direct.matrix)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


def test_a_value_that_is_not_finite_hands_no_slopes_down_a_register():
    b = GraphBuilder()
    far = b.call("gt", b.call("abs", b.call("sub", b.input("t"), b.const(1.0))), b.const(0.05))
    now = b.call("div", b.lookup("K"), b.call("select", far, b.input("t"), b.const(0.0)))  # infinite once
    states, before = [], now
    for _ in range(12):
        state = b.state()
        b.close(state, b.lookup("L"), before)
        states.append(before := state)
    finite = b.call("lt", b.call("abs", states[-1]), b.const(1e9))
    code = compiled(case(b.finish({"y": b.call("select", finite, states[-1], now)}), 40))
    with np.errstate(all="ignore"):
        exact = code.run(code.interpreter())
    got = code.accumulator().rows(code.values)[1].reshape(40, 1, -1)
    scored = np.isfinite(code.case.criteria[0].target) & np.isfinite(exact).all(axis=(1, 2))
    expected = weighted_rows(code.case, exact)[1]
    assert scored.sum() > 30
    np.testing.assert_allclose(got[scored], expected[scored], rtol=1e-12)


@pytest.mark.parametrize("columns", [8, 32, 40, 72])
def test_a_state_that_nothing_sees_hands_on_nothing(columns):
    n, length = MANY + 3, 5
    random = np.random.default_rng(columns)
    c, a = random.standard_normal((length, 1, n)), random.standard_normal((length, n, n))
    c[:, :, 2], a[:, :, 2] = 0.0, 0.0
    start = random.standard_normal((n, columns))
    s, following = start.copy(), np.zeros((n, columns))
    s[2] = np.nan
    rings, count = np.zeros(n, dtype=np.int64), np.zeros(length, dtype=np.int32)
    index, slope = np.zeros((length, 1), dtype=np.int32), np.zeros((length, 1, 1 + n))
    weight, jacobian = np.ones((length, 1)), np.full((length, 1, columns), np.nan)
    rows = sweeps(TapeLayout(1, (1,) * n, frozenset(range(n)), frozenset(range(n * n)))).rows
    before, carried, entries = (
        [x.ctypes.data for x in xs] for xs in ((weight, c, a, s), (rings, following), (index, slope, count))
    )
    rows(length, *before, columns, *carried, *entries, 1, jacobian.ctypes.data, columns)
    start[2] = 0.0
    for k in range(length):
        np.testing.assert_allclose(jacobian[k], c[k] @ start, rtol=1e-11, atol=1e-11)
        start = a[k] @ start
