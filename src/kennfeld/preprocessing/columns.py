"""Named columns of the tables that callers of the Python API pass.

A table is a dict, a DataFrame of pandas, a Dataset of xarray, an array with fields, or any table that offers the Arrow
stream or the DataFrame interchange protocol, such as those of polars, PyArrow and DuckDB.
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.data_frames import ArrowTable, InterchangeTable

_NUMBERS_AND_DATES = "biufMm"  # kinds of numpy
_UNITS = ("units", "unit")  # attributes of a column that state its unit


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns by name as a table holds them, the units that it states, and the levels of its index by label."""

    values: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    levels: tuple[tuple[str, Any], ...] = ()


def read_columns(table: object) -> Columns:
    """Return the columns of a table.

    Raises:
        ArgumentError: the object has no named columns, such as the name of a file; a name occurs twice; or the columns
            of a dict are series with different indexes.

    >>> read_columns({"x": [1.0, 2.0]}).values
    {'x': [1.0, 2.0]}
    """
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        return _of_xarray(table)
    if isinstance(table, Mapping):
        return _of_mapping(table)
    if hasattr(table, "iloc") and hasattr(table, "columns"):
        return _of_pandas(table)
    if isinstance(table, np.ndarray) and table.dtype.names:
        return Columns({name: table[name] for name in table.dtype.names})
    if isinstance(table, ArrowTable | InterchangeTable):
        return _of_arrow(table)
    message = f"data must be a dataset or columns by name, a dict or a DataFrame, got {type(table).__name__}"
    raise ArgumentError(f"{message}. kennfeld.read reads a file.")


def column_names(table: object) -> set[str]:
    """Return the names of the columns of a table, without reading them; empty for an object that has none."""
    names = getattr(table, "columns", getattr(table, "column_names", ()))
    if isinstance(table, Mapping):
        names = table.keys()
    try:
        return set(map(str, names))
    except TypeError:
        return set()


def _of_mapping(table: Mapping[Any, Any]) -> Columns:
    series = {str(name): column for name, column in table.items() if hasattr(column, "iloc")}
    units = {str(name): unit for name, column in table.items() if (unit := _stated_unit(column))}
    _check_indexes(series)
    index = next(iter(series.values())).index if series else None
    return Columns({str(name): column for name, column in table.items()}, units, _levels(index))


def _check_indexes(series: Mapping[str, Any]) -> None:
    """Raise `ArgumentError` for series that a dict would join by position although their indexes differ."""
    first = next(iter(series), "")
    for name, other in series.items():
        if not series[first].index.equals(other.index):
            message = f"columns {first} and {name} are series with different indexes"
            remedy = "pandas.DataFrame(data) joins them by index, and name.to_numpy() by position"
            raise ArgumentError(f"{message}: {remedy}.")


def _of_pandas(table: Any) -> Columns:
    names = [str(name) for name in table.columns]
    _check_names(names)
    columns = {name: table.iloc[:, i] for i, name in enumerate(names)}
    stated = table.attrs.get("units")  # as `Dataset.to_frame` writes them
    units = {name: unit for name, column in columns.items() if (unit := _stated_unit(column))}
    units |= {str(name): str(unit) for name, unit in stated.items()} if isinstance(stated, Mapping) else {}
    return Columns(columns, {name: unit for name, unit in units.items() if name in columns}, _levels(table.index))


def _of_arrow(table: Any) -> Columns:
    import pyarrow

    try:
        if isinstance(table, ArrowTable):
            arrow = pyarrow.table(table)
        else:
            from pyarrow.interchange import from_dataframe

            arrow = from_dataframe(table)
    except (pyarrow.ArrowException, NotImplementedError, RuntimeError, TypeError) as error:
        raise ArgumentError(f"the columns of a {type(table).__name__} cannot be read: {error}") from None
    _check_names(arrow.column_names)
    units = {known.name: unit for known in arrow.schema if (unit := _arrow_unit(known))}
    columns = {name: arrow.column(i).to_numpy() for i, name in enumerate(arrow.column_names)}
    return Columns(columns, units)


def _arrow_unit(field_: Any) -> str:
    metadata = field_.metadata or {}
    return next((metadata[key].decode() for key in (b"unit", b"units") if key in metadata), "")


def _of_xarray(table: Any) -> Columns:
    """Return the variables of a Dataset of xarray, and its coordinates that hold numbers or dates."""
    coordinates = {name: c for name, c in table.coords.items() if c.ndim == 1 and c.dtype.kind in _NUMBERS_AND_DATES}
    arrays = {str(name): array for name, array in {**coordinates, **table.data_vars}.items()}
    units = {name: unit for name, array in arrays.items() if (unit := _stated_unit(array))}
    return Columns({name: np.asarray(array) for name, array in arrays.items()}, units)


def _check_names(names: list[str]) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ArgumentError(f"the data have two columns {repeated[0]}; give each its own name")


def _stated_unit(column: Any) -> str:
    """Return the unit among the attributes of a column of pandas or xarray; empty if there is none."""
    attributes = getattr(column, "attrs", None)
    if not isinstance(attributes, Mapping):
        return ""
    return next((str(attributes[key]) for key in _UNITS if isinstance(attributes.get(key), str)), "")


def _levels(index: Any) -> tuple[tuple[str, Any], ...]:
    """Return the levels of an index of pandas, each with its label."""
    if index is None:
        return ()
    labels = ["" if name is None else str(name) for name in index.names]
    return tuple((label, index.get_level_values(i)) for i, label in enumerate(labels))
