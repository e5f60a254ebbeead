"""Rows of errors by recording, as they are listed."""

import numpy as np

from kennfeld.optimize.quality.recording_quality import (
    RecordingQuality,
    of_several_files,
    recordings_table,
    worst_first,
)


def row(criterion, file, rmse, samples=1):
    return RecordingQuality(criterion, "d", file, "training", samples, 1.0, rmse, 1.0, None)


def test_the_worst_recordings_of_each_criterion_come_first():
    rows = [row("a", "1", 2.0), row("b", "1", 9.0), row("a", "2", 3.0), row("a", "3", np.nan), row("b", "4", 1.0, 0)]
    assert [(r.criterion, r.file) for r in worst_first(rows)] == [("a", "3"), ("a", "2"), ("a", "1"), ("b", "1")]


def test_columns_with_equal_cells_are_omitted():
    assert recordings_table([row("a", "1", 2.0), row("a", "2", 3.0)])[0][:3] == ("file", "samples", "RMSE before")
    assert recordings_table([row("a", "1", 2.0), row("b", "1", 3.0)], before=False)[0][:4] == (
        *("file", "criterion", "samples", "RMSE"),
    )


def test_only_datasets_of_several_files_are_listed_by_file():
    assert of_several_files([row("a", "1", 1.0), row("b", "1", 1.0)]) == []
    assert len(of_several_files([row("a", "1", 1.0), row("a", "2", 1.0)])) == 2
