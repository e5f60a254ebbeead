"""MATLAB Function blocks: arguments, results and persistent variables."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.importers.simulink.expressions.code_parameters import resolve_parameter
from kennfeld.importers.simulink.expressions.parameter_expressions import parameter_value_at
from kennfeld.importers.simulink.lowering.block_context import BlockContext
from kennfeld.importers.simulink.lowering.diagnostics import BUS_REMEDY, UnsupportedError
from kennfeld.importers.simulink.lowering.integer_signals import integer_type_of
from kennfeld.importers.simulink.lowering.parameter_fields import variable_field
from kennfeld.importers.simulink.reader.dialog_words import begins_with_word
from kennfeld.importers.simulink.signals import CONSTANT, Bus, ExternalBus, Signal, SignalOrBus, as_vector, period_of
from kennfeld.importers.simulink.variables.mask_scope import names_assigned_by_functions
from kennfeld.matlab.parser import parse_script
from kennfeld.matlab.values import MatlabStruct
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY, AbortedPathError, ProgramError
from kennfeld.models.imperative.library.function_registry import matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, align_dimensions
from kennfeld.models.imperative.persistent_variables import (
    FirstCallObserver,
    Key,
    PersistentVariable,
    PersistentVariables,
    initial_persistents,
    late_persistents,
)
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.models.imperative.symbolic_values import InvalidValue, SymbolicValue, field_of, integers
from kennfeld.program import tree as m
from kennfeld.program.traversal import declares_persistent

_DEFINE_REMEDY: Final = "Define it in a script, a .mat, .sldd or calibration file given as parameters."
_BLOCK: Final = "the function of the block"
_MOST_ROUNDS: Final = 20
_PARAMETER: Final = "PARAMETER_DATA"


def matlab_function(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the results of the function in the order of its outputs."""
    try:
        return _outputs(block)
    except ProgramError as error:
        raise UnsupportedError(str(error), error.remedy) from None
    except AbortedPathError:
        raise UnsupportedError("its code ends in an error on every path", DEFAULT_REMEDY) from None
    except RecursionError:
        raise UnsupportedError("its code is nested too deeply", DEFAULT_REMEDY) from None


def _outputs(block: BlockContext) -> tuple[SignalOrBus, ...]:
    script = _script(block)
    function = script.functions[0]
    context = _evaluation_context(block, {function.name: function for function in script.functions[1:]})
    call = _Call(block, context, function, _arguments(block, function))
    results = call.results()
    period = period_of(block.input_or_bus(at) for at in range(_ports(block)))
    # persistent variables may change although all inputs are constant
    period = 0.0 if block.memories and period == CONSTANT else period
    chart = block.flat.block.chart
    shown = {data.name for data in chart.data if data.scope == "OUTPUT_DATA"} if chart is not None else set()
    named = zip(function.results, results, strict=False)
    outputs = [value for name, value in named if not shown or name in shown]
    return tuple(_wired(value, period) for value in (*outputs, *call.stores))


def _script(block: BlockContext) -> m.Script:
    try:
        script = parse_script(block.flat.block.script, block.flat.path)
    except InputError as error:
        raise UnsupportedError(str(error.findings[0]), DEFAULT_REMEDY) from None
    if not script.functions or script.statements:
        raise UnsupportedError("its code does not define a function", DEFAULT_REMEDY)
    return script


def _ports(block: BlockContext) -> int:
    """Return the number of inputs that are ports; the others are data stores."""
    return block.input_count - len(block.flat.code_stores)


def _evaluation_context(block: BlockContext, functions: Mapping[str, m.FunctionDefinition]) -> EvaluationContext:
    expressions, scope = block.compiler.expressions, block.flat.scope

    def frozen(message: str) -> None:
        expressions.frozen[f"{block.flat.path}: {message}"] = "it must be constant in code"

    return EvaluationContext(
        block.builder,
        workspace=partial(resolve_parameter, expressions, scope),
        number=partial(parameter_value_at, expressions),
        functions=dict(functions),
        find=block.compiler.files.find,
        frozen=frozen,
        remark=lambda sentence, line: block.warn(f"calls a bit function: {sentence}"),
        tables=partial(_look_up, block),
    )


def _look_up(
    block: BlockContext, name: str, axes: list[tuple[Numbers, str]], places: list[Nodes], beyond: str
) -> Nodes | None:
    """Look up a variable as a table; None if it is not one, or does not match its breakpoints."""
    try:
        table = variable_field(block, name)
        parameter_axes = [Axis(points, name=group) for points, group in axes]
    except (UnsupportedError, ArgumentError):
        return None
    shape = tuple(points.size for points, _ in axes)
    # MATLAB stores a curve as a row or a column
    values = table.values.ravel() if len(shape) == 1 else table.values
    if values.shape != shape:
        return None
    parameter = block.compiler.declared.table(table.name, values, parameter_axes, table.variable, False, beyond)
    # a lookup for each element of the coordinates
    spread = np.broadcast_arrays(*align_dimensions(*places))
    columns = zip(*(coordinate.ravel() for coordinate in spread), strict=True)
    nodes = [block.builder.lookup(parameter.name, *(int(node) for node in place)) for place in columns]
    return np.array(nodes, dtype=np.int64).reshape(spread[0].shape)


