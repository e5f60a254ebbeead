"""Functions of MATLAB in the code of a chart: those of the library of MATLAB Functions."""

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

__all__ = ["is_of_library", "results_of"]

_FIXED: Final = frozenset({"zeros", "ones", "reshape", "linspace", "numel", "length"})  # sizes are told by expressions
_ALONG: Final = frozenset({"min", "max", "sum", "prod"})  # of more forms of arrays than expressions know


def is_of_library(name: str) -> bool:
    """Whether a name is that of a function which expressions do not know by themselves."""
    return name in SYMBOLIC_FUNCTIONS and (name in _ALONG or name not in KNOWN | _FIXED)


def results_of(builder: GraphBuilder, name: str, arguments: Sequence[SymbolicValue], wanted: int) -> list[Nodes]:
    """The results of a function, as many as are wanted or fewer, each Int[rows, columns]; raises `CodeError`."""
    made = SYMBOLIC_FUNCTIONS[name].results(StatementInterpreter(EvaluationContext(builder)).calls, arguments, wanted)
    return [np.asarray(as_array(force(one), f"a result of {name}"), dtype=np.int64) for one in made]
