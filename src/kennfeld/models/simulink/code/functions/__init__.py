"""The functions that code may call by family; importing them enters them in `LIBRARY`."""

from kennfeld.models.simulink.code.functions import (
    bits,
    elementwise,
    linear,
    ordering,
    reductions,
    shapes,
    structs,
    tables,
    tests,
)
from kennfeld.models.simulink.code.functions.registry import LIBRARY

__all__ = [
    "LIBRARY",
    "bits",
    "elementwise",
    "linear",
    "ordering",
    "reductions",
    "shapes",
    "structs",
    "tables",
    "tests",
]
