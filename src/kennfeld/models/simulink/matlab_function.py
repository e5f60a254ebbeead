"""MATLAB Function blocks: their code as a graph."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from kennfeld.errors import ArgumentError, InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.imperative.evaluation_context import Desk
from kennfeld.models.imperative.evaluation_errors import MEND, CodeError, EndedError
from kennfeld.models.imperative.library.function_registry import matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, aligned
from kennfeld.models.imperative.persistent_variables import Key, Memories, Memory, Scout, declares, later, memories
from kennfeld.models.imperative.statement_interpreter import GLOBAL, Body
from kennfeld.models.imperative.symbolic_values import Held, Struct, Unclear, field_of, integers
from kennfeld.models.simulink.expressions.parameter_expressions import parameter, parameter_number
from kennfeld.models.simulink.flattening.integer_signals import word_of
from kennfeld.models.simulink.lowering.block_context import Site
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import named_text
from kennfeld.models.simulink.signals import CONSTANT, Bus, Signal, Wired, as_vector, fastest
from kennfeld.models.simulink.variables.mask_scope import written_names
from kennfeld.parameters import Axis

__all__ = []

_GIVE: Final = "Give it among the parameters: a script, a .mat, .sldd or calibration file."
_BLOCK: Final = "the function of the block"
_MOST_ROUNDS: Final = 20
_PARAMETER: Final = "PARAMETER_DATA"


def matlab_function(site: Site) -> tuple[Wired, ...]:
    """What the function's results are, in the order in which it names them."""
    try:
        return _outputs(site)
    except CodeError as error:
        raise UnsupportedError(str(error), error.mend) from None
    except EndedError:
        raise UnsupportedError("its code ends in an error in every case", MEND) from None
    except RecursionError:
        raise UnsupportedError("its code is nested too deeply", MEND) from None


def _outputs(site: Site) -> tuple[Wired, ...]:
    script = _script(site)
    function = script.functions[0]
    desk = _desk_of(site, {one.name: one for one in script.functions[1:]})
    given = _given(site, function)
    work = _Call(site, desk, function, given)
    results = work.results()
    period = fastest([site.wired(at).period for at in range(_ports(site))])
    period = 0.0 if site.memories and period == CONSTANT else period
    shown = _shown(site)
    named = zip(function.results, results, strict=False)
    made = [one for name, one in named if not shown or name in shown]
    return tuple(_wired(one, period) for one in (*made, *work.left))


def _script(site: Site) -> m.Script:
    try:
        script = parse_script(site.atom.block.script, site.atom.path)
    except InputError as error:
        raise UnsupportedError(str(error.findings[0]), MEND) from None
    if not script.functions or script.statements:
        raise UnsupportedError("its code is no function", MEND)
    return script


def _ports(site: Site) -> int:
    """How many of its inputs are ports; the others are data stores."""
    return site.count - len(site.atom.shared)


def _shown(site: Site) -> set[str]:
    """The results that are outputs, where the block says which are."""
    chart = site.atom.block.chart
    return {one.name for one in chart.data if one.scope == "OUTPUT_DATA"} if chart is not None else set()


def _desk_of(site: Site, functions: Mapping[str, m.FunctionDefinition]) -> Desk:
    """What the code of a block shares."""
    expressions, scope = site.weaver.expressions, site.atom.scope

    def frozen(what: str) -> None:
        expressions.frozen[f"{site.atom.path}: {what}"] = "it must be fixed in code"

    return Desk(
        site.builder,
        workspace=partial(parameter, expressions, scope, enumeration=site.weaver.files.enumeration),
        number=partial(parameter_number, expressions),
        functions=dict(functions),
        find=site.weaver.files.find,
        frozen=frozen,
        remark=lambda sentence: site.remark(f"calls a function of bits: {sentence}"),
        tables=partial(_looked_up, site),
    )


