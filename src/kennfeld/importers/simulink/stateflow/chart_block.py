"""Chart blocks: their memories, outputs and events, and the subsystems that they call.

A called subsystem runs within the step of the chart. If the chart reads its outputs, the subsystem is built at the
call, with the values that the outputs of the chart have then.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, enclosing_conditions
from kennfeld.importers.simulink.lowering.block_context import BlockContext
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.reader.block_ports import port_number
from kennfeld.importers.simulink.reader.model_tree import StoredChart, StoredData
from kennfeld.importers.simulink.signals import CONSTANT, Signal, SignalOrBus, apply, as_vector, scalar
from kennfeld.importers.simulink.stateflow.chart_execution import ChartExecution
from kennfeld.importers.simulink.stateflow.chart_model import ChartEvent, ChartModel, ChartVariable
from kennfeld.importers.simulink.stateflow.guarded_variables import Guard, GuardLogic, SizeChangedError
from kennfeld.importers.simulink.stateflow.temporal_logic import ChartTimers
from kennfeld.importers.simulink.variables.enumerations import enumerated_type, members_of, unqualified_member
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY, EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.imperative.symbolic_values import constants

_MEMORIES = ("OUTPUT_DATA", "LOCAL_DATA")
_TRANSIENT = ("FUNCTION_OUTPUT_DATA", "TEMPORARY_DATA")
_KNOWN = (*_MEMORIES, *_TRANSIENT, "INPUT_DATA", "PARAMETER_DATA", "CONSTANT_DATA", "FUNCTION_INPUT_DATA")
_EDGES = {"RISING_EDGE_EVENT": "rising", "FALLING_EDGE_EVENT": "falling", "EITHER_EDGE_EVENT": "either"}
_MAX_SIZE_PASSES = 20


def compile_chart(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Build the graph of a chart: one execution per sample hit, or at its events."""
    chart = block.flat.block.chart
    assert chart is not None
    _check(chart)
    # a variable without a stated size has that of what is assigned to it: each pass finds the size of one more
    sizes: dict[str, tuple[int, ...]] = {}
    for _ in range(_MAX_SIZE_PASSES):
        try:
            return _Chart(block, chart, sizes).outputs()
        except SizeChangedError as resized:
            sizes[resized.key] = resized.shape
        except RecursionError:
            raise UnsupportedError("states are nested too deeply", DEFAULT_REMEDY) from None
    raise UnsupportedError("the sizes of variables cannot be inferred", "Declare them.")


def early_inputs(block: BlockContext) -> Iterable[int]:
    """Return the inputs that a chart needs before it runs: all but the outputs of subsystems that it calls."""
    late = FunctionCallSubsystems(block).late
    return [at for at in range(block.input_count) if at not in late]


def _check(chart: StoredChart) -> None:
    """Reject settings that change the execution of a chart."""
    if chart.update == "CONTINUOUS":
        raise UnsupportedError("continuous-time charts are not supported", DEFAULT_REMEDY)
    # in a Moore chart, the actions of a step precede its transitions; here they follow, as in a classic chart
    if "MOORE" in chart.settings.get("stateMachineType", "").upper():
        raise UnsupportedError("Moore charts are not supported", DEFAULT_REMEDY)
    # with super steps, a chart goes on taking transitions within one time step
    if chart.settings.get("enableNonTerminalStates", "0") != "0":
        raise UnsupportedError("super step semantics are not supported", DEFAULT_REMEDY)
    # an output that no action of a step writes would fall back to its initial value; here it is held
    if chart.settings.get("initializeOutput", "0") != "0":
        raise UnsupportedError("initializing outputs at every wake-up is not supported", DEFAULT_REMEDY)
    ids = [*(state.id for state in chart.states), *(junction.id for junction in chart.junctions)]
    if "" in ids or len(set(ids)) < len(ids):
        raise UnsupportedError("states and junctions have no unique identifiers", "Use a complete copy of the file.")
    for data in chart.data:
        if data.scope not in _KNOWN or data.message:
            kind = "a message" if data.message else data.scope.removesuffix("_DATA").lower().replace("_", " ")
            raise UnsupportedError(f"data {data.name} has an unsupported scope ({kind})", DEFAULT_REMEDY)
        if data.first not in (("", "0") if chart.language == "C" else ("", "0", "1")):
            message = f"data {data.name} has the unsupported first index {data.first[:20]}"
            raise UnsupportedError(message, DEFAULT_REMEDY)
        if data.update == "SF_CONTINUOUS_TIME_DATA":
            raise UnsupportedError(f"data {data.name} is continuous-time, which is not supported", DEFAULT_REMEDY)


