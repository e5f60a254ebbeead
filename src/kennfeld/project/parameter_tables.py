"""The parameters of a project: today's calibration, overridden by `[parameters.NAME]`.

`[parameters.NAME]` of an expansion in radial basis functions, which has no axes and comes from a file.
"""

import glob
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError, Finding
from kennfeld.formatting import nearest
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, parameter
from kennfeld.project.axes import Axes, made_free
from kennfeld.project.initial_calibration import described, sized
from kennfeld.project.model import ProjectModel, axes_finding, coordinates_of, initial_level
from kennfeld.project.schema import DIRECTIONS, Factor, ParameterEntry, ProjectFile, Range
from kennfeld.project.steps import grid_points_within, lacking_axes
from kennfeld.rbf import RBF

__all__ = ["Tables", "build_tables"]

Report = Callable[[str, str, str], None]  # key, what, mend
TABLES = "Tables have it; remove it."


def apply_rbf_settings(old: RBF, entry: ParameterEntry, report: Report) -> Parameter | None:
    """The expansion as the project file wants it; None where that cannot be, and `report` hears why."""
    found = [*_meaningless(entry), *_wrong_lock(entry), *_wrong_bounds(old, entry)]
    for key, message, remedy in found:
        report(key, message, remedy)
    if found:
        return None
    given = {"unit": entry.unit, "description": entry.description}
    made = old.changed(**{key: value for key, value in given.items() if value is not None})
    if entry.bounds is not None:
        lower, upper = entry.bounds
        made = made.changed(lower=lower, upper=upper)
    return made.changed(locked=np.full(made.values.shape, entry.lock is True))


def _meaningless(entry: ParameterEntry) -> list[tuple[str, str, str]]:
    given = {
        "initial": entry.initial is not None,
        "smoothness": entry.smoothness is not None,
        "gradient": bool(entry.gradient),
        "curvature": bool(entry.curvature),
        "pin": bool(entry.pins),
        "extrapolation": entry.extrapolation is not None,
    }
    message = f"{entry.name} is an expansion in radial basis functions, which has no"
    initial = "Its values are those of the initial file; remove it."
    return [
        (
            key,
            f"{message} {'values of its own here' if key == 'initial' else key}",
            initial if key == "initial" else TABLES,
        )
        for key, there in given.items()
        if there
    ]


def _wrong_lock(entry: ParameterEntry) -> list[tuple[str, str, str]]:
    if isinstance(entry.lock, bool):
        return []
    message = f"{entry.name} is an expansion in radial basis functions, of which no part has a place on an axis"
    return [("lock", message, "Write lock = true, or give values that shall stay the same lower and upper bound.")]


def _wrong_bounds(old: RBF, entry: ParameterEntry) -> list[tuple[str, str, str]]:
    if entry.bounds is None or all(side.shape == old.values.shape for side in entry.bounds):
        return []
    message = f"{entry.name} has {old.size} values of several kinds: offset, slopes, weights, centres and widths"
    return [("bounds", message, f"Write two lists of {old.size} numbers, in the order of trust.csv.")]


@dataclass(frozen=True)
class Tables:
    """The parameters before the first iteration; `free` are the names to fit, `unlocked` still want "no-data"."""

    parameters: ParameterSet
    free: tuple[str, ...] = ()
    smoothness: Mapping[str, tuple[Factor, ...]] = field(default_factory=lambda: MappingProxyType({}))
    locked_without_data: tuple[str, ...] = ()

    @property
    def patterns(self) -> tuple[str, ...]:
        """The free names as glob patterns that match nothing else."""
        return tuple(glob.escape(name) for name in self.free)


def build_tables(
    file: ProjectFile, initial: ParameterSet, axes: Axes, function: ProjectModel | None, findings: list[Finding]
) -> Tables | None:
    """The parameters of a project; None where one of them cannot be made."""
    made: dict[str, Parameter] = {}
    for entry in file.parameters.values():
        table = _Table(entry, initial, axes, function, findings).made()
        if table is not None:
            made[entry.name] = table
    try:
        parameters = initial.merged(ParameterSet(made.values()))
    except ArgumentError as error:
        remedy = "Tables of one group axis share their breakpoints: give each of them { axis = ... }."
        findings.append(Finding(file.place("[axes]"), str(error), remedy))
        return None
    if len(made) < len(file.parameters):
        return None
    return Tables(
        parameters,
        _free(file, parameters, function, findings),
        {name: found for name, entry in file.parameters.items() if (found := _factors(entry, made[name], findings))},
        tuple(name for name, entry in file.parameters.items() if entry.lock == "no-data"),
    )


