"""Functions that translated code calls, by rules on arrays of nodes, with the rules that C and ESDL share."""

import math
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes
from kennfeld.models.imperative.path_facts import bound_of

Rule: TypeAlias = Callable[..., Nodes]  # of the evaluator and the arguments
_MAX_ELEMENTS: Final = 100_000


@dataclass(frozen=True)
class RuleFunction:
    """A function of the library: its name, its number of arguments, and its rule."""

    name: str
    count: int
    rule: Rule

    def results(
        self, evaluator: SymbolicEvaluator, values: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]:
        """Call the function."""
        return (self.rule(evaluator, *(np.asarray(s.as_array(s.force(value))) for value in values)),)


def elementwise(rule: Callable[..., Nodes]) -> Rule:
    """Return the rule of a function of a builder and the arguments."""
    return lambda evaluator, *arguments: rule(evaluator.builder, *arguments)


def symbolic_rule(name: str) -> Rule:
    """Return the rule of a function of MATLAB's library that other languages have as well."""

    def rule(evaluator: SymbolicEvaluator, *arguments: s.SymbolicValue) -> Nodes:
        (result,) = SYMBOLIC_FUNCTIONS[name].results(evaluator, arguments, 1)
        return np.asarray(s.as_array(result))

    return rule


def known_integer(evaluator: SymbolicEvaluator, node: Nodes) -> int:
    """Return the integer that a node is known to be; 0 if it is not known."""
    return int(evaluator.builder.value(int(node.item())) or 0)


def filled_array(evaluator: SymbolicEvaluator, node: int, sizes: Sequence[Nodes]) -> Nodes:
    """Return an array of these sizes, each element of which is the node."""
    shape = [known_integer(evaluator, size) for size in sizes]
    if math.prod(shape) > _MAX_ELEMENTS:
        raise ProgramError(f"an array of more than {_MAX_ELEMENTS} elements")
    return np.full(shape if len(shape) > 1 else (*shape, 1), node, dtype=np.int64)


def wrapped(builder: GraphBuilder, x: Nodes, least: float, count: float) -> Nodes:
    """Return x mod `count`, from `least` on; numbers that are known to be within that range stay as they are."""
    nodes = [int(node) for node in x.ravel()]
    if all(least <= bound_of(builder, node, False) and bound_of(builder, node, True) < least + count for node in nodes):
        return x
    apply = Elementwise(builder)
    return apply("add", apply("mod", apply("sub", x, least), count), least)


def shift(direction: float) -> Rule:
    """Return the rule that shifts the bits of a number, to the left if the direction is 1, to the right if it is -1."""

    def rule(evaluator: SymbolicEvaluator, x: Nodes, count: Nodes) -> Nodes:
        apply = Elementwise(evaluator.builder)
        return apply("floor", apply("mul", x, apply("pow", 2.0, apply("mul", count, direction))))

    return rule
