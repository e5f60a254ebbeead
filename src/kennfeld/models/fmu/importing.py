"""Import of FMUs for model exchange as functions and models; nothing of their code runs here."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from kennfeld.errors import Finding, Findings, Location
from kennfeld.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.fmu.description import FmuDescription
from kennfeld.models.fmu.fmu_archive import digest_of, platform_folder, read_archive
from kennfeld.models.fmu.fmu_parameters import ParameterValue, parameters_of, start_values_of
from kennfeld.models.fmu.instance import layout_of
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction, as_model
from kennfeld.parameter_set import ParameterSet

_MODULE = "kennfeld.models.fmu.instance"
_UNLIMITED = float("inf")
_MOST_NAMES = 4


def fmu(path: str | Path, step: float | None = None, solver: str = "ode4", *, fit_starts: bool = False) -> Model:
    """Read an FMU for model exchange (FMI 2.0 or 3.0) as a model.

    Its inputs are channels, its outputs nodes, its parameters scalars, curves and maps, and its continuous states are
    advanced by a solver with a fixed step. Start values of states that the FMU lets others set are parameters
    `STATE.start`. Its code runs when the model is first evaluated, not here.

    Args:
        path: the `.fmu` file.
        step: the step in s, by default that of its default experiment.
        solver: a name in `graph.integration.SOLVERS`.
        fit_starts: True if a calibration may change start values of states; otherwise they are locked.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    model = as_model(read_fmu(Path(path), "", "", step), solver)
    if not fit_starts:
        return model
    return replace(model, values=ParameterSet(p.changed(locked=np.False_) for p in model.values.parameters))


def read_fmu(path: Path, function: str, name: str, step: float | None) -> ModelFunction:
    """Read an FMU as a function, as `function_files.read_function_file` calls it.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    assert not function  # an FMU holds one model
    description = read_archive(path)
    findings = Findings(find_obstacles(description, path))
    findings.finish()
    prefix = f"{name}." if name else ""
    parameters = parameters_of(description.parameters, prefix)
    starts = start_values_of(description.started_states, prefix)
    timed = takes_time(description, step)
    calls = _FmuCalls(description, parameters.values, starts.values, (str(path.resolve()), digest_of(path), int(timed)))
    return ModelFunction(
        name=name or path.stem,
        inputs=tuple(FunctionInput(element, v.unit) for v in description.number_inputs for element in v.elements),
        outputs=tuple(FunctionOutput(element, v.unit) for v in description.number_outputs for element in v.elements),
        write=calls.write,
        memory=bool(description.states),
        values=parameters.parameters.merged(starts.parameters),
        source=str(path),
        step=step or (description.step if description.states else None),
        remarks=tuple(find_remarks(description, path)),
    )


class _FmuCalls:
    """Writes the nodes of calls; equal calls within a builder share their states."""

    def __init__(
        self,
        description: FmuDescription,
        values: Sequence[ParameterValue],
        start_values: Sequence[ParameterValue],
        arguments: tuple[str, str, int],
    ) -> None:
        layout = layout_of(description, "")
        name, self.timed = Path(arguments[0]).stem, arguments[2] == 1
        taken, self.states = layout.arguments, layout.states
        self.values, self.start_values = values, start_values
        self.description = description
        self.order = _input_order(description)
        self.jumps = layout.jumps
        self.equations = ExternalFunction(name, taken, layout.results, f"{_MODULE}:load_equations", arguments)
        started = layout.start_arguments
        self.start = ExternalFunction(f"{name} start", started, layout.states, f"{_MODULE}:load_start", arguments[:2])
        loader = f"{_MODULE}:load_events"
        self.events = ExternalFunction(f"{name} events", taken, layout.states, loader, arguments[:2])
        self._written: WeakKeyDictionary[GraphBuilder, dict[tuple[int, ...], Sequence[int]]] = WeakKeyDictionary()

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs."""
        calls = self._written.setdefault(builder, {})
        key = tuple(arguments)
        if key not in calls:
            calls[key] = self._write(builder, arguments)
        return calls[key]

    def _write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        time = builder.input("t") if self.timed else builder.const(0.0)
        inputs = [arguments[number] for number in self.order]
        parameters, starts = (_look_up(builder, values) for values in (self.values, self.start_values))
        states = [builder.state() for _ in range(self.states)]
        x: Sequence[int] = states
        if self.jumps:  # events change the states at samples, not within steps
            x = builder.external(self.events, time, *states, *inputs, *parameters)
        results = builder.external(self.equations, time, *x, *inputs, *parameters)
        limits = builder.const(-_UNLIMITED), builder.const(_UNLIMITED)
        first = builder.external(self.start, time, *inputs, *parameters, *starts) if states else ()
        for state, start, now, derivative in zip(states, first, x, results, strict=False):
            builder.close(state, start, builder.node("advance", (now, derivative, *limits)))
        return self._outputs(x, results[self.states :])

    def _outputs(self, states: Sequence[int], computed: Sequence[int]) -> Sequence[int]:
        """Return the nodes of the outputs, of which some are states."""
        nodes, remaining = iter(states), iter(computed)
        own = {state.reference: list(islice(nodes, state.size)) for state in self.description.states}
        others = {output.name: list(islice(remaining, output.size)) for output in self.description.computed_outputs}
        outputs = self.description.number_outputs
        return [node for y in outputs for node in (others[y.name] if y.name in others else own[y.reference])]


