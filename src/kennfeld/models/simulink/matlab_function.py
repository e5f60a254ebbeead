"""MATLAB Function blocks: their code as a graph."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from kennfeld.errors import ArgumentError, InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY, AbortedPathError, ProgramError
from kennfeld.models.imperative.library.function_registry import matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, aligned
from kennfeld.models.imperative.persistent_variables import (
    FirstCallObserver,
    Key,
    PersistentVariable,
    PersistentVariables,
    declares_persistent,
    initial_persistents,
    late_persistents,
)
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.models.imperative.symbolic_values import InvalidValue, SymbolicStruct, SymbolicValue, field_of, integers
from kennfeld.models.simulink.expressions.parameter_expressions import parameter_value_at, resolve_parameter
from kennfeld.models.simulink.flattening.integer_signals import integer_type_of
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import named_text
from kennfeld.models.simulink.signals import CONSTANT, Bus, Signal, SignalOrBus, as_vector, fastest_sample_time
from kennfeld.models.simulink.variables.mask_scope import names_assigned_by_functions
from kennfeld.parameters import Axis

__all__ = []

_GIVE: Final = "Give it among the parameters: a script, a .mat, .sldd or calibration file."
_BLOCK: Final = "the function of the block"
_MOST_ROUNDS: Final = 20
_PARAMETER: Final = "PARAMETER_DATA"


def matlab_function(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """What the function's results are, in the order in which it names them."""
    try:
        return _outputs(site)
    except ProgramError as error:
        raise UnsupportedError(str(error), error.remedy) from None
    except AbortedPathError:
        raise UnsupportedError("its code ends in an error in every case", DEFAULT_REMEDY) from None
    except RecursionError:
        raise UnsupportedError("its code is nested too deeply", DEFAULT_REMEDY) from None


def _outputs(site: BlockContext) -> tuple[SignalOrBus, ...]:
    script = _script(site)
    function = script.functions[0]
    context = _desk_of(site, {one.name: one for one in script.functions[1:]})
    given = _given(site, function)
    work = _Call(site, context, function, given)
    results = work.results()
    period = fastest_sample_time([site.wired(at).period for at in range(_ports(site))])
    period = 0.0 if site.memories and period == CONSTANT else period
    shown = _shown(site)
    named = zip(function.results, results, strict=False)
    made = [one for name, one in named if not shown or name in shown]
    return tuple(_wired(one, period) for one in (*made, *work.left))


def _script(site: BlockContext) -> m.Script:
    try:
        script = parse_script(site.atom.block.script, site.atom.path)
    except InputError as error:
        raise UnsupportedError(str(error.findings[0]), DEFAULT_REMEDY) from None
    if not script.functions or script.statements:
        raise UnsupportedError("its code is no function", DEFAULT_REMEDY)
    return script


def _ports(site: BlockContext) -> int:
    """How many of its inputs are ports; the others are data stores."""
    return site.count - len(site.atom.shared)


def _shown(site: BlockContext) -> set[str]:
    """The results that are outputs, where the block says which are."""
    chart = site.atom.block.chart
    return {one.name for one in chart.data if one.scope == "OUTPUT_DATA"} if chart is not None else set()


def _desk_of(site: BlockContext, functions: Mapping[str, m.FunctionDefinition]) -> EvaluationContext:
    """What the code of a block shares."""
    expressions, scope = site.compiler.expressions, site.atom.scope

    def frozen(message: str) -> None:
        expressions.frozen[f"{site.atom.path}: {message}"] = "it must be fixed in code"

    return EvaluationContext(
        site.builder,
        workspace=partial(resolve_parameter, expressions, scope, enumeration=site.compiler.files.enumeration),
        number=partial(parameter_value_at, expressions),
        functions=dict(functions),
        find=site.compiler.files.find,
        frozen=frozen,
        remark=lambda sentence: site.remark(f"calls a function of bits: {sentence}"),
        tables=partial(_looked_up, site),
    )


def _looked_up(
    site: BlockContext, name: str, axes: list[tuple[Numbers, str]], places: list[Nodes], beyond: str
) -> Nodes | None:
    """A lookup of the variable of a name; None where it is none, or does not fit its breakpoints."""
    try:
        table = named_text(site, name)
        made_axes = [Axis(points, name=group) for points, group in axes]
    except (UnsupportedError, ArgumentError):
        return None
    shape = tuple(points.size for points, _ in axes)
    values = table.values.ravel() if len(shape) == 1 else table.values
    if values.shape != shape:
        return None
    made = site.compiler.declared.table(table.name, values, made_axes, table.variable, False, beyond)
    spread = np.broadcast_arrays(*aligned(*places))
    columns = zip(*(one.ravel() for one in spread), strict=True)
    nodes = [site.builder.lookup(made.name, *(int(node) for node in place)) for place in columns]
    return np.array(nodes, dtype=np.int64).reshape(spread[0].shape)


