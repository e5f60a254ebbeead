"""The MATLAB functions that parameter scripts and block fields use, by family."""

from kennfeld.matlab.functions import (
    array_shapes,
    bits,
    elementary,
    polynomials,
    reductions,
    strings,
    structs_and_cells,
    types,
)
from kennfeld.matlab.functions.numeric_registry import NUMERIC_FUNCTIONS, NumericArguments, NumericFunction

__all__ = ["NUMERIC_FUNCTIONS", "NumericArguments", "NumericFunction"]

_FAMILIES = (array_shapes, bits, elementary, polynomials, reductions, strings, structs_and_cells, types)
