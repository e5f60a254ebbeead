import numpy as np
import pytest
from reference import compiled, sums

from kennfeld.graph import Builder
from kennfeld.native.sweeps import MANY, Pattern, sweeps
from models import case


def chain(latencies):
    """States one behind the other, the first driven by a lookup, each seen by the output and the one behind it."""
    b = Builder()
    before = b.lookup("M", b.input("u"), b.input("v"))
    total = before
    for latency in latencies:
        state = b.state(latency)
        moved = b.call("add", b.call("mul", b.const(0.6), state), b.call("mul", b.lookup("C", b.input("w")), before))
        b.close(state, b.lookup("K"), b.call("sin", moved))
        total = b.call("add", b.call("mul", b.lookup("L"), total), state)
        before = state
    return b.finish({"y": total})


@pytest.mark.parametrize("latencies", [(1,) * 12, (1, 2, 3) * 4, (3, 1, 1) * 3])
def test_rows_of_many_states_are_those_of_the_interpreter(latencies):
    made = compiled(case(chain(latencies), 60, (0, 25)))
    assert made.kernel.pattern.carried > MANY
    direct = sums(made.case, made.run(made.interpreter()))
    normal = made.accumulator().normal(made.values)
    for got, expected in ((normal.gradient, direct.gradient), (normal.matrix, direct.matrix)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


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
    rows = sweeps(Pattern(1, (1,) * n, frozenset(range(n)), frozenset(range(n * n)))).rows
    before, carried, entries = (
        [x.ctypes.data for x in xs] for xs in ((weight, c, a, s), (rings, following), (index, slope, count))
    )
    rows(length, *before, columns, *carried, *entries, 1, jacobian.ctypes.data, columns)
    start[2] = 0.0
    for k in range(length):
        np.testing.assert_allclose(jacobian[k], c[k] @ start, rtol=1e-11, atol=1e-11)
        start = a[k] @ start
