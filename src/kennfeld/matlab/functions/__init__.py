"""The functions of MATLAB that parameter scripts and block fields use, by family."""

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
from kennfeld.matlab.functions.numeric_registry import REGISTERED, Arguments, Function

__all__ = ["REGISTERED", "Arguments", "Function"]

_FAMILIES = (
    bits,
    elementary,
    array_shapes,
    polynomials,
    reductions,
    reductions,
    array_shapes,
    structs_and_cells,
    strings,
    types,
)