class _Chart:
    """A chart while its graph is built; `sizes` are the inferred sizes of variables that state none."""

    def __init__(self, block: BlockContext, chart: StoredChart, sizes: Mapping[str, tuple[int, ...]]) -> None:
        self.block = block
        self.builder = block.builder
        self.logic = GuardLogic(block.builder)
        self.chart = chart
        self.sizes = sizes
        self.diagram = ChartModel(chart)
        self.timers = ChartTimers(self.diagram)
        self.calls = FunctionCallSubsystems(block)
        self.scope = block.flat.scope.within(block.flat.block)
        self.sized: set[str] = set()
        self.ports = {kind: chart_port_names(block.flat, kind) for kind in ("Inport", "Outport")}
        timing = block.compiler.timing
        self.hit = timing.hit(timing.sample_time(block.flat))  # None if every step is a sample hit of the chart
        self._after: Signal | None = None  # the memories after the step
        self._late: dict[int, Nodes] = {}  # values at the end of the previous step

    # variables

    def outputs(self) -> tuple[SignalOrBus, ...]:
        first = self._initial()
        # no memories: `before` becomes `now` at the beginning of a step, parallel states are active with their parent
        keys = [key for key in first if not key.startswith(("before ", "active "))]
        # the next values exist once the step is built, below
        after = self.block.discrete_state(self._join(keys, first), lambda read: self._after or read)
        values = {**first, **self._split(keys, first, after), **self._inputs()}
        machine = self._machine(values)
        self._activate_parallel(machine)
        before = dict(machine.variables.values)
        self._run(machine)
        self._after = self._join(keys, machine.variables.values)
        self.calls.check(machine)
        if self.block.flat in self.block.compiler.flat.ends and not self.ports["Outport"]:
            return self._inner_signals(machine, before)
        return tuple(self._output(name, machine, before) for name in self.ports["Outport"])

    def _initial(self) -> dict[str, Nodes]:
        """Return the values of all variables before the first step."""
        values = self._zero_memories()
        for data in self.diagram.data.values():
            if data.written.scope in (*_MEMORIES, *_TRANSIENT, "CONSTANT_DATA") and not self._belongs_to_code(data):
                values[data.key] = self._start(data)
        if not self.chart.execute_at_initialization:
            return self._with_watched(values)
        begun = self._machine({**self._with_watched(values), **self._inputs(before=True)})
        begun.time = self.builder.const(0.0)
        begun.called = _called_too_early
        self._activate_parallel(begun)
        begun.begin(self.logic.always)
        return self._with_watched({key: begun.variables.values[key] for key in values})

    def _with_watched(self, values: Mapping[str, Nodes]) -> dict[str, Nodes]:
        """Return memories together with copies of the variables whose changes are queried."""
        known = {**values, **self._inputs()}
        return {**values, **{f"{when} {key}": known[key] for key in self.timers.watched for when in ("now", "before")}}

    def _zero_memories(self) -> dict[str, Nodes]:
        """Return the memories of states, timers and events, all 0."""
        states = list(self.diagram.root.descendants)
        keys = ["active"]
        keys += [item.child_key for item in states if item.children and not item.parallel]
        keys += [item.history_key for item in states if item.history]
        keys += [item.active_key for item in states if item.parent is not None and item.parent.parallel]
        for key, timer in self.timers.all.items():
            # duration keeps whether its condition holds, and since when
            keys += [key, f"since {key}"] if timer.kind == "true" else [key]
        keys += [f"output {item.key}" for item in self.diagram.events.values() if item.written.scope == "OUTPUT_EVENT"]
        keys += [f"late {at}" for at in self.calls.late]
        memories = {key: np.array([[self.builder.const(0.0)]], dtype=np.int64) for key in keys}
        return memories | {f"late {at}": self.calls.start(at) for at in self.calls.late}

    def _belongs_to_code(self, data: ChartVariable) -> bool:
        """Return True if a variable belongs to a MATLAB function, which creates its variables itself."""
        holder = self.diagram.holder(data.written.parent)
        scripts = [function.state for function in self.diagram.functions.values() if function.script]
        return holder in scripts and data.written.scope != "LOCAL_DATA"

    def _start(self, data: ChartVariable) -> Nodes:
        """Return the initial value of a variable, in its size."""
        written = data.written
        text = written.name if written.from_workspace else written.initial.strip()
        number = self._start_of_enumeration(written, text)
        try:
            if number is not None:
                value = constants(self.builder, number)
            else:
                value = self.block.compiler.expressions.array(text, self.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"the initial value of data {written.name} ({text[:60]}): {error}") from None
        shape = self._shape(data)
        if shape is None:
            return value
        if value.size == 1:
            return np.full(shape, value.ravel()[0], dtype=np.int64)
        if value.size != np.prod(shape):
            raise UnsupportedError(f"the initial value of data {written.name} does not match its size")
        # MATLAB writes the elements column by column
        return value if value.shape == shape else value.reshape(shape, order="F")

    def _start_of_enumeration(self, written: StoredData, text: str) -> float | None:
        """Return the initial value of a variable that states none, or a member without its class; None for others.

        A variable of an enumerated type begins with the default member, any other one with 0.
        """
        members = members_of(self.scope.variables.get(enumerated_type(written.type)))
        if not text:
            return next(iter(members.values()), 0.0)
        if not text.isidentifier() or self.scope.find(text) is not None:
            return None
        return members.get(text, unqualified_member(self.scope.variables, text, self.diagram.types))

    def _shape(self, data: ChartVariable) -> tuple[int, ...] | None:
        text = data.written.size.strip()
        if text in ("", "-1"):
            return self.sizes.get(data.key)
        listed = text if text.startswith("[") else f"[{text}]"
        try:
            sizes = [int(n) for n in self.block.compiler.expressions.numbers(listed, self.scope).ravel()]
        except EvaluationError as error:
            raise UnsupportedError(f"the size of data {data.written.name} ({text[:60]}): {error}") from None
        if not sizes or min(sizes) < 1 or np.prod(sizes) > 100_000 or len(sizes) > 2:
            raise UnsupportedError(f"data {data.written.name} has the invalid size {text[:60]}")
        self.sized.add(data.key)
        return (sizes[0], 1) if len(sizes) == 1 else (sizes[0], sizes[1])

    def _inputs(self, before: bool = False) -> dict[str, Nodes]:
        """Return the inputs as matrices; before the first step only constants are known."""
        inputs = {}
        for at, name in enumerate(self.ports["Inport"]):
            data = self.diagram.data.get(("", name))
            if data is None or data.written.scope != "INPUT_DATA":
                raise UnsupportedError(f"the chart has no data for input {name}")
            if at in self.calls.late:
                inputs[data.key] = self._late.get(at, self.calls.start(at))
                continue
            signal = self.block.hold_in_minor_steps(self.block.input(at))
            unknown = before and signal.period != CONSTANT
            nodes = signal.matrix
            inputs[data.key] = np.full(nodes.shape, self.builder.const(0.0)) if unknown else nodes
        return inputs

    # memory

    def _join(self, kept: list[str], values: Mapping[str, Nodes]) -> Signal:
        return Signal(np.concatenate([values[key].ravel() for key in kept]), self.block.period())

    def _split(self, kept: list[str], first: Mapping[str, Nodes], read: Signal) -> dict[str, Nodes]:
        """The memories as they are read."""
        values, at = {}, 0
        for key in kept:
            size = first[key].size
            values[key] = read.nodes[at : at + size].reshape(first[key].shape)
            at += size
        self._late = {at: values[f"late {at}"] for at in self.calls.late}
        return values

    def _activate_parallel(self, machine: ChartExecution) -> None:
        """Activate parallel states together with their parent."""
        for state in self.diagram.root.descendants:
            if state.parallel and state.children:
                node = machine.activity.active(state, self.logic.always)
                if state.parent is None:
                    node = machine.variables.scalar("active", self.logic.always)
                for child in state.children:
                    machine.variables.put(child.active_key, node, self.logic.always)

    # the step

    def _machine(self, values: Mapping[str, Nodes]) -> ChartExecution:
        clock = (int(self.block.time.nodes[0]), int(self.block.sample_step().nodes[0]))
        expressions, sized = self.block.compiler.expressions, frozenset(self.sized)
        return ChartExecution(self.diagram, self.timers, expressions, self.scope, values, sized, clock)

    def _run(self, machine: ChartExecution) -> None:
        machine.called = lambda event, guard: self.calls.note_call(
            event, guard, machine, lambda: self._outputs(machine)
        )
        for key, guard in self._wake_events():
            machine.wake(guard, key)
        # outputs of a called subsystem, which the chart reads before the call of the next step
        for at in self.calls.late:
            machine.variables.values[f"late {at}"] = machine.variables.values[self.ports["Inport"][at]]

    def _wake_events(self) -> list[tuple[str, Guard]]:
        """Return the events that wake up the chart, in their order."""
        events = self.diagram.inputs
        if not events:
            return [("", self.logic.always)]
        is_triggered = "trigger" in self.block.flat.control_ports
        signal = self.block.input(self.block.input_count - 1) if is_triggered else self.block.constant()
        if signal.size != len(events):
            raise UnsupportedError(f"the trigger has {signal.size} elements, but there are {len(events)} events")
        wakings = []
        for event, node in zip(events, signal.flat, strict=True):
            guard = self.logic.narrow(self.logic.always, self._trigger_node(event, node, signal.period))
            wakings += [(event.key, guard)] if guard is not None else []
        return wakings

    def _trigger_node(self, event: ChartEvent, node: int, period: float) -> int:
        signal = scalar(node, period, self.block.builder)
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            return int(apply("ne", signal, 0.0).nodes[0])
        kind = _EDGES.get(event.written.trigger)
        if kind is None:
            raise UnsupportedError(
                f"event {event.written.name} has the unsupported trigger {event.written.trigger[:40]}"
            )
        return int(self.block.zero_crossing(self.block.hold_in_minor_steps(signal), kind).nodes[0])

    # outputs

    def _outputs(self, machine: ChartExecution) -> tuple[SignalOrBus, ...]:
        return tuple(self._output(name, machine, {}) for name in self.ports["Outport"])

    def _output(self, name: str, machine: ChartExecution, before: Mapping[str, Nodes]) -> Signal:
        """Return an output after the step, held between the sample hits."""
        period = self.block.period()
        data = self.diagram.data.get(("", name))
        if data is not None and data.written.scope == "OUTPUT_DATA":
            return Signal(as_vector(self._hold_between_hits(data.key, machine, before)), period)
        event = self.diagram.events.get(("", name))
        if event is not None and event.written.scope == "OUTPUT_EVENT":
            key = f"output {event.key}"
            # a call belongs to one hit; it is not held until the next, as the level of a trigger is
            if event.written.trigger == "FUNCTION_CALL_EVENT":
                node = self.calls.node(name)
                return scalar(node if self.hit is None else self.builder.call("and", self.hit, node), period)
            return Signal(as_vector(self._hold_between_hits(key, machine, before)), period)
        state = next((candidate for candidate in self.chart.states if candidate.output == name), None)
        if state is None or state.id not in self.diagram.states:
            raise UnsupportedError(f"output {name} encodes the active state by numbers that the file does not contain")
        node = machine.activity.active(self.diagram.states[state.id], self.logic.always)
        return scalar(node, period)

    def _inner_signals(self, machine: ChartExecution, before: Mapping[str, Nodes]) -> tuple[SignalOrBus, ...]:
        """Return the local data and the activity of the states, as results of a chart that has no outputs."""
        path, signals = self.block.flat.path, dict[str, SignalOrBus]()
        for data in self.diagram.data.values():
            if data.written.scope == "LOCAL_DATA" and data.key in machine.variables.values:
                nodes = as_vector(self._hold_between_hits(data.key, machine, before))
                signals[f"{path}/{data.key}"] = Signal(nodes, self.block.period())
        for state in [state for state in self.diagram.root.descendants if state.parent is not None]:
            node = machine.activity.active(state, self.logic.always)
            signals[f"{path}/{state.path}"] = scalar(node, self.block.period())
        self.block.flat.output_names = dict(enumerate(signals))
        return tuple(signals.values())

    def _hold_between_hits(self, key: str, machine: ChartExecution, before: Mapping[str, Nodes]) -> Nodes:
        now = machine.variables.values[key]
        if self.hit is None or key not in before:
            return now
        return elementwise(self.builder, "select", np.array([self.hit]), now, before[key])


