"""Import of FMUs for model exchange as functions and models; nothing of their code runs here."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from weakref import WeakKeyDictionary

from kennfeld.errors import Finding, Findings, Location
from kennfeld.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.fmu.description import FmuDescription
from kennfeld.models.fmu.fmu_archive import digest_of, platform_folder, read_archive
from kennfeld.models.fmu.fmu_parameters import FmuParameters, parameters_of
from kennfeld.models.fmu.instance import layout_of
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction, as_model

_MODULE = "kennfeld.models.fmu.instance"
_UNLIMITED = float("inf")
_MOST_NAMES = 4


def fmu(path: str | Path, step: float | None = None, solver: str = "ode4") -> Model:
    """Read an FMU for model exchange (FMI 2.0 or 3.0) as a model.

    Its inputs are channels, its outputs nodes, its parameters scalars, curves and maps, and its continuous states are
    advanced by a solver with a fixed step. Its code runs when the model is first evaluated, not here.

    Args:
        path: the `.fmu` file.
        step: the step in s, by default that of its default experiment.
        solver: a name in `graph.integration.SOLVERS`.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    return as_model(read_fmu(Path(path), "", "", step), solver)


def read_fmu(path: Path, function: str, name: str, step: float | None) -> ModelFunction:
    """Read an FMU as a function, as `function_files.read_function_file` calls it.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    assert not function  # an FMU holds one model
    description = read_archive(path)
    findings = Findings(find_obstacles(description, path))
    findings.finish()
    parameters = parameters_of(description.parameters, f"{name}." if name else "")
    calls = _FmuCalls(description, parameters, path, digest_of(path))
    return ModelFunction(
        name=name or path.stem,
        inputs=tuple(FunctionInput(element, v.unit) for v in description.inputs for element in v.elements),
        outputs=tuple(FunctionOutput(element, v.unit) for v in description.real_outputs for element in v.elements),
        write=calls.write,
        memory=bool(description.states),
        values=parameters.parameters,
        source=str(path),
        step=step or (description.step if description.states else None),
        remarks=tuple(find_remarks(description, path)),
    )


class _FmuCalls:
    """Writes the nodes of calls; equal calls within a builder share their states."""

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
        self._written: WeakKeyDictionary[GraphBuilder, dict[tuple[int, ...], Sequence[int]]] = WeakKeyDictionary()

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
        """Add the nodes of one step, and return those of the outputs."""
        calls = self._written.setdefault(builder, {})
        key = tuple(arguments)
        if key not in calls:
            calls[key] = self._write(builder, arguments)
        return calls[key]

    def _write(self, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
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
    if not description.real_outputs:
        findings.error(location, "has no output that is a real number", "Export the FMU with such an output.")
    return tuple(findings)


def find_remarks(description: FmuDescription, path: Path) -> list[Finding]:
    """Return what runs differently from the source, and that code will run."""
    location, interface = Location(path.name), description.model_exchange
    sentences = [f"runs code of {path.name}"]
    if interface is not None and interface.directional:
        sentences.append(
            "slopes are the directional derivatives of the FMU along arguments where they agree with differences, "
            "otherwise central differences"
        )
    else:
        sentences.append("slopes are central differences, because the FMU offers no directional derivatives")
    if description.indicators:
        sentences.append(
            f"{description.indicators} event indicators: conditions are updated at each evaluation; "
            "an event that changes states gives NaN, and a condition must not depend on earlier ones"
        )
    if description.unused:
        names = join_names([v.name for v in description.unused], _MOST_NAMES, " and ")
        sentences.append(
            f"inputs keep their start values and outputs are skipped if they are not real numbers: {names}"
        )
    return [Finding(location, sentence, severity="remark") for sentence in sentences]
