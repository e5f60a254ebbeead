"""The constraints of a project: pins, shapes of tables, equalities, and limits of outputs."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from kennfeld.errors import Finding, nearest
from kennfeld.optimize import Equality, Limit, Pin, Shape, Term
from kennfeld.parameters import Parameter
from kennfeld.project.function import Function
from kennfeld.project.schema import DIRECTIONS, ParameterEntry, ProjectFile
from kennfeld.project.tables import Tables

__all__ = ["Constraints", "build_constraints"]


@dataclass
class Constraints:
    """What the values and the outputs must keep."""

    pins: tuple[Pin, ...] = ()
    linear: tuple[Shape | Equality, ...] = ()
    limits: tuple[Limit, ...] = ()


def build_constraints(
    file: ProjectFile, tables: Tables, function: Function | None, findings: list[Finding]
) -> Constraints:
    """The constraints that concern free parameters, and findings about those that cannot hold."""
    builder = _Builder(file, tables, function, findings)
    shapes = [shape for entry in file.parameters.values() for shape in builder.shapes(entry)]
    return Constraints(
        tuple(builder.pins()),
        (*shapes, *builder.equalities()),
        tuple(Limit(entry.node, entry.lower, entry.upper, entry.where) for entry in file.limits),
    )


@dataclass
class _Builder:
    file: ProjectFile
    tables: Tables
    function: Function | None
    findings: list[Finding] = field(default_factory=list)

    def _report(self, part: str, what: str, mend: str = "", *, warning: bool = False) -> None:
        place = part if part.startswith(self.file.path.name) else self.file.place(part)
        self.findings.append(Finding(place, what, mend, severity="warning" if warning else "error"))

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
                what = f"{x:g} lies beyond the axis, {first:g} to {last:g}"
                self._report(part, what, "It holds where the lookup ends up.", warning=True)
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
                    what = f"the axis has {len(axes[axis])} breakpoints, a {key} needs {least}"
                    self._report(part, what, "Nothing is limited.", warning=True)
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
                    mend = nearest(term.parameter, self.tables.parameters)
                    self._report(part, f"{term.parameter} is no parameter of the project", mend)
                    good = False
                elif term.parameter not in self.tables.free:
                    self._report(part, f"{term.parameter} is not free", "Free it, or remove the equality.")
                    good = False
                elif term.at is not None and not self._fits(part, term.at, self.tables.parameters[term.parameter]):
                    good = False
            if good:
                yield Equality([Term(term.parameter, term.at, term.factor) for term in entry.terms], entry.value)
