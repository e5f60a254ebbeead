"""Recordings are joined in the order of their files, and none is kept."""

import gc
import weakref

import numpy as np
import pytest

from kennfeld import ArgumentError, Dataset
from kennfeld.base.errors import Location
from kennfeld.preprocessing.joined_recordings import GrowingColumn, JoinedRecordings
from kennfeld.preprocessing.recipe import DatasetEntry

ENTRY = DatasetEntry(Location("kennfeld.toml"), ("*.csv",), warmup=2.0, weight=3.0)


def recording(samples, *names, time=True, unit="rpm", **attributes):
    columns = {name: np.arange(float(samples)) + i for i, name in enumerate(names)}
    stamps = 0.1 * np.arange(samples) if time else None
    return Dataset.of("file", columns, time=stamps, units=dict.fromkeys(names, unit), **attributes)


def join(*recordings):
    joined = JoinedRecordings("fleet", ENTRY, len(recordings))
    for part in recordings:
        joined.add(part)
    return joined


def test_each_recording_is_a_piece():
    parts = [recording(3, "n", "T"), recording(5, "n", "T", piece_starts=np.array([0, 2])), recording(2, "n", "T")]
    data = join(*parts).dataset()
    assert (data.name, data.warmup, data.weight) == ("fleet", 2.0, 3.0)
    assert data.piece_starts.tolist() == [0, 3, 5, 8]
    for name in ("n", "T"):
        np.testing.assert_array_equal(data[name].values, np.concatenate([part[name].values for part in parts]))
    np.testing.assert_array_equal(data.time, np.concatenate([part.time for part in parts]))


def test_a_channel_that_some_recordings_lack_is_missing_there():
    data = join(recording(2, "n"), recording(3, "n", "T"), recording(1, "T")).dataset()
    np.testing.assert_array_equal(data["n"].values, [0, 1, 0, 1, 2, np.nan])
    np.testing.assert_array_equal(data["T"].values, [np.nan, np.nan, 1, 2, 3, 0])
    assert data["T"].unit == "rpm"


def test_a_single_recording_is_not_copied():
    part = recording(4, "n")
    assert np.shares_memory(join(part).dataset()["n"].values, part["n"].values)
    assert join().dataset() is None


def test_recordings_with_and_without_time_do_not_mix():
    joined = join(recording(2, "n"), recording(2, "n", time=False))
    with pytest.raises(ArgumentError, match="dataset fleet mixes recordings with and without time stamps"):
        joined.dataset()


def test_units_that_differ_are_reported_once_for_each_change():
    joined = join(recording(2, "n"), recording(2, "n", unit="km/h"), recording(2, "n", unit="km/h"))
    (finding,) = joined.findings
    assert finding.message == "channel n is in rpm in one file and in km/h in another"


@pytest.mark.slow
def test_no_recording_is_kept():
    joined, references = JoinedRecordings("fleet", ENTRY, 10), []
    for _ in range(10):
        part = recording(1000, "n", "T")
        references.append(weakref.ref(part["n"].values.base if part["n"].values.base is not None else part["n"].values))
        joined.add(part)
        del part
    gc.collect()
    assert sum(reference() is not None for reference in references[1:]) == 0


def test_a_column_reserves_at_most_a_quarter_more():
    column = GrowingColumn()
    for _ in range(50):
        column.append(np.ones(1000), 10**9)
        assert column._values.size <= 1.25 * column.size
    assert column.finish().size == 50_000
