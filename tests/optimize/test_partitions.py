"""Partitions are fixed by files and lengths."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.optimize.problem.partitions import LEAST_STRETCH, Part, find_stretches, split_files
from kennfeld.optimize.sums.partitioned_sums import NormalSum, add_packed, pack
from kennfeld.preprocessing.recording_sources import RecordingSource

lengths = st.lists(st.integers(0, 50), min_size=1, max_size=8)


@settings(max_examples=40)
@given(lengths, st.integers(1, 40))
def test_every_sample_is_in_one_partition_in_order(lengths, size):
    sources = [RecordingSource(f"{i}.csv", "") for i in range(len(lengths))]
    partitions = split_files(0, sources, [()] * len(lengths), lengths, size)
    samples = [(p.source.address, k) for q in partitions for p in q.parts for k in range(p.first, p.last)]
    assert samples == [(f"{i}.csv", k) for i, length in enumerate(lengths) for k in range(length)]
    assert all(0 < partition.samples <= size for partition in partitions)


@settings(max_examples=40)
@given(st.lists(st.integers(1, 20), min_size=1, max_size=8), st.integers(1, 40))
def test_pieces_are_not_divided(pieces, size):
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


@settings(max_examples=40)
@given(st.lists(st.lists(st.integers(1, 90_000), min_size=1, max_size=30), min_size=1, max_size=3))
def test_stretches_are_long_parts_of_all_datasets(datasets):
    parts = [
        Part(number, RecordingSource(f"{at}.csv", ""), 0, length)
        for number, lengths in enumerate(datasets)
        for at, length in enumerate(lengths)
    ]
    most = 100_000 * len(datasets)
    stretches = find_stretches(parts, most)
    by_source = {(part.dataset, part.source): part for part in parts}
    for number, lengths in enumerate(datasets):
        own = [stretch for stretch in stretches if stretch.dataset == number]
        samples = sum(stretch.last - stretch.first for stretch in own)
        assert samples == sum(lengths) if sum(lengths) <= 100_000 else 0 < samples <= 100_000
        for stretch in own:
            part = by_source[number, stretch.source]
            assert part.first == stretch.first < stretch.last <= part.last
            assert stretch.last == part.last or stretch.last - stretch.first >= LEAST_STRETCH


def test_adjacent_parts_are_one_stretch():
    source, other = RecordingSource("a.csv", ""), RecordingSource("b.csv", "")
    parts = [Part(0, source, 0, 5), Part(0, source, 5, 9), Part(0, other, 0, 3), Part(0, other, 7, 8)]
    assert find_stretches(parts, 100) == [Part(0, source, 0, 9), Part(0, other, 0, 3), Part(0, other, 7, 8)]
