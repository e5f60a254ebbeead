"""The constraints of a project: pins, shapes of tables, equalities, and limits of outputs.

The criteria of a project: nodes that are there, targets told apart, nothing twice.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from kennfeld.constraints import Equality, Limit, Pin, Shape, Term
from kennfeld.criteria import Criterion, Region, Target
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding
from kennfeld.formatting import nearest
from kennfeld.parameters import Parameter
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.project.model import ProjectModel
from kennfeld.project.parameter_tables import Tables
from kennfeld.project.schema import DIRECTIONS, CriterionEntry, ParameterEntry, ProjectFile

__all__ = ["Constraints", "build_constraints", "build_criteria"]


@dataclass
class Constraints:
    """What the values and the outputs must keep."""

    pins: tuple[Pin, ...] = ()
    linear: tuple[Shape | Equality, ...] = ()
    limits: tuple[Limit, ...] = ()


def build_constraints(
    file: ProjectFile, tables: Tables, function: ProjectModel | None, findings: list[Finding]
) -> Constraints:
    """The constraints that concern free parameters, and findings about those that cannot hold."""
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
    findings: list[Finding] = field(default_factory=list)

    def _report(self, part: str, message: str, remedy: str = "", *, warning: bool = False) -> None:
        place = part if part.startswith(self.file.path.name) else self.file.place(part)
        self.findings.append(Finding(place, message, remedy, severity="warning" if warning else "error"))

    def _used(self, name: str) -> bool:
        return self.function is not None and name in self.function.graph.parameters

    def pins(self) -> Iterable[Pin]:
        """The pins of free parameters."""
        for name, entry in self.file.parameters.items():
            table = self.tables.parameters[name]
            for number, pin in enumerate(entry.pins, 1):
                part = f"[parameters.{name}] pin {number}"
                if not self._fits(part, pin.at, table):
                    continue
                if name not in self.tables.free and self._used(name):
                    self._report(part, f"{name} is not free", "Free it, or remove the pin.")
                if name in self.tables.free:
                    yield Pin(name, pin.at, pin.value)

    def _fits(self, part: str, at: tuple[float, ...], table: Parameter) -> bool:
        """Whether there is a coordinate for each axis; warns of those beyond its ends."""
        axes = table.index_axes
        if len(at) != len(axes):
            given = f"{len(at) or 'no'} coordinate{'s' * (len(at) != 1)}"
            self._report(
                part, f"{list(at)} has {given}, {table.name} has {len(axes)} axes", "Write at = [...], one an axis."
            )
            return False
        for x, axis in zip(at, axes, strict=True):
            first, last = axis.breakpoints[0], axis.breakpoints[-1]
            if not first <= x <= last:
                message = f"{x:g} lies beyond the axis, {first:g} to {last:g}"
                self._report(part, message, "It holds where the lookup ends up.", warning=True)
        return True

    def shapes(self, entry: ParameterEntry) -> Iterable[Shape]:
        """Limits of slope and curvature of a free parameter."""
        name = entry.name
        axes = self.tables.parameters[name].index_axes
        for key, kind, ranges, least in (
            ("gradient", "slope", entry.gradient, 2),
            ("curvature", "curvature", entry.curvature, 3),
        ):
            for direction, (lower, upper) in ranges.items():
                part, axis = f"[parameters.{name}] {key} {direction}", DIRECTIONS.index(direction)
                if axis >= len(axes):
                    self._report(part, f"{name} has {len(axes)} axes, there is no {direction}", "Remove it.")
                elif len(axes[axis]) < least:
                    message = f"the axis has {len(axes[axis])} breakpoints, a {key} needs {least}"
                    self._report(part, message, "Nothing is limited.", warning=True)
                elif name in self.tables.free and self._used(name):
                    yield Shape(name, axis, "slope" if kind == "slope" else "curvature", lower, upper)
                elif self._used(name):
                    self._report(part, f"{name} is not free", "Nothing is limited.", warning=True)

    def equalities(self) -> Iterable[Equality]:
        """The equalities whose terms all fit."""
        for entry in self.file.equalities:
            good = bool(entry.terms)
            for number, term in enumerate(entry.terms, 1):
                part = f"{entry.place} term {number}"
                if term.parameter not in self.tables.parameters:
                    remedy = nearest(term.parameter, self.tables.parameters)
                    self._report(part, f"{term.parameter} is no parameter of the project", remedy)
                    good = False
                elif term.parameter not in self.tables.free:
                    self._report(part, f"{term.parameter} is not free", "Free it, or remove the equality.")
                    good = False
                elif term.at is not None and not self._fits(part, term.at, self.tables.parameters[term.parameter]):
                    good = False
            if good:
                yield Equality([Term(term.parameter, term.at, term.factor) for term in entry.terms], entry.value)


def build_criteria(
    file: ProjectFile, function: ProjectModel | None, loaded: LoadedData, findings: list[Finding]
) -> tuple[Criterion, ...]:
    """The criteria that can be used, and findings about the others. A bare target is a channel, else a node."""
    made: list[Criterion] = []
    first: dict[tuple[str, str], str] = {}
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
            message = f"{entry.node} against {target} stands already in {first[key]}"
            findings.append(Finding(entry.place, message, "Remove one, or add their weights."))
        first.setdefault(key, entry.place)
        made.append(criterion)
    if file.criteria and all(entry.weight == 0 for entry in file.criteria):
        findings.append(Finding(file.place("[[criterion]]"), "every weight is 0", "Give one a weight above 0."))
    return tuple(made)


def _target(
    entry: CriterionEntry, file: ProjectFile, function: ProjectModel | None, loaded: LoadedData, findings: list[Finding]
) -> Target | None:
    given = entry.target
    nodes = function.graph.names if function else {}
    if given.kind == "number":
        return Target("number", value=given.value)
    if given.kind == "node":
        return Target("node", given.name) if given.name in nodes else None
    having = [data for data in loaded.datasets if given.name in data]
    if given.kind == "name" and given.name in nodes:
        if not having:
            return Target("node", given.name)
        message = f"{given.name} is a channel of the data and a node of the function; the channel is taken"
        remedy = f'Write {{ channel = "{given.name}" }} or {{ node = "{given.name}" }}.'
        findings.append(Finding(f"{entry.place} target", message, remedy, severity="warning"))
    if having:
        findings += _partly(entry, file.criteria, loaded.datasets)
    elif loaded.complete and loaded.datasets:
        names = {**loaded.offered, **dict.fromkeys(n for data in loaded.datasets for n in data)}
        candidates = [*names, *nodes] if given.kind == "name" else list(names)
        message = f"{given.name} is no channel of the data" + (" and no node" if given.kind == "name" else "")
        remedy = nearest(given.name, candidates) or f"They have {', '.join(list(names)[:8])}."
        findings.append(Finding(f"{entry.place} target", message, remedy))
        return None
    return Target("channel", given.name)


def _partly(entry: CriterionEntry, every: Sequence[CriterionEntry], datasets: Sequence[Dataset]) -> list[Finding]:
    """A warning for each dataset that lacks the channel, unless it is there for another criterion.

    It is there for one whose target it has, if no dataset has both channels.
    """
    name = entry.target.name
    others = {other.target.name for other in every if other.target.kind != "number"}
    apart = {other for other in others if not any(name in data and other in data for data in datasets)}
    return [
        Finding(
            f"{entry.place} target",
            f"dataset {data.name} has no channel {name}; {entry.node} is not scored there",
            severity="warning",
        )
        for data in datasets
        if name not in data and not any(other in data for other in apart)
    ]