class _Table:
    """One parameter on its way from the project file."""

    def __init__(
        self,
        entry: ParameterEntry,
        initial: ParameterSet,
        axes: Axes,
        function: ProjectModel | None,
        findings: list[Finding],
    ) -> None:
        self.entry, self.axes, self.function, self.findings = entry, axes, function, findings
        self.old = initial.get(entry.name)

    def made(self) -> Parameter | None:
        """The parameter, or None with a finding."""
        entry, before = self.entry, len(self.findings)
        if isinstance(self.old, RBF) and not entry.axes:
            return apply_rbf_settings(self.old, entry, self._report)
        axes = self._axes()
        values = None if axes is None else self._values(axes)
        if values is None or axes is None:
            return None
        attributes: dict[str, Any] = {"unit": entry.unit, "description": entry.description}
        attributes |= {"extrapolation": entry.extrapolation, **self._bounds(values)}
        attributes = {key: value for key, value in attributes.items() if value is not None}
        if any(finding.severity == "error" for finding in self.findings[before:]):
            return None
        if self.old is not None and self.old.kind == "block" and not entry.axes:
            table = self.old.changed(values=values, **attributes)
        else:
            table = parameter(entry.name, values, axes, **self._inherited(values) | attributes)
        return table.changed(locked=self._locked(table))

    def _report(self, key: str, message: str, remedy: str = "", *, warning: bool = False) -> None:
        severity: Any = "warning" if warning else "error"
        self.findings.append(Finding(f"{self.entry.place} {key}".strip(), message, remedy, severity=severity))

    def _lacking(self) -> tuple[str, str, str]:
        """That nothing gives values: the key, what is wrong, the mend."""
        name, drawn = self.entry.name, self.function is not None and bool(self.function.model.values)
        if not drawn or self.function is None or name in self.function.graph.parameters:
            message = "the parameter is in no initial file and has no values"
            return "initial", message, self._initial_advice()
        if ":" in name:
            return "", "this field of the block is no number that can be fitted", "Name a field that holds a number."
        known = list(self.function.graph.parameters)
        remedy = nearest(name, known) or f"Its parameters are {', '.join(known[:12])}."
        return "", f"the model has no parameter {name}", remedy

    def _initial_advice(self) -> str:
        level = 0.0 if self.function is None else initial_level(self.function.graph, self.entry.name)
        return f"Write initial = {level}, or all values."

    def _inherited(self, values: Float) -> dict[str, Any]:
        """What the initial file says besides values and axes; bounds only while the shape stays."""
        if self.old is None:
            unit = self.function.graph.units.get(self.entry.name, "") if self.function else ""
            return {"unit": unit}
        kept = ["unit", "description", "extrapolation"]
        if self.old.values.shape == values.shape:
            kept += ["lower", "upper"]
        return {name: getattr(self.old, name) for name in kept}

    def _axes(self) -> tuple[Axis, ...] | None:
        """The axes: those of the project file over those of the initial file."""
        given = self.entry.axes
        old = self.old.axes if self.old is not None else ()
        count = max([len(old), *(DIRECTIONS.index(direction) + 1 for direction in given)])
        fed = coordinates_of(self.function.graph, self.entry.name) if self.function else []
        beyond = [direction for direction in DIRECTIONS[len(fed) : count] if direction in given]
        if self.function and fed and any(given[direction].quantiles for direction in beyond):
            # the function has nothing to take these quantiles of
            kind = {2: "map", 3: "cube"}.get(count, "table")
            self.findings.append(axes_finding(self.function, self.entry.name, kind, count))
            return None
        made: list[Axis | None] = []
        for i, direction in enumerate(DIRECTIONS[:count]):
            if direction in given and given[direction].inherits:
                made.append(self._freed(direction, old[i] if i < len(old) else None))
            elif direction in given:
                made.append(self.axes.made(given[direction], fed[i] if i < len(fed) else ""))
            elif i < len(old):
                made.append(old[i])
            else:
                self._report(direction, "the axis is missing", f"Write {direction} = {{ ... }}.")
                made.append(None)
        whole = tuple(axis for axis in made if axis is not None)
        return whole if len(whole) == len(made) else None

    def _freed(self, direction: str, old: Axis | None) -> Axis | None:
        """The axis of the initial file, its breakpoints free."""
        entry = self.entry.axes[direction]
        if old is None:
            remedy = "Write breakpoints, begin, end and count, or count, beside it."
            self._report(direction, "no initial file has breakpoints to begin from", remedy)
            return None
        return made_free(old, entry, self.findings)

    def _values(self, axes: Sequence[Axis]) -> Float | None:
        shape = tuple(len(axis) for axis in axes)
        if self.old is not None and self.old.kind == "block" and not axes:
            shape = self.old.values.shape
        given = self.entry.initial
        if given is not None:
            return self._spread("initial", given, shape, axes)
        if self.old is None:
            self._report(*self._lacking())
            return None
        if self.old.kind != "block" and len(self.old.axes) == len(axes):
            return _regridded(self.old, axes)
        if self.old.values.shape == shape:
            return self.old.values
        message = f"the initial file holds {described(self.old)}, the axes here ask for {sized(shape)}"
        self._report("initial", message, self._initial_advice())
        return None

    def _spread(self, key: str, given: Float, shape: tuple[int, ...], axes: Sequence[Axis] = ()) -> Float | None:
        if given.ndim == 0 or given.shape == shape:
            return np.array(np.broadcast_to(given, shape))
        if not shape:
            remedy = "Give it an axis, x = { ... }, or a single number."
            self._report(key, f"{sized(given.shape)} values for a scalar", remedy)
            return None
        message = f"has {sized(given.shape)} values; its axes ask for {sized(shape)}"
        turned = given.shape == shape[::-1] and len(shape) == 2
        remedy = "It seems to be transposed: write a row for each x." if turned else "Write a row for each x."
        self._report(key, message, remedy if len(shape) > 1 else "Write one value a breakpoint.")
        return None

    def _bounds(self, values: Float) -> dict[str, Float]:
        """Bounds of the table's shape; reports where they leave the start outside."""
        if self.entry.bounds is None:
            return {}
        sides = [self._spread("bounds", side, values.shape) for side in self.entry.bounds]
        lower, upper = sides
        if lower is None or upper is None:
            return {}
        outside = (values < lower) | (values > upper)
        if outside.any():
            at = tuple(np.argwhere(outside)[0])
            message = f"{int(outside.sum())} of {values.size} initial values lie outside, such as {values[at]:g}"
            self._report("bounds", message, "They will be moved onto the bounds.", warning=True)
        return {"lower": lower, "upper": upper}

    def _locked(self, table: Parameter) -> Bool:
        """The values that a lock holds; those without data are found later."""
        lock = self.entry.lock
        if isinstance(lock, bool) or lock == "no-data":
            return np.full(table.values.shape, lock is True)
        held = np.zeros(table.values.shape, dtype=bool)
        for number, part in enumerate(lock, 1):
            held |= self._range(table, part, f"lock {number}")
        return held

    def _range(self, table: Parameter, part: Range, key: str) -> Bool:
        beyond = lacking_axes(table, part)
        if beyond:
            self._report(key, f"{table.name} has no axis {beyond[0]}")
            return np.zeros(table.values.shape, dtype=bool)
        inside = grid_points_within(table, part)
        if not inside.any():
            self._report(key, "no grid point lies in this range", warning=True)
        return inside


