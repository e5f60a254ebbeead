"""Library functions available to code, by family; importing this package registers them in `SYMBOLIC_FUNCTIONS`."""

from kennfeld.models.imperative.library import (
    array_functions,
    container_functions,
    elementwise_functions,
    interpolation_functions,
    reduction_functions,
)
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS, TAKES_TABLES

__all__ = [
    "SYMBOLIC_FUNCTIONS",
    "TAKES_TABLES",
    "array_functions",
    "container_functions",
    "elementwise_functions",
    "interpolation_functions",
    "reduction_functions",
]
