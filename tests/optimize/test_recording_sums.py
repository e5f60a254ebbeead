"""The errors of each file and its worst stretch, whatever the parts in which its samples arrive."""

import json

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_spans import FileSpans
from kennfeld.graph import GraphBuilder
from kennfeld.optimize.quality.recording_sums import BINS, ENOUGH, RecordingSums, ScoredErrors
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.bound_parts import BoundPart
from tests.draws import few_or_many


def graph():
    b = GraphBuilder()
    return b.finish({"y": b.input("x")}, {}, ("y",))


def dataset(lengths, *, step=None):
    """Return a dataset of files of these lengths, whose times begin at 100 s times their number."""
    time = None if step is None else np.concatenate([100.0 * i + step * np.arange(n) for i, n in enumerate(lengths)])
    starts = None if step is None else {"piece_starts": np.cumsum([0, *lengths[:-1]])}
    files = FileSpans.joined([f"{i}.csv" for i in range(len(lengths))], lengths)
    return Dataset.of("drives", {"x": np.zeros(sum(lengths))}, time=time, files=files, **(starts or {}))


def sums_of(data, errors, cuts=()):
    """Return the closed sums of one criterion, whose samples arrive in parts; NaN is not scored."""
    bound = bind_inputs(data, graph(), {})
    total = None
    for first, last in zip([0, *cuts], [*cuts, data.samples], strict=True):
        own = errors[first:last]
        scored = np.isfinite(own)
        numbers = None if scored.all() else np.flatnonzero(scored)
        part = BoundPart(bound, first, last, first, last, 0)
        arrived = RecordingSums.of(part, [ScoredErrors(numbers, own[scored], 2 * own[scored], own[scored])])
        if total is None:
            total = arrived
        else:
            total.merge(arrived)
    assert all(file.bins is None for file in total.files), "a complete file keeps no bins"
    return [file.quality(0, "y", data, file.name) for file in total.files]


def rms(values):
    return np.sqrt(np.nanmean(values**2))


def reference_worst(errors, step):
    """Return first and last sample and RMSE of the worst window, by trying all."""
    size = -(-errors.size // BINS)
    count = -(-errors.size // size)
    width = max(-(-count // 20), -(-5 // size))
    if step is not None:
        duration = step * (errors.size - 1)
        width = max(width, int(np.ceil(count * 5.0 / duration))) if duration > 5.0 else count
    width = min(width, count)
    average = np.isfinite(errors).sum() * width / count
    windows = [(i * size, min((i + width) * size, errors.size)) for i in range(count - width + 1)]
    eligible = [(a, b) for a, b in windows if np.isfinite(errors[a:b]).sum() >= ENOUGH * average]
    first, last = max(eligible, key=lambda window: rms(errors[slice(*window)]))
    return first, last - 1, rms(errors[first:last])


@few_or_many(
    st.lists(st.integers(1, 700), min_size=1, max_size=4),
    st.sampled_from([None, 0.1, 2.0]),
    st.sampled_from([0.0, 0.3]),
    st.integers(0, 1000),
    st.data(),
    few=12,
    many=80,
)
def test_rows_are_those_of_the_samples_of_each_file(lengths, step, missing, seed, data):
    random = np.random.default_rng(seed)
    errors = random.normal(size=sum(lengths)) * np.exp(np.cumsum(random.normal(0, 0.1, sum(lengths))))
    errors[random.uniform(size=errors.size) < missing] = np.nan
    whole = dataset(lengths, step=step)
    cuts = sorted(data.draw(st.sets(st.integers(1, max(whole.samples - 1, 1)), max_size=4))) if errors.size > 1 else []
    rows = sums_of(whole, errors, cuts)
    assert [row.file for row in rows] == [f"{i}.csv" for i in range(len(lengths))]
    for row, own, at in zip(rows, np.split(errors, np.cumsum(lengths)[:-1]), range(len(lengths)), strict=True):
        assert row.samples == np.isfinite(own).sum()
        if not row.samples:
            assert row.worst is None
            continue
        assert row.rmse_after == pytest.approx(rms(own))
        assert row.rmse_before == pytest.approx(2 * rms(own))
        assert row.max_abs_after == np.nanmax(np.abs(own))
        _, _, size = reference_worst(own, step)
        assert row.worst.rmse == pytest.approx(size)
        assert row.worst.unit == ("samples" if step is None else "s")
        begin, end = (row.worst.begin, row.worst.end)
        if step is not None:
            begin, end = (round((x - 100 * at) / step) + 1 for x in (begin, end))
        assert rms(own[begin - 1 : end]) == pytest.approx(size)  # stretches may be equal, but for samples without value


def test_the_worst_stretch_contains_the_errors():
    errors = np.full(2000, 0.1)
    errors[800:900] = 5.0
    (row,) = sums_of(dataset([2000], step=0.1), errors)
    assert (row.worst.begin, row.worst.end) == pytest.approx((80.0, 90.0), abs=1.0)
    assert row.worst.rmse == pytest.approx(5.0, abs=0.2)
    assert row.worst.unit == "s"
    assert str(row.worst).endswith(" s")


def test_a_single_large_error_in_a_stretch_that_is_hardly_scored_is_not_the_worst():
    errors = np.full(2000, 1.0)
    errors[:300] = np.nan
    errors[100] = 50.0
    (row,) = sums_of(dataset([2000], step=0.1), errors)
    assert row.max_abs_after == 50.0
    assert row.worst.rmse == 1.0


def test_errors_that_are_not_finite_are_the_worst_and_become_null():
    data = Dataset.of("d", {"x": np.arange(100.0), "m": np.zeros(100)})
    result = kf.calibrate("y = a * log(b * x)", data, {"a": 1.0, "b": 1.0}, "m", free=["a"])
    (row,) = result.recordings
    assert json.loads(json.dumps(row.as_json(), allow_nan=False))["file"] is None
    assert row.worst.begin == 1
    assert not np.isfinite(row.worst.rmse)
    assert row.as_json()["worst"]["rmse"] is None


def test_recordings_whose_time_starts_again_are_numbered_by_sample():
    time = np.concatenate([np.arange(50.0), np.arange(50.0)])
    data = Dataset.of("d", {"x": np.ones(100), "m": np.arange(100.0)}, time=time, piece_starts=[0, 50])
    (row,) = kf.calibrate("y = a * x", data, {"a": 1.0}, "m").recordings
    assert row.file is None
    assert row.worst.unit == "samples"


def test_recordings_agree_with_the_quality_of_their_dataset():
    random = np.random.default_rng(0)
    data = {"x": random.normal(size=300), "m": random.normal(size=300)}
    result = kf.calibrate("y = a * x", data, {"a": 0.0}, "m", test={"x": [1.0], "m": [2.0]})
    for row, of in zip(result.recordings, result.quality, strict=True):
        assert (row.criterion, row.dataset, row.use, row.samples) == (of.criterion, of.dataset, of.use, of.samples)
        assert row.rmse_before == pytest.approx(of.rmse_before)
        assert row.rmse_after == pytest.approx(of.rmse_after)
        assert row.max_abs_after == of.max_abs_after
