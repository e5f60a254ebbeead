"""Builds the parameters of a project: the initial calibration, overridden by `[parameters.NAME]`."""

import glob
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError, Findings, Fix, Keys
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, parameter
from kennfeld.domain.rbf import RBF
from kennfeld.domain.table_parts import Range, grid_points_within, missing_directions
from kennfeld.graph.interpolation import regrid
from kennfeld.graph.traversal import coordinates_of
from kennfeld.project.axes import Axes, free_breakpoints
from kennfeld.project.initial_calibration import describe_parameter, format_shape
from kennfeld.project.label_selection import expand_lists
from kennfeld.project.model import ProjectModel, axis_count_finding, initial_level
from kennfeld.project.schema import ProjectFile
from kennfeld.project.table_schema import AxisEntry, Factor, ParameterEntry
from kennfeld.project.value_forms import DIRECTIONS, Around

Report = Callable[[str, str, str], None]  # key, message, remedy
COUNT = 8  # breakpoints that a fix proposes


def apply_rbf_settings(old: RBF, entry: ParameterEntry, report: Report) -> Parameter | None:
    """Apply the settings of a project file to an expansion; return None, after reports, if they are invalid."""
    problems = list(_rbf_problems(old, entry))
    for key, message, remedy in problems:
        report(key, message, remedy)
    if problems:
        return None
    texts = {"unit": entry.unit, "description": entry.description}
    expansion = old.changed(**{key: text for key, text in texts.items() if text is not None})
    if entry.bounds is not None:
        bounds = entry.bounds.bounds(old.values) if isinstance(entry.bounds, Around) else entry.bounds
        expansion = expansion.with_bounds(*bounds)
    return expansion.changed(locked=np.full(old.values.shape, entry.lock is True))


def _rbf_problems(old: RBF, entry: ParameterEntry) -> Iterator[tuple[str, str, str]]:
    """Yield the settings that an expansion cannot have."""
    message = f"not supported for {entry.name}, an RBF expansion"
    if entry.initial is not None:
        yield "initial", message, "Remove it; the values are those of the initial file."
    of_tables = {
        "step": entry.step is not None,
        "smoothness": entry.smoothness is not None,
        "gradient": bool(entry.gradient),
        "curvature": bool(entry.curvature),
        "pin": bool(entry.pins),
        "extrapolation": entry.extrapolation is not None,
    }
    yield from ((key, message, "Remove it.") for key, is_set in of_tables.items() if is_set)
    if not isinstance(entry.lock, bool):
        message = f"a part of {entry.name} cannot be locked by ranges: an RBF expansion has no axes"
        yield "lock", message, "Write lock = true, or set equal lower and upper bounds for values to be kept."
    sides = () if isinstance(entry.bounds, Around) else entry.bounds or ()
    if any(side.shape != old.values.shape for side in sides):
        message = f"the bounds of {entry.name} must have {old.size} values: offset, slopes, weights, centres and widths"
        yield "bounds", message, f"Write two lists of {old.size} numbers, in the order of trust.csv."


@dataclass(frozen=True)
class Tables:
    """The initial parameters and the names of those to fit; `locked_without_data` have lock = "no-data"."""

    parameters: ParameterSet
    free: tuple[str, ...] = ()
    smoothness: Mapping[str, tuple[Factor, ...]] = field(default_factory=lambda: FrozenDict({}))
    locked_without_data: tuple[str, ...] = ()

    @property
    def patterns(self) -> tuple[str, ...]:
        """The free names, escaped as glob patterns."""
        return tuple(glob.escape(name) for name in self.free)


def build_tables(
    file: ProjectFile, initial: ParameterSet, axes: Axes, function: ProjectModel | None, findings: Findings
) -> Tables | None:
    """Build the parameters of a project; return None, with findings, if one of them is invalid."""
    built: dict[str, Parameter] = {}
    for entry in file.parameters.values():
        # of each table, so that an error in one does not stop the others
        own = Findings()
        table = _TableBuilder(entry, initial, axes, function, own).build()
        findings.add(*own)
        if table is not None:
            built[entry.name] = table
    try:
        parameters = initial.merged(ParameterSet(built.values()))
    except ArgumentError as error:
        remedy = "Tables with the same group axis share its breakpoints: write { axis = ... } in each."
        findings.error(file.location("axes"), str(error), remedy)
        return None
    if len(built) < len(file.parameters):
        return None
    return Tables(
        parameters,
        _free(file, parameters, function, findings),
        {
            name: factors
            for name, entry in file.parameters.items()
            if (factors := _factors(entry, built[name], findings))
        },
        tuple(name for name, entry in file.parameters.items() if entry.lock == "no-data"),
    )


