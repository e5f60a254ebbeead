"""Preparation of a problem whose end is rounded: its grids, and breakpoints that can be stored."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.free_axes import AxisKey, key_of, with_breakpoints
from kennfeld.domain.storage import RoundingMethod, StorageGrid, StorageRounding, storage_findings
from kennfeld.optimize.problem.problem import Problem

if TYPE_CHECKING:
    from kennfeld.calfiles.a2l.objects import A2l

Storage = Union[str, Path, "A2l"]  # an A2L file, or its content


def rounding_of(
    method: RoundingMethod,
    storage: Storage | None,
    steps: Mapping[str, float],
    max_shift: float,
    axes: Mapping[AxisKey, float] | None = None,
) -> StorageRounding:
    """Return the rounding to the storage of an A2L file, or to steps, which precede it.

    Args:
        method: "joint" or "nearest".
        storage: the file, or its content.
        steps: by parameter, in its unit.
        max_shift: the largest distance from the fit, in steps.
        axes: steps of breakpoints by axis, in its unit.

    Raises:
        InputError: the file cannot be read.
        ArgumentError: an unknown method, or a step or a shift that cannot be used.
    """
    rounding = StorageRounding(method, max_shift=max_shift)
    if storage is not None:
        from kennfeld.calfiles.a2l.storage_grids import storage_grids

        a2l = _described(storage)
        grids, name = storage_grids(a2l), a2l.file
        unrounded = {label: f"it {reason} in {name}" for label, reason in grids.unrounded.items()}
        rounding = replace(
            rounding,
            grids=grids.labels,
            axes=grids.axes,
            floats=grids.floats,
            unrounded=unrounded,
            source=name,
        )
    return rounding.with_steps(steps, axes)


def _described(storage: Storage) -> "A2l":
    if not isinstance(storage, str | Path):
        return storage
    from kennfeld.calfiles import describe_a2l

    return describe_a2l(storage).a2l


def with_rounding(
    problem: Problem, rounding: StorageRounding, locate: Callable[[str], Location]
) -> tuple[Problem, list[Finding]]:
    """Return the problem with its rounding and storable breakpoints.

    Args:
        problem: the problem.
        rounding: method and grids.
        locate: returns the location of a parameter in messages.

    Returns:
        The problem, and what cannot be rounded or was changed.
    """
    names = [name for name in problem.free_names if name in problem.parameters]
    rounding = replace(rounding, axes={**rounding.axes, **_group_grids(problem, rounding)})
    findings = list(storage_findings(problem.parameters, rounding, names, locate))
    points, axis_findings = _storable_breakpoints(problem, rounding, names, locate)
    parameters = with_breakpoints(problem.parameters, points)
    rounded = replace(problem, parameters=parameters, rounding=rounding)
    return rounded, [*findings, *axis_findings, *_pins(rounded, rounding, locate)]


def _pins(problem: Problem, rounding: StorageRounding, locate: Callable[[str], Location]) -> Iterator[Finding]:
    """Yield a warning on each pin of a grid point to a value between two steps."""
    for pin in problem.pins:
        grid, axes = rounding.grids.get(pin.parameter), problem.parameters[pin.parameter].index_axes
        # between grid points, several values meet a pin together
        on_grid = all(x in axis.breakpoints for x, axis in zip(pin.at, axes, strict=False))
        if grid is not None and on_grid and not grid.holds(np.array(pin.value)):
            at = f" at {', '.join(f'{x:g}' for x in pin.at)}" if pin.at else ""
            nearest = float(grid.nearest(np.array(pin.value)))
            message = f"the pin of {pin.parameter}{at} to {pin.value:g} lies between two steps of {grid.step:g}"
            remedy = f"Pin a storable value, such as {nearest:.6g}."
            yield Finding(locate(pin.parameter), message, remedy, severity="warning")


def _storable_breakpoints(
    problem: Problem, rounding: StorageRounding, names: Iterable[str], locate: Callable[[str], Location]
) -> tuple[dict[AxisKey, Float], list[Finding]]:
    """Return the breakpoints of free tables that storage changes, rounded before the fit, which then allows for it."""
    points: dict[AxisKey, Float] = {}
    findings = []
    for key, table, breakpoints in _axes(problem, names):
        grid = rounding.axes.get(key)
        if grid is None or key in points or grid.holds(breakpoints).all():
            continue
        rounded, nearest = grid.increasing(breakpoints), grid.nearest(breakpoints)
        if np.abs(rounded - breakpoints).max() > rounding.max_shift * grid.step or np.any(np.diff(rounded) <= 0):
            if np.any(np.diff(nearest) <= 0):
                findings.append(_merging(key, grid, breakpoints, nearest, locate(table)))
                continue
            rounded = nearest
        points[key] = rounded
        if np.any(np.diff(nearest) <= 0):
            findings.append(_parted(key, grid, breakpoints, nearest, rounded, locate(table)))
            continue
        changed = np.flatnonzero(rounded != breakpoints)
        example = f"{breakpoints[changed[0]]:.6g} to {rounded[changed[0]]:.6g}"
        count = count_noun(changed.size, "breakpoint")
        message = f"{count} of {key} rounded to the step of {grid.step:g} before the fit, such as {example}"
        findings.append(Finding(locate(table), message, severity="remark"))
    return points, findings


def _axes(problem: Problem, names: Iterable[str]) -> Iterator[tuple[AxisKey, str, Float]]:
    for name in names:
        for direction, axis in enumerate(problem.parameters[name].axes):
            yield key_of(problem.parameters[name], direction), name, axis.breakpoints


def _group_grids(problem: Problem, rounding: StorageRounding) -> dict[AxisKey, StorageGrid]:
    """Return the grids of group axes that the file knows as an axis of one of their tables only."""
    grids: dict[AxisKey, StorageGrid] = {}
    for name, table in problem.parameters.items():
        for direction, letter in zip(range(len(table.axes)), AXIS_LETTERS, strict=False):
            key, own = key_of(table, direction), AxisKey(name, letter)
            if key not in rounding.axes and own in rounding.axes:
                grids.setdefault(key, rounding.axes[own])
    return grids


def _parted(
    key: AxisKey, grid: StorageGrid, points: Float, nearest: Float, rounded: Float, location: Location
) -> Finding:
    """Return a warning on neighbours that were moved apart because storage does not tell them apart."""
    at = int(np.flatnonzero(np.diff(nearest) <= 0)[0])
    message = (
        f"breakpoints {points[at]:g} and {points[at + 1]:g} of {key} would be stored as one with its step of "
        f"{grid.step:g}: they were moved to {rounded[at]:.6g} and {rounded[at + 1]:.6g} before the fit"
    )
    return Finding(location, message, "Remove one of them, or choose others.", severity="warning")


def _merging(key: AxisKey, grid: StorageGrid, points: Float, rounded: Float, location: Location) -> Finding:
    """Return an error on neighbours that storage cannot tell apart."""
    at = int(np.flatnonzero(np.diff(rounded) <= 0)[0])
    message = (
        f"breakpoints {points[at]:g} and {points[at + 1]:g} of {key} are stored as one: "
        f"its step is {grid.step:g}, {rounded[at]:g} the nearest to both, and too few storable values are near"
    )
    return Finding(location, message, "Remove one of them, or move it.")
