"""The function as it is exported: the nodes of one step in their order, and the names and values of its interface."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings, InputError, Location, visible
from kennfeld.base.formatting import join_names, nearest, one_line
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.export.names import NameSpace, function_name, member_names
from kennfeld.graph import Graph, Node
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.lookup_lowering import AxisRef, LoweredGraph, lower_lookups
from kennfeld.graph.node import CLOCK, State, extract
from kennfeld.graph.traversal import ancestors
from kennfeld.models import Model

Precision = Literal["double", "float"]
UNIT_OF_CLOCK = {"dt": "step that ends here", "dt_next": "step that begins here", "t": "time since the start"}


@dataclass(frozen=True)
class ExportedSignal:
    """An input or output: its name in the function and in C, and its unit."""

    name: str
    member: str
    unit: str = ""
    remark: str = ""


@dataclass(frozen=True, eq=False)
class PackedNumbers:
    """Numbers in place of values: `(factor * number + shift) / divisor` is the value.

    Attributes:
        kind: their type in C, such as "uint8_t".
        numbers: Float[shape].
        scale: factor, shift and divisor.
    """

    kind: str
    numbers: Float
    scale: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ParameterValues:
    """A parameter, or a free axis: its values in C order, Float[shape]; and what is stored in their place, if any."""

    name: str
    member: str
    values: Float
    unit: str = ""
    remark: str = ""
    stored: PackedNumbers | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the values."""
        return self.values.shape


@dataclass(frozen=True, eq=False)
class PreparedFunction:
    """One time step of a function with its values.

    Attributes:
        name: identifier with which all names of the code begin.
        title: what the function is called, and where it comes from.
        nodes: lowered nodes; those of first values among them.
        states: the memory.
        starts: the node of the first value of each state.
        inputs: in the order of their first use; clock inputs are last.
        outputs: with `roots`, their nodes.
        parameters: values that are looked up, then the breakpoints of free axes.
        axes: the breakpoints of each axis of the lowered nodes, Float[breakpoints].
        comments: of named nodes, by number.
    """

    name: str
    title: str
    nodes: tuple[Node, ...]
    states: tuple[State, ...]
    starts: tuple[int, ...]
    inputs: tuple[ExportedSignal, ...]
    outputs: tuple[ExportedSignal, ...]
    roots: tuple[int, ...]
    parameters: tuple[ParameterValues, ...]
    axes: tuple[Float, ...]
    comments: Mapping[int, str]
    lowered: LoweredGraph
    values: ParameterSet

    @cached_property
    def step_order(self) -> list[int]:
        """The nodes that outputs and next values need, in the order in which they are computed."""
        return ancestors(self.nodes, [*self.roots, *(state.next for state in self.states)])

    @cached_property
    def start_order(self) -> list[int]:
        """The nodes that first values need."""
        return ancestors(self.nodes, self.starts)

    @property
    def clocks(self) -> tuple[str, ...]:
        """The clock inputs."""
        return tuple(signal.name for signal in self.inputs if signal.name in CLOCK)

    def parameter(self, name: str) -> ParameterValues:
        """Return a parameter by its name."""
        return next(parameter for parameter in self.parameters if parameter.name == name)

    def is_free(self, axis: AxisRef) -> bool:
        """Return True if the breakpoints of an axis are among the parameters."""
        return axis.key is not None

    def input_member(self, name: str) -> str:
        """Return the identifier of an input."""
        return next(signal.member for signal in self.inputs if signal.name == name)


def prepare(
    model: Model,
    parameters: ParameterSet,
    name: str,
    location: Location,
    findings: Findings,
    outputs: Sequence[str] = (),
    precision: Precision = "double",
) -> PreparedFunction:
    """Return a function that is ready to be written; findings get remarks on renamed members.

    Args:
        model: the function.
        parameters: all parameters that it looks up.
        name: its name, of which an identifier is made.
        location: for messages.
        findings: takes remarks.
        outputs: named nodes that are computed; by default the outputs of the function.
        precision: for which the values are checked.

    Raises:
        InputError: it calls code outside of the graph, an output is unknown, or a name or value cannot be written.
    """
    own = function_name(name, location)
    wanted = tuple(dict.fromkeys(outputs or model.graph.outputs))
    graph = _with_outputs(model.graph, wanted, location)
    _refuse_calls(graph, model, location)
    missing = [each for each in graph.parameters if each not in parameters]
    if missing:
        message = f"values of {join_names(missing)} are missing"
        raise InputError.of(location, message, "Give a calibration file with --parameters.")
    lowered = lower_lookups(graph, parameters)
    roots = tuple(lowered.graph.names[each] for each in wanted)
    line = differentiate(lowered.graph, roots, ())
    values = _parameters(lowered, parameters, location, findings)
    function = PreparedFunction(
        name=own,
        title=_title(model),
        nodes=line.nodes,
        states=line.states,
        starts=line.starts,
        inputs=_inputs(model.graph, lowered.graph, location, findings),
        outputs=_signals("output", wanted, graph, location, findings),
        roots=roots,
        parameters=values,
        axes=lowered.axes,
        comments=_comments(model, lowered),
        lowered=lowered,
        values=parameters,
    )
    if precision == "float":
        _check_single(function, location, findings)
    findings.finish()
    return function


