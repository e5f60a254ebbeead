"""MATLAB functions in the code of a chart, from the library of MATLAB Function blocks."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.graph_operators import KNOWN
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import StatementInterpreter
from kennfeld.models.imperative.symbolic_values import SymbolicValue, as_array, force

_FIXED: Final = frozenset({"zeros", "ones", "reshape", "linspace", "numel", "length"})  # their sizes must be constant
_ALONG: Final = frozenset({"min", "max", "sum", "prod"})  # block parameters support fewer shapes of arrays


def is_library_function(name: str) -> bool:
    """Return True if the library, but not the expressions of block parameters, has this function."""
    return name in SYMBOLIC_FUNCTIONS and (name in _ALONG or name not in KNOWN | _FIXED)


def call_library_function(
    builder: GraphBuilder, name: str, arguments: Sequence[SymbolicValue], wanted: int
) -> list[Nodes]:
    """Return up to `wanted` results of a function, each Int[rows, columns].

    Raises:
        ProgramError: The function is not defined for these arguments.
    """
    evaluator = StatementInterpreter(EvaluationContext(builder)).calls
    results = SYMBOLIC_FUNCTIONS[name].results(evaluator, arguments, wanted)
    return [np.asarray(as_array(force(result), f"a result of {name}"), dtype=np.int64) for result in results]
