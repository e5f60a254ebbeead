import ctypes
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import ArgumentError
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.column_table import BLOCK, ColumnTable
from kennfeld.native.samples import Piece, Samples
from tests.draws import few_or_many
from tests.native.models import MODELS, case, static
from tests.native.reference import compiled

lengths = st.lists(st.sampled_from([0, 1, 5, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK - 5]), min_size=1, max_size=6)


def cut(values, sizes):
    return [values[a:b] for a, b in pairwise(np.cumsum([0, *sizes]))]


def at(address, count):
    return np.array((ctypes.c_double * count).from_address(int(address)))


@few_or_many(lengths, few=20, many=100)
def test_a_block_holds_its_samples_wherever_the_arrays_of_a_row_meet(sizes):
    values = np.random.default_rng(0).standard_normal(sum(sizes))
    rows = ColumnTable([cut(values, sizes)])
    assert rows.count == values.size
    for block, address in enumerate(rows.addresses[0]):
        expected = values[block * BLOCK : (block + 1) * BLOCK]
        np.testing.assert_array_equal(at(address, expected.size), expected)


@few_or_many(lengths, st.integers(0, 2**32 - 1), few=20, many=100)
def test_values_can_be_taken_in_any_order(sizes, seed):
    random = np.random.default_rng(seed)
    values = random.standard_normal((2, sum(sizes)))
    samples = random.integers(0, max(values.shape[1], 1), 50 if values.size else 0)
    taken = ColumnTable([values[0], cut(values[1], sizes)]).take(samples)
    np.testing.assert_array_equal(taken, values[:, samples])


def test_a_row_in_one_array_is_not_copied():
    values = np.zeros(3 * BLOCK + 7)
    rows = ColumnTable([values])
    assert rows.addresses[0].tolist() == [values.ctypes.data + 8 * BLOCK * i for i in range(4)]


def test_rows_are_converted_to_contiguous_doubles():
    values = np.arange(12, dtype=np.float32).reshape(4, 3)
    rows = ColumnTable([values[:, 1], np.arange(8.0)[::2]])
    assert at(rows.addresses[0, 0], 4).tolist() == [1, 4, 7, 10]
    assert at(rows.addresses[1, 0], 4).tolist() == [0, 2, 4, 6]


def test_a_table_without_columns_keeps_its_number_of_samples():
    rows = ColumnTable([], 5)
    assert (rows.count, rows.take(np.array([1, 3])).shape) == (5, (0, 2))


def columns_of(code):
    return [code.case.columns[name] for name in code.kernel.layout.inputs], [c.target for c in code.case.criteria]


def sums(code, samples):
    summed = Accumulator(code.kernel, samples)
    costs, normal = summed.costs(code.values), summed.normal(code.values)
    return [costs, normal.gradient.copy(), normal.matrix.copy()]


@pytest.mark.parametrize("model", sorted(MODELS))
def test_rows_in_several_arrays_give_the_sums_of_rows_in_one(model):
    code = compiled(case(MODELS[model](), 2 * BLOCK + 300, (0, 900, BLOCK + 5)))
    sizes = [3, BLOCK - 3, 1, BLOCK, 299]
    data, targets = ([cut(row, sizes) for row in rows] for rows in columns_of(code))
    for a, b in zip(sums(code, code.samples), sums(code, Samples(data, targets, code.samples.pieces)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("count", [1, 2, 17, 5000, 2 * BLOCK + 300])
def test_an_order_of_visits_gives_the_sums_of_samples_that_come_in_it(count):
    code = compiled(case(static(), 2 * BLOCK + 300))
    order = np.random.default_rng(3).permutation(2 * BLOCK + 300)[:count].astype(np.uint32)
    data, targets = columns_of(code)
    pieces = [Piece(0, count // 2, np.array([0.5])), Piece(count // 2, count, np.array([2.0]))]
    visited = Samples(data, targets, pieces, order)
    assert visited.count == count
    moved = Samples([row[order] for row in data], [row[order] for row in targets], pieces)
    for a, b in zip(sums(code, visited), sums(code, moved), strict=True):
        np.testing.assert_array_equal(a, b)


def test_rows_must_be_of_equal_length():
    with pytest.raises(ArgumentError, match="rows differ in length: 3 and 2 samples"):
        ColumnTable([np.zeros(3), [np.zeros(1), np.zeros(1)]])


@few_or_many(lengths, few=20, many=100)
def test_copied_rows_can_be_read_again(sizes):
    values = np.zeros(sum(sizes))
    rows = ColumnTable([cut(values, sizes)])
    values[:] = np.arange(values.size)
    rows.reread()
    for block, address in enumerate(rows.addresses[0]):
        expected = values[block * BLOCK : (block + 1) * BLOCK]
        np.testing.assert_array_equal(at(address, expected.size), expected)