class _TableBuilder:
    """Builds one parameter from its section and its initial value."""

    def __init__(
        self,
        entry: ParameterEntry,
        initial: ParameterSet,
        axes: Axes,
        function: ProjectModel | None,
        findings: Findings,
    ) -> None:
        self.entry, self.axes, self.function, self.findings = entry, axes, function, findings
        self.old = initial.get(entry.name)

    def build(self) -> Parameter | None:
        """Build the parameter; return None, with findings, if it is invalid."""
        entry = self.entry
        if isinstance(self.old, RBF) and not entry.axes:
            return apply_rbf_settings(self.old, entry, self._report)
        axes = self._axes()
        values = None if axes is None else self._values(axes)
        if values is None or axes is None:
            return None
        attributes: dict[str, Any] = {"unit": entry.unit, "description": entry.description}
        attributes |= {"extrapolation": entry.extrapolation, **self._bounds(values)}
        attributes = {key: value for key, value in attributes.items() if value is not None}
        if self.findings.has_errors:
            return None
        # a value block has positions in place of axes, which `parameter` cannot build
        if self.old is not None and self.old.kind == "block" and not entry.axes:
            table = self.old.changed(values=values, **attributes)
        else:
            table = parameter(entry.name, values, axes, **self._inherit(values) | attributes)
        return table.changed(locked=self._lock(table) | self._unfitted(table))

    def _report(
        self, key: str, message: str, remedy: str = "", fixes: Sequence[Fix] = (), *, warning: bool = False
    ) -> None:
        report = self.findings.warning if warning else self.findings.error
        report(self.entry.location.within(key), message, remedy, fixes=fixes)

    @property
    def _keys(self) -> Keys:
        return ("parameters", self.entry.name)

    def _missing_values(self) -> tuple[str, str, str, list[Fix]]:
        """Return key, message, remedy and fixes for missing values."""
        name, has_values = self.entry.name, self.function is not None and bool(self.function.model.values)
        if not has_values or self.function is None or name in self.function.graph.parameters:
            message = "no values: the key is missing and no initial file has the parameter"
            return "initial", message, self._initial_advice(), [self._initial_fix()]
        removal = Fix.remove(self._keys)
        if ":" in name:
            message = "this field of the block is not a number that can be fitted"
            return "", message, "Name a numeric field.", [removal]
        known = list(self.function.graph.parameters)
        remedy = nearest(name, known) or f"The model has {', '.join(known[:12])}."
        return "", f"unknown parameter {name}", remedy, [removal]

    def _level(self) -> float:
        return 0.0 if self.function is None else initial_level(self.function.graph, self.entry.name)

    def _initial_advice(self) -> str:
        return f"Write initial = {self._level()}, or all values."

    def _initial_fix(self) -> Fix:
        return Fix.set((*self._keys, "initial"), self._level())

    def _inherit(self, values: Float) -> dict[str, Any]:
        """Return the attributes of the initial file; bounds only if the shape is unchanged."""
        if self.old is None:
            return {"unit": self.function.graph.units.get(self.entry.name, "") if self.function else ""}
        names = ["unit", "description", "extrapolation"]
        if self.old.values.shape == values.shape:
            names += ["lower", "upper"]
        return {name: getattr(self.old, name) for name in names}

    def _axes(self) -> tuple[Axis, ...] | None:
        """Return the axes of the project file, else of the initial file; None, with a finding, if one is invalid."""
        entries = self.entry.axes
        if self.entry.per:
            return self._recordings(entries)
        old = self.old.axes if self.old is not None else ()
        count = max([len(old), *(DIRECTIONS.index(direction) + 1 for direction in entries)])
        coordinates = coordinates_of(self.function.graph, self.entry.name) if self.function else []
        beyond = [direction for direction in DIRECTIONS[len(coordinates) : count] if direction in entries]
        if self.function and coordinates and any(entries[direction].quantiles for direction in beyond):
            # the lookup has no coordinate for these quantiles
            kind = {2: "map", 3: "cube"}.get(count, "table")
            self.findings.add(axis_count_finding(self.function, self.entry.name, kind, count))
            return None
        axes: list[Axis | None] = []
        for i, direction in enumerate(DIRECTIONS[:count]):
            if direction in entries and entries[direction].inherits:
                axes.append(self._inherited_axis(direction, old[i] if i < len(old) else None))
            elif direction in entries:
                coordinate = coordinates[i] if i < len(coordinates) else ""
                axes.append(self.axes.build(entries[direction], coordinate, old[i] if i < len(old) else None))
            elif i < len(old):
                axes.append(old[i])
            else:
                self._report(direction, "the axis is missing", f"Write {direction} = {{ ... }}.")
                axes.append(None)
        valid = tuple(axis for axis in axes if axis is not None)
        return valid if len(valid) == len(axes) else None

    def _is_over_data(self, direction: str) -> bool:
        """Return if the data show the range of an axis: it is looked up with an input."""
        graph = None if self.function is None else self.function.graph
        coordinates = [] if graph is None else coordinates_of(graph, self.entry.name)
        at = DIRECTIONS.index(direction)
        return graph is not None and at < len(coordinates) and coordinates[at] in graph.inputs

    def _recordings(self, entries: Mapping[str, AxisEntry]) -> tuple[Axis, ...] | None:
        """Return the axis of a parameter with a value for each recording."""
        for direction in entries:
            message = f"contradicts per = {self.entry.per!r}, which has an axis of its own"
            self._report(
                direction, message, "Remove one.", [Fix.remove((*self._keys, key)) for key in (direction, "per")]
            )
        axis = None if entries else self.axes.recordings(self.entry)
        return None if axis is None else (axis,)

    def _inherited_axis(self, direction: str, old: Axis | None) -> Axis | None:
        """Return the axis of the initial file, with free breakpoints if the entry says so."""
        entry = self.entry.axes[direction]
        if old is None:
            remedy = "Write breakpoints; or begin, end and count; or count."
            fix = Fix(f"Take {COUNT} points over the data", (((*self._keys, direction, "count"), COUNT),))
            fixes = [fix] if self._is_over_data(direction) else []
            self._report(direction, f"{entry.needs_points}, but no initial file has any", remedy, fixes)
            return None
        return free_breakpoints(old, entry, self.findings)

    def _values(self, axes: Sequence[Axis]) -> Float | None:
        shape = tuple(len(axis) for axis in axes)
        if self.old is not None and self.old.kind == "block" and not axes:
            shape = self.old.values.shape
        values = self.entry.initial
        if values is not None:
            return self._spread("initial", values, shape, axes)
        if self.old is None:
            self._report(*self._missing_values())
            return None
        if self.entry.per and self.old.kind == "scalar":
            return np.full(shape, self.old.values.item())
        if self.old.kind != "block" and len(self.old.axes) == len(axes):
            # new breakpoints for a table of the initial files: its values are interpolated at them
            return regrid(self.old.values, self.old.axes, axes, self.old.extrapolation)
        if self.old.values.shape == shape:
            return self.old.values
        message = f"the initial file has {describe_parameter(self.old)}, but the axes require {format_shape(shape)}"
        self._report("initial", message, self._initial_advice(), [self._initial_fix()])
        return None

    def _spread(self, key: str, array: Float, shape: tuple[int, ...], axes: Sequence[Axis] = ()) -> Float | None:
        if array.ndim == 0 or array.shape == shape:
            return np.array(np.broadcast_to(array, shape))
        if not shape:
            remedy = "Give it an axis, x = { ... }, or a single number."
            fixes = [self._initial_fix()] if key == "initial" else []
            self._report(key, f"must be one value for a scalar, got {format_shape(array.shape)}", remedy, fixes)
            return None
        message = f"has {format_shape(array.shape)} values, but the axes require {format_shape(shape)}"
        # DCM, CVX and CDFX have a row for each y
        turned = array.shape == shape[::-1] and len(shape) == 2
        remedy = "It seems to be transposed: write one row per x." if turned else "Write one row per x."
        fixes = []
        if key == "initial":
            turning = Fix("Transpose it", (((*self._keys, key), array.T.tolist()),))
            fixes = [turning] if turned else [self._initial_fix()]
        self._report(key, message, remedy if len(shape) > 1 else "Write one value per breakpoint.", fixes)
        return None

    def _bounds(self, values: Float) -> dict[str, Float]:
        """Return bounds of the table's shape; warn if initial values are outside."""
        if self.entry.bounds is None:
            return {}
        if isinstance(self.entry.bounds, Around):
            return self._bounds_around(values, self.entry.bounds)
        lower, upper = (self._spread("bounds", side, values.shape) for side in self.entry.bounds)
        if lower is None or upper is None:
            return {}
        outside = (values < lower) | (values > upper)
        if outside.any():
            at = tuple(np.argwhere(outside)[0])
            message = f"{int(outside.sum())} of {values.size} initial values are outside, such as {values[at]:g}"
            self._report("bounds", message, "They will be clipped to the bounds.", warning=True)
        return {"lower": lower, "upper": upper}

    def _bounds_around(self, values: Float, around: Around) -> dict[str, Float]:
        """Return bounds around initial values; warn if some of these are 0, which a share does not move."""
        lower, upper = around.bounds(values)
        if (fixed := int(np.count_nonzero(lower == upper))) and fixed < values.size:
            message = f"{fixed} of {values.size} initial values are 0 and cannot move"
            self._report("bounds", message, "Add absolute = ... to let them.", warning=True)
        elif fixed:
            message = (
                "all initial values are 0 and cannot move"
                if values.size > 1
                else "the initial value is 0 and cannot move"
            )
            self._report("bounds", message, "Write bounds = { absolute = ... }.", warning=True)
        return {"lower": lower, "upper": upper}

    def _lock(self, table: Parameter) -> Bool:
        """Return the mask of locked values; "no-data" is applied later."""
        lock = self.entry.lock
        if isinstance(lock, bool) or lock == "no-data":
            return np.full(table.values.shape, lock is True)
        locked = np.zeros(table.values.shape, dtype=bool)
        for number, part in enumerate(lock, 1):
            locked |= self._range(table, part, f"lock {number}")
        return locked

    def _unfitted(self, table: Parameter) -> Bool | bool:
        """Return the mask of values that belong to recordings which are not fitted, such as test data."""
        return ~np.isin(table.axes[0].breakpoints, self.axes.fitted_recordings) if self.entry.per else False

    def _range(self, table: Parameter, part: Range, key: str) -> Bool:
        beyond = missing_directions(table, part)
        if beyond:
            self._report(key, f"{table.name} has no axis {beyond[0]}")
            return np.zeros(table.values.shape, dtype=bool)
        inside = grid_points_within(table, part)
        if not inside.any():
            self._report(key, "no grid point is in this range", warning=True)
        return inside


