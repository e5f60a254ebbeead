"""Functions that only numbers can tell: where all arguments are fixed, the evaluator of MATLAB gives their result.

What all code of a block shares: the graph, the functions it may call, the parameters it may name, and a budget.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluator import evaluate
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers
from kennfeld.models.imperative.symbolic_values import SymbolicValue, constants

if TYPE_CHECKING:
    from kennfeld.models.imperative.statement_interpreter import StatementInterpreter

__all__ = ["MOST_PASSES", "EvaluationContext", "evaluate_constant_call"]

MOST_STATEMENTS: Final = 20_000
MOST_NODES: Final = 400_000
MOST_PASSES: Final = 1_000

Hook = Callable[["StatementInterpreter", str, tuple[m.Expression, ...], int], "tuple[SymbolicValue, ...] | None"]
Tables = Callable[[str, list[tuple[Numbers, str]], list[Nodes], str], "Nodes | None"]

_SHORTER = "Shorten its loops or arrays, draw it as blocks, or bind its outputs."


def _nothing(body: "StatementInterpreter", name: str, arguments: tuple[m.Expression, ...], count: int) -> None:
    return None


@dataclass(eq=False)
class EvaluationContext:
    """What all code of a block shares.

    `workspace(name)` is the value of a parameter, None where there is none. `number(parameter, place)` is the number
    that an element of a parameter has, for what must be fixed; `frozen` is told what was. `functions` are those that
    the code defines, `find` gives those of the file that is called by a name. `unknown` is asked for a function that is
    none of them, with the trees of its arguments and the number of results; it returns them, or None. `tables` makes a
    lookup of the parameter of a name over breakpoints, each with the name of theirs, at coordinates. `remark` is told
    what somebody should know of the code.
    """

    builder: GraphBuilder
    workspace: "Callable[[str], SymbolicValue | None]" = lambda name: None
    number: Callable[[str, tuple[int, ...]], float | None] = lambda name, place: None
    functions: dict[str, m.FunctionDefinition] = field(default_factory=dict)
    find: Callable[[str], Mapping[str, m.FunctionDefinition]] = lambda name: {}
    unknown: Hook = _nothing
    tables: Tables = lambda name, axes, places, beyond: None
    frozen: Callable[[str], None] = lambda name: None
    remark: Callable[[str], None] = lambda sentence: None
    calling: list[m.FunctionDefinition] = field(default_factory=list)
    statements: int = 0
    begun: int = -1
    _numbers: dict[int, float | None] = field(default_factory=dict)
    _sought: dict[str, m.FunctionDefinition | None] = field(default_factory=dict)
    _beside: dict[int, Mapping[str, m.FunctionDefinition]] = field(default_factory=dict)

    def step(self) -> None:
        """One more statement; raises `CodeError` where there are too many, or too many nodes."""
        if self.begun < 0:
            self.begun = len(self.builder.nodes)
        self.statements += 1
        if self.statements > MOST_STATEMENTS:
            raise ProgramError(f"it unfolds to more than {MOST_STATEMENTS} statements", _SHORTER)
        if len(self.builder.nodes) - self.begun > MOST_NODES:
            raise ProgramError(f"it unfolds to more than {MOST_NODES} operations", _SHORTER)

    def room(self, count: float) -> None:
        """Refuse arrays that no model has room for."""
        if not count <= MOST_NODES:
            raise ProgramError(f"it asks for an array of {count:g} elements", _SHORTER)

    def function(self, name: str, beside: Mapping[str, m.FunctionDefinition]) -> m.FunctionDefinition | None:
        """A function that stands beside the one that calls it, or one of a file of its own."""
        if name in beside:
            return beside[name]
        if name not in self._sought:
            found = self.find(name)
            self._sought[name] = found.get(name)
            self._beside |= dict.fromkeys(map(id, found.values()), found)
        return self._sought[name]

    def beside(self, function: m.FunctionDefinition) -> Mapping[str, m.FunctionDefinition]:
        """The functions of the same text."""
        return self._beside.get(id(function), self.functions)

    def constant(self, node: int) -> float | None:
        """The number of a node that depends on no signal, its parameters at their values; else None."""
        if node not in self._numbers:
            self._numbers[node] = self._evaluated(node)
        return self._numbers[node]

    def _evaluated(self, root: int) -> float | None:
        """By a stack: sums over many passes are chains that are longer than calls may be nested."""
        stack, numbers = [root], self._numbers
        while stack:
            node = stack[-1]
            op, args, _ = self.builder.nodes[node]
            missing = [arg for arg in args if arg not in numbers] if op in OPERATIONS else []
            if missing and not any(arg in numbers and numbers[arg] is None for arg in args):
                stack += missing
                continue
            numbers[node] = self._one(node)
            stack.pop()
        return numbers[root]

    def _one(self, node: int) -> float | None:
        op, args, payload = self.builder.nodes[node]
        if op == "const":
            return float(payload)
        if op == "lookup":
            places = [self.builder.value(arg) for arg in args]
            fixed = tuple(int(place) for place in places if place is not None)
            return self.number(payload, fixed) if len(fixed) == len(places) else None
        parts = [self._numbers.get(arg) for arg in args]
        if op not in OPERATIONS or None in parts:
            return None
        return float(OPERATIONS[op].evaluate(*parts))

    def numbers(self, nodes: Nodes, message: str) -> Numbers | None:
        """The numbers of nodes that depend on no signal; None where one does. The parameters in them are then fixed."""
        found = [self.constant(int(node)) for node in nodes.ravel()]
        if any(one is None for one in found):
            return None
        if any(self.builder.value(int(node)) is None for node in nodes.ravel()):
            self.frozen(message)
        return np.array(found, dtype=np.float64).reshape(nodes.shape)


def evaluate_constant_call(
    context: EvaluationContext, name: str, arguments: Sequence[SymbolicValue]
) -> SymbolicValue | None:
    """What a function gives for numbers and texts; None where an argument is none or the function is not known."""
    given: dict[str, Any] = {}
    for at, held in enumerate(arguments):
        value = held if isinstance(held, str) else context.numbers(held, name) if isinstance(held, np.ndarray) else None
        if value is None:
            return None
        given[f"argument{at}"] = value
    try:
        found = evaluate(m.Call(m.Name(name), tuple(m.Name(one) for one in given)), given)
    except MatlabError:
        return None
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiub":
        return None
    return constants(context.builder, found)
