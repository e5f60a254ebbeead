"""Units of channels, of the function and of axes that do not go together.

Channels are converted to the units of the function first (`preprocessing/units.py`); what is left cannot be converted,
or the function does not state its unit.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.traversal import coordinates_of
from kennfeld.preprocessing.units import UnitConversion, Units, compare_units, is_unit_missing


@dataclass(frozen=True)
class UnitConflict:
    """A channel in another unit than the input or the node of the function that it belongs to.

    `contrary` is True for units of different quantities, False if one of them is not known.
    """

    dataset: Dataset
    channel: str
    message: str
    unit: str
    contrary: bool


def wanted_units(
    graph: Graph, channels: Mapping[str, str], targets: Iterable[tuple[str, str]] = ()
) -> dict[str, tuple[str, str]]:
    r"""Return the unit of each channel for which the function states one, and its owner.

    The units of inputs precede those of nodes that have the channel for a target.

    Args:
        graph: the function.
        channels: the channel of an input, if the names differ.
        targets: nodes, and the channels that are their targets.

    >>> from kennfeld import formula
    >>> wanted_units(formula("input x[Pa]\ny[Nm] = x").graph, {}, [("y", "z")])
    {'x': ('Pa', 'the input x'), 'z': ('Nm', 'the node y')}
    """
    inputs = [(channels.get(name, name), name, "input") for name in graph.inputs]
    nodes = [(channel, node, "node") for node, channel in targets]
    units: dict[str, tuple[str, str]] = {}
    for channel, name, kind in [*inputs, *nodes]:
        if not is_unit_missing(unit := graph.units.get(name, "")):
            units.setdefault(channel, (unit, f"the {kind} {name}"))
    return units


def target_channels(criteria: Iterable[Criterion]) -> list[tuple[str, str]]:
    """Return the nodes of criteria whose target may be a channel, with its name."""
    return [(c.node, c.target.name) for c in criteria if c.target.kind in ("channel", "name")]


def convert_units(datasets: Sequence[Dataset], wanted: Mapping[str, tuple[str, str]]) -> list[Dataset]:
    """Return datasets with their channels in the units of a function, other channels in that of the first dataset.

    Each conversion is a remark among the findings of the dataset.
    """
    first: dict[str, tuple[str, str]] = {}
    converted = []
    for data in datasets:
        # every conversion is recorded under the dataset alone, so that its remarks stay apart from those of others
        own = Units({}, wanted, first)
        after = own.convert(data, f"dataset {data.name}")
        converted.append(after.with_findings(*own.remarks(())))
    return converted


def unit_conflicts(
    graph: Graph, datasets: Sequence[Dataset], channels: Mapping[str, str], criteria: Sequence[Criterion] = ()
) -> Iterator[UnitConflict]:
    """Yield channels whose unit differs from that of the function's input or node."""
    pairs = [(name, channels.get(name, name), "input") for name in graph.inputs]
    pairs += [(node, channel, "node") for node, channel in target_channels(criteria)]
    for data in datasets:
        for name, channel, kind in dict.fromkeys(pairs):
            own, recorded = graph.units.get(name, ""), data[channel].unit if channel in data else ""
            if is_unit_missing(own) or is_unit_missing(recorded):
                continue
            if (relation := compare_units(recorded, own)) == "same":
                continue
            contrary = relation == "contrary"
            message = f"channel {channel} is in {recorded}, but the {kind} {name} of the function is in {own}"
            yield UnitConflict(data, channel, message + ", a different quantity" * contrary, own, contrary)


def axis_unit_conflicts(
    graph: Graph, parameters: ParameterSet, datasets: Sequence[Dataset], channels: Mapping[str, str]
) -> Iterator[tuple[str, int, str, str]]:
    """Yield axes in another unit than the input or node that they are looked up with.

    A unit that is not known is none that differs: those of calibration files are spelled in many ways.

    Yields:
        A parameter, the number of its axis, the message and the remedy.
    """
    for name in graph.parameters:
        axes = parameters[name].axes if name in parameters else ()
        coordinates = coordinates_of(graph, name) if any(axis.unit for axis in axes) else ()
        for at, (axis, looked_up) in enumerate(zip(axes, coordinates, strict=False)):
            for unit, owner, remedy in _units_of(graph, looked_up, datasets, channels):
                relation = compare_units(unit, axis.unit)
                if isinstance(relation, UnitConversion) or relation == "contrary":
                    message = f"axis {AXIS_LETTERS[at]} of {name} is in {axis.unit}, but {owner} is in {unit}"
                    yield name, at, message, remedy.format(unit=axis.unit)


def _units_of(
    graph: Graph, name: str, datasets: Sequence[Dataset], channels: Mapping[str, str]
) -> Iterator[tuple[str, str, str]]:
    """Yield the units of a coordinate: that of the function, else those of the channel, each once."""
    if not is_unit_missing(own := graph.units.get(name, "")):
        kind = "input" if name in graph.inputs else "node"
        yield own, f"the {kind} {name} of the function", "Correct the unit of the axis, or its breakpoints."
        return
    channel = channels.get(name, name)
    recorded = {data[channel].unit: data for data in datasets if name in graph.inputs and channel in data}
    for unit, data in recorded.items():
        remedy = f"State the unit of {name} in the function, `input {name}[{{unit}}]`, so that the data are converted."
        yield unit, f"channel {channel} of dataset {data.name}", remedy


def unit_warnings(
    graph: Graph,
    datasets: Sequence[Dataset],
    parameters: ParameterSet,
    channels: Mapping[str, str],
    criteria: Sequence[Criterion] = (),
) -> Iterator[Finding]:
    """Yield the warnings about units of a problem made in Python."""
    for conflict in unit_conflicts(graph, datasets, channels, criteria):
        remedy = "Convert it, or correct the unit."
        if conflict.contrary:
            remedy = f"Name another channel, or correct its unit: Dataset.of(..., units={{{conflict.channel!r}: ...}})."
        yield Finding(Location(f"dataset {conflict.dataset.name}"), conflict.message, remedy, severity="warning")
    for name, _, message, remedy in axis_unit_conflicts(graph, parameters, datasets, channels):
        yield Finding(Location(f"parameter {name}"), message, remedy, severity="warning")
