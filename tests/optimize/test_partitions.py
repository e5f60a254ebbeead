"""Partitions are fixed by files and lengths."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.optimize.partitioned_sums import NormalSum, add_packed, pack
from kennfeld.optimize.partitions import split_files
from kennfeld.preprocessing.recording_sources import RecordingSource

lengths = st.lists(st.integers(0, 50), min_size=1, max_size=8)


@given(lengths, st.integers(1, 40))
def test_every_sample_is_in_one_partition_in_order(lengths, size):
    sources = [RecordingSource(f"{i}.csv", "") for i in range(len(lengths))]
    partitions = split_files(0, sources, [()] * len(lengths), lengths, size)
    samples = [(p.source.address, k) for q in partitions for p in q.parts for k in range(p.first, p.last)]
    assert samples == [(f"{i}.csv", k) for i, length in enumerate(lengths) for k in range(length)]
    assert all(0 < partition.samples <= size for partition in partitions)


@given(st.lists(st.integers(1, 20), min_size=1, max_size=8), st.integers(1, 40))
def test_pieces_stay_whole(pieces, size):
    starts = tuple(np.cumsum([0, *pieces[:-1]]).tolist())
    partitions = split_files(0, [RecordingSource("a.csv", "")], [starts], [sum(pieces)], size)
    parts = [part for partition in partitions for part in partition.parts]
    assert all(part.first in starts for part in parts)
    assert all(p.last - p.first <= max(size, *pieces) for p in parts)
    assert sum(part.last - part.first for part in parts) == sum(pieces)


def test_normal_equations_are_added_in_order_and_unpacked():
    random = np.random.default_rng(0)
    sums = [NormalSum(random.normal(size=7), (m := random.normal(size=(7, 7))) + m.T) for _ in range(3)]
    total = add_packed(pack(each) for each in sums)
    assert np.array_equal(total.gradient, sums[0].gradient + sums[1].gradient + sums[2].gradient)
    assert np.array_equal(total.matrix, sums[0].matrix + sums[1].matrix + sums[2].matrix)
