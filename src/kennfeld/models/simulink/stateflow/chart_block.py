"""Subsystems that a chart calls by its output events, and the inputs of the chart that come from them.

A called subsystem runs in the midst of the chart's step. Where the chart reads what it makes, it is built at the call,
with the chart's outputs as they are by then.

Stateflow charts: their memories and outputs, their events, and the subsystems that they call.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY, EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.scheduling import SampleTime
from kennfeld.models.simulink.reader.block_ports import port_number
from kennfeld.models.simulink.reader.model_tree import StoredChart
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Signal, SignalOrBus, as_vector, scalar
from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution
from kennfeld.models.simulink.stateflow.chart_model import ChartEvent, ChartModel, ChartVariable
from kennfeld.models.simulink.stateflow.guarded_variables import Guard, GuardLogic, SizeChangedError
from kennfeld.models.simulink.stateflow.temporal_logic import ChartTimers

__all__ = []

_MEMORIES = ("OUTPUT_DATA", "LOCAL_DATA")
_TRANSIENT = ("FUNCTION_OUTPUT_DATA", "TEMPORARY_DATA")
_KNOWN = (*_MEMORIES, *_TRANSIENT, "INPUT_DATA", "PARAMETER_DATA", "CONSTANT_DATA", "FUNCTION_INPUT_DATA")
_EDGES = {"RISING_EDGE_EVENT": "rising", "FALLING_EDGE_EVENT": "falling", "EITHER_EDGE_EVENT": "either"}
_MOST_SIZES = 20


def chart_port_names(atom: FlatBlock, kind: str) -> list[str]:
    """The names of a chart's Inports or Outports, in the order of their ports."""
    system = atom.block.system
    if system is None:
        raise UnsupportedError("the file does not say its ports")
    ports = sorted(system.of(kind), key=port_number)
    return [one.name.removesuffix("()") for one in ports]


