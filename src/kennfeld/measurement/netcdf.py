"""Reader of netCDF 3 files; those of version 4 are HDF5 files."""

import warnings
from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import InputError
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, tables_of
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.variable_attributes import description_of, unit_of, unpack_numbers


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each dimension that has a requested variable; others than vectors are left out."""
    from scipy.io import netcdf_file

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with source.path.open("rb") as stream, netcdf_file(stream, "r", mmap=False) as file:
                groups = _groups(file)
                if groups:
                    return tables_of(source.location, groups, selection)
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "netCDF", error) from None
    raise InputError.of(source.location, "holds no vectors", "Is it the right file?")


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each dimension."""
    return [describe_table(table) for table in read_tables(source, Selection())]


def _groups(file: Any) -> list[RecordedGroup]:
    vectors: dict[str, list[RecordedChannel]] = defaultdict(list)
    lengths: dict[str, int] = {}
    for name, variable in file.variables.items():
        if len(variable.dimensions) == 1 and variable.shape[0]:
            (dimension,) = variable.dimensions
            lengths[dimension] = int(variable.shape[0])
            vectors[dimension].append(_channel(name, variable))
    return [
        RecordedGroup(dimension if len(vectors) > 1 else "", lengths[dimension], channels)
        for dimension, channels in vectors.items()
    ]


def _channel(name: str, variable: Any) -> RecordedChannel:
    attributes = dict(variable._attributes)
    content = "a text" if np.asarray(variable.data).dtype.kind == "S" else ""
    load = partial(_numbers, variable, attributes)
    return RecordedChannel(name, name, unit_of(attributes), load, description_of(attributes), content=content)


def _numbers(variable: Any, attributes: dict[str, Any]) -> Float:
    return unpack_numbers(np.array(variable.data), attributes)
