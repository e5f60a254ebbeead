"""What a project file says about single samples: their weights, and how long points are held."""

from contextlib import suppress

from kennfeld.errors import Finding, InputError
from kennfeld.graph import Graph
from kennfeld.models.formula import expression
from kennfeld.optimize import Problem
from kennfeld.optimize.data.settling import hold_of, is_settled
from kennfeld.optimize.data.weighting import weight_findings
from kennfeld.project.loading import Loaded
from kennfeld.project.schema import ProjectFile

__all__ = ["sample_findings", "settling_findings", "weight_channels"]

_MOST = 100_000_000  # samples made of points; each takes 8 bytes a channel


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


def settling_findings(graph: Graph, loaded: Loaded) -> list[Finding]:
    """What is wrong with the holding of steady-state points."""
    found = []
    for data in loaded.datasets:
        if data.settling is None:
            continue
        place = loaded.places[data.name]
        if not is_settled(data, graph):
            what = "the function has no memory, so that its points need not be held"
            found.append(Finding(f"{place} settle", what, "Remove settle.", severity="warning"))
        elif data.settling.step is None:
            what = "the points are held, but no step of the model is given"
            found.append(Finding(f"{place} step", what, "Write step = ... in s, here or in [model]."))
        elif (total := data.samples * (each := hold_of(data, data.settling, None).samples)) > _MOST:
            what = f"{data.samples} points of {each} samples each are {total} samples, too many for memory"
            found.append(Finding(f"{place} settle", what, "Shorten settle, or take a larger step."))
    return found
