"""Import of FMUs as functions and models; nothing of their code runs here."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, Location
from kennfeld.base.fmi_platform import platform_folder
from kennfeld.base.formatting import join_names
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.importers.fmu.chosen_outputs import SEPARATOR, choose_outputs, describe_choice
from kennfeld.importers.fmu.description import FmuDescription, FmuInterface
from kennfeld.importers.fmu.equation_calls import EquationCalls
from kennfeld.importers.fmu.fmu_archive import digest_of, read_archive
from kennfeld.importers.fmu.fmu_parameters import parameters_of, start_values_of
from kennfeld.importers.fmu.trajectory_calls import TrajectoryCalls
from kennfeld.models.import_report import FunctionReport
from kennfeld.models.importer import ImportRequest, ImportResult
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction, Write, as_model, share_calls

MODEL_EXCHANGE, CO_SIMULATION = "model-exchange", "co-simulation"
INTERFACES = {MODEL_EXCHANGE: "model exchange", CO_SIMULATION: "co-simulation"}
_MOST_NAMES = 4


def fmu(
    path: str | Path,
    step: float | None = None,
    solver: str = "ode4",
    interface: str = "",
    *,
    fit_starts: bool = False,
    outputs: Sequence[str] = (),
) -> Model:
    """Read an FMU (FMI 2.0 or 3.0) as a model.

    Its inputs are channels, its outputs nodes, and its parameters scalars, curves and maps. For model exchange, its
    continuous states are advanced by a solver with a fixed step, and start values of states that the FMU lets others
    set are parameters `STATE.start`; for co-simulation, it advances itself. Its code runs when the model is first
    evaluated, not here.

    Args:
        path: the `.fmu` file.
        step: the step in s, by default that of its default experiment.
        solver: `ode1` to `ode5` or `ode8`, for model exchange.
        interface: `model-exchange` or `co-simulation`; by default model exchange if the FMU can be used so.
        fit_starts: True if a calibration may change start values of states; otherwise they are locked.
        outputs: variables that become nodes in addition to its outputs, such as states, their derivatives and other
            local variables, or patterns of their names: `["body.v", "der(*)"]`. The states do if it has no outputs.

    Returns:
        The model.

    Raises:
        InputError: the file is damaged, the FMU cannot be used here, or it computes no such variable.
        ArgumentError: there is no such interface.

    >>> model = fmu("lag.fmu")
    >>> model.graph.inputs, model.graph.outputs, list(model.values)
    (('u',), ('y',), ['tau', 'k', 'table'])
    """
    chosen = interface.replace("_", "-").replace(" ", "-")
    if chosen not in ("", *INTERFACES):
        raise ArgumentError(f"interface={interface!r} must be {join_names(list(INTERFACES), 2, ' or ')}")
    model = as_model(read_fmu(Path(path), chosen, "", step, outputs), solver)
    if not fit_starts:
        return model
    return replace(model, values=ParameterSet(p.changed(locked=np.False_) for p in model.values.parameters))


def import_fmu(request: ImportRequest) -> ImportResult:
    """Import an FMU as a model of its own, with the outputs that a project chooses.

    Raises:
        InputError: the file is damaged, the FMU cannot be used here, or it computes no such variable.
    """
    options = request.options
    function = read_fmu(request.path, request.choice, "", options.step, options.outputs)
    return ImportResult(as_model(function), FunctionReport.of(function))


def read_fmu(path: Path, function: str, name: str, step: float | None, outputs: Sequence[str] = ()) -> ModelFunction:
    """Read an FMU as a function, as `function_files.read_function_file` calls it.

    Args:
        path: the `.fmu` file.
        function: the interface; empty for the first one that can be used.
        name: name for calls in formula text, which precedes those of parameters; empty for a model of its own.
        step: the step in s; None for that of the default experiment.
        outputs: variables that become outputs in addition, or patterns of their names.

    Raises:
        InputError: the file is damaged, or the FMU cannot be used here.
    """
    description = read_archive(path)
    # first, since an FMU without outputs is usable by the choice alone
    further = choose_outputs(description, outputs, path)
    stated, description = description, description.with_outputs(further)
    interface = function or usable_interface(description, path)
    Findings(find_obstacles(description, path, interface)).finish()
    prefix = f"{name}." if name else ""
    parameters = parameters_of(description.parameters, prefix)
    # the digest makes a file that is replaced later an error, see `read_unchanged`
    known = (str(path.resolve()), digest_of(path), SEPARATOR.join(further))
    starts = start_values_of(description.started_states, prefix)
    write: Write
    together = interface == CO_SIMULATION
    if together:
        write = TrajectoryCalls(description, (*parameters.values, *starts.values), path, known).write
        memory = True
    else:
        timed = int(takes_time(description, step))
        write = EquationCalls(description, parameters.values, starts.values, (*known, timed)).write
        memory = bool(description.states)
    # formula text cannot write brackets and parentheses; a model of its own keeps the names
    spell = call_name if name else str
    remarks = find_remarks(description, path, interface)
    # what the user did not request is reported
    if further and not stated.number_outputs and not outputs:
        remarks.append(Finding(Location(path.name), _states_remark(stated), severity="remark"))
    inputs = [FunctionInput(spell(x), v.unit, later=together) for v in description.number_inputs for x in v.elements]
    results = [FunctionOutput(spell(element), v.unit) for v in description.number_outputs for element in v.elements]
    return ModelFunction(
        name=name or path.stem,
        inputs=tuple(inputs),
        outputs=tuple(results),
        write=share_calls(write),
        memory=memory,
        values=parameters.parameters.merged(starts.parameters),
        source=str(path),
        step=step or (description.step if memory else None),
        remarks=tuple(remarks),
    )


def call_name(element: str) -> str:
    """Spell the name of an input or output as formula text can write it.

    >>> call_name("y[1,2]"), call_name("pipe[1].p"), call_name("der(x)")
    ('y.1.2', 'pipe.1.p', 'der_x_')
    """
    places = re.sub(r"\[([\d, ]+)\]", lambda match: f".{re.sub(', *', '.', match[1])}", element)
    return re.sub(r"[^\w.]", "_", places)


def takes_time(description: FmuDescription, step: float | None) -> bool:
    """Return True if the outputs may depend on the time; points without time stamps then cannot be evaluated.

    Without states, they do if the description says so; if it does not state dependencies, a given step decides.
    """
    if description.states:
        return True
    clocks = {v.reference for v in description.variables if v.causality == "independent"}
    stated = [dependency.references for dependency in description.outputs]
    return any(step is not None if used is None else used & clocks for used in stated)


def usable_interface(description: FmuDescription, path: Path) -> str:
    """Choose the interface by which an FMU is used: model exchange, unless only co-simulation is possible."""
    interfaces = (MODEL_EXCHANGE, CO_SIMULATION)
    # an FMU may offer model exchange with discrete states, which its co-simulation hides
    usable = [each for each in interfaces if not find_obstacles(description, path, each)]
    offered = [each for each in interfaces if interface_of(description, each) is not None]
    return next(iter([*usable, *offered]), MODEL_EXCHANGE)


def interface_of(description: FmuDescription, interface: str) -> FmuInterface | None:
    """Return what an FMU states about an interface, None if it does not offer it."""
    return description.co_simulation if interface == CO_SIMULATION else description.model_exchange


def find_obstacles(description: FmuDescription, path: Path, interface: str) -> tuple[Finding, ...]:
    """Find why an FMU cannot be used here by an interface; empty if it can."""
    findings, location = Findings(), Location(path.name)
    own, folder = interface_of(description, interface), platform_folder(description.version)
    if own is None:
        # an FMU of FMI 3.0 may offer neither of them
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
    if not description.number_outputs:
        remedy = describe_choice(description) or "Export the FMU with such an output"
        findings.error(location, "has no output that is a number", f"{remedy}.")
    return tuple(findings)


def _states_remark(description: FmuDescription) -> str:
    return f"it has no output that is a number, so that its states are nodes; {describe_choice(description)}"


def _find_discrete(description: FmuDescription, interface: str, location: Location, findings: Findings) -> None:
    # without its ticks, what an input clock drives would stay as it was at the start, without an error
    ticked = [clock.name for clock in description.clocks if clock.causality == "input"]
    if ticked:
        message = f"has input clocks, which are not supported: {join_names(ticked, _MOST_NAMES, ' and ')}"
        findings.error(location, message, "Export the model without them, with clocks inside of the FMU.")
    if interface == MODEL_EXCHANGE and description.discrete:
        names = join_names(description.discrete, _MOST_NAMES, " and ")
        other = "Choose its co-simulation." if description.co_simulation is not None else ""
        message = f"has discrete states, which are not supported for model exchange: {names}"
        findings.error(location, message, other or "Export the continuous part of the model, or for co-simulation.")


def find_remarks(description: FmuDescription, path: Path, interface: str) -> list[Finding]:
    """Find what runs differently from the source."""
    differing = _trajectory_remarks if interface == CO_SIMULATION else _equation_remarks
    sentences = [*differing(description)]
    if description.clocks:
        names = join_names([v.name for v in description.clocks], _MOST_NAMES, " and ")
        sentences.append(f"clocks are not read; the FMU itself handles their ticks: {names}")
    if description.unused:
        names = join_names([v.name for v in description.unused], _MOST_NAMES, " and ")
        sentences.append(f"inputs keep their start values and outputs are skipped if they are not numbers: {names}")
    return [Finding(Location(path.name), sentence, severity="remark") for sentence in sentences]


def _equation_remarks(description: FmuDescription) -> Iterator[str]:
    interface = description.model_exchange
    if interface is not None and interface.directional:
        yield (
            "slopes are the directional derivatives of the FMU where they agree with differences, otherwise differences"
        )
    else:
        yield "slopes are differences, because the FMU offers no directional derivatives"
    if description.indicators:
        yield (
            f"{description.indicators} event indicators: conditions are updated at each evaluation, and events change "
            "states at the samples that follow them, with errors of the order of the step; slopes do not include that "
            "events move with parameters"
        )


def _trajectory_remarks(description: FmuDescription) -> Iterator[str]:
    yield "co-simulation: outputs at a sample are those of a step with the inputs of the sample before"
    yield "slopes are differences of whole simulations"
    interface = description.co_simulation
    if interface is not None and interface.single:
        yield "one simulation runs at a time, because the FMU allows one instance in a process"
    if interface is not None and not interface.variable_step:
        yield "all steps must have the same length"
