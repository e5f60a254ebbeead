"""Values as a control unit stores them: whole numbers of few bits, or floats, which a lookup converts.

The conversion is that of `domain.storage`, in the same order of operations, so that code with stored numbers computes
the same bits as one with the values themselves.
"""

from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun
from kennfeld.domain.storage import FloatStorage, StorageGrid, StorageRounding
from kennfeld.export.prepared import PackedNumbers, ParameterValues, PreparedFunction

_SIZES = (8, 16, 32)


def with_stored_numbers(
    function: PreparedFunction, rounding: StorageRounding
) -> tuple[PreparedFunction, tuple[Finding, ...]]:
    """Return a function whose values are stored as whole numbers where a grid is known, and what is not."""
    location, findings = Location(function.name), []
    looked_up = {node.payload.name for node in function.nodes if node.op == "interpolate"}
    parameters = []
    for parameter in function.parameters:
        stored = None
        if parameter.name in looked_up:
            stored, reason = _stored(parameter, rounding)
            if stored is None:
                message = f"{parameter.name} is written in floating point: {reason}"
                findings.append(Finding(location, message, severity="remark"))
        parameters.append(replace(parameter, stored=stored))
    return replace(function, parameters=tuple(parameters)), tuple(findings)


def _stored(parameter: ParameterValues, rounding: StorageRounding) -> tuple[PackedNumbers | None, str]:
    """Return the numbers of a parameter, or None and a clause why it has none."""
    name, values = parameter.name, parameter.values
    grid, floating = rounding.grids.get(name), rounding.floats.get(name)
    if grid is not None:
        off = ~grid.holds(values)
        if off.any():
            count = count_noun(int(off.sum()), "value")
            return None, f"{count} between two steps of {grid.step:g}, such as {float(values[off][0]):g}"
        return _whole(grid, values)
    if floating is not None and floating == FloatStorage(single=True):
        if np.array_equal(floating.nearest(values), values):
            return PackedNumbers("float", values, (1.0, 0.0, 1.0)), ""
        return None, "values are not rounded to single precision"
    return None, rounding.unrounded.get(name, "its step is not known")


def _whole(grid: StorageGrid, values: Float) -> tuple[PackedNumbers | None, str]:
    numbers = np.rint(grid.positions(values))
    ends = np.array([grid.least, grid.largest]) if grid.bits else np.array([numbers.min(), numbers.max()])
    signed = bool(ends[0] < 0)
    for bits in _SIZES:
        low, high = (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) if signed else (0.0, 2.0**bits - 1)
        if bits >= grid.bits and low <= ends[0] and ends[1] <= high:
            kind = f"{'int' if signed else 'uint'}{bits}_t"
            return PackedNumbers(kind, numbers, (grid.factor, grid.shift, grid.divisor)), ""
    return None, "its numbers need more than 32 bits"
