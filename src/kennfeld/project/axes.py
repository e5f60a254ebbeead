"""Builds the axes of a project's tables: given, evenly spaced, shared by a group, or quantiles of the training data."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, Finding, Findings, Location
from kennfeld.formatting import nearest
from kennfeld.free_axes import AxisKey
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.optimize.linear_limits import breakpoint_bounds
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.validation import check_shared_axes
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis
from kennfeld.preprocessing.calculated import evaluate_expression
from kennfeld.project.model import ProjectModel
from kennfeld.project.schema import ProjectFile
from kennfeld.project.table_schema import GroupAxisEntry


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
            yield Finding(_location(file, key), finding.message, finding.remedy)
        lower, upper = breakpoint_bounds(axis, problem.parameters, problem.held)
        if np.array_equal(lower, upper):
            message = f"no breakpoint of {key} can move: the ends and those at locks and pins are fixed"
            yield Finding(_location(file, key), message, "Add breakpoints, or a range.", severity="warning")
    for key in problem.idle_axes:
        message = f"the breakpoints of {key} are free, but no table with this axis is fitted"
        yield Finding(_location(file, key), message, "Free a table with this axis.", severity="warning")


def _location(file: ProjectFile, key: AxisKey) -> Location:
    return file.location("parameters", key.owner, key.direction) if key.direction else file.location("axes", key.owner)


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
    ) -> None:
        self._file, self._function, self._datasets, self._findings = file, function, datasets, findings
        self._initial = {axis.name: axis for axis in initial.axes}
        self._groups: dict[str, Axis | None] = {}

    def build(self, entry: GroupAxisEntry, coordinate: str = "") -> Axis | None:
        """Build the axis of one table; `coordinate` is the input of the lookup."""
        if entry.group:
            return self.group(entry)
        return self._axis(entry, entry.input or coordinate, "")

    def group(self, entry: GroupAxisEntry) -> Axis | None:
        """Return the group axis that an entry names, of the project file or the initial files."""
        name = entry.group
        if name in self._file.axes:
            if name not in self._groups:
                own = self._file.axes[name]
                self._groups[name] = (
                    self._free_inherited(own, name) if own.inherits else self._axis(own, own.input, name)
                )
            return self._groups[name]
        if name not in self._initial:
            remedy = nearest(name, [*self._file.axes, *self._initial]) or f"Write a section [axes.{name}]."
            self._findings.error(entry.location, f"unknown group axis {name}", remedy)
        return self._initial.get(name)

    def _free_inherited(self, entry: GroupAxisEntry, name: str) -> Axis | None:
        """Return a group axis of the initial files with free breakpoints."""
        if name not in self._initial:
            remedy = nearest(name, self._initial) or "Write breakpoints, or begin, end and count."
            message = f"breakpoints are free, but the initial files have no group axis {name}"
            self._findings.error(entry.location, message, remedy)
            return None
        return free_breakpoints(self._initial[name], entry, self._findings)

    def _axis(self, entry: GroupAxisEntry, quantity: str, name: str) -> Axis | None:
        points: Sequence[float] | Float | None = entry.points
        if entry.quantiles:
            points = self._quantiles(entry, quantity)
        if points is None or not len(points):
            return None
        axis = Axis(points, input=quantity, unit=self._unit(quantity), name=name)
        return free_breakpoints(axis, entry, self._findings)

    def _unit(self, quantity: str) -> str:
        if self._function is None:
            return ""
        unit = self._function.graph.units.get(quantity, "")
        channel = self._file.channels.get(quantity, quantity)
        units = [data[channel].unit for data in self._datasets or () if channel in data]
        return unit or next(filter(None, units), "")

    def _quantiles(self, entry: GroupAxisEntry, quantity: str) -> Float | None:
        """Return the quantiles of the training data as breakpoints, minimum and maximum included."""
        values = self._values(entry, quantity)
        if values is None:
            return None
        values = values[np.isfinite(values)]
        if not values.size:
            self._findings.error(entry.location, f"{quantity} has no values in the training data", "Write breakpoints.")
            return None
        points = np.unique(np.quantile(values, np.linspace(0.0, 1.0, entry.quantiles)))
        if points.size < entry.quantiles:
            message = f"only {points.size} of {entry.quantiles} quantiles of {quantity} differ"
            self._findings.warning(entry.location, message, "Write a smaller count, or begin, end and count.")
        return points

    def _values(self, entry: GroupAxisEntry, quantity: str) -> Float | None:
        """Return the values of a quantity at all training samples."""
        if self._function is None or self._datasets is None:
            return None
        graph = self._function.graph
        training = [data for data in self._datasets if data.use == "training" and data.weight > 0]
        if not quantity:
            self._findings.error(entry.location, "quantiles require an input", 'Write input = "...".')
            return None
        channel = self._file.channels.get(quantity, quantity) if quantity in graph.inputs else quantity
        columns = [data[channel].values for data in training if channel in data]
        if columns:
            return np.concatenate(columns)
        if quantity in graph.names:
            return self._node(entry, quantity, graph, training)
        if training and quantity not in graph.inputs:
            remedy = nearest(quantity, [*graph.inputs, *graph.names, *(n for data in training for n in data)])
            self._findings.error(entry.location, f"unknown input, node or channel {quantity}", remedy)
        return None

    def _node(self, entry: GroupAxisEntry, name: str, graph: Graph, training: Sequence[Dataset]) -> Float | None:
        """Return the values of a node that depends on data alone."""
        part = GraphBuilder.of(graph).finish({"value": graph.names[name]})
        if part.parameters:
            message = f"the values of {name} depend on parameters ({', '.join(list(part.parameters)[:3])})"
            self._findings.error(entry.location, message, "Write begin, end and count, or breakpoints.")
            return None
        if part.clocks and any(data.time is None for data in training):
            return None  # reported where the data are bound to the function
        names, columns = self._file.channels, []
        for data in training:
            if all(names.get(name, name) in data for name in part.inputs):
                inputs = (replace(data[names.get(name, name)], name=name) for name in part.inputs)
                columns.append(evaluate_expression(part, replace(data, channels=tuple(inputs))))
        return np.concatenate(columns) if columns else None
