"""Topic `files`: large calibration and measurement files, read beside the libraries that others use."""

import gc
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.file_data import CHANNELS, write_calibration, write_csv, write_mdf
from benchmarks.machine import load
from benchmarks.measure import apart, installed, peak, reset_peak
from benchmarks.table import Table, megabytes, seconds

__all__ = ["measure", "run"]

REPEATS = 3
RASTER = 0.01  # s


def _kennfeld_calibration(path: str) -> Any:
    from kennfeld.calfiles import read

    return lambda: [member.values for member in read(path).parameters]


def _kennfeld_rewritten(path: str) -> Any:
    from kennfeld.calfiles import read, write

    parameters = read(path)
    name = next(iter(parameters))
    changed = parameters.with_parameters(parameters[name].with_values(parameters[name].values + 1))

    def work() -> list[Any]:
        write(changed, Path(path).with_suffix(f".new{Path(path).suffix}"))
        return [member.values for member in changed.parameters]

    return work


def _dcm_reader(path: str) -> Any:
    from dcmReader.dcm_reader import DcmReader

    def work() -> list[Any]:
        reader = DcmReader()
        reader.read(path)
        maps = reader.get_characteristic_maps()
        return [np.array([list(row.values()) for row in table.values.values()]) for table in maps]

    return work


def _kennfeld_measurement(path: str, **options: Any) -> Any:
    from kennfeld.measurement import read

    return lambda: [channel.values for channel in read(path, **options).channels]


def _kennfeld_kept(path: str, **options: Any) -> Any:
    from kennfeld.measurement.cache import Cache

    kept = Cache(Path(path).with_suffix(".kept"))
    return lambda: [channel.values for channel in kept.read(path, **options).channels]


def _asammdf(path: str, work: str) -> Any:
    import warnings

    from asammdf import MDF

    warnings.simplefilter("ignore")

    def frame() -> list[Any]:
        with MDF(path) as mdf:
            table = mdf.to_dataframe(channels=list(CHANNELS), raster=RASTER, time_from_zero=False)
            return [table[name].to_numpy() for name in table]

    def select() -> list[Any]:
        with MDF(path) as mdf:
            return [signal.samples for signal in mdf.select(list(CHANNELS))]

    return {"frame": frame, "select": select}[work]


def _pandas(path: str) -> Any:
    import pandas as pd

    return lambda: [column.to_numpy() for _, column in pd.read_csv(path).items()]  # noqa: PERF102  (of a DataFrame)


def _polars(path: str) -> Any:
    import polars as pl

    return lambda: [column.to_numpy() for column in pl.read_csv(path)]


def _pyarrow(path: str) -> Any:
    from pyarrow import csv

    return lambda: [column.to_numpy() for column in csv.read_csv(path).columns]


READERS: Mapping[str, Callable[..., Callable[[], list[Any]]]] = {
    "kennfeld calibration": _kennfeld_calibration,
    "kennfeld rewritten": _kennfeld_rewritten,
    "dcmReader": _dcm_reader,
    "kennfeld measurement": _kennfeld_measurement,
    "kennfeld kept": _kennfeld_kept,
    "asammdf": _asammdf,
    "pandas": _pandas,
    "polars": _polars,
    "pyarrow": _pyarrow,
}


def measure(reader: str, path: str, **options: Any) -> dict[str, Any]:
    """Read a file several times in a process of its own; the first time begins with the imports."""
    began = time.perf_counter()
    work = READERS[reader](path, **options)
    arrays = work()
    first = time.perf_counter() - began
    total = float(np.sum([np.nansum(np.asarray(values, dtype=np.float64)) for values in arrays]))
    count = int(sum(np.size(values) for values in arrays))
    arrays.clear()
    gc.collect()
    before, durations = reset_peak(), []
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        durations.append(time.perf_counter() - began)
    return {"best": min(durations), "first": first, "memory": peak() - before, "values": count, "sum": total}


def run() -> list[Table]:
    """Every file with every reader that is there."""
    table = Table(
        "files: reading and writing", ("file", "reader", "best", "first", "memory", "values", "sum", "remark")
    )
    with tempfile.TemporaryDirectory() as folder:
        _calibrations(table, Path(folder))
        _recordings(table, Path(folder))
        _texts(table, Path(folder))
    table.notes = [
        "Budget: 36 MB of DCM below 2 s; 20 channels of a 150 MB MF4 below 1 s; CSV within 1.3 times of pandas.",
        f"The shortest of {REPEATS} times in a process that has read the file before; first is from the start of the "
        "imports to the values. Memory is the peak above what the process had. Equal sums say that equal values were "
        f"read; a reader that keeps other rows has another sum. Load at the end {load()}.",
    ]
    return [table]


def _calibrations(table: Table, folder: Path) -> None:
    for ending in (".dcm", ".cdfx", ".csv", ".json"):
        path = folder / f"maps{ending}"
        write_calibration(path)
        name = f"5000 maps of 16x16, {ending[1:].upper()}, {megabytes(path.stat().st_size)}"
        _row(table, name, "Kennfeld", "kennfeld calibration", path)
        if ending == ".dcm":
            _row(table, f"{name}, one value changed, written", "Kennfeld", "kennfeld rewritten", path)
            _row(table, name, "dcmReader", "dcmReader", path, package="dcmReader")


def _recordings(table: Table, folder: Path) -> None:
    for compressed in (False, True):
        path = folder / f"recording{compressed:d}.mf4"
        write_mdf(path, compressed)
        packed = " compressed," if compressed else ""
        name = f"20 channels of 3 rasters, MF4,{packed} {megabytes(path.stat().st_size)}"
        options = {"channels": list(CHANNELS), "raster": RASTER}
        _row(table, name, "Kennfeld, raster 10 ms", "kennfeld measurement", path, **options)
        apart("benchmarks.files:measure", reader="kennfeld kept", path=str(path), **options)  # what an earlier run left
        _row(table, name, "Kennfeld, second run of a project", "kennfeld kept", path, **options)
        _row(table, name, "asammdf to_dataframe, raster 10 ms", "asammdf", path, work="frame")
        _row(table, name, "asammdf select, as recorded", "asammdf", path, work="select")


def _texts(table: Table, folder: Path) -> None:
    path = folder / "table.csv"
    write_csv(path)
    name = f"1 000 000 rows of 20 columns, CSV, {megabytes(path.stat().st_size)}"
    _row(table, name, "Kennfeld", "kennfeld measurement", path)
    for package in ("pandas", "polars", "pyarrow"):
        _row(table, name, package, package, path, package=package)


def _row(table: Table, name: str, shown: str, reader: str, path: Path, package: str = "", **options: Any) -> None:
    if package and not installed(package):
        table.add(name, shown, "-", "-", "-", "-", "-", "missing")
        return
    outcome = apart("benchmarks.files:measure", reader=reader, path=str(path), **options)
    if "error" in outcome:
        table.add(name, shown, "-", "-", "-", "-", "-", outcome["error"])
        return
    cells = seconds(outcome["best"]), seconds(outcome["first"]), megabytes(outcome["memory"]), str(outcome["values"])
    table.add(name, shown, *cells, f"{outcome['sum']:.10g}")
