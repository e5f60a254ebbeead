"""Proposals: keys that the function needs and the project lacks, added so that the project can be evaluated."""

from collections.abc import Mapping, Sequence
from typing import Any

from kennfeld.app.answer import finite
from kennfeld.app.questions.recordings import channel_ranges
from kennfeld.app.session.initial_files import initial_names
from kennfeld.app.session.proposal import POINTS, KeyChoice, Proposal, even_breakpoints, propose
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.app.session.trial import Trial, try_out
from kennfeld.app.wire import KeyChange
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.formula import declared_inputs
from kennfeld.project.value_forms import DIRECTIONS

Changes = list[tuple[tuple[str | int, ...], Any]]


@dataclass(frozen=True)
class ProposalRow:
    """Something that the project lacks, with the keys that provide it; one of them may be chosen."""

    title: str
    changes: Sequence[KeyChange]
    choice: KeyChoice | None


@dataclass(frozen=True)
class ProposalRows:
    """Proposals for all that the project lacks, and why its initial files say nothing about some of it."""

    proposals: Sequence[ProposalRow]
    problems: Sequence[str] = ()


@dataclass(frozen=True)
class AddedProposals:
    """Proposals that are added, by title, with what was chosen for those that have a choice."""

    titles: Sequence[str]
    choices: Mapping[str, str]


@dataclass(frozen=True)
class AddedReply:
    """The state of the project after proposals were added.

    Attributes:
        rmse: error of the first criterion on training data; null if the project still lacks something.
        unit: of the error.
        problems: what it lacks.
    """

    rmse: float | None
    unit: str
    problems: Sequence[str]


def proposals(session: Session) -> ProposalRows:
    """Return what the function needs and the project lacks, with the keys that provide it."""
    problems = initial_names(session.settings, session.path).findings
    rows = [ProposalRow(each.title, each.changes, each.choice) for each in _proposals(session)]
    return ProposalRows(rows, list(map(str, problems)))


def _proposals(session: Session) -> list[Proposal]:
    function = session.function
    if function is None:
        return []
    file = session.formula_file
    # inputs of functions of other tools are what their files say
    declared = declared_inputs(session.text_of(file)) if file else function.graph.inputs
    return list(propose(function, session.settings, session.initial_names, channel_ranges(session), declared))


def add_proposals(session: Session, asked: AddedProposals) -> AddedReply:
    """Add proposals as one change: axes over inner nodes and starts come from a trial evaluation."""
    known = {each.title: each for each in _proposals(session)}
    if missing := [title for title in asked.titles if title not in known]:
        raise ArgumentError(f"there is no proposal {missing[0][:100]!r} any more")
    changes: Changes = []
    for title in asked.titles:
        changes += _changes(known[title], asked.choices.get(title, ""))
    trial = _trial(session, changes)
    title = f"Added: {asked.titles[0]}" if len(asked.titles) == 1 else f"Added {len(asked.titles)} proposals"
    session.do(SetKeys(title, session.path.name, _completed(changes, trial)))
    return _outcome(session)


def _changes(own: Proposal, choice: str) -> Changes:
    if own.choice is None:
        return list(own.changes)
    if choice not in own.choice.options:
        raise ArgumentError(f"{own.title}: choose one of {', '.join(own.choice.options[:10])}")
    return [*((path, value) for path, value in own.changes if path != own.choice.path), (own.choice.path, choice)]


def _trial(session: Session, changes: Changes) -> Trial | None:
    """Evaluate the project with what is added; None if it still lacks something."""
    names = [str(path[1]) for path, _ in changes if path[0] == "parameters" and len(path) == 2]
    if not names:
        return None
    try:
        return try_out(session.read_trial(SetKeys("", session.path.name, changes)).problem(), names)
    except InputError:
        pass
    # without a criterion, the nodes can be evaluated all the same
    function, channels = session.function, list(channel_ranges(session))
    if function is None or not channels or session.settings.get("criterion"):
        return None
    node = (function.graph.outputs or tuple(function.graph.names))[-1]
    assumed = [*changes, (("criterion", 1), {"node": node, "target": {"channel": channels[0]}})]
    try:
        problem = session.read_trial(SetKeys("", session.path.name, assumed)).problem()
        return try_out(problem, names, fitted=False)
    except InputError:
        return None


def _completed(changes: Changes, trial: Trial | None) -> Changes:
    """Return the changes with the starts, the axes over inner nodes and the smoothness that a trial found."""
    if trial is None:
        return changes
    completed: Changes = []
    for path, value in changes:
        name = str(path[-1])
        if path[0] != "parameters" or name not in trial.levels:
            completed.append((path, value))
            continue
        level = trial.levels[name]
        entry = {**value, "initial": int(level) if level.is_integer() else level}
        if name in trial.smoothness:
            entry["smoothness"] = trial.smoothness[name]
        ranges = trial.ranges.get(name, ())
        for direction, reach in zip(DIRECTIONS, ranges, strict=False):
            axis = entry.get(direction)
            if isinstance(axis, dict) and "breakpoints" not in axis and reach is not None:
                kept = {key: own for key, own in axis.items() if key == "input"}
                entry[direction] = {**kept, "breakpoints": even_breakpoints(reach, POINTS[len(ranges)])}
        completed.append((path, entry))
    return completed


def _outcome(session: Session) -> AddedReply:
    if session.stale or session.view is None:
        return AddedReply(None, "", [str(finding) for finding in session.findings if finding.severity == "error"])
    score = next((each for each in session.view.now.scores if each.use == "training" and each.samples), None)
    unit = session.view.model.unit(0) if session.view.model.problem.criteria else ""
    return AddedReply(None if score is None else finite(score.rmse), unit, [])
