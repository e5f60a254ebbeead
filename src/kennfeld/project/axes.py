"""The axes of a project's tables: as given, spread evenly, shared by a group, or quantiles of the training data.

Free breakpoints in a project file: the keys of an axis that say so, and what is wrong with axes that move.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, Finding
from kennfeld.formatting import nearest
from kennfeld.free_axes import AxisKey
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.optimize.linear_limits import breakpoint_bounds
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.validation import check_shared_axes
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis
from kennfeld.preprocessing.calculated import evaluate_expression, uses_clock
from kennfeld.project.model import ProjectModel
from kennfeld.project.schema import AxisEntry, ProjectFile

__all__ = ["Axes", "check_free_axes", "made_free"]


def made_free(axis: Axis, entry: AxisEntry, findings: list[Finding]) -> Axis | None:
    """The axis with the freedom that its entry gives it; None, and a finding, where the start is outside of that."""
    freedom = entry.freedom
    if freedom is None:
        return axis
    try:
        return axis.changed(free=True, min_distance=freedom.min_distance, range=freedom.range)
    except ArgumentError as error:
        findings.append(Finding(entry.place, str(error), "Change it, or the breakpoints at the start."))
        return None


def check_free_axes(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """Errors and warnings about axes that are marked as free."""
    for key, axis in problem.free_axes.items():
        for finding in check_shared_axes({key: axis}, problem.free_names):
            yield Finding(_place(file, key), finding.message, finding.remedy)
        lower, upper = breakpoint_bounds(axis, problem.parameters, problem.held)
        if np.array_equal(lower, upper):
            message = f"no breakpoint of {key} can move: its ends stay, and so do those at locks and pins"
            yield Finding(_place(file, key), message, "Give it more breakpoints, or a range.", severity="warning")
    for key in problem.idle_axes:
        message = f"the breakpoints of {key} are free, but no table on it is fitted"
        yield Finding(_place(file, key), message, "Free a table on it.", severity="warning")


def _place(file: ProjectFile, key: AxisKey) -> str:
    return file.place(f"[parameters.{key.owner}] {key.direction}" if key.direction else f"[axes.{key.owner}]")


class Axes:
    """Makes the axes that a project file asks for; `None` where one cannot be made, with a finding unless the data
    that it needs are missing for reasons that are reported already.
    """

    def __init__(
        self,
        file: ProjectFile,
        function: ProjectModel | None,
        datasets: Sequence[Dataset] | None,
        initial: ParameterSet,
        findings: list[Finding],
    ) -> None:
        self._file, self._function, self._datasets, self._findings = file, function, datasets, findings
        self._given = {axis.name: axis for axis in initial.axes}
        self._groups: dict[str, Axis | None] = {}

    def made(self, entry: AxisEntry, fed: str = "") -> Axis | None:
        """The axis of one table; `fed` is what the function looks the table up with."""
        if entry.group:
            return self.group(entry)
        return self._axis(entry, entry.input or fed, "")

    def group(self, entry: AxisEntry) -> Axis | None:
        """The group axis that an entry names: of the project file, else of the initial files."""
        name = entry.group
        if name in self._file.axes:
            if name not in self._groups:
                own = self._file.axes[name]
                self._groups[name] = self.freed(own, name) if own.inherits else self._axis(own, own.input, name)
            return self._groups[name]
        if name not in self._given:
            remedy = nearest(name, [*self._file.axes, *self._given]) or f"Write a section [axes.{name}]."
            self._findings.append(Finding(entry.place, f"there is no group axis {name}", remedy))
        return self._given.get(name)

    def freed(self, entry: AxisEntry, name: str) -> Axis | None:
        """The group axis of the initial files, its breakpoints free."""
        if name not in self._given:
            remedy = nearest(name, self._given) or "Write breakpoints, or begin, end and count."
            self._report(entry, f"the initial files have no group axis {name} whose breakpoints to free", remedy)
            return None
        return made_free(self._given[name], entry, self._findings)

    def _axis(self, entry: AxisEntry, quantity: str, name: str) -> Axis | None:
        points: Sequence[float] | Float | None = entry.breakpoints
        if entry.quantiles:
            points = self._quantiles(entry, quantity)
        if points is None or not len(points):
            return None
        axis = Axis(points, input=quantity, unit=self._unit(quantity), name=name)
        return made_free(axis, entry, self._findings)

    def _unit(self, quantity: str) -> str:
        if self._function is None:
            return ""
        unit = self._function.graph.units.get(quantity, "")
        channel = self._file.channels.get(quantity, quantity)
        units = [data[channel].unit for data in self._datasets or () if channel in data]
        return unit or next(filter(None, units), "")

    def _quantiles(self, entry: AxisEntry, quantity: str) -> Float | None:
        """Breakpoints at even shares of the training data, both ends included."""
        values = self._values(entry, quantity)
        if values is None:
            return None
        values = values[np.isfinite(values)]
        if not values.size:
            self._report(entry, f"{quantity} has no value in the training data", "Give breakpoints.")
            return None
        points = np.unique(np.quantile(values, np.linspace(0.0, 1.0, entry.quantiles)))
        if points.size < entry.quantiles:
            message = f"{entry.quantiles} quantiles of {quantity} give {points.size} breakpoints, since some are equal"
            self._report(entry, message, "Write a smaller count, or begin, end and count.", "warning")
        return points

    def _report(
        self, entry: AxisEntry, message: str, remedy: str, severity: Literal["error", "warning"] = "error"
    ) -> None:
        self._findings.append(Finding(entry.place, message, remedy, severity=severity))

    def _values(self, entry: AxisEntry, quantity: str) -> Float | None:
        """What lies on the axis, over all training samples."""
        if self._function is None or self._datasets is None:
            return None
        graph = self._function.graph
        training = [data for data in self._datasets if data.use == "training" and data.weight > 0]
        if not quantity:
            self._report(entry, "the axis needs an input to take quantiles of", 'Write input = "...".')
            return None
        channel = self._file.channels.get(quantity, quantity) if quantity in graph.inputs else quantity
        found = [data[channel].values for data in training if channel in data]
        if found:
            return np.concatenate(found)
        if quantity in graph.names:
            return self._node(entry, quantity, graph, training)
        if training and quantity not in graph.inputs:
            remedy = nearest(quantity, [*graph.inputs, *graph.names, *(n for data in training for n in data)])
            self._report(entry, f"{quantity} is no input, no node and no channel", remedy)
        return None

    def _node(self, entry: AxisEntry, name: str, graph: Graph, training: Sequence[Dataset]) -> Float | None:
        """The values of a node that depends on the data alone."""
        part = GraphBuilder.of(graph).finish({"value": graph.names[name]})
        if part.parameters:
            message = f"the range of {name} depends on parameters ({', '.join(list(part.parameters)[:3])})"
            self._report(entry, message, "Write begin, end and count, or breakpoints.")
            return None
        if uses_clock(part) and any(data.time is None for data in training):
            return None  # reported where the data are bound to the function
        found = [
            evaluate_expression(part, self._renamed(data, part)) for data in training if self._has_inputs(data, part)
        ]
        return np.concatenate(found) if found else None

    def _has_inputs(self, data: Dataset, part: Graph) -> bool:
        return all(self._file.channels.get(name, name) in data for name in part.inputs)

    def _renamed(self, data: Dataset, part: Graph) -> Dataset:
        """The dataset with the function's inputs under their own names."""
        names: Mapping[str, str] = self._file.channels
        inputs = (replace(data[names.get(name, name)], name=name) for name in part.inputs)
        return replace(data, channels=tuple(inputs))
