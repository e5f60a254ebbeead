"""Whether the method of the optimizer suits the problem."""

from collections.abc import Collection, Sequence

import numpy as np

from kennfeld.errors import Finding
from kennfeld.graph.events import Event, events
from kennfeld.optimize import Problem
from kennfeld.optimize.problem import difference
from kennfeld.optimize.search.global_search import FEW, unbounded
from kennfeld.project.schema import ProjectFile

__all__ = ["event_warning", "listed", "method_findings"]

_NAMED = 4  # events that a warning names
_SHOWN = 6  # and parameters


def method_findings(file: ProjectFile, problem: Problem) -> list[Finding]:
    """What a global search lacks: bounds; and a warning where it has too many values to search."""
    if file.optimizer.method != "global":
        return []
    found = unbounded(problem, lambda name: file.place(f"[parameters.{name}] bounds"))
    values = sum(int(np.count_nonzero(~problem.parameters[name].locked)) for name in problem.free_names)
    if values > FEW:
        what = f"{values} values are many for a search without gradients, which suits up to {FEW}"
        mend = "Free fewer, use fewer breakpoints, or raise max_evaluations."
        found.append(Finding(file.place("[optimizer] method"), what, mend, severity="warning"))
    return found


def event_warning(file: ProjectFile, problem: Problem) -> list[Finding]:
    """A warning where a descent follows derivatives that are blind to events of the model; one for all of them."""
    if file.optimizer.method == "global":
        return []
    outputs = [difference(i) for i in range(len(problem.criteria))]
    found = events(problem.graph, problem.free_names, outputs)
    if not found:
        return []
    model = problem.model
    place = next((model.places[event.name] for event in found if event.name in model.places), model.source)
    names = dict.fromkeys(name for event in found for name in event.parameters)
    decide = "decides" if len(names) == 1 else "decide"
    what = f"{listed(found)} when {_some(names)} {decide}, and derivatives do not see that"
    values = sum(problem.parameters[name].size for name in names)
    few = f"Free up to {FEW} values, and write" if values > FEW else "Write"
    mend = f'{few} [optimizer] method = "global", and bounds for {_some(names) if values <= FEW else "them"}.'
    return [Finding(place, what, mend, severity="warning")]


def _some(names: Collection[str]) -> str:
    shown = list(names) if len(names) <= _SHOWN else list(names)[: _SHOWN - 1]
    return ", ".join(shown) + (f" and {len(names) - len(shown)} more" if len(shown) < len(names) else "")


def listed(found: Sequence[Event]) -> str:
    """The events in words: `turned (floor) and fires (>) jump`."""
    words: dict[str, list[str]] = {}
    for event in found:
        name = event.name if event.name.isprintable() else ""
        words.setdefault(name or "a node without a name", []).append(event.word)
    shown = [f"{name} ({', '.join(dict.fromkeys(own))})" for name, own in list(words.items())[:_NAMED]]
    if len(words) > _NAMED:
        shown.append(f"{len(words) - _NAMED} more")
    return f"{', '.join(shown[:-1])} and {shown[-1]} jump" if len(shown) > 1 else f"{shown[0]} jumps"
