"""Recordings that formats of other packages return, as tables."""

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.domain.dataset import Dataset
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Table


def table_of(recording: object, source: MeasurementFile) -> Table:
    """Return a recording as a table, so that channels, units, time and raster are treated as in all formats.

    Raises:
        InputError: a format of another package returned something else.
    """
    if not isinstance(recording, Dataset):
        message = (
            f"the format {source.format.name} returned a value of the type {type(recording).__name__}, not Dataset"
        )
        raise InputError.of(source.location, message, "Update the package that reads it.")
    columns = [
        Column(each.name, each.unit, each.name, each.values, description=each.description)
        for each in recording.channels
    ]
    if recording.time is not None:
        columns.insert(0, Column("time", "s", "time", recording.time))
    names = tuple(column.name for column in columns)
    return Table(
        source.location,
        tuple(columns),
        np.arange(1, recording.samples + 1),
        row_word="sample",
        names=names,
        findings=recording.findings,
        clock_index=None if recording.time is None else 0,
        restarts=True,
    )