def _looked_up(
    site: Site, name: str, axes: list[tuple[Numbers, str]], places: list[Nodes], beyond: str
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
    made = site.weaver.declared.table(table.name, values, made_axes, table.variable, False, beyond)
    spread = np.broadcast_arrays(*aligned(*places))
    columns = zip(*(one.ravel() for one in spread), strict=True)
    nodes = [site.builder.lookup(made.name, *(int(node) for node in place)) for place in columns]
    return np.array(nodes, dtype=np.int64).reshape(spread[0].shape)


# arguments and results


def _given(site: Site, function: m.FunctionDefinition) -> list[Held]:
    """The arguments in their order: inputs, and parameters where the block says so or no input is left."""
    chart = site.atom.block.chart
    fixed = {one.name for one in chart.data if one.scope == _PARAMETER} if chart is not None else set()
    expressions, made, at = site.weaver.expressions, list[Held](), 0
    for name in function.parameters:
        if name not in fixed and at < _ports(site):
            made.append(_typed(site, at, name))
            at += 1
            continue
        held = parameter(expressions, site.atom.scope, name)
        if held is None and name in fixed:
            raise UnsupportedError(f"its parameter {name} has no value", _GIVE, name)
        made.append(held if held is not None else Unclear(f"{name} is a parameter that has no value", _GIVE))
    return made


def _typed(site: Site, at: int, name: str) -> Held:
    """An input as a variable, of the integer type that the block states for it or that its signal has."""
    held, chart = _held(site.wired(at)), site.atom.block.chart
    stated = next((one.type for one in chart.data if one.name == name), "") if chart is not None else ""
    word = matlab_word(stated) or word_of(site.source(at))
    return integers(held, word) if isinstance(held, np.ndarray) else held


def _held(wired: Wired) -> Held:
    """A signal as a variable: a vector is a column, a bus a struct."""
    if isinstance(wired, Bus):
        return Struct({name: _held(member) for name, member in wired.members.items()})
    return wired.nodes.reshape(-1, 1) if wired.nodes.ndim == 1 else wired.nodes


def _wired(held: Held, period: float) -> Wired:
    if isinstance(held, Struct):
        return Bus({name: _wired(field_of(held, name), period) for name in held.fields})
    if isinstance(held, Unclear):
        raise CodeError(held.why, held.mend or MEND)
    if not isinstance(held, np.ndarray) or held.size == 0:
        raise CodeError("an output of it is neither numbers nor a struct of them")
    return Signal(as_vector(np.asarray(held)), period)


# memory


@dataclass(eq=False)
class _Call:
    """The call of a block's function in a step, with the variables that it keeps for the next one."""

    site: Site
    desk: Desk
    function: m.FunctionDefinition
    given: list[Held]
    left: tuple[Held, ...] = ()

    def results(self) -> tuple[Held, ...]:
        """The results, the memories of persistent variables being read and written."""
        if not self._remembers():
            return self._run(self._begun())
        known = self._scouted()
        for _ in range(_MOST_ROUNDS):
            body = self._begun()
            made = Memories(self.desk, self._remember)
            for key, memory in known.items():
                body.state.kept[key] = made.begun(memory, partial(self._left, body, key))
            results = self._run(body)
            more = later(self.desk, body.state.kept, known)
            if not more:
                return results
            known |= more
        raise CodeError("its persistent variables do not settle")

    def _begun(self) -> Body:
        """The code before its call, with what the data stores hold that it uses."""
        body = Body(self.desk)
        for at, name in enumerate(self.site.atom.shared, _ports(self.site)):
            body.state.kept[GLOBAL, name] = _held(self.site.wired(at))
        return body

    def _left(self, body: Body, key: Key) -> Held | None:
        return body.state.kept.get(key)

    def _remembers(self) -> bool:
        return any(declares(one.body) for one in (self.function, *self.desk.functions.values()))

    def _run(self, body: Body) -> tuple[Held, ...]:
        self.desk.statements = 0
        before = dict(body.state.kept)
        results = body.call(self.function, self.given, len(self.function.results), _BLOCK)
        self.left = tuple(self._end_of(body, before, name) for name in self.site.atom.shared)
        return results

    def _end_of(self, body: Body, before: Mapping[Key, Held], name: str) -> Held:
        """What the call leaves in a data store."""
        made = body.state.kept[GLOBAL, name]
        if made is not before[GLOBAL, name] and name not in written_names(self.site.atom.block.script):
            raise CodeError(f"a function in a file writes the data store {name}", "Write it in the block's own code.")
        return made

    def _scouted(self) -> dict[Key, Memory]:
        """What the first call makes of persistent variables."""
        body = self._begun()
        scout = Scout(self.desk, body)
        body.watch = scout.watch
        self._run(body)
        return memories(scout, body.state.kept, body.questions)

    def _remember(self, init: Nodes, end: Callable[[], Nodes]) -> Nodes:
        def then(_: Signal) -> Signal:
            try:
                return Signal(end())
            except CodeError as error:
                raise UnsupportedError(str(error), error.mend) from None

        return self.site.remember(Signal(init, CONSTANT), then).nodes
