"""The sums over a tape, on random linear systems x' = A x + B, r' = C S + D, written out densely."""

import numpy as np
import pytest

from kennfeld.native.forward_sweep import BATCH, scratch_size
from kennfeld.native.sweeps import sweeps
from kennfeld.native.tape_layout import MANY, TapeLayout
from kennfeld.native.workspace import BatchMemory


class Tape:
    """Random steps of m outputs and n states, with `room` entries a sample, some columns twice."""

    def __init__(self, m, n, columns, length=61, room=6, sparse=False, seed=0, runs=1):
        random = np.random.default_rng(seed)
        self.m, self.n, self.columns, self.length, self.room = m, n, columns, length, room
        self.residual, self.weight = random.standard_normal((length, m)), random.uniform(0, 2, (length, m))
        self.weight[::5] = 0.0
        self.c, self.a = random.standard_normal((length, m, n)), random.standard_normal((length, n, n)) * 0.5
        present_c = [i for i in range(m * n) if not sparse or i % 2]
        present_a = [i for i in range(n * n) if not sparse or i % 3]
        self.c.reshape(length, -1)[:, [i for i in range(m * n) if i not in present_c]] = 0.0
        self.a.reshape(length, -1)[:, [i for i in range(n * n) if i not in present_a]] = 0.0
        self.index = random.integers(0, columns, (length, room)).astype(np.int32)
        self.index[:, 1] = self.index[:, 0]
        self.slope = random.standard_normal((length, room, m + n))
        self.count = random.integers(0, room + 1, length).astype(np.int32)
        for k in range(length):  # neighbours that touch the same columns, `runs` in a row
            self.index[k], self.count[k] = self.index[k // runs * runs], self.count[k // runs * runs]
        self.start = random.standard_normal((n, columns))
        self.pattern = TapeLayout(m, (1,) * n, frozenset(present_c), frozenset(present_a))

    def rows(self):
        """The Jacobian, [length, m, columns]."""
        s, jacobian_rows = self.start.copy(), []
        for k in range(self.length):
            entries = np.zeros((self.m + self.n, self.columns))
            for e in range(self.count[k]):
                entries[:, self.index[k, e]] += self.slope[k, e]
            jacobian_rows.append(self.c[k] @ s + entries[: self.m])
            s = self.a[k] @ s + entries[self.m :]
        return np.array(jacobian_rows), s

    @property
    def sums(self):
        j, _ = self.rows()
        weighted = self.weight[:, :, None] * j
        return np.einsum("kmi,km->i", weighted, self.residual), np.einsum("kmi,kmj->ij", weighted, j)

    def entries(self):
        return self.index.ctypes.data, self.slope.ctypes.data, self.count.ctypes.data, self.room


def at(*arrays):
    return [a.ctypes.data for a in arrays]


def close(a, b):
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * np.max(np.abs(b)))


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("columns", [3, 40, 100])
def test_sums_without_states(m, columns):
    tape = Tape(m, 0, columns)
    gradient, matrix = np.zeros(columns), np.zeros((columns, columns))
    native = sweeps(tape.pattern)
    head = (tape.length, *at(tape.residual, tape.weight), *tape.entries(), *at(gradient))
    memory = BatchMemory(tape.room, columns, m)
    native.normal(*head, *at(matrix), columns, *memory.pointers)
    native.fold(matrix.ctypes.data, columns, columns)
    close(gradient, tape.sums[0])
    close(matrix, tape.sums[1])


@pytest.mark.parametrize("runs", [1, 2, 3, 7, 200])
@pytest.mark.parametrize(
    ("m", "n", "sparse"),
    [
        (2, 1, False),
        (2, 1, True),
        (1, 2, True),
        (2, 3, False),
        (2, 3, True),
        pytest.param(3, 8, False, marks=pytest.mark.slow),
    ],
)
def test_backward_and_forward_give_the_direct_sum(m, n, sparse, runs):
    tape, width = Tape(m, n, columns=32, length=BATCH + 50, sparse=sparse, runs=runs), 32
    native = sweeps(tape.pattern)
    q, lam = np.zeros((n, n)), np.zeros(n)
    q_next, l_next = np.zeros((tape.length, n, n)), np.zeros((tape.length, n))
    steps = at(tape.residual, tape.weight, tape.c, tape.a)
    native.backward(tape.length, *steps, *at(q, lam, q_next, l_next))
    matrix, gradient = 0.5 * tape.start.T @ q @ tape.start, tape.start.T @ lam
    s, scratch = tape.start.copy(), np.full(scratch_size(tape.pattern, tape.room), np.nan)
    later = (*at(q_next, l_next, s), width, *at(scratch))
    native.forward(tape.length, *steps, *later, *tape.entries(), *at(matrix), width, *at(gradient))
    native.fold(matrix.ctypes.data, width, width)
    close(gradient, tape.sums[0])
    close(matrix, tape.sums[1])
    close(s, tape.rows()[1])


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize(("m", "n"), [(1, 0), (1, 1), (2, 3), (2, 8), (1, 9), (3, 20)])
def test_rows_are_those_of_the_recursion(m, n, sparse):
    tape = Tape(m, n, columns=24, sparse=sparse)
    close(native_rows(tape, tape.pattern, tape.a), np.sqrt(tape.weight)[:, :, None] * tape.rows()[0])