def _look_up(builder: GraphBuilder, values: Sequence[ParameterValue]) -> list[int]:
    return [builder.lookup(value.parameter, *map(builder.const, value.coordinates)) for value in values]


def _input_order(description: FmuDescription) -> list[int]:
    """Return the numbers of the elements of inputs in the order in which the code takes them."""
    inputs = description.number_inputs
    numbers, sizes = iter(range(sum(v.size for v in inputs))), {v.name: v.size for v in inputs}
    places = {name: list(islice(numbers, size)) for name, size in sizes.items()}
    return [number for variable in description.sorted_by_type(inputs) for number in places[variable.name]]


def takes_time(description: FmuDescription, step: float | None) -> bool:
    """Return True if the outputs may depend on the time; points without time stamps then cannot be evaluated.

    Without states, they do if the description says so; if it does not state dependencies, a given step decides.
    """
    if description.states:
        return True
    clocks = {v.reference for v in description.variables if v.causality == "independent"}
    stated = [dependency.references for dependency in description.outputs]
    return any(step is not None if used is None else used & clocks for used in stated)


def find_obstacles(description: FmuDescription, path: Path) -> tuple[Finding, ...]:
    """Return why an FMU cannot be used here; empty if it can."""
    findings, location = Findings(), Location(path.name)
    interface, folder = description.model_exchange, platform_folder(description.version)
    if interface is None:
        offered = "co-simulation" if description.co_simulation is not None else "scheduled execution"
        message = f"offers {offered} only, which is not supported"
        findings.error(location, message, "Export the model as an FMU for model exchange.")
    elif interface.needs_tool:
        message = f"runs only within {description.tool or 'the tool that exported it'}"
        findings.error(location, message, "Export it so that it runs alone.")
    if interface is not None and folder not in description.platforms:
        offered = join_names(description.platforms, _MOST_NAMES, " and ") or "no platform"
        findings.error(location, f"has libraries for {offered}, not for {folder}", "Export the FMU for this platform.")
    if description.discrete:
        names = join_names(description.discrete, _MOST_NAMES, " and ")
        message = f"has clocks or discrete states, which are not supported: {names}"
        findings.error(location, message, "Export the continuous part of the model.")
    if not description.number_outputs:
        findings.error(location, "has no output that is a number", "Export the FMU with such an output.")
    return tuple(findings)


def find_remarks(description: FmuDescription, path: Path) -> list[Finding]:
    """Return what runs differently from the source, and that code will run."""
    location, interface = Location(path.name), description.model_exchange
    sentences = [f"runs code of {path.name}"]
    if interface is not None and interface.directional:
        sentences.append(
            "slopes are the directional derivatives of the FMU where they agree with differences, otherwise differences"
        )
    else:
        sentences.append("slopes are differences, because the FMU offers no directional derivatives")
    if description.indicators:
        sentences.append(
            f"{description.indicators} event indicators: conditions are updated at each evaluation, and events change "
            "states at the samples that follow them, with errors of the order of the step; slopes do not include that "
            "events move with parameters"
        )
    if description.unused:
        names = join_names([v.name for v in description.unused], _MOST_NAMES, " and ")
        sentences.append(f"inputs keep their start values and outputs are skipped if they are not numbers: {names}")
    return [Finding(location, sentence, severity="remark") for sentence in sentences]
