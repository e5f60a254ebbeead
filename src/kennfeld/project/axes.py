"""Builds the axes of a project's tables: given, evenly spaced, shared by a group, or quantiles of the training data."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding, Findings, Fix, Location, choices
from kennfeld.base.formatting import join_names, nearest
from kennfeld.domain.axis import Axis
from kennfeld.domain.breakpoint_rounding import rounded, separated
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.optimize.limits.linear_limits import breakpoint_bounds
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import check_shared_axes
from kennfeld.preprocessing.recordings import RECORDING
from kennfeld.project.data_column import DataColumn
from kennfeld.project.model import ProjectModel
from kennfeld.project.recording_parameters import recording_numbers
from kennfeld.project.schema import ProjectFile
from kennfeld.project.table_schema import GroupAxisEntry, ParameterEntry

_MAX_LISTED = 12  # breakpoints in a remark


def free_breakpoints(axis: Axis, entry: GroupAxisEntry, findings: Findings) -> Axis | None:
    """Free the breakpoints of an axis if its entry says so; return None, with a finding, if the start is invalid."""
    if not entry.is_free:
        return axis
    try:
        return axis.changed(free=True, min_distance=entry.min_distance, range=entry.range)
    except ArgumentError as error:
        findings.error(entry.location, str(error), "Change it, or the initial breakpoints.")
        return None


def check_free_axes(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """Yield errors and warnings about axes with free breakpoints."""
    for key, axis in problem.free_axes.items():
        for finding in check_shared_axes({key: axis}, problem.free_names):
            yield Finding(axis_location(file, key), finding.message, finding.remedy)
        lower, upper = breakpoint_bounds(axis, problem.parameters, problem.held)
        if np.array_equal(lower, upper):
            message = f"no breakpoint of {key} can move: the ends and those at locks and pins are fixed"
            yield Finding(axis_location(file, key), message, "Add breakpoints, or a range.", severity="warning")
    for key in problem.idle_axes:
        message = f"the breakpoints of {key} are free, but no table with this axis is fitted"
        yield Finding(axis_location(file, key), message, "Free a table with this axis.", severity="warning")


def axis_location(file: ProjectFile, key: AxisKey) -> Location:
    return file.location("parameters", key.owner, key.direction) if key.direction else file.location("axes", key.owner)


def _permits(entry: GroupAxisEntry, points: Float) -> bool:
    """Return True if the limits of free breakpoints permit these; limits that are violated anyway are reported."""
    # rounding is optional: it must not turn breakpoints that are valid into ones that are not
    low, high = entry.range or (-np.inf, np.inf)
    return bool(low <= points[0] and points[-1] <= high and np.diff(points).min() >= (entry.min_distance or 0.0))


QuantileSource = Callable[[DataColumn, Float], Float]  # of all training samples, if the datasets are excerpts


class Axes:
    """Builds the axes of a project file.

    An axis that cannot be built is None, with a finding unless the required data are missing for a reported reason.
    """

    def __init__(
        self,
        file: ProjectFile,
        function: ProjectModel | None,
        datasets: Sequence[Dataset] | None,
        initial: ParameterSet,
        findings: Findings,
        quantiles_of: QuantileSource | None = None,
    ) -> None:
        self._file, self._function, self._datasets, self._findings = file, function, datasets, findings
        self._quantiles_of = quantiles_of
        self._initial = {axis.name: axis for axis in initial.axes}
        self._groups: dict[str, Axis | None] = {}

    def build(self, entry: GroupAxisEntry, coordinate: str = "", initial: Axis | None = None) -> Axis | None:
        """Build the axis of one table.

        Args:
            entry: its section.
            coordinate: the input of the lookup.
            initial: the axis of the table in the initial files, whose order in files it keeps.
        """
        if entry.group:
            return self.group(entry)
        return self._axis(entry, entry.input or coordinate, "", initial)

    def group(self, entry: GroupAxisEntry) -> Axis | None:
        """Return the group axis that an entry names, of the project file or the initial files."""
        name = entry.group
        if name in self._file.axes:
            if name not in self._groups:
                own = self._file.axes[name]
                # built once, so that findings about it are not repeated by each table on it
                self._groups[name] = (
                    self._inherited(own, name)
                    if own.inherits
                    else self._axis(own, own.input, name, self._initial.get(name))
                )
            return self._groups[name]
        if name not in self._initial:
            known = [*self._file.axes, *self._initial]
            remedy = nearest(name, known) or f"Write a section [axes.{name}]."
            fixes = choices((*entry.location.keys, "axis"), known)
            self._findings.error(entry.location, f"unknown group axis {name}", remedy, fixes=fixes)
        return self._initial.get(name)

    def recordings(self, entry: ParameterEntry) -> Axis | None:
        """Return the axis over the numbers of all recordings, of training and test data."""
        if self._datasets is None:
            return None
        numbers = recording_numbers(self._datasets)
        if numbers.size > 1:
            return Axis(numbers, input=RECORDING)
        if numbers.size:  # else the function does not use it, or the data are incomplete, which is reported
            message = f"there is one recording, so that {entry.name} has one value"
            fixes = [Fix.remove((*entry.location.keys, "per"))]
            self._findings.error(entry.location.within("per"), message, "Remove per, or add recordings.", fixes=fixes)
        return None

    @property
    def fitted_recordings(self) -> Float:
        """The numbers of the recordings that values are fitted to, Float[recordings]."""
        return recording_numbers(self._training)

    def _inherited(self, entry: GroupAxisEntry, name: str) -> Axis | None:
        """Return a group axis of the initial files, with free breakpoints if the entry says so."""
        if name not in self._initial:
            remedy = nearest(name, self._initial) or "Write breakpoints, or begin, end and count."
            message = f"{entry.needs_points}, but the initial files have no group axis {name}"
            self._findings.error(entry.location, message, remedy)
            return None
        return free_breakpoints(self._initial[name], entry, self._findings)

    def _axis(self, entry: GroupAxisEntry, quantity: str, name: str, initial: Axis | None) -> Axis | None:
        points: Sequence[float] | Float | None = entry.points
        if entry.quantiles:
            points = self._quantiles(entry, quantity)
        if points is None or not len(points):
            return None
        # a file that stores the greatest breakpoint first gets new breakpoints in that order, too
        falling = initial is not None and initial.falling
        axis = Axis(points, input=quantity, unit=self._unit(quantity), name=name, falling=falling)
        return free_breakpoints(axis, entry, self._findings)

    def _unit(self, quantity: str) -> str:
        if self._function is None:
            return ""
        unit = self._function.graph.units.get(quantity, "")
        channel = self._file.channels.get(quantity, quantity)
        units = [data[channel].unit for data in self._datasets or () if channel in data]
        # the unit of the function precedes those of the data
        return unit or next(filter(None, units), "")

    def _quantiles(self, entry: GroupAxisEntry, quantity: str) -> Float | None:
        """Return the quantiles of the training data as breakpoints, which cover all of them."""
        column = self._column(entry, quantity)
        if column is None:
            return None
        quantiles = self._distribution(column, np.linspace(0.0, 1.0, entry.quantiles))
        if quantiles is None:
            return None
        if not quantiles.size:
            self._findings.error(entry.location, f"{quantity} has no values in the training data", "Write breakpoints.")
            return None
        return self._spaced(entry, quantity, np.unique(quantiles))

    def _spaced(self, entry: GroupAxisEntry, quantity: str, quantiles: Float) -> Float:
        """Return the quantiles without those that are too close, rounded; report both."""
        points = separated(quantiles) if entry.round else quantiles
        if points.size < entry.quantiles:
            merged = "" if points.size == quantiles.size else "; very close ones are merged"
            message = f"only {points.size} of {entry.quantiles} quantiles of {quantity} differ{merged}"
            self._findings.warning(entry.location, message, "Write a smaller count, or begin, end and count.")
        result = rounded(points)
        if not entry.round or not result.coarsest or not _permits(entry, result.points):
            return points
        values = join_names([f"{point:.10g}" for point in result.points.tolist()], _MAX_LISTED)
        message = f"quantiles of {quantity} are rounded to multiples of {result.steps}, the ends outwards: {values}"
        self._findings.remark(entry.location, message, "Write round = false to use them as computed.")
        return result.points

    @property
    def _training(self) -> list[Dataset]:
        return [data for data in self._datasets or () if data.is_fitted]

    def _distribution(self, column: DataColumn, probabilities: Float) -> Float | None:
        """Return quantiles of a column at all training samples, empty if it has no values; None if no data have it."""
        columns = [values for data in self._training if (values := column.values(data)) is not None]
        if not columns:
            return None
        if self._quantiles_of is not None:
            return self._quantiles_of(column, probabilities)
        values = np.concatenate(columns)
        values = values[np.isfinite(values)]
        return np.asarray(np.quantile(values, probabilities)) if values.size else values

    def _column(self, entry: GroupAxisEntry, quantity: str) -> DataColumn | None:
        """Return the data of a quantity."""
        if self._function is None or self._datasets is None:
            return None
        graph, training = self._function.graph, self._training
        if not quantity:
            fixes = choices((*entry.location.keys, "input"), [*graph.inputs, *graph.names])
            self._findings.error(entry.location, "quantiles require an input", 'Write input = "...".', fixes=fixes)
            return None
        # only inputs have channels of other names; anything else is named as in the data
        channel = self._file.channels.get(quantity, quantity) if quantity in graph.inputs else quantity
        if any(channel in data for data in training):
            return DataColumn(channel)
        if quantity in graph.names:
            return self._node(entry, quantity, graph, training)
        if training and quantity not in graph.inputs:
            remedy = nearest(quantity, [*graph.inputs, *graph.names, *(n for data in training for n in data)])
            fixes = choices((*entry.location.keys, "input"), [*graph.inputs, *graph.names])
            message = f"unknown input, node or channel {quantity}"
            self._findings.error(entry.location, message, remedy, fixes=fixes)
        return None

    def _node(self, entry: GroupAxisEntry, name: str, graph: Graph, training: Sequence[Dataset]) -> DataColumn | None:
        """Return the values of a node that depends on data alone."""
        # only what the node depends on, so that parameters elsewhere in the function do not count
        part = GraphBuilder.of(graph).finish({"value": graph.names[name]})
        if part.parameters:
            message = f"the values of {name} depend on parameters ({', '.join(list(part.parameters)[:3])})"
            self._findings.error(entry.location, message, "Write begin, end and count, or breakpoints.")
            return None
        if part.clocks and any(data.time is None for data in training):
            return None  # reported where the data are bound to the function
        return DataColumn(graph=part, channels=dict(self._file.channels))
