"""A C function as nodes of a graph: its arguments, its results, and what it keeps between calls as states."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.builder import BoundedGraphBuilder, GraphBuilder, GraphTooLargeError
from kennfeld.importers.c.calibration_values import lookups, parameter_of
from kennfeld.importers.c.declarations import CFile, CFunctionDeclaration
from kennfeld.importers.c.expression_translation import COperand, PassedNames, converted
from kennfeld.importers.c.functions import LIBRARY, written_last
from kennfeld.importers.c.interface import (
    CInterface,
    CNumbers,
    argument_numbers,
    find_interface,
    result_numbers,
    settle,
    static_numbers,
)
from kennfeld.importers.c.number_types import DOUBLE, UnsupportedCError
from kennfeld.importers.c.statement_translation import FunctionTranslation, translate_shared
from kennfeld.importers.c.struct_types import TAG
from kennfeld.importers.c.usage import Usage, usage_of
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.program import tree as m

OPEN_PASSES: Final = 50  # such as whole turns that `while (angle > pi) angle -= 2 * pi` takes off
_NUMBER: Final = "number"
_UNKNOWN: Final = "unknown name "
_UNNAMED: Final = (_UNKNOWN, "unknown function ")  # how problems begin that one declaration solves


@dataclass(frozen=True)
class TranslatedFunction:
    """A function and those that it calls, in the shared syntax tree.

    Attributes:
        function: its declaration.
        functions: the functions by name.
        statics: the numbers that keep their values.
        interface: inputs, outputs, states and calibration values.
        values: the calibration values.
        prefix: text that precedes the names of calibration values.
        remarks: what is computed differently from C.
        problems: why it cannot be a graph, with lines; empty if it can.
        open_loops: lines of loops whose end is not known, which are followed for `OPEN_PASSES` passes.
    """

    function: CFunctionDeclaration
    functions: Mapping[str, m.FunctionDefinition]
    statics: tuple[CNumbers, ...]
    interface: CInterface
    values: ParameterSet = ParameterSet()
    prefix: str = ""
    remarks: tuple[str, ...] = ()
    problems: tuple[UnsupportedCError, ...] = ()
    open_loops: tuple[int, ...] = ()

    def write(
        self, builder: GraphBuilder, arguments: Sequence[int], note: Callable[[int], None] = lambda line: None
    ) -> list[int]:
        """Add the nodes of a call to a graph; return those of the results.

        `note` is called with the lines of loops whose end is not known.
        """
        call = _FunctionCall(self, builder, note)
        last = call.run(arguments)
        for number in self.interface.written:
            if number.name in self.interface.states:
                call.close(number, last[number.name])
        results = [
            _shown(builder, number, last) for number in (*result_numbers(self.function), *self.interface.outputs)
        ]
        return [int(node) for nodes in results for node in nodes.ravel()]

    @property
    def outputs(self) -> list[str]:
        """The names of the results."""
        numbers = (*result_numbers(self.function), *self.interface.outputs)
        return [label for number in numbers for label in number.labels]

    @property
    def states(self) -> list[str]:
        """The names of what it keeps between calls."""
        kept = (number for number in self.interface.written if number.name in self.interface.states)
        kept = (number for number in kept if not number.leaf.is_tag)
        return [label for number in kept for label in number.labels]

    @property
    def inputs(self) -> list[str]:
        """The names of the arguments that a call in a model takes."""
        return [label for number in self.interface.inputs for label in number.labels]


class _FunctionCall:
    """One call of a function, with its states open in a graph."""

    def __init__(
        self, translated: TranslatedFunction, builder: GraphBuilder, note: Callable[[int], None] = lambda line: None
    ) -> None:
        self.translated, self.builder = translated, builder
        context = EvaluationContext(
            builder, functions=dict(translated.functions), library=LIBRARY, open_passes=OPEN_PASSES, open_loop=note
        )
        self.interpreter = StatementInterpreter(context)
        self.first: dict[str, Nodes] = {}
        self.reads: dict[str, Nodes] = {}

    def run(self, arguments: Sequence[int]) -> dict[str, Nodes]:
        """Run the function; return the nodes of what it returns and writes."""
        values = self._values(arguments)
        kept = {static.name for static in self.translated.statics}
        self.interpreter.state.kept.update({(GLOBAL, name): values[name] for name in kept})
        definition = self.translated.functions[f"{self.translated.function.name}()"]
        # the call takes all arguments, also those that the function neither reads nor writes
        unused = [each for each in argument_numbers(self.translated.function) if each.name not in values]
        values |= {number.name: _unset(number) if number.is_result else self.started(number) for number in unused}
        passed = [values[name] for name in definition.parameters]
        results = self.interpreter.call(definition, passed, len(definition.results))
        last = dict(zip(definition.results, results, strict=True))
        last |= {name: self.interpreter.state.kept[GLOBAL, name] for name in kept}
        names = {number.name for number in self.translated.interface.written}
        names.update(self.translated.function.result_names)
        return {name: np.asarray(s.as_array(value, name)) for name, value in last.items() if name in names}

    def close(self, number: CNumbers, last: Nodes) -> None:
        """Set the first and the next values of states."""
        if last.size != self.reads[number.name].size:
            raise ProgramError(f"an index of {number.label} is out of range")
        for parts in zip(self.reads[number.name].ravel(), self.first[number.name].ravel(), last.ravel(), strict=True):
            self.builder.close(*map(int, parts))

    def _values(self, arguments: Sequence[int]) -> dict[str, s.SymbolicValue]:
        interface = self.translated.interface
        values: dict[str, s.SymbolicValue] = {static.name: self.started(static) for static in self.translated.statics}
        inputs = iter(arguments)
        for number in interface.inputs:
            nodes = np.array([next(inputs) for _ in number.labels], dtype=np.int64)
            values[number.name] = self._converted(number, nodes)
        for number in interface.parameters:
            values[number.name] = self._converted(number, lookups(self.builder, number, self.translated.prefix))
        for number in interface.written:
            if number.name in interface.states:
                values[number.name] = self._opened(number)
            elif number.mode:
                values[number.name] = _unset(number) if number.is_result else self.started(number)
        return values

    def started(self, number: CNumbers) -> Nodes:
        """Return the nodes of first values; 0 for those of arguments."""
        if number.first is not None:
            return np.asarray(self.interpreter.nodes(number.first, number.label))
        return _shaped(number, np.full(len(number.labels), self.builder.const(0.0), dtype=np.int64))

    def _opened(self, number: CNumbers) -> Nodes:
        self.first[number.name] = self.started(number)
        states = [self.builder.state() for _ in number.labels]
        self.reads[number.name] = _shaped(number, np.array(states, dtype=np.int64))
        return self.reads[number.name]

    def _converted(self, number: CNumbers, nodes: Nodes) -> Nodes:
        """Return numbers in the type that C stores them in."""
        tree = converted(COperand(m.Name(_NUMBER), DOUBLE), number.leaf.type)
        results = []
        for node in nodes:
            self.interpreter.names[_NUMBER] = np.array([[int(node)]], dtype=np.int64)
            results.append(int(self.interpreter.nodes(tree, number.label).item()))
        return _shaped(number, np.array(results, dtype=np.int64))


def _unset(number: CNumbers) -> s.InvalidValue:
    return s.InvalidValue(f"{number.label} is read before it is assigned, or not assigned in every case")


def _shown(builder: GraphBuilder, number: CNumbers, last: Mapping[str, Nodes]) -> Nodes:
    """Return the nodes of a result: NaN for a member of a union, if another one was written last."""
    nodes = last[number.name]
    for path, member in number.leaf.unions:
        tag = last.get(f"{number.root.name}{path}")
        nodes = nodes if tag is None else written_last(builder, nodes, tag, member)
    return nodes


def _shaped(number: CNumbers, nodes: Nodes) -> Nodes:
    sizes = number.leaf.sizes
    return nodes.reshape(sizes if len(sizes) > 1 else (-1, 1))


def translate(file: CFile, function: CFunctionDeclaration, prefix: str = "") -> TranslatedFunction:
    """Translate a function of a file with all functions that it calls; `problems` lists what is not supported.

    Args:
        file: the declarations of the file.
        function: the function.
        prefix: text that precedes the names of its calibration values.
    """
    shared, parts, unreadable = translate_shared(file)
    translations = {name: FunctionTranslation(file, declared, shared) for name, declared in file.functions.items()}
    functions = {f"{name}()": translation.translate() for name, translation in translations.items()}
    called = [translations[name] for name in _called(function.name, translations)]
    problems = [problem for translation in called for problem in translation.problems]
    reasons = {f"{_UNKNOWN}{problem.name}": problem for problem in unreadable}
    # several functions, or places of one, may use what is not known, or a variable that cannot be read
    distinct: dict[tuple[str, int], UnsupportedCError] = {}
    for problem in (reasons.get(each.message, each) for each in problems):
        line = 0 if problem.message.startswith(_UNNAMED) else problem.line
        distinct.setdefault((problem.message, line), problem)
    problems = list(distinct.values())
    statics = [static_numbers(part, file) for part in parts]
    statics += [static_numbers(part, file) for translation in called for part in translation.statics]
    arguments = list(argument_numbers(function))
    usage = usage_of(f"{function.name}()", functions)
    problems += _wrong_arguments(arguments, usage)
    problems += [
        each for name in _called(function.name, translations) for each in _lost(file.functions[name], functions)
    ]
    problems += _overlaps([*(each for each in arguments if each.mode != "value"), *statics], usage)
    if not problems:
        problems += [problem for translation in called for problem in _aliases(translation.passed, functions)]
    others = {name for own in functions for name in usage_of(own, functions).writes}
    interface = find_interface(arguments, statics, usage, others)
    statics = [static for static in statics if static.name in usage.reads or static.name in usage.writes]
    remarks = dict.fromkeys(remark for translation in called for remark in translation.remarks)
    whole = TranslatedFunction(
        function, functions, tuple(statics), interface, prefix=prefix, remarks=tuple(remarks), problems=tuple(problems)
    )
    if problems:
        return whole
    whole = _completed(whole, usage)
    own = {f"{name}()" for name in _called(function.name, translations)}
    return replace(whole, remarks=(*whole.remarks, *_kept_arguments(whole), *_initializations(whole, own)))


def _kept_arguments(whole: TranslatedFunction) -> Iterator[str]:
    """Yield remarks about numbers that a function reads and writes through their addresses."""
    for number in whole.interface.written:
        if number.is_result and number.name in whole.interface.states:
            yield f"{number.label} is read and written through its address: it keeps its value between calls"


def _initializations(whole: TranslatedFunction, own: Collection[str]) -> Iterator[str]:
    """Yield remarks about functions that set states before the first call, which is not known to the graph."""
    states = {number.name: number.label for number in whole.interface.written if not number.mode}
    for name in whole.functions:
        if name not in own and "init" in name.casefold():
            usage = usage_of(name, whole.functions)
            written = [label for key, label in states.items() if key in usage.writes & whole.interface.states]
            if written:
                yield f"{name.removesuffix('()')} sets {join_names(written, 3)}, but is not run: edit the first values"


def _called(name: str, translations: Mapping[str, FunctionTranslation]) -> Iterator[str]:
    """Yield the names of a function and of all that it calls."""
    waiting, seen = [name], {name}
    while waiting:
        name = waiting.pop(0)
        yield name
        following = [other for other in translations[name].calls if other not in seen]
        seen.update(following)
        waiting += following


def _wrong_arguments(arguments: Iterable[CNumbers], usage: Usage) -> Iterator[UnsupportedCError]:
    for number in arguments:
        if 0 in number.leaf.sizes and (number.name in usage.reads or number.name in usage.writes):
            message = f"the argument {number.label} is an array of unknown size; write its size, as in float x[4]"
            yield UnsupportedCError(message, number.line)


def _overlaps(numbers: Sequence[CNumbers], usage: Usage) -> Iterator[UnsupportedCError]:
    """Yield problems of members of unions that a function reads, although it writes other members only."""
    for number in numbers:
        for path, member in number.leaf.unions:
            tag = f"{number.root.name}{path}"
            others = [
                each.label
                for each in numbers
                for own, at in each.leaf.unions
                if each.root is number.root and own == path and at != member and each.name in usage.writes
            ]
            if tag in usage.writes and number.name in usage.reads - usage.writes and others:
                message = f"{number.label} is read, but {join_names(others, 2)} is written, which overlaps with it"
                yield UnsupportedCError(message, number.line)


def _lost(function: CFunctionDeclaration, functions: Mapping[str, m.FunctionDefinition]) -> Iterator[UnsupportedCError]:
    """Yield problems of numbers that a function sets through pointers of a struct which it gets by value."""
    writes = usage_of(f"{function.name}()", functions).writes
    for argument in function.arguments:
        for leaf in argument.variable.leaves if argument.mode == "value" else ():
            label = f"{argument.variable.name}{leaf.path}"
            if leaf.owner[0] and label in writes:
                message = f"{function.name} sets {label} through a pointer of a struct that it gets by value"
                yield UnsupportedCError(f"{message}, which is not supported", function.line)


def _aliases(
    passed: Sequence[PassedNames], functions: Mapping[str, m.FunctionDefinition]
) -> Iterator[UnsupportedCError]:
    """Yield problems of calls that pass the address of a number which the function can change by another name."""
    for call in passed:
        usage = usage_of(f"{call.function}()", functions)
        for name in dict.fromkeys(call.names):
            # numbers are copied into a call and back after it: what is written by one name would not be read by the
            # other
            is_twice = call.names.count(name) > 1 and name in call.changed
            is_shared = name in usage.writes or (name in usage.reads and name in call.changed)
            if is_twice or (is_shared and (name.startswith(".") or "()." in name)):
                label = name.removeprefix(".").partition(f".{TAG}")[0] or "a union"
                message = f"{call.function} can change {label} by two names, which is not supported"
                yield UnsupportedCError(message, call.line)


def _completed(whole: TranslatedFunction, usage: Usage) -> TranslatedFunction:
    """Return a function with its outputs, states and calibration values, after it was written once."""
    try:
        whole = replace(whole, interface=_settled(whole, usage), values=_calibration_values(whole))
        if not whole.outputs:
            raise ProgramError(_without_result(whole.function), line=whole.function.line)
        builder = BoundedGraphBuilder()
        lines = set[int]()
        whole.write(builder, [builder.input(name) for name in whole.inputs], lines.add)
    except ProgramError as error:
        problem = UnsupportedCError(error.message, error.line or whole.function.line)
    except UnsupportedCError as error:
        problem = error
    except AbortedPathError:
        problem = UnsupportedCError("an index is always out of range of its array", whole.function.line)
    except (GraphTooLargeError, RecursionError):
        problem = UnsupportedCError("it is too large or nested too deeply", whole.function.line)
    else:
        return replace(whole, open_loops=tuple(sorted(lines)))
    return replace(whole, problems=(problem,))


def _without_result(function: CFunctionDeclaration) -> str:
    """Return why a function has no result."""
    if not function.passed_back:
        return f"{function.name} has no result: it returns and writes nothing"
    reason = f"it returns an address, that of its argument {function.passed_back}, and writes nothing there"
    return f"{function.name} has no number as a result: {reason}. Choose a function that calls it"


def _settled(whole: TranslatedFunction, usage: Usage) -> CInterface:
    """Return the interface with outputs and states: a value matters if the graph of the next values reads it."""
    # all that is written is a state at first; those stay whose values before the call reach a value after it.
    # A number behind a pointer that is only written is none: where it is not assigned, a result is missing
    everything = frozenset(
        number.name for number in whole.interface.written if not number.is_result or number.name in usage.reads
    )
    trial = replace(whole, interface=replace(whole.interface, states=everything))
    builder = BoundedGraphBuilder()
    call = _FunctionCall(trial, builder)
    last = call.run([builder.input(name) for name in whole.inputs])
    seen = _ancestors(builder, (int(node) for nodes in last.values() for node in nodes.ravel()))
    needed = {name for name, nodes in call.reads.items() if not seen.isdisjoint(nodes.ravel().tolist())}
    return settle(whole.interface, usage, needed, returns=whole.function.result is not None)


def _ancestors(builder: GraphBuilder, nodes: Iterable[int]) -> set[int]:
    seen = set(nodes)
    waiting = list(seen)
    while waiting:
        arguments = [node for node in builder.nodes[waiting.pop()].args if node not in seen]
        seen.update(arguments)
        waiting += arguments
    return seen


def _calibration_values(whole: TranslatedFunction) -> ParameterSet:
    call = _FunctionCall(whole, GraphBuilder())
    parameters = []
    for number in whole.interface.parameters:
        nodes = call.started(number)
        values = call.interpreter.context.numbers(nodes, number.label)
        if values is None:
            raise UnsupportedCError(f"the first value of {number.label} is not a constant", number.line)
        parameters.append(parameter_of(number, values.ravel().tolist(), whole.prefix))
    return ParameterSet(parameters)