def _arguments(block: BlockContext, function: m.FunctionDefinition) -> list[SymbolicValue]:
    """Return the arguments in order: inputs, and parameters if specified or if no input is left."""
    chart = block.flat.block.chart
    fixed = {data.name for data in chart.data if data.scope == _PARAMETER} if chart is not None else set()
    expressions, values, at = block.compiler.expressions, list[SymbolicValue](), 0
    for name in function.parameters:
        if name not in fixed and at < _ports(block):
            values.append(_input_value(block, at, name))
            at += 1
            continue
        value = resolve_parameter(expressions, block.flat.scope, name)
        if value is None and name in fixed:
            raise UnsupportedError(f"its parameter {name} has no value", _DEFINE_REMEDY, name)
        values.append(
            value if value is not None else InvalidValue(f"the parameter {name} has no value", _DEFINE_REMEDY)
        )
    return values


def _input_value(block: BlockContext, at: int, name: str) -> SymbolicValue:
    """Return an input as a variable with the integer type that the block or its signal specifies."""
    wired, chart = block.input_or_bus(at), block.flat.block.chart
    stated = next((data.type for data in chart.data if data.name == name), "") if chart is not None else ""
    if isinstance(wired, ExternalBus) and not wired.members and begins_with_word(stated, "Bus:"):
        why = f"the elements of its input {name} are unknown: {wired.why}"
        return InvalidValue(why, BUS_REMEDY)
    value = _to_symbolic(wired)
    word = matlab_word(stated) or integer_type_of(block.source(at))
    return integers(value, word) if isinstance(value, np.ndarray) else value


def _to_symbolic(wired: SignalOrBus) -> SymbolicValue:
    """Return a signal as a variable: a vector as a column, a bus as a struct."""
    # an element of an unknown bus is a number until something selects its elements
    if isinstance(wired, ExternalBus) and not wired.members:
        return wired.signal.matrix
    if isinstance(wired, Bus):
        return MatlabStruct.of({name: _to_symbolic(member) for name, member in wired.members.items()})
    return wired.matrix


def _wired(nodes: SymbolicValue, period: float) -> SignalOrBus:
    if isinstance(nodes, MatlabStruct):
        return Bus({name: _wired(field_of(nodes, name), period) for name in nodes.fields})
    if isinstance(nodes, InvalidValue):
        raise ProgramError(nodes.why, nodes.remedy or DEFAULT_REMEDY)
    if not isinstance(nodes, np.ndarray) or nodes.size == 0:
        raise ProgramError("one of its outputs is neither numeric nor a struct of numbers")
    return Signal(as_vector(np.asarray(nodes)), period)


@dataclass(eq=False)
class _Call:
    """Call of a block's function in one step, with its persistent variables."""

    block: BlockContext
    context: EvaluationContext
    function: m.FunctionDefinition
    arguments: list[SymbolicValue]
    stores: tuple[SymbolicValue, ...] = ()

    def results(self) -> tuple[SymbolicValue, ...]:
        """Call the function, and read and write its persistent variables."""
        functions = (self.function, *self.context.functions.values())
        if not any(declares_persistent(function.body) for function in functions):
            return self._run(self._prepare())
        known = self._observe_first_call()
        # a persistent variable that a later call creates first takes another round, in which it is a state
        for _ in range(_MOST_ROUNDS):
            body = self._prepare()
            persistent = PersistentVariables(self.context, self._remember)
            for key, memory in known.items():
                body.state.kept[key] = persistent.begun(memory, partial(self._value_kept, body, key))
            results = self._run(body)
            more = late_persistents(self.context, body.state.kept, known)
            if not more:
                return results
            known |= more
        raise ProgramError("the sizes of its persistent variables cannot be determined")

    def _prepare(self) -> StatementInterpreter:
        """Prepare an interpreter with the contents of the data stores that the code uses."""
        body = StatementInterpreter(self.context)
        for at, name in enumerate(self.block.flat.code_stores, _ports(self.block)):
            body.state.kept[GLOBAL, name] = _to_symbolic(self.block.input_or_bus(at))
        return body

    def _value_kept(self, body: StatementInterpreter, key: Key) -> SymbolicValue | None:
        return body.state.kept.get(key)

    def _run(self, body: StatementInterpreter) -> tuple[SymbolicValue, ...]:
        # the limit on statements is one for each run, of which there are several while variables are found
        self.context.statements = 0
        before = dict(body.state.kept)
        results = body.call(self.function, self.arguments, len(self.function.results), _BLOCK)
        self.stores = tuple(self._final_value(body, before, name) for name in self.block.flat.code_stores)
        return results

    def _final_value(self, body: StatementInterpreter, before: Mapping[Key, SymbolicValue], name: str) -> SymbolicValue:
        value = body.state.kept[GLOBAL, name]
        if value is not before[GLOBAL, name] and name not in names_assigned_by_functions(self.block.flat.block.script):
            raise ProgramError(
                f"a function file writes the data store {name}, which is not supported",
                "Write the data store in the block's own code.",
            )
        return value

    def _observe_first_call(self) -> dict[Key, PersistentVariable]:
        """Return the persistent variables as the first call creates them."""
        body = self._prepare()
        scout = FirstCallObserver(self.context, body)
        body.watch = scout.watch
        self._run(body)
        return initial_persistents(scout, body.state.kept, body.questions)

    def _remember(self, init: Nodes, end: Callable[[], Nodes]) -> Nodes:
        def then(_: Signal) -> Signal:
            try:
                return Signal(end())
            except ProgramError as error:
                raise UnsupportedError(str(error), error.remedy) from None

        return self.block.discrete_state(Signal(init, CONSTANT), then).nodes
