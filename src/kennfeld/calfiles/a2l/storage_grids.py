"""The grids of numbers that the labels and axes of an A2L file can store, without an image."""

from collections.abc import Iterator
from dataclasses import field

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.conversion import conversion_of
from kennfeld.calfiles.a2l.labels import hard_limits
from kennfeld.calfiles.a2l.objects import DIRECTIONS, A2l, AxisDescr, AxisPts, Characteristic
from kennfeld.calfiles.a2l.storage import NUMBERS, SIZES, StorageFormat
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.storage import FloatStorage, StorageGrid

FLOATS = ("FLOAT32_IEEE", "FLOAT64_IEEE")
Numbers = Characteristic | AxisPts | AxisDescr


@dataclass
class StorageGrids:
    """The grids of an A2L file, and why other labels have none.

    Attributes:
        labels: by the name of the characteristic.
        axes: by the group axis, or the characteristic and the direction.
        floats: by the name of the characteristic, those with a linear conversion of numbers in floating point.
        unrounded: a clause for each other label or axis, by its name.
    """

    labels: dict[str, StorageGrid] = field(default_factory=dict)
    axes: dict[AxisKey, StorageGrid] = field(default_factory=dict)
    floats: dict[str, FloatStorage] = field(default_factory=dict)
    unrounded: dict[str, str] = field(default_factory=dict)


def storage_grids(a2l: A2l) -> StorageGrids:
    """Return the grids of all labels of an A2L file whose values are whole numbers with a linear conversion."""
    grids = StorageGrids()
    for name, source in a2l.characteristics.items():
        try:
            bit_mask = source.bit_mask or None
            data_type = _data_type(a2l, source, "FNC_VALUES")
            if data_type in FLOATS:
                grids.floats[name] = FloatStorage(*_coefficients(a2l, source), single=data_type == "FLOAT32_IEEE")
            grids.labels[name] = _grid(a2l, source, data_type, bit_mask)
        except A2lError as error:
            grids.unrounded[name] = str(error)
    for key, owner, axis in _axes(a2l):
        try:
            kind = f"AXIS_PTS_{'X' if isinstance(axis, AxisPts) else DIRECTIONS[AXIS_LETTERS.index(key.direction)]}"
            grids.axes[key] = _grid(a2l, axis, _data_type(a2l, owner, kind))
        except A2lError as error:
            grids.unrounded[str(key)] = str(error)
    return grids


def _axes(a2l: A2l) -> Iterator[tuple[AxisKey, AxisPts | Characteristic, AxisPts | AxisDescr]]:
    """Yield the axes whose breakpoints are stored, each with the object whose layout places them."""
    for name, source in a2l.axis_pts.items():
        yield AxisKey(name), source, source
    for name, label in a2l.characteristics.items():
        for letter, axis in zip(AXIS_LETTERS, label.axes, strict=False):
            if axis.attribute == "STD_AXIS":
                yield AxisKey(name, letter), label, axis
            elif axis.attribute == "COM_AXIS" and (shared := a2l.axis_pts.get(axis.axis_pts_ref)) is not None:
                # for tables whose axis has another name, or none, in the project
                yield AxisKey(name, letter), shared, shared


def _data_type(a2l: A2l, source: AxisPts | Characteristic, key: str) -> str:
    layout = a2l.record_layouts.get(source.record_layout)
    if layout is None:
        raise A2lError(f"has the record layout {source.record_layout[:60]}, which is not defined")
    component = next((component for component in layout.components if component.key == key), None)
    if component is None:
        raise A2lError(f"has the record layout {layout.name}, which has no {key}")
    if component.data_type not in NUMBERS:
        raise A2lError(f"has the record layout {layout.name} with the data type {component.data_type[:40]!r}")
    return component.data_type


def _grid(a2l: A2l, source: Numbers, data_type: str, bit_mask: int | None = None) -> StorageGrid:
    """Return the grid of some numbers. Raises `A2lError` with the reason why they have none."""
    factor, shift, divisor = _coefficients(a2l, source)
    conversion = conversion_of(a2l, source.conversion, source.lower, source.upper)
    storage = StorageFormat(data_type, "", conversion, bit_mask)
    if not storage.integer:
        raise A2lError(f"is stored as {data_type}, which needs no rounding")
    whole = StorageGrid(factor, shift, divisor, *storage.span, 8 * SIZES[data_type])
    least, largest = whole.range_within(*map(np.array, hard_limits(source)))
    if least > largest:
        lower, upper = hard_limits(source)
        between = f"has the limits {lower:g} to {upper:g}"
        raise A2lError(f"{between}, between which no number is stored at a step of {whole.step:g}")
    grid = StorageGrid(factor, shift, divisor, float(least) + 0.0, float(largest) + 0.0, whole.bits)
    ends = np.array([grid.least, grid.largest])
    # a shift that is large against the step leaves no digits for it
    if not np.array_equal(np.rint(grid.positions(grid.values(ends))), ends):
        raise A2lError(f"has the step {grid.step:g}, which is too fine for double precision beside {abs(shift):g}")
    return grid


def _coefficients(a2l: A2l, source: Numbers) -> tuple[float, float, float]:
    """Return factor, shift and divisor of a linear conversion."""
    method = a2l.compu_methods.get(source.conversion)
    if source.conversion in ("NO_COMPU_METHOD", "") or (method is not None and method.kind == "IDENTICAL"):
        return 1.0, 0.0, 1.0
    if method is None:
        raise A2lError(f"has the conversion {source.conversion[:60]}, which is not defined")
    if method.table in a2l.compu_vtabs:
        raise A2lError(f"has the conversion {method.name}, whose values are words")
    if method.kind == "LINEAR":
        factor, shift, divisor = method.coeffs[0], method.coeffs[1], 1.0
    elif method.kind == "RAT_FUNC" and not any(method.coeffs[i] for i in (0, 3, 4)):
        # raw = (b p + c) / f, so that p = (f raw - c) / b
        _, b, c, _, _, f = method.coeffs
        factor, shift, divisor = f, 0.0 - c, b
    else:
        raise A2lError(f"has the conversion {method.name} of the kind {method.kind}, which is not linear")
    if not (factor and divisor):
        raise A2lError(f"has the conversion {method.name}, whose step is 0")
    return factor, shift, divisor
