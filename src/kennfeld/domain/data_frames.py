"""DataFrames of pandas, which is imported only here and only when it is needed, and the types of other tables."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float, Int
from kennfeld.base.errors import Location
from kennfeld.base.optional_packages import optional_package

_CALL = Location("to_frame")
GridAxis = tuple[str, Float]  # its label and its breakpoints


@runtime_checkable
class ArrowTable(Protocol):
    """A table that other libraries can read as a stream of Arrow, as those of polars, PyArrow and DuckDB."""

    def __arrow_c_stream__(self, requested_schema: Any = None) -> object: ...


@runtime_checkable
class InterchangeTable(Protocol):
    """A table that offers the DataFrame interchange protocol, as those of pandas, polars and vaex."""

    def __dataframe__(self, nan_as_null: bool = False, allow_copy: bool = True) -> Any: ...


Table = Mapping[str, ArrayLike] | ArrowTable | InterchangeTable


def pandas_module() -> Any:
    """Return the module pandas.

    Raises:
        InputError: it is not installed; the message has the command that installs it.
    """
    with optional_package(_CALL, "notebook"):
        import pandas
    return pandas


def grid_frame(name: str, values: Float, axes: Sequence[GridAxis]) -> Any:
    """Return values over breakpoints.

    Args:
        name: the name of the values.
        values: Float[x, y, ...]; a single number without axes.
        axes: one for each direction of the values.

    Returns:
        Two axes: x along the rows and y along the columns. Otherwise one column, with a level of the index per axis.
    """
    pandas = pandas_module()
    if not axes:
        return pandas.DataFrame({name: [float(values)]})
    labels, points = zip(*axes, strict=True)
    if len(axes) == 2:
        rows, columns = (pandas.Index(ticks, name=label) for label, ticks in axes)
        # a copy, here and below: the arrays of parameters and channels cannot be written to
        return pandas.DataFrame(np.array(values), index=rows, columns=columns)
    if len(axes) == 1:
        return pandas.DataFrame({name: np.array(values)}, index=pandas.Index(points[0], name=labels[0]))
    return pandas.DataFrame({name: values.ravel()}, index=pandas.MultiIndex.from_product(points, names=labels))


def column_frame(columns: Mapping[str, ArrayLike]) -> Any:
    """Return columns of equal length."""
    return pandas_module().DataFrame({name: np.array(values) for name, values in columns.items()})


def sample_frame(columns: Mapping[str, Float], units: Mapping[str, str], time: Float | None, starts: Int) -> Any:
    """Return channels of a recording over their time, or over the number of the sample.

    Args:
        columns: Float[samples] by channel.
        units: of channels; `attrs["units"]` of the frame.
        time: in s, Float[samples]; None for steady-state points.
        starts: the first sample of each piece. Several pieces are a level `piece` of the index, counted from 0.
    """
    pandas = pandas_module()
    count = next((values.size for values in columns.values()), 0 if time is None else time.size)
    index = pandas.RangeIndex(count, name="sample") if time is None else pandas.Index(time, name="time [s]")
    if starts.size > 1:
        # the last piece that begins at or before a sample
        pieces = np.searchsorted(starts, np.arange(count), side="right") - 1
        index = pandas.MultiIndex.from_arrays([pieces, index], names=["piece", index.name])
    frame = pandas.DataFrame({name: np.array(values) for name, values in columns.items()}, index=index)
    frame.attrs["units"] = dict(units)
    return frame
