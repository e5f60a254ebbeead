"""Reader of netCDF 3 files; those of version 4 are HDF5 files."""

import warnings
from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.recorded_groups import (
    RecordedChannel,
    RecordedGroup,
    tables_of,
    unnamed_matrices,
    with_clock,
)
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.variable_attributes import (
    description_of,
    is_time_coordinate,
    unit_of,
    unpack_numbers,
)


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each dimension that has a requested variable; others than vectors are skipped."""
    from scipy.io import netcdf_file

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # not as a map, which could not be closed as long as arrays refer to it
            with source.path.open("rb") as stream, netcdf_file(stream, "r", mmap=False) as file:
                groups, matrices = _groups(file)
                if groups:
                    return tables_of(source, groups, selection, unnamed_matrices(matrices))
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "netCDF", error) from None
    raise InputError.of(source.location, "holds no vectors", "Is it the right file?")


def _groups(file: Any) -> tuple[list[RecordedGroup], dict[str, tuple[int, ...]]]:
    """Return the vectors by their dimension, and the sizes of what are none."""
    vectors: dict[str, list[RecordedChannel]] = defaultdict(list)
    lengths: dict[str, int] = {}
    matrices: dict[str, tuple[int, ...]] = {}
    for name, variable in file.variables.items():
        # axes of length 1 do not matter
        long = [at for at, length in enumerate(variable.shape) if length != 1] or [0]
        if len(variable.dimensions) == 0 or 0 in variable.shape:
            continue
        if len(long) == 1:
            dimension = variable.dimensions[long[0]]
            lengths[dimension] = int(variable.shape[long[0]])
            vectors[dimension].append(_channel(name, variable))
        elif _dtype(variable).kind in "iuf":
            matrices[name] = tuple(map(int, variable.shape))
    groups = [
        RecordedGroup(dimension if len(vectors) > 1 else "", lengths[dimension], with_clock(channels))
        for dimension, channels in vectors.items()
    ]
    return groups, matrices


def _dtype(variable: Any) -> Any:
    return np.asarray(variable.data).dtype


def _channel(name: str, variable: Any) -> RecordedChannel:
    attributes = dict(variable._attributes)
    content = "a text" if _dtype(variable).kind == "S" else ""
    clock = not content and is_time_coordinate(attributes)
    load = partial(_numbers, variable, attributes)
    description = description_of(attributes)
    return RecordedChannel(name, name, unit_of(attributes), load, description, content=content, clock=clock)


def _numbers(variable: Any, attributes: dict[str, Any]) -> Float:
    return unpack_numbers(np.ravel(np.array(variable.data)), attributes)
