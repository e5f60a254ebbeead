"""A C function as nodes of a graph: its arguments, its results, and its static variables as states."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from kennfeld.graph.builder import BoundedGraphBuilder, GraphBuilder, GraphTooLargeError
from kennfeld.lazy_dataclass import dataclass
from kennfeld.matlab import syntax as m
from kennfeld.matlab.traversal import assigned_name
from kennfeld.models.c_code.declarations import CFile, CFunctionDeclaration, StaticVariable
from kennfeld.models.c_code.expression_translation import Operand, converted
from kennfeld.models.c_code.functions import LIBRARY
from kennfeld.models.c_code.number_types import DOUBLE, UnsupportedCError
from kennfeld.models.c_code.statement_translation import FunctionTranslation, translate_shared
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter

_ARGUMENT: Final = "argument"


@dataclass(frozen=True)
class TranslatedFunction:
    """A function and those that it calls, in the shared syntax tree.

    Attributes:
        function: its declaration.
        functions: the functions by name.
        statics: the variables that keep their values.
        changed: names of those that the functions assign, which become states.
        remarks: what is computed differently from C.
        problems: why it cannot be a graph, with lines; empty if it can.
    """

    function: CFunctionDeclaration
    functions: Mapping[str, m.FunctionDefinition]
    statics: tuple[StaticVariable, ...]
    changed: frozenset[str]
    remarks: tuple[str, ...] = ()
    problems: tuple[UnsupportedCError, ...] = ()

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> list[int]:
        """Add the nodes of a call to a graph; return those of the results."""
        context = EvaluationContext(builder, functions=dict(self.functions), library=LIBRARY)
        interpreter = StatementInterpreter(context)
        first = {
            static.variable.name: np.asarray(interpreter.nodes(static.first, static.variable.name))
            for static in self.statics
        }
        reads = {name: self._opened(builder, name, nodes) for name, nodes in first.items()}
        interpreter.state.kept.update({(GLOBAL, name): nodes for name, nodes in reads.items()})
        results = self._called(interpreter, arguments)
        for name in self.changed:
            last = np.asarray(s.as_array(interpreter.state.kept[GLOBAL, name], name))
            for read, init, following in zip(reads[name].ravel(), first[name].ravel(), last.ravel(), strict=True):
                builder.close(int(read), int(init), int(following))
        return results

    def _opened(self, builder: GraphBuilder, name: str, first: Nodes) -> Nodes:
        if name not in self.changed:
            return first
        return np.array([builder.state() for _ in first.ravel()], dtype=np.int64).reshape(first.shape)

    def _called(self, interpreter: StatementInterpreter, arguments: Sequence[int]) -> list[int]:
        values: list[s.SymbolicValue] = []
        inputs = iter(arguments)
        for argument in self.function.arguments:
            name = argument.variable.name
            if argument.mode == "value":
                interpreter.names[_ARGUMENT] = np.array([[next(inputs)]], dtype=np.int64)
                tree = converted(Operand(m.Name(_ARGUMENT), DOUBLE), argument.variable.type)
                values.append(interpreter.nodes(tree, name))
            else:
                values.append(s.InvalidValue(f"{name} is read before it is assigned, or not assigned in every case"))
        definition = self.functions[f"{self.function.name}()"]
        results = interpreter.call(definition, values, len(definition.results))
        nodes = []
        for name, value in zip(definition.results, results, strict=True):
            array = s.as_array(value, name)
            if array.size != 1:
                raise ProgramError(f"the result {name} is an array")
            nodes.append(int(array.item()))
        return nodes


def translate(file: CFile, function: CFunctionDeclaration) -> TranslatedFunction:
    """Translate a function of a file with all functions that it calls; `problems` lists what is not supported."""
    shared, statics, problems = translate_shared(file)
    functions: dict[str, m.FunctionDefinition] = {}
    remarks: dict[str, None] = {}
    waiting = [function.name]
    while waiting:
        name = waiting.pop()
        if f"{name}()" in functions:
            continue
        translation = FunctionTranslation(file, file.functions[name], shared)
        functions[f"{name}()"] = translation.translate()
        statics += translation.statics
        problems += translation.problems
        remarks |= translation.remarks
        waiting += [
            called for called in file.functions if f"{called}()" not in functions and called in translation.calls
        ]
    changed = frozenset(_assigned(functions.values())) & {static.variable.name for static in statics}
    for argument in function.arguments:
        if argument.mode == "input" or argument.variable.is_array:
            message = f"the argument {argument.variable.name} is an array; arguments must be numbers"
            problems.append(UnsupportedCError(message, function.line, wrong=True))
    if function.result is None and not function.outputs:
        problems.append(UnsupportedCError(f"{function.name} has no result", function.line, wrong=True))
    whole = TranslatedFunction(function, functions, tuple(statics), changed, tuple(remarks))
    problems = problems or _trial(whole)
    return TranslatedFunction(function, functions, tuple(statics), changed, tuple(remarks), tuple(problems))


def _trial(translated: TranslatedFunction) -> list[UnsupportedCError]:
    """Write the function once, to see whether a graph can express it."""
    builder = BoundedGraphBuilder()
    names = [x.variable.name for x in translated.function.arguments if x.mode == "value"]
    try:
        translated.write(builder, [builder.input(name) for name in names])
    except ProgramError as error:
        return [UnsupportedCError(error.message, error.line or translated.function.line)]
    except (AbortedPathError, GraphTooLargeError, RecursionError):
        return [UnsupportedCError("it is too large or nested too deeply", translated.function.line)]
    return []


def _assigned(functions: Iterable[m.FunctionDefinition]) -> set[str]:
    """Return the names of all variables that functions assign."""
    names: set[str] = set()
    waiting: list[m.Statement] = [statement for function in functions for statement in function.body]
    while waiting:
        match waiting.pop():
            case m.Assign(targets, _):
                names |= {assigned_name(target) for target in targets if target is not None}
            case m.If(branches, otherwise):
                waiting += [statement for branch in branches for statement in branch.body]
                waiting += otherwise
            case m.While(_, body):
                waiting += body
    return names
