"""Tables of a simulation: one row for each sample of all datasets, as Parquet or CSV."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.domain.dataset import Dataset
from kennfeld.project.csv_cells import neutral_cell
from kennfeld.project.simulated_recordings import numbers_of_pieces
from kennfeld.project.simulation import SimulatedPart, Simulation

SAMPLES_WRITTEN = 1 << 18  # at once


def write_table(simulation: Simulation, path: Path) -> None:
    """Write the columns dataset, file, piece (from 1), time, then the channels; null if a dataset lacks one."""
    text = neutral_cell if path.suffix.lower() == ".csv" else str
    schema = _schema({text(name): unit for name, unit in simulation.units.items()})
    with _table_writer(path, schema) as writer:
        for parts in _batches(simulation.parts()):
            writer.write_table(_table(parts, simulation, schema, text))


def _table_writer(path: Path, schema: Any) -> Any:
    """Return a writer of tables by the extension of `path`.

    Measured numbers hardly repeat, so that a dictionary of them takes twice the time. They are not split by byte, since
    older readers fail if such a column has missing values.
    """
    from pyarrow import csv, parquet, types

    if path.suffix.lower() == ".csv":
        return csv.CSVWriter(path, schema)
    repeated = [column.name for column in schema if not types.is_float64(column.type)]
    return parquet.ParquetWriter(path, schema, use_dictionary=repeated)


def _batches(parts: Iterable[SimulatedPart]) -> Iterator[list[SimulatedPart]]:
    """Yield neighbouring parts that have together about as many samples as are written at once."""
    batch: list[SimulatedPart] = []
    for part in parts:
        batch.append(part)
        if sum(each.data.samples for each in batch) >= SAMPLES_WRITTEN:
            yield batch
            batch = []
    if batch:
        yield batch


def _schema(units: Mapping[str, str]) -> Any:
    import pyarrow as pa

    name = pa.dictionary(pa.int64(), pa.string())
    columns = {"dataset": name, "file": name, "piece": pa.int64(), "time": pa.float64()}
    clock = {"time": {"unit": "s"}}
    parts = [pa.field(name, kind, metadata=clock.get(name)) for name, kind in columns.items()]
    for name, unit in units.items():
        # a node called `time` or `piece` must not hide the column of this name
        label = f"{name} (model)" if name in columns else name
        parts.append(pa.field(label, pa.float64(), metadata={"unit": unit} if unit else None))
    return pa.schema(parts)


def _table(parts: Sequence[SimulatedPart], simulation: Simulation, schema: Any, text: Callable[[str], str]) -> Any:
    import pyarrow as pa

    datasets = [part.data for part in parts]
    columns = [
        _names([(text(data.name), data.samples) for data in datasets]),
        _names(
            [(name and text(name), count) for each in datasets for name, count in _file_spans(each, simulation.files)]
        ),
        _numbers([numbers_of_pieces(part) for part in parts]),
        _numbers([_nan_column(data) if data.time is None else data.time for data in datasets]),
    ]
    columns += (
        _numbers([data[name].values if name in data else _nan_column(data) for data in datasets])
        for name in simulation.units
    )
    return pa.table(columns, schema=schema)


def _nan_column(data: Dataset) -> Float:
    return np.full(data.samples, np.nan)


# the Arrow arrays below are created from buffers, as conversions from Python load pandas, which takes 0.4 s


def _numbers(parts: Sequence[Float | Int]) -> Any:
    """Return one array of all parts; NaN becomes null."""
    values = np.concatenate(parts)
    return _array(values, ~np.isnan(values))


def _array(values: NDArray[Any], known: Bool) -> Any:
    """Return an array with null for values that are not known."""
    import pyarrow as pa

    kind = pa.float64() if values.dtype == np.float64 else pa.int64()
    # validity bitmap of Arrow: one bit for each value, the first one the least significant
    bits = np.packbits(known, bitorder="little")
    return pa.Array.from_buffers(kind, values.size, [pa.py_buffer(bits), pa.py_buffer(values)])


def _file_spans(data: Dataset, names: Mapping[str, str]) -> list[tuple[str | None, int]]:
    """Return the short name of each file, and the number of its samples."""
    if data.files is None:
        return [(None, data.samples)]
    sizes = data.files.sizes(data.samples).tolist()
    return [(names[name], size) for name, size in zip(data.files.names, sizes, strict=True)]


def _names(spans: Sequence[tuple[str | None, int]]) -> Any:
    """Return a name for each sample, given the names of neighbouring ones and their number; None becomes null."""
    import pyarrow as pa

    used = list(dict.fromkeys(name for name, _ in spans if name is not None))
    encoded = [name.encode() for name in used]
    # a string array of Arrow: int32 offsets, then all bytes in a row
    ends = np.cumsum([0, *(len(name) for name in encoded)], dtype=np.int32)
    texts = pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))
    numbers = {name: number for number, name in enumerate(used)}
    sizes = [size for _, size in spans]
    known = np.repeat([name is not None for name, _ in spans], sizes)
    # the code of a null is arbitrary, but must be valid
    codes = np.repeat(np.array([numbers.get(name or "", 0) for name, _ in spans], dtype=np.int64), sizes)
    return pa.DictionaryArray.from_arrays(_array(codes, known), texts)
