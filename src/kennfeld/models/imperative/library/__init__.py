"""Library functions available to code, by family; importing this package registers them in `SYMBOLIC_FUNCTIONS`."""

from kennfeld.models.imperative.library import (
    array_functions,
    container_functions,
    elementwise_functions,
    interpolation_functions,
    numeric_rules,
    reduction_functions,
)
from kennfeld.models.imperative.library.function_registry import C_FUNCTIONS, SYMBOLIC_FUNCTIONS, TAKES_TABLES

__all__ = ["C_FUNCTIONS", "SYMBOLIC_FUNCTIONS", "TAKES_TABLES"]

_FAMILIES = (
    array_functions, container_functions, elementwise_functions, interpolation_functions, numeric_rules,
    reduction_functions,
)  # fmt: skip