class FunctionCallSubsystems:
    """The calls that a chart makes within a step.

    `late` are the inputs that come from what it calls, each with the names of the events that call it.
    """

    def __init__(self, site: BlockContext) -> None:
        self.site = site
        self._nodes: dict[str, int] = {}
        self._made: list[tuple[str, Guard, Mapping[str, Nodes]]] = []
        self._built: set[FlatBlock] = set()
        self._controls = dict(self._called())
        found = {at: self._callers(at) for at in range(len(site.atom.inputs)) if self._controls}
        self.late = {at: names for at, names in found.items() if names}

    @property
    def early(self) -> tuple[int, ...]:
        """The inputs that do not come from called subsystems."""
        return tuple(at for at in range(len(self.site.atom.inputs)) if at not in self.late)

    def _called(self) -> Iterator[tuple[FlatBlock, str]]:
        """What stands for the subsystems that this chart calls, each with the name of the event."""
        names = chart_port_names(self.site.atom, "Outport")
        for atom in self.site.compiler.flat.atoms:
            trigger = atom.special.get("trigger") if atom.kind == "Control" else None
            if trigger is not None and trigger.value("TriggerType") == "function-call":
                for source in atom.inputs:
                    if source is not None and source.atom is self.site.atom and 0 <= source.port < len(names):
                        yield atom, names[source.port]

    def _callers(self, at: int) -> frozenset[str]:
        """The events on whose subsystems an input depends within the step."""
        source = self.site.atom.inputs[at]
        waiting = [source.atom] if source is not None else []
        seen: set[FlatBlock] = {self.site.atom}
        found: set[str] = set()
        while waiting:
            atom = waiting.pop()
            if atom in seen:
                continue
            seen.add(atom)
            if atom in self._controls:
                found.add(self._controls[atom])
            if atom.kind == "Chart":  # which of its inputs it needs is asked in turn
                waiting += [one.atom for one in atom.inputs if one is not None]
            else:
                waiting += self.site.compiler.needs.now(atom)
        return frozenset(found)

    def start(self, at: int) -> Nodes:
        """What a late input is before the first call."""
        source = self.site.atom.inputs[at]
        held = source is not None and source.atom.kind == "Held"
        stated = self.site.compiler.site(source.atom).initial_output() if source is not None and held else None
        return (stated or self.site.constant(0.0)).nodes.reshape(-1, 1)

    def node(self, name: str) -> int:
        """The node that is 1 where the chart has called so far."""
        return self._nodes.get(name, self.site.builder.const(0.0))

    def called(
        self, event: ChartEvent, guard: Guard, machine: ChartExecution, outputs: Callable[[], tuple[SignalOrBus, ...]]
    ) -> None:
        """Note a call; where the chart reads what it makes, build the called subsystem now."""
        name = event.written.name
        before = self._nodes.get(name)
        if before is not None and machine.logic.truth(before, guard) is not False:
            raise UnsupportedError(f"it may call {name} twice in a step", DEFAULT_REMEDY)
        self._nodes[name] = guard.node if before is None else machine.builder.call("or", before, guard.node)
        self._made.append((name, guard, dict(machine.variables.values)))
        late = [at for at, names in self.late.items() if name in names]
        if not late:
            return
        if before is not None or any(len(self.late[at]) > 1 for at in late):
            raise UnsupportedError(f"it calls {name} in several places, and reads what it makes", DEFAULT_REMEDY)
        self._build(name, late, machine, outputs())

    def _build(self, name: str, late: list[int], machine: ChartExecution, outputs: tuple[SignalOrBus, ...]) -> None:
        atom = self.site.atom
        goals = [source.atom for at in late if (source := atom.inputs[at]) is not None]
        built = self.site.compiler.visits.meanwhile(atom, outputs, goals)
        for one in built:
            reads = any(source is not None and source.atom is atom for source in one.inputs)
            if reads and one not in self._controls and self._caller(one) != name:
                raise UnsupportedError(
                    f"what it calls by {name} needs {one.path}, which needs the chart", DEFAULT_REMEDY
                )
        self._built.update(built)
        names = chart_port_names(atom, "Inport")
        for at in late:
            key = machine.diagram.data["", names[at]].key
            machine.variables.values[key] = self.site.input(at).nodes.reshape(-1, 1)

    def _caller(self, atom: FlatBlock) -> str:
        """The event that calls the subsystem that a block is in; empty where this chart does not call it."""
        here = atom.control
        while here is not None:
            if here in self._controls:
                return self._controls[here]
            here = here.control
        return ""

    def check(self, machine: ChartExecution) -> None:
        """Refuse outputs that change after a call, where the called subsystem reads them."""
        names = chart_port_names(self.site.atom, "Outport")
        for name, guard, values in self._made:
            changed = {
                at for at, port in enumerate(names)
                if port in values and not self._same(machine, guard, values[port], machine.variables.values[port])
            }  # fmt: skip
            for atom in self.site.compiler.flat.atoms:
                if atom in self._built or self._caller(atom) != name:
                    continue
                for source in atom.inputs:
                    if source is not None and source.atom is self.site.atom and source.port in changed:
                        what = f"it changes {names[source.port]}, which {atom.path} reads, after it has called {name}"
                        raise UnsupportedError(what, DEFAULT_REMEDY)

    def _same(self, machine: ChartExecution, guard: Guard, one: Nodes, other: Nodes) -> bool:
        logic = machine.logic
        return bool(np.array_equal(logic.simplified(one, guard), logic.simplified(other, guard)))


def early(site: BlockContext) -> Iterable[int]:
    """The inputs that a chart needs before it runs: all but those that it computes itself by calling subsystems."""
    return FunctionCallSubsystems(site).early


