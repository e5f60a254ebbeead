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
from kennfeld.models.simulink.code.functions.registry import LIBRARY, TAKES_TABLES

__all__ = [
    "LIBRARY",
    "TAKES_TABLES",
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