def _called_too_early(event: ChartEvent, guard: Guard) -> None:
    raise UnsupportedError(f"{event.written.name} is called before the first step", DEFAULT_REMEDY)


class FunctionCallSubsystems:
    """The function calls of a chart within a step.

    `late` maps the inputs that come from called subsystems to the names of the events that call them.
    """

    def __init__(self, block: BlockContext) -> None:
        self.block = block
        self._nodes: dict[str, int] = {}
        self._calls: list[tuple[str, Guard, Mapping[str, Nodes]]] = []
        self._built: set[FlatBlock] = set()
        self._controls = dict(self._called_subsystems())
        callers = {at: self._callers(at) for at in range(len(block.flat.inputs)) if self._controls}
        self.late = {at: names for at, names in callers.items() if names}

    def _called_subsystems(self) -> Iterator[tuple[FlatBlock, str]]:
        """Yield the subsystems that this chart calls, each with the name of the event."""
        names = chart_port_names(self.block.flat, "Outport")
        for atom in self.block.compiler.flat.blocks:
            trigger = atom.control_ports.get("trigger") if atom.type == "ConditionalSubsystem" else None
            if trigger is not None and trigger.is_set_to("TriggerType", "function-call"):
                for source in atom.inputs:
                    if source is not None and source.flat is self.block.flat and 0 <= source.port < len(names):
                        yield atom, names[source.port]

    def _callers(self, at: int) -> frozenset[str]:
        """Return the events whose subsystems an input depends on within the step."""
        source = self.block.flat.inputs[at]
        waiting = [source.flat] if source is not None else []
        seen: set[FlatBlock] = {self.block.flat}
        events: set[str] = set()
        while waiting:
            atom = waiting.pop()
            if atom in seen:
                continue
            seen.add(atom)
            if atom in self._controls:
                events.add(self._controls[atom])
            if atom.type == "Chart":  # the inputs it requires are determined from it in turn
                waiting += [item.flat for item in atom.inputs if item is not None]
            else:
                waiting += self.block.compiler.needs.step_dependencies(atom)
        return frozenset(events)

    def start(self, at: int) -> Nodes:
        """Return the value of a late input before the first call."""
        source = self.block.flat.inputs[at]
        is_held = source is not None and source.flat.type == "ConditionalOutput"
        stated = self.block.of(source.flat).initial_output() if source is not None and is_held else None
        return (stated or self.block.constant(0.0)).nodes.reshape(-1, 1)

    def node(self, name: str) -> int:
        """Return the node that is 1 if the chart has called so far."""
        return self._nodes.get(name, self.block.builder.const(0.0))

    def note_call(
        self, event: ChartEvent, guard: Guard, machine: ChartExecution, outputs: Callable[[], tuple[SignalOrBus, ...]]
    ) -> None:
        """Record a call; if the chart reads the outputs of the subsystem, build it now."""
        name = event.written.name
        before = self._nodes.get(name)
        # two calls are allowed where one certainly excludes the other
        if before is not None and machine.logic.truth(before, guard) is not False:
            raise UnsupportedError(f"{name} may be called twice in one step", DEFAULT_REMEDY)
        self._nodes[name] = guard.node if before is None else machine.builder.call("or", before, guard.node)
        # the values at the call, which `check` compares with those at the end of the step
        self._calls.append((name, guard, dict(machine.variables.values)))
        late = [at for at, names in self.late.items() if name in names]
        if not late:
            return
        if before is not None or any(len(self.late[at]) > 1 for at in late):
            raise UnsupportedError(f"{name} is called in several places, and its outputs are read", DEFAULT_REMEDY)
        self._build(name, late, machine, outputs())

    def _build(self, name: str, late: list[int], machine: ChartExecution, outputs: tuple[SignalOrBus, ...]) -> None:
        atom = self.block.flat
        goals = [source.flat for at in late if (source := atom.inputs[at]) is not None]
        built = self.block.compiler.visits.build_dependents(atom, outputs, goals)
        for member in built:
            reads = any(source is not None and source.flat is atom for source in member.inputs)
            if reads and member not in self._controls and self._caller(member) != name:
                raise UnsupportedError(
                    f"the subsystem called by {name} requires {member.path}, which requires the chart", DEFAULT_REMEDY
                )
        self._built.update(built)
        names = chart_port_names(atom, "Inport")
        for at in late:
            key = machine.diagram.data["", names[at]].key
            machine.variables.values[key] = self.block.input(at).nodes.reshape(-1, 1)

    def _caller(self, atom: FlatBlock) -> str:
        """Return the event that calls the subsystem of a block; empty if this chart does not call it."""
        return next((self._controls[here] for here in enclosing_conditions(atom) if here in self._controls), "")

    def check(self, machine: ChartExecution) -> None:
        """Reject outputs that change after a call and are read by the called subsystem."""
        names = chart_port_names(self.block.flat, "Outport")
        for name, guard, values in self._calls:
            changed = {
                at for at, port in enumerate(names)
                if port in values and not self._same(machine, guard, values[port], machine.variables.values[port])
            }  # fmt: skip
            for atom in self.block.compiler.flat.blocks:
                if atom in self._built or self._caller(atom) != name:
                    continue
                for source in atom.inputs:
                    if source is not None and source.flat is self.block.flat and source.port in changed:
                        message = f"{names[source.port]}, which {atom.path} reads, changes after the call of {name}"
                        raise UnsupportedError(message, DEFAULT_REMEDY)

    def _same(self, machine: ChartExecution, guard: Guard, left: Nodes, right: Nodes) -> bool:
        logic = machine.logic
        return bool(np.array_equal(logic.simplify_all(left, guard), logic.simplify_all(right, guard)))


def chart_port_names(atom: FlatBlock, kind: str) -> list[str]:
    """Return the names of the Inports or Outports of a chart, in the order of their ports."""
    system = atom.block.system
    if system is None:
        raise UnsupportedError("the file does not contain its ports")
    return [port.name.removesuffix("()") for port in sorted(system.of(kind), key=port_number)]
