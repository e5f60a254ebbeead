import numpy as np
from hypothesis import strategies as st

from kennfeld.domain.dataset import Dataset, concatenate
from kennfeld.domain.file_spans import FileSpans, short_names
from tests.draws import few_or_many

LENGTHS = st.lists(st.integers(0, 6), min_size=1, max_size=5)


def owners(files, samples):
    """Return the file of each sample."""
    return np.repeat(np.array(files.names, dtype=object), files.sizes(samples)).tolist()


@few_or_many(LENGTHS, st.data(), few=20, many=100)
def test_files_of_a_part_are_those_of_its_samples(lengths, data):
    files = FileSpans.joined([f"{i}.csv" for i in range(len(lengths))], lengths)
    samples = sum(lengths)
    first = data.draw(st.integers(0, samples))
    last = data.draw(st.integers(first, samples))
    assert files.covers(samples)
    part = files.cut(first, last)
    assert part.covers(last - first)
    assert owners(part, last - first) == owners(files, samples)[first:last]


@few_or_many(LENGTHS, st.data(), few=20, many=100)
def test_files_of_picked_samples_are_those_of_these(lengths, data):
    files = FileSpans.joined([f"{i}.csv" for i in range(len(lengths))], lengths)
    samples = sum(lengths)
    kept = np.flatnonzero(data.draw(st.lists(st.booleans(), min_size=samples, max_size=samples)))
    picked = files.picked(kept)
    assert owners(picked, kept.size) == [owners(files, samples)[at] for at in kept]


def test_files_of_reordered_samples_are_unknown():
    data = Dataset.of("bench", {"x": [1.0, 2.0, 3.0]}, files=FileSpans.joined(["a.csv"], [3]))
    assert data.select([2, 0]).files is None
    assert data.select([0, 2]).files.names == ("a.csv",)


def test_files_of_other_samples_are_forgotten():
    files = FileSpans.joined(["a.csv"], [2])
    assert Dataset.of("bench", {"x": [1.0, 2.0, 3.0]}, files=files).files is None


def test_joined_recordings_know_their_files():
    parts = [Dataset.of("d", {"x": np.zeros(n)}, files=FileSpans.joined([f"{n}.csv"], [n])) for n in (2, 3)]
    assert owners(concatenate("d", parts).files, 5) == ["2.csv"] * 2 + ["3.csv"] * 3
    assert concatenate("d", [*parts, Dataset.of("d", {"x": np.zeros(1)})]).files is None


@few_or_many(
    st.sets(st.lists(st.sampled_from("abc"), min_size=1, max_size=4).map("/".join), max_size=12), few=20, many=100
)
def test_short_names_are_ends_that_differ(paths):
    names = short_names(sorted(paths))
    assert len(set(names.values())) == len(paths)
    assert all(f"/{path}".endswith(f"/{name}") for path, name in names.items())