def chart(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """One execution of a chart in each hit of its sample time, or at its events."""
    given = site.atom.block.chart
    assert given is not None
    _check(given)
    sizes: dict[str, tuple[int, ...]] = {}
    for _ in range(_MOST_SIZES):
        try:
            return _Chart(site, given, sizes).outputs()
        except SizeChangedError as resized:
            sizes[resized.key] = resized.shape
        except RecursionError:
            raise UnsupportedError("its states lie too deep within each other", DEFAULT_REMEDY) from None
    raise UnsupportedError("the sizes of its variables do not settle", "Declare them.")


def _check(given: StoredChart) -> None:
    """Refuse what changes how a chart runs."""
    if given.update == "CONTINUOUS":
        raise UnsupportedError("it is a chart in continuous time", DEFAULT_REMEDY)
    machine = given.settings.get("stateMachineType", "")
    if "MOORE" in machine.upper():
        raise UnsupportedError("it is a Moore chart", DEFAULT_REMEDY)
    if given.settings.get("enableNonTerminalStates", "0") != "0":
        raise UnsupportedError("it runs in super steps", DEFAULT_REMEDY)
    if given.settings.get("initializeOutput", "0") != "0":
        raise UnsupportedError("it begins with new outputs whenever it wakes up", DEFAULT_REMEDY)
    ids = [*(state.id for state in given.states), *(junction.id for junction in given.junctions)]
    if "" in ids or len(set(ids)) < len(ids):
        raise UnsupportedError("the file does not tell its states and junctions apart", "Take a complete copy of it.")
    for data in given.data:
        if data.scope not in _KNOWN or data.message:
            kind = "a message" if data.message else data.scope.removesuffix("_DATA").lower().replace("_", " ")
            raise UnsupportedError(f"its data {data.name} is of a kind that is not supported ({kind})", DEFAULT_REMEDY)
        if (data.first not in ("", "0") and given.language == "C") or data.first not in ("", "0", "1"):
            raise UnsupportedError(
                f"the elements of its data {data.name} are counted from {data.first[:20]}", DEFAULT_REMEDY
            )
        if data.update == "SF_CONTINUOUS_TIME_DATA":
            raise UnsupportedError(f"its data {data.name} is integrated in continuous time", DEFAULT_REMEDY)


class _Chart:
    """A chart while its graph is built. `sizes` are what was found of variables that state none."""

    def __init__(self, site: BlockContext, given: StoredChart, sizes: Mapping[str, tuple[int, ...]]) -> None:
        self.site = site
        self.builder = site.builder
        self.logic = GuardLogic(site.builder)
        self.given = given
        self.sizes = sizes
        self.diagram = ChartModel(given)
        self.timers = ChartTimers(self.diagram)
        self.calls = FunctionCallSubsystems(site)
        self.scope = site.atom.scope.within(site.atom.block)
        self.sized: set[str] = set()
        self.ports = {kind: chart_port_names(site.atom, kind) for kind in ("Inport", "Outport")}
        self.hit = self._hit()
        self._found: dict[str, Signal] = {}
        self._late: dict[int, Nodes] = {}  # what they held at the end of the step before

    def _hit(self) -> int | None:
        """The node that is 1 where the chart's sample time is hit; None where it always is."""
        period = self.site.period()
        rate = self.site.compiler.timing.rate(self.site.atom) or SampleTime(period)
        if rate.period in (CONTINUOUS, CONSTANT):
            return None
        return self.site.compiler.clock.hit(self.builder, rate)

    # variables

    def outputs(self) -> tuple[SignalOrBus, ...]:
        first = self._initial()
        kept = [key for key in first if not key.startswith(("before ", "active "))]
        after = self._remembered(kept, first)
        values = {**first, **self._split(kept, first, after), **self._inputs()}
        machine = self._machine(values)
        self._parallel(machine)
        before = dict(machine.variables.values)
        self._run(machine)
        self._found["after"] = self._joined(kept, machine.variables.values)
        self.calls.check(machine)
        return tuple(self._output(name, machine, before) for name in self.ports["Outport"])

    def _initial(self) -> dict[str, Nodes]:
        """What all variables hold before the first step."""
        values = self._empty()
        for data in self.diagram.data.values():
            if data.written.scope in (*_MEMORIES, *_TRANSIENT, "CONSTANT_DATA") and not self._coded(data):
                values[data.key] = self._start(data)
        if not self.given.execute_at_initialization:
            return {**values, **self._watched({**values, **self._inputs()})}
        begun = self._machine({**values, **self._inputs(before=True), **self._watched({**values, **self._inputs()})})
        begun.time = self.builder.const(0.0)
        begun.called = _called_too_early
        self._parallel(begun)
        begun.begin(self.logic.always)
        found = {key: begun.variables.values[key] for key in values}
        return {**found, **self._watched({**found, **self._inputs()})}

    def _watched(self, values: Mapping[str, Nodes]) -> dict[str, Nodes]:
        return {f"{when} {key}": values[key] for key in self.timers.watched for when in ("now", "before")}

    def _empty(self) -> dict[str, Nodes]:
        """The memories of states, timers and events, all 0."""
        states = list(self.diagram.root.below)
        keys = ["active"]
        keys += [one.child_key for one in states if one.children and not one.parallel]
        keys += [one.history_key for one in states if one.history]
        keys += [one.active_key for one in states if one.parent is not None and one.parent.parallel]
        for key, timer in self.timers.all.items():
            keys += [key, f"since {key}"] if timer.kind == "true" else [key]
        keys += [f"output {one.key}" for one in self.diagram.events.values() if one.written.scope == "OUTPUT_EVENT"]
        keys += [f"late {at}" for at in self.calls.late]
        made = {key: np.array([[self.builder.const(0.0)]], dtype=np.int64) for key in keys}
        return made | {f"late {at}": self.calls.start(at) for at in self.calls.late}

    def _coded(self, data: ChartVariable) -> bool:
        """Whether a variable belongs to a function in MATLAB, which makes its variables itself."""
        holder = self.diagram.holder(data.written.parent)
        scripts = [one.state for one in self.diagram.functions.values() if one.script]
        return holder in scripts and data.written.scope != "LOCAL_DATA"

    def _start(self, data: ChartVariable) -> Nodes:
        """The value with which a variable begins, in its size."""
        written = data.written
        text = written.name if written.from_workspace else written.initial.strip()
        try:
            value = self.site.compiler.expressions.array(text, self.scope) if text else self._array(0.0)
        except EvaluationError as error:
            raise UnsupportedError(f"the initial value of its data {written.name} ({text[:60]}): {error}") from None
        shape = self._shape(data)
        if shape is None:
            return value
        if value.size == 1:
            return np.full(shape, value.ravel()[0], dtype=np.int64)
        if value.size != np.prod(shape):
            raise UnsupportedError(f"the initial value of its data {written.name} does not fit its size")
        return value if value.shape == shape else value.reshape(shape, order="F")

    def _shape(self, data: ChartVariable) -> tuple[int, ...] | None:
        text = data.written.size.strip()
        if text in ("", "-1"):
            return self.sizes.get(data.key)
        try:
            found = [int(n) for n in self.site.compiler.expressions.numbers(_listed(text), self.scope).ravel()]
        except EvaluationError as error:
            raise UnsupportedError(f"the size of its data {data.written.name} ({text[:60]}): {error}") from None
        if not found or min(found) < 1 or np.prod(found) > 100_000 or len(found) > 2:
            raise UnsupportedError(f"its data {data.written.name} has the size {text[:60]}")
        self.sized.add(data.key)
        return (found[0], 1) if len(found) == 1 else (found[0], found[1])

    def _array(self, value: float) -> Nodes:
        return np.array([[self.builder.const(value)]], dtype=np.int64)

    def _inputs(self, before: bool = False) -> dict[str, Nodes]:
        """The inputs as matrices; `before` the first step only constants are known."""
        found = {}
        for at, name in enumerate(self.ports["Inport"]):
            data = self.diagram.data.get(("", name))
            if data is None or data.written.scope != "INPUT_DATA":
                raise UnsupportedError(f"its input {name} is no data of the chart")
            if at in self.calls.late:
                found[data.key] = self._late.get(at, self.calls.start(at))
                continue
            signal = self.site.discrete(self.site.input(at))
            nodes = signal.nodes.reshape(-1, 1) if signal.nodes.ndim == 1 else signal.nodes
            unknown = before and signal.period != CONSTANT
            found[data.key] = np.full(nodes.shape, self.builder.const(0.0)) if unknown else nodes
        return found

    # memory

    def _remembered(self, kept: list[str], first: Mapping[str, Nodes]) -> Signal:
        init = self._joined(kept, first)
        return self.site.remember(init, lambda seen: self._found.get("after", seen))

    def _joined(self, kept: list[str], values: Mapping[str, Nodes]) -> Signal:
        return Signal(np.concatenate([values[key].ravel() for key in kept]), self.site.period())

    def _split(self, kept: list[str], first: Mapping[str, Nodes], read: Signal) -> dict[str, Nodes]:
        """The memories as they are read."""
        found, at = {}, 0
        for key in kept:
            size = first[key].size
            found[key] = read.nodes[at : at + size].reshape(first[key].shape)
            at += size
        self._late = {at: found[f"late {at}"] for at in self.calls.late}
        return found

    def _parallel(self, machine: ChartExecution) -> None:
        """Parallel states are active with the state around them."""
        for state in self.diagram.root.below:
            if state.parallel and state.children:
                node = machine.activity.active(state, self.logic.always)
                if state.parent is None:
                    node = machine.variables.one("active", self.logic.always)
                for child in state.children:
                    machine.variables.put(child.active_key, node, self.logic.always)

    # the step

    def _machine(self, values: Mapping[str, Nodes]) -> ChartExecution:
        clock = (int(self.site.time.nodes[0]), int(self.site.step().nodes[0]))
        return ChartExecution(
            self.diagram, self.timers, self.site.compiler.expressions, self.scope, values, frozenset(self.sized), clock,
            lambda event, guard: None,
        )  # fmt: skip

    def _run(self, machine: ChartExecution) -> None:
        machine.called = lambda event, guard: self.calls.called(event, guard, machine, lambda: self._outputs(machine))
        for key, guard in self._wakings():
            machine.wake(guard, key)
        for at in self.calls.late:
            machine.variables.values[f"late {at}"] = machine.variables.values[self.ports["Inport"][at]]

    def _wakings(self) -> list[tuple[str, Guard]]:
        """The events that wake the chart up, in their order."""
        events = self.diagram.inputs
        if not events:
            return [("", self.logic.always)]
        signal = self.site.input(self.site.count - 1) if "trigger" in self.site.atom.special else self.site.constant()
        if signal.size != len(events):
            raise UnsupportedError(f"its trigger has {signal.size} elements for {len(events)} events")
        found = []
        for event, node in zip(events, signal.flat, strict=True):
            guard = self.logic.where(self.logic.always, self._comes(event, node, signal.period))
            found += [(event.key, guard)] if guard is not None else []
        return found

    def _comes(self, event: ChartEvent, node: int, period: float) -> int:
        one = scalar(node, period)
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            return int(self.site.call("ne", one, self.site.constant(0.0)).nodes[0])
        kind = _EDGES.get(event.written.trigger)
        if kind is None:
            raise UnsupportedError(f"its event {event.written.name} has the trigger {event.written.trigger[:40]}")
        return int(self.site.edge(self.site.discrete(one), kind).nodes[0])

    # outputs

    def _outputs(self, machine: ChartExecution) -> tuple[SignalOrBus, ...]:
        return tuple(self._output(name, machine, {}) for name in self.ports["Outport"])

    def _output(self, name: str, machine: ChartExecution, before: Mapping[str, Nodes]) -> Signal:
        """An output after the step; between the hits of the sample time it keeps what it was."""
        period = self.site.period()
        data = self.diagram.data.get(("", name))
        if data is not None and data.written.scope == "OUTPUT_DATA":
            return Signal(as_vector(self._kept(data.key, machine, before)), period)
        event = self.diagram.events.get(("", name))
        if event is not None and event.written.scope == "OUTPUT_EVENT":
            key = f"output {event.key}"
            if event.written.trigger == "FUNCTION_CALL_EVENT":
                return scalar(self._at_hit(self.calls.node(name)), period)
            return Signal(as_vector(self._kept(key, machine, before)), period)
        state = next((one for one in self.given.states if one.output == name), None)
        if state is None or state.id not in self.diagram.states:
            raise UnsupportedError(
                f"its output {name} tells which state is active by a number that the file does not say"
            )
        node = machine.activity.active(self.diagram.states[state.id], self.logic.always)
        return scalar(node, period)

    def _kept(self, key: str, machine: ChartExecution, before: Mapping[str, Nodes]) -> Nodes:
        now = machine.variables.values[key]
        if self.hit is None or key not in before:
            return now
        pairs = zip(now.ravel(), before[key].ravel(), strict=True)
        made = [self.builder.call("select", self.hit, int(one), int(other)) for one, other in pairs]
        return np.array(made, dtype=np.int64).reshape(now.shape)

    def _at_hit(self, node: int) -> int:
        return node if self.hit is None else self.builder.call("and", self.hit, node)


def _called_too_early(event: ChartEvent, guard: Guard) -> None:
    raise UnsupportedError(f"it calls {event.written.name} before the first step", DEFAULT_REMEDY)


def _listed(text: str) -> str:
    return text if text.startswith("[") else f"[{text}]"
