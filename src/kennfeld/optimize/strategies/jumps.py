"""Jumps of a function whose time depends on free values: what derivatives do not see of the cost of a problem."""

from collections.abc import Iterator, Sequence
from pathlib import PurePath

from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.graph.events import Event, events
from kennfeld.optimize.problem.problem import Problem

FEW = 30  # values up to which a search without gradients is a good idea
MAX_EVENTS = 4  # in a warning
MAX_NAMES = 5  # of parameters in a warning


def jumps_of(problem: Problem) -> tuple[Event, ...]:
    """Return the discontinuities that a criterion feels and whose time depends on free values."""
    return problem.once("jumps", _jumps_of)  # the search for them evaluates the function many times


def _jumps_of(problem: Problem) -> tuple[Event, ...]:
    return problem.model.once(
        "jumps",
        problem.structure and (problem.structure, problem.free_names),
        lambda: events(problem.graph, problem.free_names, problem.differences),
    )


def find_jumps(problem: Problem, option: str = "") -> Iterator[Finding]:
    """Yield one warning if derivatives do not account for jumps of the function.

    Args:
        problem: what is fitted.
        option: written before `method` in the remedy, such as the name of a section.
    """
    jumps = jumps_of(problem)
    if not jumps:
        return
    model = problem.model
    located = (model.locations[event.name] for event in jumps if event.name in model.locations)
    place = next(located, Location.of_file(model.source))
    names = dict.fromkeys(name for event in jumps for name in event.parameters)
    listed = join_names(list(names), MAX_NAMES)
    written = PurePath(place.file).suffix in ("", ".kf")  # else the operators are not those of the source
    message = f"{describe_events(jumps, operators=written)} depending on {listed}; derivatives do not account for that"
    yield Finding(place, message, global_search_remedy(problem, list(names), option), severity="warning")


def global_search_remedy(problem: Problem, names: Sequence[str], option: str = "") -> str:
    """Return the advice to search for parameters without derivatives; for `option` see `find_jumps`."""
    values = sum(problem.parameters[name].size for name in names)
    few = f"Free up to {FEW} values, and write" if values > FEW else "Write"
    return (
        f'{few} {option}method = "global", and bounds for {join_names(names, MAX_NAMES) if values <= FEW else "them"}.'
    )


def describe_events(jumps: Sequence[Event], *, operators: bool = True) -> str:
    """Return a clause on the events, such as `turned (floor) and fires (>) jump`.

    Without `operators`, those of formula text are left out: the source is in another language.
    """
    words: dict[str, list[str]] = {}
    for event in jumps:
        name = event.name if event.name.isprintable() else ""
        words.setdefault(name or "a node without a name", []).append(event.word)
    shown = [
        f"{name} ({', '.join(dict.fromkeys(own))})" if operators else name
        for name, own in list(words.items())[:MAX_EVENTS]
    ]
    if len(words) > MAX_EVENTS:
        shown.append(f"{len(words) - MAX_EVENTS} more")
    return f"{', '.join(shown[:-1])} and {shown[-1]} jump" if len(shown) > 1 else f"{shown[0]} jumps"