def _factors(entry: ParameterEntry, table: Parameter, findings: Findings) -> tuple[Factor, ...]:
    """Return the smoothness along each axis."""
    factors = entry.smoothness
    if factors is None:
        return ()
    if not isinstance(factors, Mapping):
        return (factors,) * len(table.axes)
    known = DIRECTIONS[: len(table.axes)]
    for direction in factors:
        if direction not in known:
            message = f"{entry.name} has no axis {direction}"
            fixes = [Fix.remove(("parameters", entry.name, "smoothness", direction))]
            remedy = f"It has {', '.join(known) or 'none'}."
            findings.error(entry.location.within("smoothness"), message, remedy, fixes=fixes)
    return tuple(factors.get(direction, 0.0) for direction in known)


def _free(
    file: ProjectFile, parameters: ParameterSet, function: ProjectModel | None, findings: Findings
) -> tuple[str, ...]:
    """Return the parameters to fit, among those that the function uses."""
    used = list(function.graph.parameters) if function else list(parameters)
    chosen = set()
    place = file.location("calibration", "free")
    known = [name for name in used if name in parameters]
    for pattern in expand_lists(file.calibration.free, file.folder, parameters, known, place, findings):
        matches = {name for name in parameters if fnmatchcase(name, pattern) or name == pattern}
        chosen |= matches
        # without any parameter the default `*` matches nothing, and other findings say why there is none
        if not matches and (parameters or pattern != "*"):
            remedy = nearest(pattern, parameters) or f"The parameters are {', '.join(used[:12])}."
            fixes = _other_patterns(file, pattern, parameters)
            findings.error(place, f"{pattern} matches no parameter", remedy, fixes=fixes)
        elif matches and matches.isdisjoint(used):
            names = ", ".join(sorted(matches)[:5])
            message = f"{pattern} matches only parameters that the function does not use: {names}"
            findings.warning(place, message)
    for name, entry in file.parameters.items():
        if entry.free is not None:
            # the section of a parameter decides over the patterns
            (chosen.add if entry.free else chosen.discard)(name)
    return tuple(name for name in used if name in chosen and name in parameters)


def _other_patterns(file: ProjectFile, pattern: str, parameters: ParameterSet) -> list[Fix]:
    """Return the fixes of a pattern of `free` that matches nothing: the most similar name, or none in its place."""
    patterns, keys = list(file.calibration.free), ("calibration", "free")
    if pattern not in patterns:  # it is from a list of labels
        return []
    removal, similar = Fix.exchange(f"Remove {pattern}", keys, patterns, pattern), most_similar(pattern, parameters)
    if not similar or similar in patterns:
        return [removal]
    return [Fix.exchange(f"Write {similar}", keys, patterns, pattern, similar), removal]
