"""Context shared by all code of a block: graph, callable functions, parameters, and limits on unrolled code."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Final, Protocol

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.matlab.values import MatlabFunctionHandle
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers
from kennfeld.models.imperative.symbolic_values import SymbolicValue
from kennfeld.program import tree as m

MAX_STATEMENTS: Final = 20_000
MAX_NODES: Final = 400_000
MAX_PASSES: Final = 1_000

Evaluate = Callable[[m.Expression], SymbolicValue]
Hook = Callable[[Evaluate, str, m.Expressions], SymbolicValue | None]
Tables = Callable[[str, list[tuple[Numbers, str]], list[Nodes], str], Nodes | None]

_SHORTER = "Reduce its loops or arrays, replace it by blocks, or bind its outputs."


class LibraryFunction(Protocol):
    """A function that any code may call."""

    def results(
        self, evaluator: "SymbolicEvaluator", values: Sequence[SymbolicValue], wanted: int
    ) -> tuple[SymbolicValue, ...]:
        """Call the function with the values of its arguments; it may return more results than wanted."""


@dataclass(eq=False)
class EvaluationContext:
    """Context shared by all code of a block.

    Attributes:
        workspace: returns the value of a parameter by name, or None.
        parameters_first: let parameters precede the functions of the library. Fields of structs are then parameters as
            well, with names such as "Control.Gain".
        single_elements: indices select one element and must be integers, as in block fields. Else they may select
            several, and are rounded, as in generated code.
        number: returns the number of an element of a parameter where a constant is required; `frozen` is called with
            what requires it.
        functions: functions that the code defines; `find` returns those of a separate file by name.
        library: functions that any code may call; None for those of MATLAB.
        unknown: called for any other function with the evaluation of arguments, the name and the trees of its
            arguments; returns the result, or None.
        tables: builds a lookup of a parameter by name, over named breakpoints, at coordinates.
        remark: called with remarks on the code for the user, and their lines, 0 if they are not known.
        open_passes: number of passes of a loop without a known end, beyond which all that it assigns is NaN; with 0
            such a loop is an error.
        open_loop: called with the line of such a loop.
        running: the functions that are being run, the outermost first.
    """

    builder: GraphBuilder
    workspace: Callable[[str], SymbolicValue | None] = lambda name: None
    parameters_first: bool = False
    single_elements: bool = False
    number: Callable[[str, tuple[int, ...]], float | None] = lambda name, place: None
    functions: dict[str, m.FunctionDefinition] = field(default_factory=dict)
    find: Callable[[str], Mapping[str, m.FunctionDefinition]] = lambda name: {}
    library: Mapping[str, LibraryFunction] | None = None
    unknown: Hook = lambda evaluate, name, arguments: None
    tables: Tables = lambda name, axes, places, beyond: None
    frozen: Callable[[str], None] = lambda name: None
    remark: Callable[[str, int], None] = lambda sentence, line: None
    open_passes: int = 0
    open_loop: Callable[[int], None] = lambda line: None
    running: list[m.FunctionDefinition] = field(default_factory=list)
    statements: int = 0
    _first_node: int = -1
    _numbers: dict[int, float | None] = field(default_factory=dict)
    _file_functions: dict[str, m.FunctionDefinition | None] = field(default_factory=dict)
    _same_file: dict[int, Mapping[str, m.FunctionDefinition]] = field(default_factory=dict)

    def step(self) -> None:
        """Count one statement; raises `ProgramError` if there are too many statements or nodes."""
        if self._first_node < 0:
            self._first_node = len(self.builder.nodes)
        self.statements += 1
        if self.statements > MAX_STATEMENTS:
            raise ProgramError(f"it unrolls to more than {MAX_STATEMENTS} statements", _SHORTER)
        if len(self.builder.nodes) - self._first_node > MAX_NODES:
            raise ProgramError(f"it unrolls to more than {MAX_NODES} operations", _SHORTER)

    def room(self, count: float) -> None:
        """Raise `EvaluationError` if an array is too large."""
        if not count <= MAX_NODES:
            raise EvaluationError(f"it creates an array of {count:g} elements", remedy=_SHORTER)

    def function(self, name: str, nearby: Mapping[str, m.FunctionDefinition]) -> m.FunctionDefinition | None:
        """Return a function of the same text as the caller, or of a separate file."""
        if name in nearby:
            return nearby[name]
        if name not in self._file_functions:
            functions = self.find(name)
            self._file_functions[name] = functions.get(name)
            self._same_file |= dict.fromkeys(map(id, functions.values()), functions)
        return self._file_functions[name]

    def functions_near(self, function: m.FunctionDefinition) -> Mapping[str, m.FunctionDefinition]:
        """Return the functions of the same text."""
        return self._same_file.get(id(function), self.functions)

    def constant(self, node: int) -> float | None:
        """Return the number of a node that depends on no signal, with parameters at their values; else None."""
        # with an explicit stack: sums over many passes are deeper than the recursion limit
        stack, numbers = [node] if node not in self._numbers else [], self._numbers
        while stack:
            last = stack[-1]
            op, args, _ = self.builder.nodes[last]
            missing = [arg for arg in args if arg not in numbers] if op in OPERATIONS else []
            if missing and not any(arg in numbers and numbers[arg] is None for arg in args):
                stack += missing
                continue
            numbers[last] = self._evaluate_node(last)
            stack.pop()
        return numbers[node]

    def _evaluate_node(self, node: int) -> float | None:
        """Return the number of a node whose arguments are in `_numbers`."""
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


class SymbolicEvaluator(Protocol):
    """Evaluator of expressions, as indexing and library functions use it.

    `mask` are the elements that a masked assignment selects; they may be computed as all elements.
    """

    context: EvaluationContext
    builder: GraphBuilder
    mask: Nodes | None

    def value(self, tree: m.Expression) -> SymbolicValue: ...
    def number(self, tree: m.Expression, message: str = ...) -> float: ...
    def index_values(self, array: Nodes, trees: Sequence[m.Expression]) -> list[SymbolicValue]:
        """Evaluate the indices into an array, within which `end` is defined; ":" stands for all."""

    def fail_where(self, condition: Nodes) -> None:
        """Note that the code fails where a condition holds."""

    def operation(self, operator: str, left: Nodes, right: Nodes) -> Nodes: ...
    def call_named(self, name: str, values: Sequence[SymbolicValue], wanted: int) -> tuple[SymbolicValue, ...]: ...
    def call_handle(
        self, handle: MatlabFunctionHandle, values: Sequence[SymbolicValue], wanted: int
    ) -> tuple[SymbolicValue, ...]: ...
