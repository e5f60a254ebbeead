"""The weights of single samples, as a project file gives them."""

from contextlib import suppress

from kennfeld.errors import Finding, InputError
from kennfeld.models.formula import expression
from kennfeld.optimize import Problem
from kennfeld.optimize.weighting import weight_findings
from kennfeld.project.loading import Loaded
from kennfeld.project.schema import ProjectFile

__all__ = ["sample_findings", "weight_channels"]


def weight_channels(file: ProjectFile) -> dict[str, str]:
    """The channels that criteria weigh their samples by, each with what it is for."""
    found = {}
    for entry in file.criteria:
        if entry.weight_channel:
            found[entry.weight_channel] = f"the weights of {entry.place}"
        for region in entry.regions:
            with suppress(InputError):  # reported with the other findings about weights
                found |= dict.fromkeys(expression(region.where, "").inputs, f"a region of {entry.place}")
    return found


def sample_findings(file: ProjectFile, problem: Problem, loaded: Loaded) -> list[Finding]:
    """What is wrong with the weights of single samples."""
    training = [data for data in problem.datasets if data.use == "training" and data.weight > 0]
    return weight_findings(
        problem.criteria,
        training,
        lambda number: file.criteria[number].place,
        lambda data: loaded.places[data.name],
        list(loaded.offered),
    )
