"""A search over partitions begins with some recordings, picked by the files and by what they measure."""

import numpy as np
import pytest

from kennfeld.base.errors import Location
from kennfeld.base.task_runner import SerialRunner
from kennfeld.native.samples import Piece, Samples
from kennfeld.optimize.problem.partitions import Part, Partition, Partitions, Recordings
from kennfeld.optimize.problem.picked_recordings import GROUPS, PartRecording, count_recordings, pick_recordings
from kennfeld.preprocessing.prepared_files import DatasetRecipe, PreparedFiles, StoredSettings
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.preprocessing.recording_sources import RecordingSource
from kennfeld.preprocessing.recordings import ChannelRequest

LENGTH = 100


@pytest.fixture
def recordings(tmp_path):
    settings = StoredSettings("kennfeld.toml", tmp_path, {}, {}, {})
    entries = [
        DatasetEntry(Location(), (), name=name, weight=weight) for name, weight in (("road", 1.0), ("bench", 2.0))
    ]
    request = ChannelRequest({}, {}, frozenset())
    return Recordings(tuple(DatasetRecipe(settings, entry, request) for entry in entries), PreparedFiles(tmp_path, 1))


def partitions_of(recordings, files, size):
    """Partitions of whole files of `LENGTH` samples, each in this dataset."""
    parts = [Part(dataset, RecordingSource(f"{i}.csv", ""), 0, LENGTH) for i, dataset in enumerate(files)]
    groups = [parts[first : first + size] for first in range(0, len(parts), size)]
    return Partitions(recordings, tuple(Partition(tuple(group)) for group in groups), (), SerialRunner())


def counted(partitions, scored):
    """The recordings of each partition: one a file, which scores so many samples."""
    return [
        [PartRecording(i, 0, LENGTH, scored(part)) for i, part in enumerate(partition.parts)]
        for partition in partitions.training
    ]


def picked_files(partitions):
    return [part.source.address for partition in partitions.training for part in partition.parts]


def test_the_recordings_do_not_depend_on_the_size_of_partitions(recordings):
    picks = []
    for size in (1, 3, 40):
        partitions = partitions_of(recordings, [0] * 40, size)
        picks.append(pick_recordings(partitions, counted(partitions, lambda part: (90,)), 0.2, 4))
    assert picked_files(picks[0]) == [f"{i}.csv" for i in np.linspace(0, 39, 8).round().astype(int)]
    assert picks[0].training == picks[1].training == picks[2].training
    assert len(picks[0].training) <= GROUPS


def test_each_kind_of_recording_keeps_its_weight(recordings):
    partitions = partitions_of(recordings, [0] * 30 + [1] * 30, 5)
    seldom = {"3.csv", "7.csv", "31.csv"}

    def scored(part):
        return (90, 50) if part.source.address in seldom else (80, 0)

    few = pick_recordings(partitions, counted(partitions, scored), 0.1, 2)
    assert seldom <= set(picked_files(few))
    parts = [part for partition in few.training for part in partition.parts]
    for dataset in (0, 1):
        own = [part for part in parts if part.dataset == dataset]
        rare = 1 + (dataset == 0)
        sums = np.sum([np.multiply(part.factors, scored(part)) for part in own], axis=0)
        assert sums == pytest.approx([90 * rare + 80 * (30 - rare), 50 * rare])
    assert all(len({part.dataset for part in partition.parts}) == 1 for partition in few.training)


def test_all_recordings_are_taken_if_they_are_few_or_long(recordings):
    partitions = partitions_of(recordings, [0] * 19, 5)
    recorded = counted(partitions, lambda part: (90,))
    assert pick_recordings(partitions, recorded, 0.1, 10) is partitions
    assert pick_recordings(partitions, recorded, 0.9, 2) is partitions


def test_recordings_without_a_scored_sample_are_left_out(recordings):
    partitions = partitions_of(recordings, [0] * 40, 5)
    idle = {f"{i}.csv" for i in range(10, 40, 2)}
    few = pick_recordings(
        partitions, counted(partitions, lambda part: (0 if part.source.address in idle else 90,)), 0.2, 4
    )
    assert not idle & set(picked_files(few))


def test_pieces_are_counted_in_their_recording():
    class Bound:
        def __init__(self, starts, kept, samples):
            self.dataset = type("Data", (), {"piece_starts": np.array(starts), "samples": samples})
            self.kept, self.count = np.array(kept), len(kept)

    # of the first file, sample 3 is dropped, so that its first recording has two pieces
    bounds = (Bound([0, 5], [0, 1, 2, 4, 5, 6, 7], 8), Bound([0], range(4), 4))
    targets = np.zeros((1, 11))
    targets[0, [1, 9]] = np.nan
    edges = [(0, 3), (3, 4), (4, 7), (7, 11)]
    samples = Samples(np.zeros((0, 11)), targets, [Piece(*edge, np.ones(1)) for edge in edges])
    compiled = type("Compiled", (), {"problem": type("Gathered", (), {"gathered": bounds}), "samples": samples})
    assert count_recordings(compiled) == [
        PartRecording(0, 0, 5, (3,)),
        PartRecording(0, 5, 8, (3,)),
        PartRecording(1, 0, 4, (3,)),
    ]
