"""The rules for problems, checked before anything is compiled: names, limits, axes, bounds, time steps and memory."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np

from kennfeld.base.errors import Finding, Findings, Fix, InputError, Location
from kennfeld.base.formatting import count_noun, nearest
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Shape, Term
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.free_axes import AxisKey, FreeAxis, key_of
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.table_parts import missing_directions
from kennfeld.graph import Graph
from kennfeld.graph.external_function import is_sequential
from kennfeld.graph.traversal import dependents
from kennfeld.models import Model
from kennfeld.optimize.problem.limit_nodes import add_limit_nodes, channels_of, limit_sides
from kennfeld.optimize.problem.problem import Problem, moving_axis
from kennfeld.preprocessing.sample_weights import weight_findings

STEP_TOLERANCE = 1e-3  # relative difference of steps that time stamps may have by rounding
MAX_BYTES = 4e9  # of all delays, or of one matrix; a fit and its trust keep several of them
MAX_LISTED = 5
MAX_LISTED_CHANNELS = 12
_TABLES = {1: "Curve", 2: "Map"}  # class of a table by its number of axes


def dataset_location(data: Dataset) -> Location:
    """Return the location of a dataset in messages."""
    return Location(f"dataset {data.name}")


def weight_warnings(problem: Problem) -> list[Finding]:
    """Return the warnings about sample weights of a problem made in Python, such as missing ones."""
    return [finding for finding in _weight_findings(problem) if finding.severity == "warning"]


def _weight_findings(problem: Problem) -> list[Finding]:
    return weight_findings(
        problem.criteria,
        problem.fitted_datasets,
        lambda i: Location(f"criterion on {problem.criteria[i].node}"),
        dataset_location,
    )


def check_problem(problem: Problem) -> Findings:
    """Check a problem made in Python; sizes and limits only if all names are known."""
    findings = Findings(check_inputs(problem.model.graph, problem.datasets, problem.parameters, problem.channels))
    findings.add(*step_findings(problem.model, problem.datasets, problem.model.step, dataset_location))
    for name in problem.channels:
        if name not in problem.model.graph.inputs:
            remedy = nearest(name, problem.model.graph.inputs)
            findings.error(Location("channels"), f"unknown input {name}", remedy)
    for pin in problem.pins:
        if not np.all(np.isfinite((*pin.at, pin.value))):
            findings.error(Location(f"pin of {pin.parameter}"), f"{pin.value} at {list(pin.at)} is not finite")
    findings.add(*(finding for finding in _weight_findings(problem) if finding.severity == "error"))
    names = problem.model.graph.names
    channels = list(dict.fromkeys(channel for data in problem.datasets for channel in data))
    for criterion in problem.criteria:
        for node in (criterion.node, problem.target_node(criterion)):
            if node is not None and node not in names:
                remedy = nearest(node, [*names, *channels]) or f"The channels are {_listed(channels)}."
                findings.error(Location("criterion"), f"unknown node or channel {node}", remedy)
    sizes = delay_findings(problem.model, problem.free_size) or matrix_findings(
        Location("parameters"), problem.free_size
    )
    if not findings.has_errors:
        sizes += trajectory_findings(problem)
    findings.add(*([] if findings.has_errors else sizes))
    findings.add(*([] if findings.has_errors else check_limits(problem)))
    return findings


def check_inputs(
    graph: Graph, datasets: Sequence[Dataset], parameters: ParameterSet, channels: Mapping[str, str]
) -> Iterator[Finding]:
    """Report inputs without a channel, lookups without a parameter, and tables with a different number of axes."""
    function = Location("function")
    for name, count in graph.parameters.items():
        if name not in parameters:
            yield Finding(function, f"unknown parameter {name}", nearest(name, parameters))
        elif (axes := parameters[name].coordinates) != count:
            message = f"{name} is looked up with {count_noun(count, 'coordinate')}, but has {_axes(axes)}"
            yield Finding(function, message, _table_remedy(name, count, axes))
    for dataset in datasets:
        for name in graph.inputs:
            channel = channels.get(name, name)
            if channel not in dataset:
                remedy = nearest(channel, dataset) or _channel_remedy(name, dataset)
                yield Finding(dataset_location(dataset), f"no channel named {channel}", remedy)


def _channel_remedy(name: str, dataset: Dataset) -> str:
    """Return what to do about an input without a channel, which may be meant as a parameter."""
    return f"It has {_listed(list(dataset))}. If {name} is a scalar to fit, give it an initial value."


def _listed(channels: Sequence[str]) -> str:
    return ", ".join(channels[:MAX_LISTED_CHANNELS])


def _axes(count: int) -> str:
    return "1 axis" if count == 1 else f"{count} axes"


def _table_remedy(name: str, count: int, axes: int) -> str:
    """Return what to change if a table is looked up with another number of coordinates than it has axes."""
    if axes == 0:  # a number as start, where the formula calls a table
        return f'A table needs initial values: kf.{_TABLES.get(count, "Cube")}("{name}", ...).'
    return f"Look it up with {count_noun(axes, 'coordinate')}, or give it {_axes(count)}."


def check_fittable(problem: Problem, *, globally: bool) -> Findings:
    """Check that there is something to fit; `globally` without gradients."""
    findings = Findings()
    if not problem.criteria:
        findings.error(Location("criteria"), "no criterion is defined", 'Give target="channel", or criteria.')
    if not problem.free_names:
        message = f"free = {list(problem.free)} matches no parameter that the function uses"
        findings.error(Location("parameters"), message)
    findings.add(*check_shared_axes(problem.free_axes, problem.free_names))
    if not any(bound.count for bound in problem.training):
        findings.error(Location("datasets"), "no training data", "Use at least one dataset for training.")
    else:
        for c, known in zip(problem.criteria, have_targets(problem), strict=True):
            if not known:
                message = f"no sample of the training data has its target {c.target}"
                findings.error(Location(f"criterion on {c.node}"), message)
    if globally:
        findings.add(*unbounded(problem))
    return findings


def have_targets(problem: Problem) -> list[bool]:
    """Return for each criterion if a training sample has its target; excerpts of partitions usually tell."""
    known = _own_targets(problem)
    if not all(known) and problem.partitions is not None:
        known = [any(own) for own in zip(*problem.each(_own_targets), strict=True)]
    return known


def _own_targets(problem: Problem) -> list[bool]:
    return [any(np.isfinite(problem.target(c, b)).any() for b in problem.training) for c in problem.criteria]


def check_limits(problem: Problem) -> list[Finding]:
    """Report unknown names in output limits, and conditions that depend on free parameters."""
    if not problem.limits:
        return []
    try:
        graph = add_limit_nodes(problem.model, problem.limits).graph
    except InputError as error:
        return list(error.findings)
    live = dependents(graph, lambda node: node.parameter in problem.free_names)
    findings = []
    for name in channels_of(problem.model, problem.limits):
        for data in problem.datasets:
            if data.use == "training" and problem.channels.get(name, name) not in data:
                message = f"unknown node or channel {name} (dataset {data.name})"
                remedy = nearest(name, [*problem.model.graph.names, *problem.parameters, *data])
                findings.append(Finding(Location("limit"), message, remedy))
    for side in limit_sides(problem.limits):
        if side.limit.where and graph.names[side.where] in live:
            message = f"its condition {side.limit.where} depends on a free parameter"
            findings.append(Finding(Location(f"limit {side}"), message, "Use channels only."))
    return findings


def check_linear_limits(problem: Problem) -> Iterator[Finding]:
    """Report pins, shapes and equalities that cannot be used."""
    for pin in problem.pins:
        yield from _check_term(problem, f"pin of {pin.parameter}", Term(pin.parameter, pin.at))
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            yield from _check_shape(problem, f"{constraint.kind} of {constraint.parameter}", constraint)
        else:
            for term in constraint.terms:
                yield from _check_term(problem, f"equality {constraint}", term)


def _check_shape(problem: Problem, name: str, shape: Shape) -> Iterator[Finding]:
    yield from _check_term(problem, name, Term(shape.parameter))
    if shape.parameter not in problem.parameters:
        return
    if shape.kind == "curvature" and moving_axis(problem, shape) is not None:  # it is not linear in the breakpoints
        message = "the breakpoints along this axis are free"
        yield Finding(Location(name), message, "Fix them, or remove the limit.")
    table = problem.parameters[shape.parameter]
    axes = len(table.index_axes)
    if not 0 <= shape.axis < axes:
        yield Finding(Location(name), f"axis {shape.axis} does not exist, the parameter has {axes} axes")
    for direction in missing_directions(table, shape.where):
        yield Finding(Location(name), f"axis {direction} of its where does not exist, the parameter has {axes} axes")
    for direction in shape.where:
        which = AXIS_LETTERS.index(direction)
        if which < len(table.axes) and key_of(table, which) in problem.free_axes:
            message = f"the breakpoints along {direction}, on which its where depends, are free"
            yield Finding(Location(name), message, "Fix them, or limit the whole table.")


def _check_term(problem: Problem, name: str, term: Term) -> Iterator[Finding]:
    if term.parameter not in problem.free_names:
        yield Finding(Location(name), f"{term.parameter} is not free", "Free it, or remove the limit.")
    elif term.at is not None and len(term.at) != (axes := len(problem.parameters[term.parameter].index_axes)):
        yield Finding(Location(name), f"{list(term.at)} has {len(term.at)} coordinates for {axes} axes")


def check_shared_axes(axes: Mapping[AxisKey, FreeAxis], free: Collection[str]) -> list[Finding]:
    """Report tables that would change with a free axis although they are not fitted."""
    findings = []
    for key, axis in axes.items():
        others = list(dict.fromkeys(name for name, _ in axis.places if name not in free))
        if others:
            names = ", ".join(others[:MAX_LISTED]) + (", ..." if len(others) > MAX_LISTED else "")
            message = f"its breakpoints are free, but {names} on it {'is' if len(others) == 1 else 'are'} not fitted"
            remedy = "Such a table would change with the axis: fit it as well, or give it an axis of its own."
            findings.append(Finding(Location(f"axis {key}"), message, remedy))
    return findings


def unbounded(
    problem: Problem, location: Callable[[str], Location] = lambda name: Location(f"bounds of {name}")
) -> list[Finding]:
    """Report free parameters without finite bounds on both sides, and free axes; locked values need no bounds."""
    findings = []
    for name in problem.free_names:
        parameter = problem.parameters[name]
        sides = {"lower": parameter.lower, "upper": parameter.upper}
        open_sides = [side for side, bound in sides.items() if not np.all(np.isfinite(bound) | parameter.locked)]
        if open_sides:
            message = f'{name} has no {" and no ".join(open_sides)} bound; method = "global" requires both'
            findings.append(
                Finding(location(name), message, "Write bounds = [lower, upper], as narrow as you know them.")
            )
    for key in problem.free_axes:
        message = f'method = "global" cannot fit breakpoints, but those of {key} are free'
        findings.append(Finding(location(key.owner), message, 'Fix them, or use method = "gauss-newton".'))
    return findings


def step_findings(
    model: Model, datasets: Iterable[Dataset], step: float | None, location: Callable[[Dataset], Location]
) -> Iterator[Finding]:
    """Yield errors for datasets whose time step differs from that of the model's surrogates.

    Args:
        model: the model.
        datasets: its data.
        step: the model's own step in s, or None.
        location: the location of a dataset in messages.
    """
    trained = _training_steps(model)
    for data in datasets if trained else ():
        if data.settling is not None:
            own_step = data.settling.step or step  # as `plan_hold` has it; without any it reports so itself
            steps = np.array([] if own_step is None else [own_step])
        elif step is not None:
            steps = np.array([step])
        elif data.time is not None:
            steps = np.delete(np.diff(data.time), data.piece_starts[1:] - 1)  # within pieces
        else:
            message = f"{', '.join(trained)} runs in time, but dataset {data.name} has no time stamps"
            yield Finding(location(data), message, "Name the time channel `time`.")
            continue
        for name, own in trained.items():
            wrong = steps[np.abs(steps - own) > STEP_TOLERANCE * own]
            if wrong.size:
                message = f"{name} was trained at steps of {own:g} s, and dataset {data.name} has one of {wrong[0]:g} s"
                key = "raster" if data.settling is None else "step"
                place, remedy = location(data), f"Write {key} = {own:g}, or train it at the step of the data."
                fixes = (Fix.set((*place.keys, key), own),) if place.keys else ()
                yield Finding(place, message, remedy, fixes=fixes)


def _training_steps(model: Model) -> dict[str, float]:
    if not model.surrogates:
        return {}
    from kennfeld.surrogate.surrogate_models import StaticSurrogate

    return {s.name: s.step for s in model.surrogates if not isinstance(s, StaticSurrogate)}


def delay_findings(model: Model, values: int) -> list[Finding]:
    """Return an error if the delays of a model do not fit into memory.

    Args:
        model: the model; each step of each delay stores a value, and its derivative for each free value.
        values: how many values are free; 0 for a simulation.
    """
    graph = model.graph
    steps = sum(state.latency for state in graph.states)
    size = 8.0 * steps * (2 + values)
    if size <= MAX_BYTES:
        return []
    longest = max(range(len(graph.states)), key=lambda i: graph.states[i].latency)
    behind = dependents(graph, lambda node: node.op == "state" and node.payload == longest)
    name = min((name for name, at in graph.names.items() if at in behind), key=graph.names.__getitem__, default="")
    message = f"a delay of {graph.states[longest].latency:.10g} steps needs {size / 1e9:.3g} GB of memory"
    location = model.locations.get(name, Location.of_file(model.source))
    return [Finding(location, message, "Use a shorter delay or a longer step.")]


def matrix_findings(location: Location, values: int) -> list[Finding]:
    """Return an error if the matrix of a fit, with a row and a column for each free value, does not fit into memory.

    Args:
        location: of the message.
        values: how many values are free.
    """
    size = 8.0 * values**2
    if size <= MAX_BYTES:
        return []
    message = f"{values} free values need matrices of {size / 1e9:.3g} GB"
    return [Finding(location, message, "Use fewer breakpoints, or fit fewer parameters at once.")]


def trajectory_findings(
    problem: Problem, location: Callable[[AxisKey], Location] = lambda key: Location(f"axis {key}")
) -> list[Finding]:
    """Return errors for what cannot be fitted through functions that keep memory.

    Their slopes are differences of whole trajectories along single values of parameters.

    Args:
        problem: the problem.
        location: the location of an axis in messages.
    """
    graph = problem.model.graph
    names = {at: node.payload.function.name for at, node in enumerate(graph.nodes) if is_sequential(node)}
    if not names:
        return []
    reaching = {table: [names[at] for at in sorted(names.keys() & _behind(graph, table))] for table in graph.parameters}
    findings = []
    for key, axis in problem.free_axes.items():
        if called := next((reaching[table][0] for table, _ in axis.places if reaching.get(table)), None):
            message = f"its breakpoints are free, and {called} depends on them through whole trajectories"
            findings.append(Finding(location(key), message, "Fix the breakpoints."))
    # columns of slopes: one for each value, result and sample
    values = sum(problem.parameters[name].size for name in problem.free_names if reaching[name])
    size = 8.0 * values * len(names) * sum(bound.count for bound in problem.training)
    if size > MAX_BYTES:
        called = ", ".join(dict.fromkeys(names.values()))
        message = f"slopes of {called} along {values} free values at all samples need {size / 1e9:.3g} GB of memory"
        findings.append(Finding(Location(called), message, "Fit fewer values, or use fewer samples or a longer step."))
    return findings


def _behind(graph: Graph, table: str) -> Collection[int]:
    return dependents(graph, lambda node: node.parameter == table)