def _with_outputs(graph: Graph, outputs: Sequence[str], location: Location) -> Graph:
    unknown = [name for name in outputs if name not in graph.names]
    if unknown:
        remedy = nearest(unknown[0], graph.names) or f"The nodes are {join_names(graph.names, 12)}."
        raise InputError.of(location, f"has no node {join_names(unknown)}", remedy)
    needed = _needed(graph, [graph.names[name] for name in outputs])
    # names of inner nodes are kept for comments
    inner = [name for name, at in graph.names.items() if at in needed and name not in outputs]
    names = {name: graph.names[name] for name in (*outputs, *inner)}
    return extract(graph.nodes, graph.states, names, graph.units, outputs)


def _needed(graph: Graph, roots: Sequence[int]) -> set[int]:
    """Return the nodes from which some are computed, through states as well."""
    needed: set[int] = set()
    while not needed.issuperset(roots):
        needed |= set(ancestors(graph.nodes, roots))
        states = {graph.nodes[at].payload for at in needed if graph.nodes[at].op == "state"}
        roots = [at for which in states for at in graph.states[which][:2]]
    return needed


def _refuse_calls(graph: Graph, model: Model, location: Location) -> None:
    called = dict.fromkeys(node.payload.function.name for node in graph.nodes if node.op == "external")
    if called:
        what = "code that is not part of it and cannot be written"
        remedy = "Replace the call by formula text or a surrogate, or export the nodes that do not need it."
        raise InputError.of(location, f"{model.name} calls {join_names([*called])}: {what}", remedy)


def _title(model: Model) -> str:
    source = model.source.replace("\\", "/").rpartition("/")[2]
    return f"{model.name} ({source})" if source and source != "formula" else model.name


def _signals(
    kind: str, names: tuple[str, ...], graph: Graph, location: Location, findings: Findings
) -> tuple[ExportedSignal, ...]:
    members = member_names(NameSpace(kind, names), location, findings)
    return tuple(ExportedSignal(name, members[name], graph.units.get(name, "")) for name in names)


def _inputs(whole: Graph, graph: Graph, location: Location, findings: Findings) -> tuple[ExportedSignal, ...]:
    clocks = [name for name in CLOCK if name in graph.clocks]
    timed = tuple(ExportedSignal(name, name, "s", UNIT_OF_CLOCK[name]) for name in clocks)
    names = tuple(name for name in whole.inputs if name in graph.inputs)
    members = member_names(NameSpace("input", names, tuple(clocks)), location, findings)
    signals = (ExportedSignal(name, members[name], graph.units.get(name, "")) for name in names)
    return (*signals, *timed)


def _parameters(
    lowered: LoweredGraph, parameters: ParameterSet, location: Location, findings: Findings
) -> tuple[ParameterValues, ...]:
    axes = free_axes(parameters)
    keys = dict.fromkeys(
        node.payload.key for node in lowered.graph.nodes if node.op == "position" and node.payload.key is not None
    )
    space = NameSpace("parameter", tuple(lowered.shapes), derived=tuple(map(str, keys)))
    members = member_names(space, location, findings)
    values = []
    for name in lowered.shapes:
        own = parameters[name]
        remark = " by ".join(
            axis.input or axis.name or letter for axis, letter in zip(own.axes, AXIS_LETTERS, strict=False)
        )
        values.append(ParameterValues(name, members[name], own.values, own.unit, remark))
    for key in keys:
        axis = axes[key].axis
        remark = f"breakpoints of {join_names([name for name, _ in axes[key].places])}"
        values.append(ParameterValues(str(key), members[str(key)], axis.breakpoints, axis.unit, remark))
    return tuple(values)


def _comments(model: Model, lowered: LoweredGraph) -> dict[int, str]:
    """Return name, unit and source of the named nodes, by their numbers in the lowered graph."""
    comments: dict[int, str] = {}
    for name, at in lowered.graph.names.items():
        comments.setdefault(at, describe(name, model.graph.units.get(name, ""), model.locations.get(name)))
    return comments


def describe(name: str, unit: str = "", place: Location | None = None) -> str:
    """Return the text of a comment on a name, which may come from anywhere.

    >>> describe("Torque", "Nm", Location("torque.kf", 4))
    'Torque [Nm], torque.kf line 4'
    """
    text = f"{name} [{unit}]" if unit else name
    return comment_text(f"{text}, {place}" if place is not None else text)


def comment_text(text: str) -> str:
    """Return a text that cannot end a comment of C, begin another one, or be a trigraph.

    >>> comment_text("a */ b ??/ c")
    'a * / b ? ?/ c'
    """
    plain = one_line(visible(text)).replace("\\", "/")
    for pair in ("*/", "/*", "??"):
        while pair in plain:
            plain = plain.replace(pair, f"{pair[0]} {pair[1]}")
    return plain


def _check_single(function: PreparedFunction, location: Location, findings: Findings) -> None:
    """Add an error for each value that is infinite, and each axis that has equal breakpoints, in single precision."""
    with np.errstate(over="ignore"):
        for parameter in function.parameters:
            single = parameter.values.astype(np.float32)
            if np.any(np.isinf(single) & np.isfinite(parameter.values)):
                message = f"{parameter.name} has values beyond 3.4e38, the limit of single precision"
                findings.error(location, message, "Export with --precision double.")
        for points in function.axes:
            single = points.astype(np.float32)
            equal = np.flatnonzero(single[1:] <= single[:-1])
            if equal.size:
                at = int(equal[0])
                message = (
                    f"breakpoints {float(points[at])!r} and {float(points[at + 1])!r} are equal in single precision"
                )
                findings.error(location, message, "Export with --precision double, or move one of them.")