# arguments and results


def _given(site: BlockContext, function: m.FunctionDefinition) -> list[SymbolicValue]:
    """The arguments in their order: inputs, and parameters where the block says so or no input is left."""
    chart = site.atom.block.chart
    fixed = {one.name for one in chart.data if one.scope == _PARAMETER} if chart is not None else set()
    expressions, made, at = site.compiler.expressions, list[SymbolicValue](), 0
    for name in function.parameters:
        if name not in fixed and at < _ports(site):
            made.append(_typed(site, at, name))
            at += 1
            continue
        held = resolve_parameter(expressions, site.atom.scope, name)
        if held is None and name in fixed:
            raise UnsupportedError(f"its parameter {name} has no value", _GIVE, name)
        made.append(held if held is not None else InvalidValue(f"{name} is a parameter that has no value", _GIVE))
    return made


def _typed(site: BlockContext, at: int, name: str) -> SymbolicValue:
    """An input as a variable, of the integer type that the block states for it or that its signal has."""
    held, chart = _held(site.wired(at)), site.atom.block.chart
    stated = next((one.type for one in chart.data if one.name == name), "") if chart is not None else ""
    word = matlab_word(stated) or integer_type_of(site.source(at))
    return integers(held, word) if isinstance(held, np.ndarray) else held


def _held(wired: SignalOrBus) -> SymbolicValue:
    """A signal as a variable: a vector is a column, a bus a struct."""
    if isinstance(wired, Bus):
        return SymbolicStruct({name: _held(member) for name, member in wired.members.items()})
    return wired.nodes.reshape(-1, 1) if wired.nodes.ndim == 1 else wired.nodes


def _wired(held: SymbolicValue, period: float) -> SignalOrBus:
    if isinstance(held, SymbolicStruct):
        return Bus({name: _wired(field_of(held, name), period) for name in held.fields})
    if isinstance(held, InvalidValue):
        raise ProgramError(held.why, held.remedy or DEFAULT_REMEDY)
    if not isinstance(held, np.ndarray) or held.size == 0:
        raise ProgramError("an output of it is neither numbers nor a struct of them")
    return Signal(as_vector(np.asarray(held)), period)


# memory


@dataclass(eq=False)
class _Call:
    """The call of a block's function in a step, with the variables that it keeps for the next one."""

    site: BlockContext
    context: EvaluationContext
    function: m.FunctionDefinition
    given: list[SymbolicValue]
    left: tuple[SymbolicValue, ...] = ()

    def results(self) -> tuple[SymbolicValue, ...]:
        """The results, the memories of persistent variables being read and written."""
        if not self._remembers():
            return self._run(self._begun())
        known = self._scouted()
        for _ in range(_MOST_ROUNDS):
            body = self._begun()
            made = PersistentVariables(self.context, self._remember)
            for key, memory in known.items():
                body.state.kept[key] = made.begun(memory, partial(self._left, body, key))
            results = self._run(body)
            more = late_persistents(self.context, body.state.kept, known)
            if not more:
                return results
            known |= more
        raise ProgramError("its persistent variables do not settle")

    def _begun(self) -> StatementInterpreter:
        """The code before its call, with what the data stores hold that it uses."""
        body = StatementInterpreter(self.context)
        for at, name in enumerate(self.site.atom.shared, _ports(self.site)):
            body.state.kept[GLOBAL, name] = _held(self.site.wired(at))
        return body

    def _left(self, body: StatementInterpreter, key: Key) -> SymbolicValue | None:
        return body.state.kept.get(key)

    def _remembers(self) -> bool:
        return any(declares_persistent(one.body) for one in (self.function, *self.context.functions.values()))

    def _run(self, body: StatementInterpreter) -> tuple[SymbolicValue, ...]:
        self.context.statements = 0
        before = dict(body.state.kept)
        results = body.call(self.function, self.given, len(self.function.results), _BLOCK)
        self.left = tuple(self._end_of(body, before, name) for name in self.site.atom.shared)
        return results

    def _end_of(self, body: StatementInterpreter, before: Mapping[Key, SymbolicValue], name: str) -> SymbolicValue:
        """What the call leaves in a data store."""
        made = body.state.kept[GLOBAL, name]
        if made is not before[GLOBAL, name] and name not in names_assigned_by_functions(self.site.atom.block.script):
            raise ProgramError(
                f"a function in a file writes the data store {name}", "Write it in the block's own code."
            )
        return made

    def _scouted(self) -> dict[Key, PersistentVariable]:
        """What the first call makes of persistent variables."""
        body = self._begun()
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

        return self.site.remember(Signal(init, CONSTANT), then).nodes
