"""The functions of MATLAB that parameter scripts and block fields use, by family."""

from kennfeld.matlab.functions import (
    bits,
    elementary,
    making,
    polynomials,
    reducing,
    searching,
    shaping,
    structures,
    texts,
    types,
)
from kennfeld.matlab.functions.registry import REGISTERED, Arguments, Function

__all__ = ["REGISTERED", "Arguments", "Function"]

_FAMILIES = (bits, elementary, making, polynomials, reducing, searching, shaping, structures, texts, types)
