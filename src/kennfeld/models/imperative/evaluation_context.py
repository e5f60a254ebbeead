"""Context shared by all code of a block: graph, callable functions, parameters, and limits on unrolled code."""

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


MAX_STATEMENTS: Final = 20_000
MAX_NODES: Final = 400_000
MAX_PASSES: Final = 1_000

Hook = Callable[["StatementInterpreter", str, tuple[m.Expression, ...], int], "tuple[SymbolicValue, ...] | None"]
Tables = Callable[[str, list[tuple[Numbers, str]], list[Nodes], str], "Nodes | None"]

_SHORTER = "Reduce its loops or arrays, replace it by blocks, or bind its outputs."


def _nothing(body: "StatementInterpreter", name: str, arguments: tuple[m.Expression, ...], count: int) -> None:
    return None


@dataclass(eq=False)
class EvaluationContext:
    """Context shared by all code of a block.

    Attributes:
        workspace: returns the value of a parameter by name, or None.
        number: returns the number of an element of a parameter where a constant is required; `frozen` is called with
            it.
        functions: functions that the code defines; `find` returns those of a separate file by name.
        unknown: called for any other function with the trees of its arguments and the number of results; returns the
            results, or None.
        tables: builds a lookup of a parameter by name, over named breakpoints, at coordinates.
        remark: called with remarks on the code for the user.
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
        """Count one statement; raises `ProgramError` if there are too many statements or nodes."""
        if self.begun < 0:
            self.begun = len(self.builder.nodes)
        self.statements += 1
        if self.statements > MAX_STATEMENTS:
            raise ProgramError(f"it unrolls to more than {MAX_STATEMENTS} statements", _SHORTER)
        if len(self.builder.nodes) - self.begun > MAX_NODES:
            raise ProgramError(f"it unrolls to more than {MAX_NODES} operations", _SHORTER)

    def room(self, count: float) -> None:
        """Raise `ProgramError` if an array is too large."""
        if not count <= MAX_NODES:
            raise ProgramError(f"it creates an array of {count:g} elements", _SHORTER)

    def function(self, name: str, beside: Mapping[str, m.FunctionDefinition]) -> m.FunctionDefinition | None:
        """Return a function of the same text as the caller, or of a separate file."""
        if name in beside:
            return beside[name]
        if name not in self._sought:
            result = self.find(name)
            self._sought[name] = result.get(name)
            self._beside |= dict.fromkeys(map(id, result.values()), result)
        return self._sought[name]

    def beside(self, function: m.FunctionDefinition) -> Mapping[str, m.FunctionDefinition]:
        """Return the functions of the same text."""
        return self._beside.get(id(function), self.functions)

    def constant(self, node: int) -> float | None:
        """Return the number of a node that depends on no signal, with parameters at their values; else None."""
        if node not in self._numbers:
            self._numbers[node] = self._evaluated(node)
        return self._numbers[node]

    def _evaluated(self, root: int) -> float | None:
        """Evaluate with an explicit stack: sums over many passes are deeper than the recursion limit."""
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
        """Return the numbers of nodes, None if one depends on a signal. Freezes the parameters in them."""
        numbers = [self.constant(int(node)) for node in nodes.ravel()]
        if any(number is None for number in numbers):
            return None
        if any(self.builder.value(int(node)) is None for node in nodes.ravel()):
            self.frozen(message)
        return np.array(numbers, dtype=np.float64).reshape(nodes.shape)


def evaluate_constant_call(
    context: EvaluationContext, name: str, arguments: Sequence[SymbolicValue]
) -> SymbolicValue | None:
    """Evaluate a function numerically; None if an argument is not constant or the function is unknown."""
    given: dict[str, Any] = {}
    for at, held in enumerate(arguments):
        value = held if isinstance(held, str) else context.numbers(held, name) if isinstance(held, np.ndarray) else None
        if value is None:
            return None
        given[f"argument{at}"] = value
    try:
        result = evaluate(m.Call(m.Name(name), tuple(m.Name(item) for item in given)), given)
    except MatlabError:
        return None
    if not isinstance(result, np.ndarray) or result.dtype.kind not in "fiub":
        return None
    return constants(context.builder, result)
