"""Import of the methods of a step: translation, lowering to the graph, and the model with its report."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import GraphBuilder
from kennfeld.graph.builder import BoundedGraphBuilder, GraphTooLargeError
from kennfeld.importers.ascet.display_names import DisplayNames
from kennfeld.importers.ascet.functions import library
from kennfeld.importers.ascet.import_remarks import import_remarks
from kennfeld.importers.ascet.import_report import EsdlImport, EsdlReport, TaskSummary
from kennfeld.importers.ascet.instances import Program, ProgramVariable
from kennfeld.importers.ascet.method_selection import MethodSelection, Process, ScheduledTask
from kennfeld.importers.ascet.method_translation import translate_method
from kennfeld.importers.ascet.program_code import RESULT, MethodCode, ProgramCode
from kennfeld.importers.ascet.program_parameters import ProgramParameters
from kennfeld.importers.ascet.resolved_types import Dimension, NumberType, leaves_of
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError
from kennfeld.models.formula.printer import merge_equal_states
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import MAX_PASSES, EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.models.import_report import StateSummary
from kennfeld.models.model import Model
from kennfeld.models.quantities import Quantity, calibratable
from kennfeld.models.sample_times import sample_hit
from kennfeld.program import tree as m

OPEN_PASSES: Final = MAX_PASSES - 1  # of a loop without a known end; one with a known end may have as many
_MAX_SHOWN: Final = 200  # elements of an array that become nodes


# a method that was called, its code, and its results
MethodResult: TypeAlias = tuple[Process, MethodCode, tuple[s.SymbolicValue, ...]]


@dataclass(eq=False)
class _Names:
    """Names of nodes and what belongs to them."""

    visible: dict[str, int] = field(default_factory=dict)
    outputs: list[str] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    locations: dict[str, Location] = field(default_factory=dict)


class EsdlModelImport:
    """Import of selected methods of a program.

    Args:
        program: the instances.
        selection: the methods.
        name: name of the model.
        source: path of its file.
        initial: values of parameters where a constant is required; their names are preferred.
    """

    def __init__(
        self, program: Program, selection: MethodSelection, name: str, source: str, initial: ParameterSet | None = None
    ) -> None:
        self.program, self.selection, self.name, self.source = program, selection, name, source
        self.initial = ParameterSet() if initial is None else initial
        self.code = ProgramCode(program, translate_method)
        self.findings: list[Finding] = []
        self.frozen: dict[str, None] = {}
        self.open_loops: dict[str, None] = {}

    def run(self) -> EsdlImport:
        """Return the model and the report."""
        main = self._translated(self.selection.processes)
        # before startup is translated: what only startup assigns does not change in a step
        self.assigned = frozenset(self.code.assigned)
        startup = self._translated(self.selection.startup)
        self._add_unsupported()
        if self.findings:
            return EsdlImport(None, self._report())
        self._choose_names()
        try:
            return self._lowered(main, startup)
        except _StoppedError:
            return EsdlImport(None, self._report())

    def _translated(self, processes: Sequence[Process]) -> list[MethodCode]:
        result = []
        for process in processes:
            try:
                result.append(self.code.method(process.instance, process.method))
            except UnsupportedEsdlError as error:
                self.code.report(error, process.instance.scope, process.method.place, process.label)
        return result

    def _add_unsupported(self) -> None:
        """Add the elements whose types are not supported, and what the translated methods do not support."""
        if self.code.findings:
            self.findings += [*self.program.findings, *self.code.findings]

    def _report(self) -> EsdlReport:
        selection = self.selection
        labels = dict.fromkeys(process.instance.label for process in selection.processes)
        return EsdlReport(
            tuple(labels),
            tuple(process.label for process in selection.processes),
            tuple(process.label for process in selection.startup),
            selection.step,
            tasks=_task_summaries(selection),
            missing=tuple(sorted({name for p in selection.processes for name in p.instance.scope.tree.missing})),
            sources=(*self.program.sources(), *self.code.files),
            findings=tuple(dict.fromkeys(self.findings)),
            remarks=self._remarks(),
        )

    def _remarks(self) -> tuple[Finding, ...]:
        sentences = import_remarks(self.program, self.code, self.frozen)
        own = tuple(Finding(Location(), text, severity="remark") for text in (*sentences, *self.open_loops))
        others = () if self.findings else (replace(f, severity="warning") for f in self.program.findings)
        return (*self.selection.remarks, *own, *others)

    # names

    def _choose_names(self) -> None:
        roots = dict.fromkeys(process.instance.label for process in self.selection.processes)
        program, used = self.program, self.code.read | self.code.assigned
        interfaces = {
            label.rpartition(".")[0] for label, item in program.variables.items() if item.storage == "message"
        }
        self.display = DisplayNames(list(roots), sorted(interfaces), tuple(self.initial))
        characteristics = [
            label for label, item in program.variables.items() if item.storage == "characteristic" and label in used
        ]
        # parameters choose first: calibration files know them by their names
        names = self.display.choose([*characteristics, *program.tables])
        # axes and parameters may have the same names
        axes = DisplayNames(list(roots), ()).choose(list(program.axes))
        self.parameters = ProgramParameters(program, names, axes, self.initial)
        messages = [label for label in program.variables if label in used and self._is_input(program.variables[label])]
        self.input_names = self.display.choose(messages)
        self.roots = frozenset(roots)

    def _is_input(self, variable: ProgramVariable) -> bool:
        """Return True for messages that no method writes, and for variables that are set from outside."""
        if variable.storage == "message":
            return variable.label not in self.code.assigned
        owner = variable.label.rpartition(".")[0]
        labels = {process.instance.label for process in self.selection.processes}
        return variable.is_set and variable.storage == "variable" and owner in labels

    # lowering

    def _lowered(self, main: Sequence[MethodCode], startup: Sequence[MethodCode]) -> EsdlImport:
        # bounded: loops are unrolled, and a program of a few lines may ask for millions of nodes
        builder = self.builder = BoundedGraphBuilder()
        self._nodes: dict[str, Nodes] = {}
        self.units: dict[str, str] = {}
        # startup begins with the initial values; a step with those after startup, those of the last step in states
        fixed = {label: self._fixed(label) for label in sorted(self.code.read | self.code.assigned)}
        # a variable that only startup assigns is one of them: it may differ from its initial value
        mutable = [label for label in fixed if label in self.code.assigned]
        first = {**fixed, **{label: self._initial(label) for label in mutable}}
        begin = self._call_all(startup, [ScheduledTask("", self.selection.startup)], first)[0] if startup else first
        reads = {label: self._opened(label, begin[label], label in self.assigned) for label in mutable}
        # a method may assign a variable that is set from outside: each step begins with the input again
        inputs = {label: fixed[label] for label in mutable if self._is_input(self.program.variables[label])}
        end, results = self._call_all(main, self.selection.tasks, {**begin, **fixed, **reads, **inputs})
        for label, nodes in reads.items():
            self._close(nodes, begin[label], end[label])
        return self._model(builder, end, reads, results)

    def _fixed(self, label: str) -> Nodes:
        """Return the nodes of a variable that no method changes."""
        if label not in self._nodes:
            self._nodes[label] = self._evaluated(label) if label in self.code.dependents else self._stored(label)
        return self._nodes[label]

    def _evaluated(self, label: str) -> Nodes:
        """Return the nodes of a dependent characteristic."""
        formula = self.code.dependents[label]
        assert formula is not None
        context = self._context(self.builder)
        interpreter = StatementInterpreter(context, {name: self._fixed(name) for name in sorted(formula.used)})
        with _Stops(self, context):
            return interpreter.nodes(formula.tree)

    def _stored(self, label: str) -> Nodes:
        variable = self.program.variables[label]
        if variable.storage == "step":
            return np.array([[self.builder.step()]], dtype=np.int64)
        if variable.storage == "characteristic":
            return self.parameters.nodes(self.builder, label)
        if label in self.input_names:
            return self._input_nodes(
                self.input_names[label], variable.initial.shape, variable.dimensions, variable.type
            )
        return self._initial(label)

    def _initial(self, label: str) -> Nodes:
        if label in self.input_names:
            return self._fixed(label)
        numbers = self.program.variables[label].initial
        return s.constants(self.builder, numbers.reshape(-1, 1) if numbers.ndim == 1 else numbers)

    def _input_nodes(
        self, name: str, shape: tuple[int, ...], dimensions: Sequence[Dimension], kind: NumberType
    ) -> Nodes:
        nodes = np.empty(shape, dtype=np.int64)
        for place in np.ndindex(*shape):
            own = name + "".join(f"[{at + dim.first}]" for at, dim in zip(place, dimensions, strict=True))
            nodes[place] = self.builder.input(own)
            if kind.unit:
                self.units[own] = kind.unit
        return np.atleast_2d(nodes).reshape(-1, 1) if nodes.ndim < 2 else nodes

    def _opened(self, label: str, first: Nodes, changes: bool) -> Nodes:
        """Return the nodes that read the state of a variable; the value after startup if no step changes it."""
        # constants need no state; what startup computes from inputs must be kept from its one run
        if not changes and all(self.builder.value(int(node)) is not None for node in first.ravel()):
            return first
        return np.array([self.builder.state() for _ in first.ravel()], dtype=np.int64).reshape(first.shape)

    def _close(self, nodes: Nodes, first: Nodes, last: Nodes) -> None:
        for read, init, following in zip(nodes.ravel(), first.ravel(), last.ravel(), strict=True):
            # constants were not opened
            if self.builder.nodes[int(read)].op == "state":
                self.builder.close(int(read), int(init), int(following))

    def _call_all(
        self, codes: Sequence[MethodCode], tasks: Sequence[ScheduledTask], values: Mapping[str, Nodes]
    ) -> tuple[dict[str, Nodes], list[MethodResult]]:
        """Run tasks one after the other; return the variables afterwards and the results of each method."""
        interpreter = StatementInterpreter(self._context(self.builder))
        # kept as globals: methods of several instances share the messages, and see what the one before wrote
        interpreter.state.kept.update({(GLOBAL, label): nodes for label, nodes in values.items()})
        results: list[MethodResult] = []
        remaining = iter(codes)
        for task in tasks:
            calls = [(next(remaining), process) for process in task.processes]
            results += self._run(interpreter, task, calls)
        end = {label: interpreter.state.kept[GLOBAL, label] for label in values}
        arrays: dict[str, Nodes] = {}
        for label, value in end.items():
            with _Stops(self, interpreter.context):
                arrays[label] = np.asarray(s.as_array(value, label))
        return arrays, results

    def _run(
        self, interpreter: StatementInterpreter, task: ScheduledTask, calls: Sequence[tuple[MethodCode, Process]]
    ) -> list[MethodResult]:
        """Run a task where it is due; all variables, and the results of its methods, keep their values elsewhere."""
        results: list[MethodResult] = []

        def run() -> None:
            for code, process in calls:
                arguments = self._arguments(code, process)
                with _Stops(self, interpreter.context):
                    values = interpreter.call(code.definition, arguments, len(code.definition.results))
                results.append((process, code, values))

        if task.rate is None:
            run()
            return results
        kept = interpreter.state.kept
        durations = [label for label, variable in self.program.variables.items() if variable.storage == "step"]
        # within the task, dT is its own period; the step again behind it
        present = {label: kept[GLOBAL, label] for label in durations if (GLOBAL, label) in kept}
        own = np.array([[self.builder.const(task.rate.period)]], dtype=np.int64)
        kept.update({(GLOBAL, label): own for label in present})
        hit = sample_hit(self.builder, task.rate, self.selection.step)
        if hit is None:
            run()
        else:
            with _Stops(self, interpreter.context):
                interpreter.decide(hit, run)
        interpreter.state.kept.update({(GLOBAL, label): nodes for label, nodes in present.items()})
        return results if hit is None else [self._held(hit, result) for result in results]

    def _held(self, hit: int, result: MethodResult) -> MethodResult:
        """Return the results of a method, held between the runs of its task."""
        process, code, values = result
        kept = []
        for leaf, value in zip(code.definition.results, values, strict=True):
            with _Stops(self, None, process.instance.scope.location(process.method.place, process.method.name)):
                nodes = np.asarray(s.as_array(value, leaf))
            kept.append(np.array([self._held_node(hit, int(node)) for node in nodes.ravel()]).reshape(nodes.shape))
        return process, code, tuple(kept)

    def _held_node(self, hit: int, node: int) -> int:
        # y[k] = x[k] at a run of the task, else y[k - 1]; 0 before the first
        before = self.builder.state()
        value = self.builder.call("select", hit, node, before)
        self.builder.close(before, self.builder.const(0.0), value)
        return value

    def _context(self, builder: GraphBuilder) -> EvaluationContext:
        return EvaluationContext(
            builder,
            number=self.parameters.number,
            functions={name: code.definition for name, code in self.code.functions.items()},
            library=library(self.parameters.names),
            frozen=lambda text: self.frozen.update({text: None}),
            open_passes=OPEN_PASSES,
            open_loop=self._note_open_loop,
        )

    def _note_open_loop(self, line: int) -> None:
        sentence = f"the end of a loop in line {line} depends on signals: it is followed for {OPEN_PASSES} passes"
        self.open_loops[f"{sentence}, and results are NaN beyond"] = None

    def _arguments(self, code: MethodCode, process: Process) -> list[Nodes]:
        """Return the inputs that are the arguments of a method."""
        result: list[Nodes] = []
        for argument in process.method.arguments:
            kind = self.program.types.resolve(argument.type, process.instance.scope)
            for path, leaf, dimensions in leaves_of(kind):
                assert isinstance(leaf, NumberType)
                key = f"{process.label}.{'.'.join((argument.name, *path))}"
                # a method that several tasks call has its arguments once
                if key not in self.input_names:
                    plain = ".".join((argument.name, *path))
                    self.input_names[key] = self.display.claim(plain, f"{process.method.name}.{plain}")
                shape = tuple(dimension.size or 0 for dimension in dimensions)
                result.append(self._input_nodes(self.input_names[key], shape, dimensions, leaf))
        return result

    # model

    def _model(
        self,
        builder: GraphBuilder,
        end: Mapping[str, Nodes],
        reads: Mapping[str, Nodes],
        results: Sequence[MethodResult],
    ) -> EsdlImport:
        names = self._name_nodes(end, results)
        if not names.visible:
            place = self.selection.processes[0]
            message = "it has no outputs: the methods return nothing and change no variable"
            self.findings.append(Finding(place.instance.scope.location(place.method.place, place.label), message))
            raise _StoppedError
        graph = merge_equal_states(builder.finish(names.visible, {}, tuple(dict.fromkeys(names.outputs))))
        values = ParameterSet(self.parameters.by_name[name] for name in self._used(graph.parameters))
        units = {name: parameter.unit for name, parameter in values.items() if parameter.unit}
        units |= self.units | names.units
        present = {*graph.names, *graph.inputs, *graph.parameters}
        locations = {name: self._parameter_location(label) for label, name in self.parameters.names.items()}
        model = Model(
            graph=replace(graph, units=MappingProxyType({k: v for k, v in units.items() if k in present})),
            name=self.name,
            step=self.selection.step,
            declared=MappingProxyType({name: parameter.coordinates for name, parameter in values.items()}),
            source=self.source,
            locations=MappingProxyType(locations | names.locations),
            values=values,
            remarks=self._remarks(),
        )
        return EsdlImport(model, self._full_report(model, reads, end))

    def _used(self, parameters: Collection[str]) -> list[str]:
        return [name for name in self.parameters.by_name if name in parameters]

    def _parameter_location(self, label: str) -> Location:
        table = self.program.tables.get(label)
        return table.location if table is not None else self.program.variables[label].location

    def _name_nodes(
        self,
        end: Mapping[str, Nodes],
        results: Sequence[MethodResult],
    ) -> _Names:
        """Name the variables that a step changes, and the results of methods."""
        names = _Names()
        labels = [label for label in self.program.variables if label in self.assigned]
        chosen = self.display.choose(labels)
        # outputs first and in groups, as users look for them, whatever order the methods assign them in
        messages = [label for label in labels if self.program.variables[label].storage == "message"]
        own = [label for label in labels if label not in messages and label.rpartition(".")[0] in self.roots]
        others = [label for label in labels if label not in messages and label not in own]
        for label in (*own, *messages, *others):
            variable = self.program.variables[label]
            is_output = variable.storage == "message" or (variable.is_get and label in own)
            self._add_nodes(names, chosen[label], end[label], variable, is_output)
        for process, code, values in results:
            self._add_results(names, process, code, values)
        return names

    def _add_nodes(self, names: _Names, name: str, nodes: Nodes, variable: ProgramVariable, is_output: bool) -> None:
        flat = nodes.ravel()
        if flat.size > _MAX_SHOWN:
            return
        for at, place in enumerate(np.ndindex(*variable.initial.shape)):
            indices = zip(place, variable.dimensions, strict=True)
            own = name + "".join(f"[{index + dimension.first}]" for index, dimension in indices)
            node = int(flat[at])
            # inputs have their names already
            if not is_output and self.builder.nodes[node].op in ("const", "input"):
                continue
            names.visible[own] = node
            names.locations[own] = variable.location
            if variable.type.unit:
                names.units[own] = variable.type.unit
            if is_output:
                names.outputs.append(own)

    def _add_results(
        self, names: _Names, process: Process, code: MethodCode, values: tuple[s.SymbolicValue, ...]
    ) -> None:
        """Name the results of a method after the method, and the arguments that it changes after them."""
        place = process.instance.scope.location(process.method.place, process.method.name)
        for leaf, value in zip(code.definition.results, values, strict=True):
            with _Stops(self, None, place):
                nodes = np.asarray(s.as_array(value, leaf)).ravel()
            plain = leaf.replace("->", ".")
            plain = process.method.name + plain[len(RESULT) :] if plain.partition(".")[0] == RESULT else f"{plain}.out"
            name = self.display.claim(plain, f"{process.instance.label}.{plain}")
            for at, node in enumerate(nodes[:_MAX_SHOWN]):
                own = name if nodes.size == 1 else f"{name}[{at}]"
                names.visible[own] = int(node)
                names.outputs.append(own)
                names.locations[own] = place
                if isinstance(code.result, NumberType) and code.result.unit:
                    names.units[own] = code.result.unit

    def _full_report(self, model: Model, reads: Mapping[str, Nodes], end: Mapping[str, Nodes]) -> EsdlReport:
        graph, units = model.graph, model.graph.units
        inputs, outputs = (
            tuple(Quantity(name, units.get(name, "")) for name in names) for names in (graph.inputs, graph.outputs)
        )
        parameters = tuple(
            calibratable(p, str(replace(model.locations[p.name], column=0))) for p in model.values.values()
        )
        return replace(
            self._report(), inputs=inputs, outputs=outputs, parameters=parameters, states=self._states(reads, end)
        )

    def _states(self, reads: Mapping[str, Nodes], end: Mapping[str, Nodes]) -> tuple[StateSummary, ...]:
        """Return the variables whose values of the last step are needed."""
        needed = _needed_states(self.builder, end)
        names = DisplayNames(list(self.roots), ()).choose(list(reads))
        result = []
        for label, nodes in reads.items():
            states = [int(node) for node in nodes.ravel() if int(node) in needed]
            for at, node in enumerate(states):
                init = self.builder.value(self.builder.states[self.builder.nodes[node].payload].init)
                own = names[label] if nodes.size == 1 else f"{names[label]}[{at}]"
                result.append(StateSummary(own, init))
        return tuple(result)


def _needed_states(builder: GraphBuilder, end: Mapping[str, Nodes]) -> set[int]:
    """Return the state nodes that a value at the end of a step depends on, other than as its own unchanged value."""
    seen: set[int] = set()
    waiting = [int(node) for nodes in end.values() for node in nodes.ravel() if builder.nodes[int(node)].op != "state"]
    while waiting:
        node = waiting.pop()
        if node not in seen:
            seen.add(node)
            waiting += builder.nodes[node].args
    return {node for node in seen if builder.nodes[node].op == "state"}


def _task_summaries(selection: MethodSelection) -> tuple[TaskSummary, ...]:
    """Return the tasks that run at periods of their own."""
    return tuple(
        TaskSummary(task.name, task.rate.period, task.rate.offset, tuple(process.label for process in task.processes))
        for task in selection.tasks
        if task.rate is not None
    )


class _StoppedError(Exception):
    """The import ends with findings and without a model."""


class _Stops:
    """Turns errors of lowered code into findings, and stops the import."""

    def __init__(
        self, model_import: EsdlModelImport, context: EvaluationContext | None, place: Location | None = None
    ) -> None:
        self.model_import, self.context, self.place = model_import, context, place

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ProgramError):
            # remedies with blocks are those of Simulink
            self._stop(error.message, error.remedy if "blocks" not in error.remedy else "", error.line)
        if isinstance(error, GraphTooLargeError):
            self._stop("the program needs too many operations", "Make its arrays or loops smaller.")
        if isinstance(error, RecursionError):
            self._stop("the program is nested too deeply", "Split its expressions.")
        if isinstance(error, AbortedPathError):
            self._stop("the program ends on every path")

    def _stop(self, message: str, remedy: str = "", line: int = 0) -> None:
        running: Sequence[m.FunctionDefinition] = self.context.running if self.context is not None else ()
        location = self.place or Location.of_file(self.model_import.source)
        if running:
            code = self.model_import.code.functions.get(running[-1].name)
            if code is not None:
                line = line or running[-1].place.line
                location = Location(code.scope.path.name, line, running[-1].name.partition("()")[0])
        self.model_import.findings.append(Finding(location, message, remedy))
        raise _StoppedError from None
