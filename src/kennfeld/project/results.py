"""What a run leaves in its folder: complete, or the folder as it was.

The trust in each value as a table for a spreadsheet.
"""

import csv
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.atomic_files import replacing, write_whole
from kennfeld.calfiles import unwritable
from kennfeld.calfiles import write as write_parameters
from kennfeld.calfiles.flash.description import IMAGE_ENDINGS
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.free_axes import free_axes
from kennfeld.optimize import Result, TraceLine
from kennfeld.optimize.trust import Trust
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.folder_replacement import LOCK, move, scratch_folder
from kennfeld.project.manifest import KEY, digests
from kennfeld.rbf import RBF

__all__ = ["COLUMNS", "ResultSource", "require_room", "write", "write_simulation", "write_text", "write_trust"]

AXES = ("x", "y", "z", "w")
COLUMNS = (
    *("parameter", *AXES, "value", "unit", "deviation", "scatter"),
    *("samples", "leverage", "informed", "by_smoothness"),
)
MANY = 2000  # values up to which the leverage is computed: its cost grows with the third power

RESULT = "result.json"
ELSEWHERE = "Name another folder with -o."


def write_trust(trust: Trust, parameters: ParameterSet, path: Path) -> None:
    """Write a line for each free value, breakpoints last; what is not known stays empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        leverage = trust.leverage if sum(a.size for a in trust.deviation.values()) <= MANY else {}
        for name in trust.deviation:
            writer.writerows(_lines(trust, name, *_values(name, parameters), leverage.get(name)))


def _values(name: str, parameters: ParameterSet) -> tuple[Float, str, list[list[float | str]]]:
    """The values of a parameter, their unit, and its breakpoints: of an axis numbers, of an expansion names."""
    if name in parameters:
        table = parameters[name]
        if isinstance(table, RBF):
            return table.values, table.unit, [[table.value_name(i) for i in range(table.size)]]
        return table.values, table.unit, [axis.breakpoints.tolist() for axis in table.index_axes]
    place = next(axis.places[0] for key, axis in free_axes(parameters).items() if name in (str(key), f"axis {key}"))
    axis = parameters[place[0]].axes[place[1]]
    return axis.breakpoints, axis.unit, [np.arange(1.0, len(axis) + 1).tolist()]


def _lines(
    trust: Trust, name: str, values: Float, unit: str, breakpoints: Sequence[list[float | str]], leverage: Float | None
) -> Iterator[list[Any]]:
    for at in np.ndindex(values.shape):
        place = [points[i] for points, i in zip(breakpoints, at, strict=True)]
        yield [
            name,
            *(place + [""] * (len(AXES) - len(place))),
            float(values[at]),
            unit,
            *(_number(array[at]) for array in (trust.deviation[name], trust.scatter[name])),
            int(trust.samples[name][at]),
            "" if leverage is None else _number(leverage[at]),
            *(int(flags[name][at]) for flags in (trust.informed, trust.by_smoothness)),
        ]


def _number(value: Any) -> float | str:
    return "" if np.isnan(value) else float(f"{value:.6g}")


class ResultSource(Protocol):
    """The part of a project that results need."""

    @property
    def formats(self) -> Sequence[str]:
        """File endings of the calibration formats asked for, such as `.dcm`."""

    @property
    def surrogates(self) -> Collection[str]:
        """The data-driven models, which have files of their own."""

    def simulate(
        self, parameters: ParameterSet | None = None, shifts: Mapping[str, Mapping[str, float]] | None = None
    ) -> list[Dataset]:
        """Nodes and targets over all datasets."""


def write(
    result: Result,
    project: ResultSource,
    folder: str | Path,
    documents: Mapping[str, str] | None = None,
    further: Mapping[str, Any] | None = None,
    told: list[Finding] | None = None,
) -> tuple[Path, ...]:
    """Write a result into a folder, with further texts by file name, and give the paths of its files.

    `further` are keys of `result.json` besides those of the result. What should be said about calibration files goes
    to `told`, and so does why an image cannot hold the values: that leaves out the image alone. So do the parameters
    that a format has no name for: they are in `parameters.json`.

    Existing files of these names are replaced, all of them or none. `result.json` comes last and lists the SHA-256 of
    the others, but for those of `documents`, which may be made again. Raises `InputError` where that is not possible.
    """
    target = Path(folder)
    simulation = project.simulate(result.parameters, result.shifts)
    with _written_beside(target) as scratch:
        for ending in dict.fromkeys((".json", *project.formats)):
            said = _write_values(result.parameters.without(project.surrogates), scratch / f"parameters{ending}")
            (told if told is not None else []).extend(said)
        _write_trace(result.trace, scratch / "trace.csv")
        write_trust(result.trust, result.parameters, scratch / "trust.csv")
        _save(simulation, scratch / "simulation.parquet")
        names = sorted(path.name for path in scratch.iterdir() if path.name != LOCK)
        content = result.as_json() | dict(further or {}) | {KEY: digests(scratch, names)}
        for name, text in (documents or {}).items():
            (scratch / name).write_text(text, encoding="utf-8", newline="\n")
        _write_json(content, scratch / RESULT)
        names += [*(documents or {}), RESULT]
        move(names, scratch, target)
    for ending in project.formats:
        if ending in IMAGE_ENDINGS and f"parameters{ending}" not in names:
            (target / f"parameters{ending}").unlink(missing_ok=True)  # an older one would be taken for this one
    return tuple(target / name for name in names)


def _write_values(parameters: ParameterSet, path: Path) -> Sequence[Finding]:
    try:
        return write_parameters(parameters, path)
    except InputError as error:
        if path.suffix in IMAGE_ENDINGS:
            return error.findings
        left = unwritable(parameters, path.suffix) if path.suffix != ".json" else {}
        if not left:
            raise
        said = [replace(one, remedy="parameters.json holds it.", severity="warning") for one in left.values()]
        return [*said, *write_parameters(parameters.without(left), path)]


def write_simulation(datasets: Sequence[Dataset], path: str | Path) -> Path:
    """Write simulated datasets, one below the other, as Parquet or CSV by the ending of `path`."""
    target = Path(path)
    if target.suffix.lower() not in (".parquet", ".csv"):
        raise InputError.of(
            str(target), f"{target.suffix or 'no ending'} is no format for a simulation", "Write .parquet or .csv."
        )
    with _reported(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as beside:
            _save(datasets, beside)
    return target


def require_room(folder: str | Path) -> None:
    """Raise `InputError` where nothing can be written into a folder; leaves no trace."""
    target = Path(folder)
    made = [path for path in (target, *target.parents) if not path.exists()]
    try:
        with _written_beside(target) as scratch:
            (scratch / "result.json").write_bytes(b"{}")
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def write_text(text: str, path: str | Path) -> Path:
    """Write a text into a file of its own, whole or not at all."""
    target = Path(path)
    with _reported(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, text, durable=True)
    return target


@contextmanager
def _reported(target: Path) -> Iterator[None]:
    """Turn an error of the system into one that names the file and the remedy."""
    try:
        yield
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise InputError.of(str(target), message, "Name another file with -o.") from None


@contextmanager
def _written_beside(folder: Path) -> Iterator[Path]:
    """A hidden folder within `folder`, which is made if need be; it is gone at the end, whatever happens."""
    try:
        with scratch_folder(folder) as scratch:
            yield scratch
    except OSError as error:
        raise InputError.of(str(folder), f"cannot be written: {error.strerror or error}", ELSEWHERE) from None


def _write_json(content: Any, path: Path) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _write_trace(trace: Sequence[TraceLine], path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(field.name for field in fields(TraceLine))
        writer.writerows(astuple(line) for line in trace)


def _save(datasets: Sequence[Dataset], path: Path) -> None:
    if path.suffix.lower() == ".csv":
        from pyarrow import csv as arrow_csv

        arrow_csv.write_csv(_table(datasets), path)
    else:
        from pyarrow import parquet

        parquet.write_table(_table(datasets), path)


def _table(datasets: Sequence[Dataset]) -> Any:
    """Columns dataset, piece (counted from 1), time, then the channels; no value where a dataset lacks one."""
    import pyarrow as pa

    columns: dict[str, tuple[Any, str]] = {
        "dataset": (_names(datasets), ""),
        "piece": (_numbers([_pieces(data) for data in datasets]), ""),
        "time": (_numbers([_nothing(data) if data.time is None else data.time for data in datasets]), "s"),
    }
    for name in dict.fromkeys(name for data in datasets for name in data):
        values = _numbers([data[name].values if name in data else _nothing(data) for data in datasets])
        unit = next(data[name].unit for data in datasets if name in data)
        columns[f"{name} (model)" if name in columns else name] = (values, unit)
    schema = [
        pa.field(name, values.type, metadata={"unit": unit} if unit else None)
        for name, (values, unit) in columns.items()
    ]
    return pa.table([values for values, _ in columns.values()], schema=pa.schema(schema))


def _nothing(data: Dataset) -> Float:
    return np.full(data.samples, np.nan)


def _pieces(data: Dataset) -> Int:
    begins = np.zeros(data.samples, dtype=np.int64)
    begins[data.starts[data.starts < data.samples]] = 1
    return np.cumsum(begins)


# Arrow arrays are made from buffers below: whatever converts from Python loads pandas, which costs 0.4 s


def _numbers(parts: Sequence[Float | Int]) -> Any:
    """One array of all parts, without a value where it is NaN."""
    import pyarrow as pa

    values = np.concatenate(parts)
    kind = pa.float64() if values.dtype == np.float64 else pa.int64()
    known = np.packbits(~np.isnan(values), bitorder="little")
    return pa.Array.from_buffers(kind, values.size, [pa.py_buffer(known), pa.py_buffer(values)])


def _names(datasets: Sequence[Dataset]) -> Any:
    """The name of the dataset for each sample."""
    import pyarrow as pa

    encoded = [data.name.encode() for data in datasets]
    ends = np.cumsum([0, *(len(name) for name in encoded)], dtype=np.int32)
    names = pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))
    codes = np.repeat(np.arange(len(datasets)), [data.samples for data in datasets])
    return pa.DictionaryArray.from_arrays(_numbers([codes]), names)
