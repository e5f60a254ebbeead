"""Import of FMUs as functions and models; nothing of their code runs here."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from kennfeld.errors import ArgumentError, Finding, Findings, Location
from kennfeld.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.fmu.description import FmuDescription, FmuInterface
from kennfeld.models.fmu.fmu_archive import digest_of, platform_folder, read_archive
from kennfeld.models.fmu.fmu_parameters import FmuParameters, parameters_of
from kennfeld.models.fmu.instance import layout_of
from kennfeld.models.fmu.trajectory_calls import TrajectoryCalls, signals
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction, as_model, share_calls

MODEL_EXCHANGE, CO_SIMULATION = "model_exchange", "co_simulation"
INTERFACES = {MODEL_EXCHANGE: "model exchange", CO_SIMULATION: "co-simulation"}
_MODULE = "kennfeld.models.fmu.instance"
_UNLIMITED = float("inf")
_MOST_NAMES = 4


def fmu(path: str | Path, step: float | None = None, solver: str = "ode4", interface: str = "") -> Model:
    """Read an FMU (FMI 2.0 or 3.0) as a model.

    Its inputs are channels, its outputs nodes, and its parameters scalars, curves and maps. For model exchange, its
    continuous states are advanced by a solver with a fixed step; for co-simulation, it advances itself. Its code runs
    when the model is first evaluated, not here.

    Args:
        path: the `.fmu` file.
        step: the step in s, by default that of its default experiment.
        solver: a name in `graph.integration.SOLVERS`, for model exchange.
        interface: `model exchange` or `co-simulation`; by default model exchange if the FMU can be used so.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
        ArgumentError: there is no such interface.
    """
    if interface not in ("", *INTERFACES.values()):
        raise ArgumentError(f"interface={interface!r} must be {join_names(list(INTERFACES.values()), 2, ' or ')}")
    words = {text: word for word, text in INTERFACES.items()}
    return as_model(read_fmu(Path(path), words.get(interface, ""), "", step), solver)


def read_fmu(path: Path, function: str, name: str, step: float | None) -> ModelFunction:
    """Read an FMU as a function, as `function_files.read_function_file` calls it; `function` may name the interface.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    description = read_archive(path)
    interface = function or usable_interface(description, path)
    Findings(find_obstacles(description, path, interface)).finish()
    parameters = parameters_of(description.parameters, f"{name}." if name else "")
    together = interface == CO_SIMULATION
    inputs = signals(description, "input") if together else description.inputs
    outputs = signals(description, "output") if together else description.real_outputs
    writer = (TrajectoryCalls if together else _FmuCalls)(description, parameters, path, digest_of(path))
    memory = together or bool(description.states)
    return ModelFunction(
        name=name or path.stem,
        inputs=tuple(FunctionInput(element, v.unit) for v in inputs for element in v.elements),
        outputs=tuple(FunctionOutput(element, v.unit) for v in outputs for element in v.elements),
        write=share_calls(writer.write),
        memory=memory,
        values=parameters.parameters,
        source=str(path),
        step=step or (description.step if memory else None),
        remarks=tuple(find_remarks(description, path, interface)),
    )


