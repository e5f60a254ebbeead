"""Free breakpoints in a project file: the keys of an axis that say so, and what is wrong with axes that move."""

from collections.abc import Iterator

import numpy as np

from kennfeld.errors import ArgumentError, Finding
from kennfeld.graph.free_axes import AxisKey
from kennfeld.optimize.free_axes.breakpoints import bounds_of, left_behind
from kennfeld.optimize.problem import Problem
from kennfeld.parameters import Axis
from kennfeld.project.schema import AxisEntry, ProjectFile

__all__ = ["check_free_axes", "made_free"]


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
        for finding in left_behind({key: axis}, problem.free_names):
            yield Finding(_place(file, key), finding.what, finding.mend)
        lower, upper = bounds_of(axis, problem.parameters, problem.held)
        if np.array_equal(lower, upper):
            what = f"no breakpoint of {key} can move: its ends stay, and so do those at locks and pins"
            yield Finding(_place(file, key), what, "Give it more breakpoints, or a range.", severity="warning")
    for key in problem.idle_axes:
        what = f"the breakpoints of {key} are free, but no table on it is fitted"
        yield Finding(_place(file, key), what, "Free a table on it.", severity="warning")


def _place(file: ProjectFile, key: AxisKey) -> str:
    return file.place(f"[parameters.{key.owner}] {key.direction}" if key.direction else f"[axes.{key.owner}]")