def _regridded(old: Parameter, axes: Sequence[Axis]) -> Float:
    """The table interpolated onto other axes."""
    values = old.values
    for i, (before, after) in enumerate(zip(old.axes, axes, strict=True)):
        if not np.array_equal(before.breakpoints, after.breakpoints):
            place = position(after.breakpoints, before.breakpoints, old.extrapolation)
            weights = cell_weights(place, len(before))[0]
            values = np.moveaxis(np.tensordot(weights, values, axes=(1, i)), 0, i)
    return values


def _factors(entry: ParameterEntry, table: Parameter, findings: list[Finding]) -> tuple[Factor, ...]:
    """Smoothness along each axis."""
    given = entry.smoothness
    if given is None:
        return ()
    if not isinstance(given, Mapping):
        return (given,) * len(table.axes)
    known = DIRECTIONS[: len(table.axes)]
    for direction in given:
        if direction not in known:
            message = f"{entry.name} has no axis {direction}"
            findings.append(Finding(f"{entry.place} smoothness", message, f"It has {', '.join(known) or 'none'}."))
    return tuple(given.get(direction, 0.0) for direction in known)


def _free(
    file: ProjectFile, parameters: ParameterSet, function: ProjectModel | None, findings: list[Finding]
) -> tuple[str, ...]:
    """The parameters to fit among those that the function uses."""
    used = list(function.graph.parameters) if function else list(parameters)
    chosen = set()
    for pattern in file.calibration.free:
        matches = {name for name in parameters if fnmatchcase(name, pattern) or name == pattern}
        chosen |= matches
        place = file.place("[calibration] free")
        if not matches and (parameters or pattern != "*"):
            remedy = nearest(pattern, parameters) or f"The parameters are {', '.join(used[:12])}."
            findings.append(Finding(place, f"{pattern} matches no parameter", remedy))
        elif matches and matches.isdisjoint(used):
            names = ", ".join(sorted(matches)[:5])
            message = f"{pattern} matches only parameters that the function does not use: {names}"
            findings.append(Finding(place, message, severity="warning"))
    for name, entry in file.parameters.items():
        if entry.free is not None:
            (chosen.add if entry.free else chosen.discard)(name)
    return tuple(name for name in used if name in chosen and name in parameters)
