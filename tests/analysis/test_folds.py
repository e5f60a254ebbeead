"""Every sample is held back once, and never together with neighbours that would give it away."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.analysis.cross_validation import folds_of
from kennfeld.domain.file_spans import FileSpans

lengths = st.lists(st.lists(st.integers(1, 30), min_size=1, max_size=4), min_size=1, max_size=3)


def datasets_of(pieces, *, timed):
    """Datasets with pieces of these lengths."""
    datasets = []
    for i, sizes in enumerate(pieces):
        starts = np.cumsum([0, *sizes[:-1]])
        time = np.concatenate([np.arange(size) * 0.1 for size in sizes]) if timed else None
        datasets.append(kf.Dataset.of(f"d{i}", {"x": np.arange(float(sum(sizes)))}, time=time, piece_starts=starts))
    return datasets


@settings(max_examples=40)
@given(lengths, st.integers(2, 6), st.booleans(), st.sampled_from(["auto", "files", "blocks", "random"]))
def test_every_sample_is_held_back_exactly_once(pieces, count, timed, kind):
    datasets = datasets_of(pieces, timed=timed)
    if min(sum(map(len, pieces)) if kind == "files" else sum(map(sum, pieces)), 10**6) < count:
        with pytest.raises(kf.InputError, match=r"Use fewer folds\."):
            folds_of(datasets, count, kind, memory=False)
        return
    if kind == "auto" and sum(map(sum, pieces)) < count:
        return
    folds = folds_of(datasets, count, kind, memory=False)
    assert len(folds) == count
    for i, data in enumerate(datasets):
        assert np.sum([fold.held[i] for fold in folds], axis=0).tolist() == [1] * data.samples
        assert not any(np.any(fold.held[i] & fold.excluded[i]) for fold in folds)


@settings(max_examples=40)
@given(lengths, st.integers(2, 4))
def test_files_are_held_back_whole(pieces, count):
    datasets = datasets_of(pieces, timed=True)
    if sum(map(len, pieces)) < count:
        return
    for fold in folds_of(datasets, count, memory=True):
        for data, mask in zip(datasets, fold.held, strict=True):
            assert all(mask[piece].all() or not mask[piece].any() for piece in data.pieces)


def test_folds_of_files_are_about_equally_long():
    folds = folds_of(datasets_of([[10], [20], [30], [40], [50], [60]], timed=True), 3, memory=False)
    assert [sum(int(mask.sum()) for mask in fold.held) for fold in folds] == [70, 70, 70]
    assert folds[0].name == "d0, d5"


def test_folds_of_files_have_their_names():
    (data,) = datasets_of([[10, 20, 30]], timed=True)
    files = FileSpans.joined(["runs/a.csv", "runs/b.csv", "runs/c.csv"], [10, 20, 30])
    folds = folds_of([replace(data, files=files)], 2, "files", memory=False)
    assert [fold.name for fold in folds] == ["c.csv", "a.csv, b.csv"]


def test_samples_beside_a_held_out_block_are_not_fitted():
    block = folds_of(datasets_of([[400]], timed=True), 4, memory=False)[1]
    assert block.held[0].nonzero()[0].tolist() == list(range(100, 200))
    assert block.excluded[0].nonzero()[0].tolist() == [*range(95, 100), *range(200, 205)]


def test_steady_points_are_held_back_at_random_and_the_same_each_time():
    datasets = datasets_of([[50]], timed=False)
    one, other, third = (folds_of(datasets, 5, memory=False, seed=seed)[0].held[0] for seed in (0, 0, 1))
    assert one.sum() == 10
    assert one.tolist() == other.tolist() != third.tolist()
    assert np.diff(one.nonzero()[0]).max() > 1


def test_impossible_settings_are_reported():
    with pytest.raises(kf.KennfeldError, match="folds must be >= 2, got 1"):
        folds_of(datasets_of([[5]], timed=False), 1, memory=False)
    with pytest.raises(kf.InputError, match="a model with states cannot be cross-validated"):
        folds_of(datasets_of([[50]], timed=True), 2, "random", memory=True)