class _FmuCalls:
    """Writes the nodes of calls of the equations."""

    def __init__(self, description: FmuDescription, parameters: FmuParameters, path: Path, digest: str) -> None:
        layout = layout_of(description, "")
        arguments = (str(path.resolve()), digest)
        taken, self.states = layout.arguments, layout.states
        self.values = parameters.values
        self.outputs = [(output.reference, output.size) for output in description.real_outputs]
        self.state_sizes = [(state.reference, state.size) for state in description.states]
        self.equations = ExternalFunction(path.stem, taken, layout.results, f"{_MODULE}:load_equations", arguments)
        started = taken - layout.states
        self.start = ExternalFunction(f"{path.stem} start", started, layout.states, f"{_MODULE}:load_start", arguments)

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs."""
        time = builder.input("t")
        parameters = [builder.lookup(v.parameter, *map(builder.const, v.coordinates)) for v in self.values]
        states = [builder.state() for _ in range(self.states)]
        results = builder.external(self.equations, time, *states, *arguments, *parameters)
        limits = builder.const(-_UNLIMITED), builder.const(_UNLIMITED)
        starts = builder.external(self.start, time, *arguments, *parameters) if states else ()
        for state, start, derivative in zip(states, starts, results, strict=False):
            builder.close(state, start, builder.node("advance", (state, derivative, *limits)))
        return self._outputs(states, results[self.states :])

    def _outputs(self, states: Sequence[int], computed: Sequence[int]) -> Sequence[int]:
        """Return the nodes of the outputs, of which some are states."""
        nodes, remaining = iter(states), iter(computed)
        own = {reference: list(islice(nodes, size)) for reference, size in self.state_sizes}
        return [
            node
            for reference, size in self.outputs
            for node in (own[reference] if reference in own else islice(remaining, size))
        ]


def usable_interface(description: FmuDescription, path: Path) -> str:
    """Return the interface by which an FMU is used: model exchange, unless only co-simulation is possible."""
    interfaces = (MODEL_EXCHANGE, CO_SIMULATION)
    usable = [each for each in interfaces if not find_obstacles(description, path, each)]
    offered = [each for each in interfaces if interface_of(description, each) is not None]
    return next(iter([*usable, *offered]), MODEL_EXCHANGE)


def interface_of(description: FmuDescription, interface: str) -> FmuInterface | None:
    """Return what an FMU states about an interface, None if it does not offer it."""
    return description.co_simulation if interface == CO_SIMULATION else description.model_exchange


def find_obstacles(description: FmuDescription, path: Path, interface: str) -> tuple[Finding, ...]:
    """Return why an FMU cannot be used here by an interface; empty if it can."""
    findings, location = Findings(), Location(path.name)
    own, folder = interface_of(description, interface), platform_folder(description.version)
    if own is None:
        both = (description.model_exchange, description.co_simulation)
        offered = [text for text, each in zip(INTERFACES.values(), both, strict=True) if each is not None]
        message = (
            f"offers {join_names(offered or ['scheduled execution'], 2, ' and ')} only, not {INTERFACES[interface]}"
        )
        findings.error(location, message, f"Export the model as an FMU for {INTERFACES[interface]}.")
    elif own.needs_tool:
        message = f"runs only within {description.tool or 'the tool that exported it'}"
        findings.error(location, message, "Export it so that it runs alone.")
    if own is not None and folder not in description.platforms:
        platforms = join_names(description.platforms, _MOST_NAMES, " and ") or "no platform"
        findings.error(
            location, f"has libraries for {platforms}, not for {folder}", "Export the FMU for this platform."
        )
    _find_discrete(description, interface, location, findings)
    outputs = signals(description, "output") if interface == CO_SIMULATION else description.real_outputs
    if not outputs:
        kind = "number" if interface == CO_SIMULATION else "real number"
        findings.error(location, f"has no output that is a {kind}", "Export the FMU with such an output.")
    return tuple(findings)


def _find_discrete(description: FmuDescription, interface: str, location: Location, findings: Findings) -> None:
    if interface == CO_SIMULATION:
        names, sort = [v.name for v in description.variables if v.type == "Clock"], "clocks"
    else:
        names, sort = list(description.discrete), "clocks or discrete states"
    if names:
        message = f"has {sort}, which are not supported: {join_names(names, _MOST_NAMES, ' and ')}"
        findings.error(location, message, "Export the continuous part of the model.")


def find_remarks(description: FmuDescription, path: Path, interface: str) -> list[Finding]:
    """Return what runs differently from the source, and that code will run."""
    location = Location(path.name)
    differing = _trajectory_remarks if interface == CO_SIMULATION else _equation_remarks
    return [
        Finding(location, sentence, severity="remark")
        for sentence in (f"runs code of {path.name}", *differing(description))
    ]


def _equation_remarks(description: FmuDescription) -> Iterator[str]:
    interface = description.model_exchange
    if interface is not None and interface.directional:
        yield (
            "slopes are the directional derivatives of the FMU along arguments where they agree with differences, "
            "otherwise central differences"
        )
    else:
        yield "slopes are central differences, because the FMU offers no directional derivatives"
    if description.indicators:
        yield (
            f"{description.indicators} event indicators: conditions are updated at each evaluation; "
            "an event that changes states gives NaN, and a condition must not depend on earlier ones"
        )
    if description.unused:
        names = join_names([v.name for v in description.unused], _MOST_NAMES, " and ")
        yield f"inputs keep their start values and outputs are skipped if they are not real numbers: {names}"


def _trajectory_remarks(description: FmuDescription) -> Iterator[str]:
    yield "co-simulation: outputs at a sample are those of a step with the inputs of the sample before"
    yield "slopes are differences of whole simulations"
    interface = description.co_simulation
    if interface is not None and interface.single:
        yield "one simulation runs at a time, because the FMU allows one instance in a process"
    if interface is not None and not interface.variable_step:
        yield "all steps must have the same length"
    used = {*signals(description, "input"), *signals(description, "output")}
    others = [v.name for v in description.variables if v.causality in ("input", "output") and v not in used]
    if others:
        names = join_names(others, _MOST_NAMES, " and ")
        yield f"inputs keep their start values and outputs are skipped if they are not numbers: {names}"
