"""Checks of a set before it is written, which several formats share."""

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

USE_JSON = "Write it as .json."


def report_repeated(
    names: Iterable[str],
    findings: FileFindings,
    message: str = "is defined twice",
    remedy: str = "Rename one of the two.",
) -> None:
    """Add an error for each name that occurs more than once."""
    for name, count in Counter(names).items():
        if count > 1:
            findings.error(0, name, message, remedy)


def report_repeated_variables(parameters: ParameterSet, findings: FileFindings) -> list[str]:
    """Add an error for each name used twice in a format with one namespace; return all names."""
    names = [item.name for item in (*parameters.chosen, *parameters.axes)]
    message = "is defined twice; parameters, texts and group axes share one namespace"
    report_repeated(names, findings, message, "Rename one.")
    return names


def value_faults(member: Parameter, format_name: str) -> Iterator[str]:
    """Yield why a format without expansions, empty blocks and non-finite numbers cannot store a parameter."""
    if member.kind == "rbf":
        yield f"{format_name} cannot store a radial basis function expansion"
    elif member.size == 0:
        yield f"{format_name} cannot store an empty block"
    elif not np.isfinite(member.values).all():
        yield f"{format_name} cannot store non-finite values"


def differing_groups(member: Parameter, parameters: ParameterSet) -> list[str]:
    """Return the group axes that have other breakpoints in a variant than in the set, which a file holds once."""
    groups = {axis.name: axis.breakpoints for axis in parameters.axes}
    return [
        axis.name
        for axis in member.axes
        if axis.name and not np.array_equal(axis.breakpoints, groups.get(axis.name, ()))
    ]