def native_rows(tape, pattern, a):
    """The rows of a tape, of whose matrix a the cells are held that the pattern keeps."""
    n, flat = tape.n, a.reshape(tape.length, -1)
    stored = [row * n + i for row, columns in zip(pattern.kept, pattern.sources, strict=True) for i in columns]
    a = np.ascontiguousarray(flat[:, stored] if n > MANY else flat)
    assert a.shape[1] == pattern.cells
    s, following = tape.start.copy(), np.zeros((n, 24))
    rings, jacobian = np.zeros(max(n, 1), dtype=np.int64), np.full((tape.length, tape.m, 24), np.nan)
    sweeps(pattern).rows(
        tape.length, *at(tape.weight, tape.c, a, s), 24, *at(rings, following), *tape.entries(), *at(jacobian), 24
    )
    return jacobian


REACH = 16  # columns that can reach a state, of 32


def half_reaching(m, n):
    """A tape of which the columns from REACH on have slopes of the outputs alone; S, and what lies behind it."""
    tape = Tape(m, n, columns=32)
    tape.slope[:, :, m:][tape.index >= REACH] = 0.0
    tape.start[:, REACH:] = 0.0
    behind = np.full((n + 1, 32), -0.0)  # -0 + 0 is 0: an addition of nothing shows as well
    s = behind.reshape(-1)[: n * REACH].reshape(n, REACH)
    s[:] = tape.start[:, :REACH]
    return tape, behind, s


def is_untouched(behind, n):
    return np.signbit(behind.reshape(-1)[n * REACH :]).all()


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 3), (1, 9)])
def test_rows_add_to_no_sensitivity_of_a_column_that_reaches_no_state(m, n):
    tape, behind, s = half_reaching(m, n)
    following = np.full((n + 1, 32), -0.0)
    rings, jacobian = np.zeros(n, dtype=np.int64), np.full((tape.length, m, 32), np.nan)
    before, carried = at(tape.weight, tape.c, tape.a, s), at(rings, following)
    sweeps(tape.pattern).rows(tape.length, *before, REACH, *carried, *tape.entries(), *at(jacobian), 32)
    close(jacobian, np.sqrt(tape.weight)[:, :, None] * tape.rows()[0])
    assert is_untouched(behind, n)
    assert is_untouched(following, n)


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 3)])
def test_sweeps_add_to_no_sensitivity_of_a_column_that_reaches_no_state(m, n):
    tape, behind, s = half_reaching(m, n)
    native = sweeps(tape.pattern)
    q, lam, q_next, l_next = (np.zeros(shape) for shape in ((n, n), n, (tape.length, n, n), (tape.length, n)))
    steps = at(tape.residual, tape.weight, tape.c, tape.a)
    native.backward(tape.length, *steps, *at(q, lam, q_next, l_next))
    matrix, gradient = 0.5 * tape.start.T @ q @ tape.start, tape.start.T @ lam
    scratch = np.zeros(scratch_size(tape.pattern, tape.room))
    later = (*at(q_next, l_next, s), REACH, *at(scratch))
    native.forward(tape.length, *steps, *later, *tape.entries(), *at(matrix), 32, *at(gradient))
    native.fold(matrix.ctypes.data, 32, 32)
    close(gradient, tape.sums[0])
    close(matrix, tape.sums[1])
    assert is_untouched(behind, n)


@pytest.mark.parametrize("m", [1, 3])
def test_states_that_take_over_what_others_were_need_no_slopes(m):
    n, pairs = 15, {0: 3, 4: 4, 5: 6, 6: 5, 9: 8, 14: 0}
    tape = Tape(m, n, columns=24, sparse=True)
    for row, source in pairs.items():
        tape.a[:, row] = np.eye(n)[source]
        tape.slope[:, :, m + row] = 0.0
    expected = np.sqrt(tape.weight)[:, :, None] * tape.rows()[0]
    a = tape.pattern.a - {row * n + i for row in pairs for i in range(n)}
    pattern = TapeLayout(m, (1,) * n, tape.pattern.c, a | {r * n + s for r, s in pairs.items()}, tuple(pairs.items()))
    tape.slope = np.ascontiguousarray(tape.slope[:, :, [*range(m), *(m + i for i in pattern.kept)]])
    close(native_rows(tape, pattern, tape.a), expected)


@pytest.mark.parametrize("columns", [0, 1, 31, 32, 33, 64, 100])
def test_fold_adds_the_transpose(columns):
    g = np.random.default_rng(columns).standard_normal((columns, columns))
    h = g.copy()
    sweeps(TapeLayout(1, (), frozenset(), frozenset())).fold(h.ctypes.data, columns, columns)
    np.testing.assert_array_equal(h, g + g.T)


def test_fold_leaves_columns_beside_the_matrix_unchanged():
    g = np.random.default_rng(0).standard_normal((30, 32))
    h = g.copy()
    sweeps(TapeLayout(1, (), frozenset(), frozenset())).fold(h.ctypes.data, 32, 30)
    np.testing.assert_array_equal(h[:, :30], g[:, :30] + g[:, :30].T)
    np.testing.assert_array_equal(h[:, 30:], g[:, 30:])


def test_kernels_of_one_pattern_share_their_sweeps():
    one, two = (TapeLayout(2, (1,), frozenset({0}), frozenset({0})) for _ in range(2))
    assert sweeps(one) is sweeps(two)


def test_sweeps_are_for_states_of_one_step_and_not_too_many():
    def pattern(*latencies):
        return TapeLayout(1, latencies, frozenset(), frozenset())

    assert pattern(1).accumulates
    assert pattern(*[1] * 8).accumulates
    assert not pattern().accumulates
    assert not pattern(1, 2).accumulates
    assert not pattern(*[1] * 9).accumulates
