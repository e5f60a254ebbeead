"""Findings about costs that jump: derivatives do not describe them, so a descent ends where it cannot see further."""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Int
from kennfeld.errors import Finding, Location
from kennfeld.formatting import join_names
from kennfeld.graph.events import Event, events, switching_parameters
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.projection import FEASIBLE
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.global_search import FEW

MAX_EVENTS = 4  # in a warning
MAX_NAMES = 5  # of parameters in a warning
STEPS = (0.01, 0.1, 0.5)  # of a value without a slope, relative to its size
MAX_VALUES = 16  # whose steps are tried
CHANGED = 1e-9  # of a cost: less is rounding


def jump_finding(problem: Problem, jumps: Sequence[Event]) -> Finding:
    """Return the warning that derivatives do not account for events of the model."""
    model = problem.model
    located = (model.locations[event.name] for event in jumps if event.name in model.locations)
    place = next(located, Location(model.source))
    names = list(dict.fromkeys(name for event in jumps for name in event.parameters))
    message = (
        f"{describe_events(jumps)} depending on {join_names(names, MAX_NAMES)}; derivatives do not account for that"
    )
    return Finding(place, message, global_search_remedy(problem, names), severity="warning")


def global_search_remedy(problem: Problem, names: Sequence[str]) -> str:
    """Return the advice to search for these parameters without derivatives."""
    values = sum(problem.parameters[name].size for name in names)
    few = f"Free up to {FEW} values, and write" if values > FEW else "Write"
    bounded = join_names(names, MAX_NAMES) if values <= FEW else "them"
    return f'{few} [optimizer] method = "global", and bounds for {bounded}.'


def describe_events(jumps: Sequence[Event]) -> str:
    """Return a clause on the events, such as `turned (floor) and fires (>) jump`."""
    words: dict[str, list[str]] = {}
    for event in jumps:
        name = event.name if event.name.isprintable() else ""
        words.setdefault(name or "a node without a name", []).append(event.word)
    shown = [f"{name} ({', '.join(dict.fromkeys(own))})" for name, own in list(words.items())[:MAX_EVENTS]]
    if len(words) > MAX_EVENTS:
        shown.append(f"{len(words) - MAX_EVENTS} more")
    return f"{', '.join(shown[:-1])} and {shown[-1]} jump" if len(shown) > 1 else f"{shown[0]} jumps"


def find_jumps(
    compiled: CompiledProblem, objective: LeastSquaresObjective, end: SolverResult, limits: LinearLimits
) -> list[Finding]:
    """Return a warning if the cost depends on values that have no slope at the end of a descent."""
    problem = compiled.problem
    switching = switching_parameters(problem.graph, problem.free_names, problem.differences)
    owners = {place: name for name in switching for place in _places(compiled, name) if limits.movable[place]}
    places = np.array(sorted(owners), dtype=np.int64)
    if not places.size:
        return []
    places = places[~objective.informed(end.values)[places]]
    moving = {owners[place] for place in _jumping(objective, end, limits, places)}
    found = events(problem.graph, problem.free_names, problem.differences) if moving else ()
    jumps = [event for event in found if not moving.isdisjoint(event.parameters)]
    return [jump_finding(problem, jumps)] if jumps else []


def _places(compiled: CompiledProblem, name: str) -> range:
    """Return the places of the values of a free parameter."""
    first = compiled.values.offsets[name]
    return range(first, first + compiled.problem.parameters[name].size)


def _jumping(objective: LeastSquaresObjective, end: SolverResult, limits: LinearLimits, places: Int) -> list[int]:
    """Return the places of the values whose steps change the cost although they have no slope."""
    allowed = max(limits.violation(end.values), FEASIBLE)
    jumping = []
    for place in places[:MAX_VALUES].tolist():
        for step in (sign * share for share in STEPS for sign in (1, -1)):
            trial = end.values.copy()
            trial[place] += step * (abs(trial[place]) or 1.0)
            trial = limits.clip(trial)
            changes = limits.violation(trial) <= allowed and abs(objective.cost(trial) - end.cost) > CHANGED * end.cost
            if changes:
                jumping.append(place)
                break
    return jumping
