"""The criteria of a project: nodes that are there, targets told apart, nothing twice."""

from collections.abc import Sequence

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, nearest
from kennfeld.optimize import Criterion, Region, Target
from kennfeld.project.function import Function
from kennfeld.project.loading import Loaded
from kennfeld.project.schema import CriterionEntry, ProjectFile

__all__ = ["build_criteria"]


def build_criteria(
    file: ProjectFile, function: Function | None, loaded: Loaded, findings: list[Finding]
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
            what = f"{entry.node} against {target} stands already in {first[key]}"
            findings.append(Finding(entry.place, what, "Remove one, or add their weights."))
        first.setdefault(key, entry.place)
        made.append(criterion)
    if file.criteria and all(entry.weight == 0 for entry in file.criteria):
        findings.append(Finding(file.place("[[criterion]]"), "every weight is 0", "Give one a weight above 0."))
    return tuple(made)


def _target(
    entry: CriterionEntry, file: ProjectFile, function: Function | None, loaded: Loaded, findings: list[Finding]
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
        what = f"{given.name} is a channel of the data and a node of the function; the channel is taken"
        mend = f'Write {{ channel = "{given.name}" }} or {{ node = "{given.name}" }}.'
        findings.append(Finding(f"{entry.place} target", what, mend, severity="warning"))
    if having:
        findings += _partly(entry, file.criteria, loaded.datasets)
    elif loaded.complete and loaded.datasets:
        names = {**loaded.offered, **dict.fromkeys(n for data in loaded.datasets for n in data)}
        candidates = [*names, *nodes] if given.kind == "name" else list(names)
        what = f"{given.name} is no channel of the data" + (" and no node" if given.kind == "name" else "")
        mend = nearest(given.name, candidates) or f"They have {', '.join(list(names)[:8])}."
        findings.append(Finding(f"{entry.place} target", what, mend))
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
