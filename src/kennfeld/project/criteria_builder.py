"""Builds the criteria and constraints of a project: pins, shapes of tables, equalities, and output limits."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.base.errors import Finding, Findings, Fix, Location
from kennfeld.base.formatting import count_noun, nearest, toml_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.domain.criteria import Criterion, Region, Target
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.table_parts import Range, grid_points_within, missing_directions
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.project.criteria_schema import CriterionEntry
from kennfeld.project.model import ProjectModel
from kennfeld.project.parameter_tables import Tables
from kennfeld.project.schema import ProjectFile
from kennfeld.project.table_schema import ParameterEntry, ShapeEntry
from kennfeld.project.value_forms import DIRECTIONS

IGNORED = "The limit is ignored."
Limits = Range | tuple[ShapeEntry, ...]


@dataclass
class Constraints:
    """Constraints on values and outputs."""

    pins: tuple[Pin, ...] = ()
    linear: tuple[Shape | Equality, ...] = ()
    limits: tuple[Limit, ...] = ()


def build_constraints(
    file: ProjectFile, tables: Tables, function: ProjectModel | None, findings: Findings
) -> Constraints:
    """Return the constraints on free parameters; add findings about those that cannot be met."""
    builder = _ConstraintBuilder(file, tables, function, findings)
    shapes = [shape for entry in file.parameters.values() for shape in builder.shapes(entry)]
    return Constraints(
        tuple(builder.pins()),
        (*shapes, *builder.equalities()),
        tuple(Limit(entry.node, entry.lower, entry.upper, entry.where) for entry in file.limits),
    )


@dataclass
class _ConstraintBuilder:
    file: ProjectFile
    tables: Tables
    function: ProjectModel | None
    findings: Findings

    def _is_used(self, name: str) -> bool:
        return self.function is not None and name in self.function.graph.parameters

    def pins(self) -> Iterable[Pin]:
        for name, entry in self.file.parameters.items():
            table = self.tables.parameters[name]
            for number, pin in enumerate(entry.pins, 1):
                location = entry.location.within(f"pin {number}")
                if not self._fits(location, pin.at, table):
                    continue
                if name not in self.tables.free and self._is_used(name):
                    fixes = [_free(name), Fix.remove(("parameters", name, "pin", number))]
                    self.findings.error(location, f"{name} is not free", "Free it, or remove the pin.", fixes=fixes)
                if name in self.tables.free:
                    yield Pin(name, pin.at, pin.value)

    def _fits(self, location: Location, at: tuple[float, ...], table: Parameter) -> bool:
        """Return if there is a coordinate for each axis; warn of those outside the axis."""
        axes = table.index_axes
        if len(at) != len(axes):
            self.findings.error(
                location,
                f"{list(at)} has {count_noun(len(at), 'coordinate')}, but {table.name} has {len(axes)} axes",
                "Write at = [...], one per axis.",
            )
            return False
        for x, axis in zip(at, axes, strict=True):
            first, last = axis.breakpoints[0], axis.breakpoints[-1]
            if not first <= x <= last:
                message = f"{x:g} is outside the axis, {first:g} to {last:g}"
                self.findings.warning(location, message, "It applies at the clipped coordinate.")
        return True

    def shapes(self, entry: ParameterEntry) -> Iterable[Shape]:
        """Yield the limits of slope and curvature of a free parameter."""
        table = self.tables.parameters[entry.name]
        kinds: tuple[tuple[str, Literal["slope", "curvature"], Limits, int], ...] = (
            ("gradient", "slope", entry.gradient, 2),
            ("curvature", "curvature", entry.curvature, 3),
        )
        for key, kind, limits, width in kinds:
            for place, direction, (lower, upper), where in _shape_limits(key, limits):
                fault = self._shape_fault(table, direction, where, width)
                if fault is None and not self._is_used(entry.name):
                    continue
                if fault is not None:
                    message, remedy, is_error = fault
                    number = [int(place.split()[1])] if " " in place else []
                    fixes = [Fix.remove(("parameters", entry.name, key, *number, direction))]
                    report = self.findings.error if is_error else self.findings.warning
                    report(entry.location.within(f"{place} {direction}"), message, remedy, fixes=fixes)
                else:
                    yield Shape(entry.name, DIRECTIONS.index(direction), kind, lower=lower, upper=upper, where=where)

    def _shape_fault(self, table: Parameter, direction: str, where: Range, width: int) -> tuple[str, str, bool] | None:
        """Return why a table cannot have limits on differences of `width` points: message, remedy, if an error."""
        for beyond in missing_directions(table, {direction: (0.0, 0.0), **where}):
            return f"{table.name} has no axis {beyond}", "Remove it.", True
        points = len(table.index_axes[DIRECTIONS.index(direction)])
        if points < width:
            kind = "gradient" if width == 2 else "curvature"
            return f"{kind} requires {width} breakpoints, but the axis has {points}", IGNORED, False
        along = np.moveaxis(grid_points_within(table, where), DIRECTIONS.index(direction), 0)
        if not np.any(np.all([along[i : points - width + 1 + i] for i in range(width)], axis=0)):
            return f"no {width} neighbouring breakpoints are within its where", IGNORED, False
        if self._is_used(table.name) and table.name not in self.tables.free:
            return f"{table.name} is not free", IGNORED, False
        return None

    def equalities(self) -> Iterable[Equality]:
        """Yield the equalities whose terms are all valid."""
        for entry in self.file.equalities:
            is_valid = bool(entry.terms)
            for number, term in enumerate(entry.terms, 1):
                location = entry.location.within(f"term {number}")
                if term.parameter not in self.tables.parameters:
                    remedy = nearest(term.parameter, self.tables.parameters)
                    keys = (*entry.location.keys, "terms", number, "parameter")
                    fixes = [Fix.choose(keys, self.tables.free), Fix.remove(entry.location.keys)]
                    self.findings.error(location, f"unknown parameter {term.parameter}", remedy, fixes=fixes)
                    is_valid = False
                elif term.parameter not in self.tables.free:
                    fixes = [_free(term.parameter), Fix.remove(entry.location.keys)]
                    remedy = "Free it, or remove the equality."
                    self.findings.error(location, f"{term.parameter} is not free", remedy, fixes=fixes)
                    is_valid = False
                elif term.at is not None and not self._fits(location, term.at, self.tables.parameters[term.parameter]):
                    is_valid = False
            if is_valid:
                yield Equality([Term(term.parameter, term.at, term.factor) for term in entry.terms], entry.value)


def _free(name: str) -> Fix:
    return Fix(f"Free {name}", ((("parameters", name, "free"), True),))


def _shape_limits(key: str, limits: Limits) -> Iterator[tuple[str, str, tuple[float, float], Range]]:
    """Yield of each limit its place in the section, its direction, its ends and where it applies."""
    if not isinstance(limits, tuple):
        yield from ((key, direction, ends, {}) for direction, ends in limits.items())
        return
    for number, entry in enumerate(limits, 1):
        yield from ((f"{key} {number}", direction, ends, entry.where) for direction, ends in entry.limits.items())


def build_criteria(
    file: ProjectFile, function: ProjectModel | None, loaded: LoadedData, findings: Findings
) -> tuple[Criterion, ...]:
    """Return the valid criteria; add findings about the others. A bare target is a channel, else a node."""
    criteria: list[Criterion] = []
    first: dict[tuple[str, str], Location] = {}
    for entry in file.criteria:
        target = _target(entry, file, function, loaded, findings)
        if target is None:
            continue
        settings = {"weight": entry.weight, "loss": entry.loss, "delta": entry.delta, "scale": entry.scale}
        samples = {
            "weight_channel": entry.weight_channel,
            "regions": [Region(r.where, r.weight) for r in entry.regions],
        }
        criterion = Criterion(entry.node, target, **settings, **samples)  # type: ignore[arg-type]
        key = (entry.node, str(target))
        if key in first:
            message = f"duplicate criterion: {entry.node} and {target} are already compared in {first[key]}"
            fixes = [Fix.remove(entry.location.keys)]
            findings.error(entry.location, message, "Remove one, or add their weights.", fixes=fixes)
        first.setdefault(key, entry.location)
        criteria.append(criterion)
    if file.criteria and all(entry.weight == 0 for entry in file.criteria):
        fixes = [Fix.remove((*entry.location.keys, "weight")) for entry in file.criteria[:1]]
        weightless = [replace(fix, title=f"Weight {file.criteria[0].node} by 1") for fix in fixes]
        remedy = "Set at least one weight > 0."
        findings.error(file.location("criterion"), "all weights are 0", remedy, fixes=weightless)
    return tuple(criteria)


def _target(
    entry: CriterionEntry, file: ProjectFile, function: ProjectModel | None, loaded: LoadedData, findings: Findings
) -> Target | None:
    target = entry.target
    nodes = function.graph.names if function else {}
    if target.kind == "number":
        return Target("number", value=target.value)
    if target.kind == "node":
        return Target("node", target.name) if target.name in nodes else None
    having = [data for data in loaded.datasets if target.name in data]
    if target.kind == "name" and target.name in nodes:
        if not having:
            return Target("node", target.name)
        message = f"{target.name} is both a channel and a node; the channel is used"
        text = toml_text(target.name)
        remedy = f"Write {{ channel = {text} }} or {{ node = {text} }}."
        keys = (*entry.location.keys, "target")
        fixes = [Fix(f"Take the {kind}", ((keys, {kind: target.name}),)) for kind in ("channel", "node")]
        findings.warning(entry.location.within("target"), message, remedy, fixes)
    if having:
        findings.add(*_partly(entry, file.criteria, loaded.datasets))
    # names of files that could not be read are not known
    elif loaded.complete and loaded.datasets:
        names = {**loaded.offered, **dict.fromkeys(n for data in loaded.datasets for n in data)}
        candidates = [*names, *nodes] if target.kind == "name" else list(names)
        kinds = "channel or node" if target.kind == "name" else "channel"
        message = f"unknown {kinds} {target.name}"
        remedy = nearest(target.name, candidates) or f"The data have {', '.join(list(names)[:8])}."
        fixes = [Fix.choose((*entry.location.keys, "target", "channel"), sorted(names))]
        if target.kind == "name":
            fixes = [Fix.choose((*entry.location.keys, "target"), sorted(names))]
        findings.error(entry.location.within("target"), message, remedy, fixes=fixes)
        return None
    return Target("channel", target.name)


def _partly(entry: CriterionEntry, every: Sequence[CriterionEntry], datasets: Sequence[Dataset]) -> list[Finding]:
    """Return a warning for each dataset that lacks the target, unless it is meant for another criterion.

    It is meant for a criterion whose target it has, if no dataset has both channels.
    """
    name = entry.target.name
    others = {other.target.name for other in every if other.target.kind != "number"}
    apart = {other for other in others if not any(name in data and other in data for data in datasets)}
    return [
        Finding(
            entry.location.within("target"),
            f"dataset {data.name} has no channel {name}; {entry.node} is not scored there",
            severity="warning",
        )
        for data in datasets
        if name not in data and not any(other in data for other in apart)
    ]
