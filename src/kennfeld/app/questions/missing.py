"""Missing terms: what is looked for, what was found, its picture and its change of the formula; terms are applied."""

from collections.abc import Sequence
from difflib import SequenceMatcher
from glob import escape

import numpy as np

from kennfeld.analysis.missing.picture import value_unit
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.analysis.missing.proposal import RmseChange, TermProposal
from kennfeld.analysis.missing.proposing import SearchScope
from kennfeld.analysis.missing.recordings import can_be_numbered
from kennfeld.analysis.missing.scoring import is_timed
from kennfeld.analysis.missing.terms import FORMS, OF_CHANNELS, Form, Kind, describe
from kennfeld.app.answer import finite, finite_list
from kennfeld.app.questions.recordings import channel_ranges, recorded_channels
from kennfeld.app.session.session import Session
from kennfeld.app.session.term_search import (
    TermFindings,
    adopt_stored,
    apply_term,
    picture_of,
    proposal_at,
    start_search,
    term_patch,
)
from kennfeld.base.arrays import Float
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.recording_sources import recording_files
from kennfeld.project.missing_terms import channels_of_file, offered_channels, sentence

CONTEXT = 1  # lines around a change


@dataclass(frozen=True)
class TermChannel:
    """A channel of the recordings; `reason` says why it takes no part, as a clause."""

    name: str
    unit: str
    reason: str


@dataclass(frozen=True)
class TermKind:
    """A kind of terms, with the number of nodes at which it is tried; 0 if the data have no time, or few recordings."""

    name: Form
    places: int


@dataclass(frozen=True)
class BeforeAfter:
    """An RMSE without a term and with it."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class PlaceRow:
    """A node at which a term explains as much as at the one that is proposed; `number` names it in questions."""

    number: int
    node: str
    kind: Kind
    change: str


@dataclass(frozen=True)
class HeldOutRow:
    """The errors on a part of the data that was held out."""

    name: str
    samples: int
    rmse: BeforeAfter


@dataclass(frozen=True)
class TermRow:
    """A proposal.

    Attributes:
        change: in words.
        explains: root of the difference of the squared errors on held-out data.
        held_name: what was held out.
        better: held-out parts that the term makes better, of `parts`.
        values: number of values of the term.
        second: the second channel of a map.
        ends: the first and the last breakpoint of a curve, each with its value.
        places: others that the data cannot distinguish from it.
        location: of the node in the source of the function.
    """

    change: str
    node: str
    kind: Kind
    channel: str
    second: str
    training: BeforeAfter
    held_out: BeforeAfter
    held_name: str
    test: BeforeAfter | None
    explains: float | None
    better: int
    parts: int
    values: int
    ends: Sequence[tuple[float, float]]
    places: Sequence[PlaceRow]
    held_out_parts: Sequence[HeldOutRow]
    location: str


@dataclass(frozen=True)
class FoundTerms:
    """The outcome of a search.

    Attributes:
        old: true if values, function or data have changed since.
        message: the verdict, a sentence.
        smallest: RMSE of the smallest effect that would have been detected.
        stopped: candidates that were fitted, and all that were to be; null if the search has ended.
        rejected: candidates that are not proposed, in words.
        excluded: channels that took no part, with the reason.
    """

    old: bool
    status: str
    message: str
    smallest: float | None
    unit: str
    candidates: int
    stopped: tuple[int, int] | None
    proposals: Sequence[TermRow]
    rejected: Sequence[str]
    excluded: Sequence[tuple[str, str]]
    remarks: Sequence[str]
    seconds: float


@dataclass(frozen=True)
class MissingTerms:
    """Candidates for a search, and the outcome of the last one.

    Attributes:
        node: of the first criterion.
        nodes: those that can take part.
        found: null if none has found anything yet.
    """

    node: str
    unit: str
    channels: Sequence[TermChannel]
    kinds: Sequence[TermKind]
    nodes: Sequence[str]
    found: FoundTerms | None


@dataclass(frozen=True)
class TermQuestion:
    """The scope of a search; null for all.

    Attributes:
        least: effect that a proposal must explain on held-out data, in the unit of the target.
    """

    channels: Sequence[str] | None = None
    nodes: Sequence[str] | None = None
    kinds: Sequence[Form] | None = None
    least: float = 0.0


@dataclass(frozen=True)
class AskedTerm:
    """A proposal, from 0, at its best place or at an equal one, from 0."""

    number: int
    place: int | None = None


@dataclass(frozen=True)
class ChangedLine:
    """A line of a changed text; `sign` is `+`, `-` or a space, `line` its number before or after, 0 for a gap."""

    sign: str
    line: int
    text: str


@dataclass(frozen=True)
class ChangedFile:
    """The change of a file."""

    file: str
    lines: Sequence[ChangedLine]


@dataclass(frozen=True, eq=False)
class ShownTerm:
    """A proposal in detail.

    Attributes:
        parameter: name of the new parameter; empty for a delay.
        input: the channel, with its unit in `input_unit`.
        second: the second channel of a map, with its unit in `second_unit`.
        points: breakpoints of a curve, or of the first channel of a map.
        second_points: those of the second channel.
        now: the values, of a map row by row, one for each of `points`; the time constant of a lag.
        deviation: standard deviation of each; null if nothing determines one.
        value_unit: of the values and their deviations; empty for a factor.
        neutral: the value without effect.
        fitted: false at an equal place, where the values are those without effect.
        criterion: node whose errors are drawn.
        unit: of the errors.
        counts: samples by bin of the channel.
        files: what changes; empty if the function has changed since.
        text: the term as a line of formula text, for a function that is not.
        reason: why it cannot be written; empty if it can.
        edges: of the bins.
        before: mean error by bin without the term.
        after: with it.
        x: channel of some samples.
        error: their errors without the term.
    """

    parameter: str
    input: str
    input_unit: str
    second: str
    second_unit: str
    points: Sequence[float]
    second_points: Sequence[float]
    now: Sequence[float]
    deviation: Sequence[float | None]
    value_unit: str
    neutral: float
    fitted: bool
    criterion: str
    unit: str
    counts: Sequence[int]
    files: Sequence[ChangedFile]
    text: str
    reason: str
    edges: Float
    before: Float
    after: Float
    x: Float
    error: Float


@dataclass(frozen=True)
class AppliedTerm:
    """The title of the command that applied a term."""

    title: str


def missing(session: Session) -> MissingTerms:
    """Return what takes part in a search, and what the last one has found."""
    adopt_stored(session)
    view, work = session.require_view(), session.term_search
    problem = view.model.problem
    nodes = Nodes.of(problem).names
    timed = is_timed(problem)
    kinds = [TermKind(kind, len(nodes) if _is_possible(kind, problem, timed=timed) else 0) for kind in FORMS]
    findings: TermFindings | None = work.outcome
    return MissingTerms(
        node=problem.criteria[0].node if problem.criteria else "",
        unit=view.model.unit(0) if problem.criteria else "",
        channels=_channels(session),
        kinds=kinds,
        nodes=nodes,
        found=None if findings is None else _found(findings, old=work.subject != session.subject, seconds=work.seconds),
    )


def _is_possible(kind: Form, problem: Problem, *, timed: bool) -> bool:
    if kind == "offset":
        return can_be_numbered(problem)
    return timed or kind in (*OF_CHANNELS, "map")


def _channels(session: Session) -> list[TermChannel]:
    view, project = session.require_view(), session.project
    assert project is not None
    problem = view.model.problem
    ranges, units = channel_ranges(session), _channel_units(session)
    targets = {criterion.target.name for criterion in problem.criteria if criterion.target.kind != "number"}
    known = [name for data in problem.datasets if data.use == "training" for name in data]
    rows = []
    for name in dict.fromkeys([*known, *offered_channels(project, _channels_of_file)]):
        reach = ranges.get(name)
        constant = reach is not None and reach.least == reach.greatest
        reason = "the target" if name in targets else "constant" if constant else ""
        rows.append(TermChannel(name, units.get(name, ""), reason))
    return rows


def _channel_units(session: Session) -> dict[str, str]:
    """Return the units of all channels of the recordings; those of the problem are as its settings state them."""
    view, project = session.require_view(), session.project
    assert project is not None
    units = {channel.name: channel.unit for data in view.model.problem.datasets for channel in data.channels}
    for number in range(len(project.file.datasets)):
        units |= {name: unit for name, unit in recorded_channels(session, number).items() if name not in units}
    return units


@while_unchanged(256)
def _channels_of_file(path: str) -> list[str]:
    for file in recording_files(path):
        note_opened(file)
    return channels_of_file(path)


def _found(findings: TermFindings, *, old: bool, seconds: float) -> FoundTerms:
    outcome = findings.found
    return FoundTerms(
        old=old,
        status=outcome.status,
        message=outcome.message,
        smallest=finite(outcome.smallest_effect),
        unit=outcome.unit,
        candidates=outcome.candidates,
        stopped=findings.stopped,
        proposals=[_row(proposal) for proposal in outcome.proposals],
        rejected=outcome.rejected,
        excluded=list(outcome.excluded.items()),
        remarks=outcome.remarks,
        seconds=seconds,
    )


def _row(own: TermProposal) -> TermRow:
    term = own.term
    return TermRow(
        change=own.change,
        node=term.node,
        kind=term.kind,
        channel=term.channel,
        second=term.second,
        training=_change(own.rmse),
        held_out=_change(own.held_out),
        held_name=own.held_name,
        test=None if own.test is None else _change(own.test),
        explains=finite(own.held_out.explained),
        better=own.better,
        parts=own.parts,
        values=0 if own.parameter is None else own.parameter.size,
        ends=_ends(own),
        places=_places(own),
        held_out_parts=[HeldOutRow(part.name, part.samples, _change(part.rmse)) for part in own.held_out_parts],
        location=own.location,
    )


def _change(rmse: RmseChange) -> BeforeAfter:
    return BeforeAfter(finite(rmse.before), finite(rmse.after))


def _ends(own: TermProposal) -> list[tuple[float, float]]:
    if own.parameter is None or not own.term.breakpoints or own.term.second:
        return []
    values = own.parameter.values.ravel()
    return [(own.term.breakpoints[k], float(values[k])) for k in (0, -1)]


def _places(own: TermProposal) -> list[PlaceRow]:
    """Return the equal places that are other ones: a lag is found with several time constants at one node."""
    rows: dict[tuple[str, Kind], PlaceRow] = {}
    for number, place in enumerate(own.equal_places):
        assert place.addition is not None
        if (place.node, place.kind) != (own.term.node, own.term.kind):
            row = PlaceRow(number, place.node, place.kind, describe(place.addition.term))
            rows.setdefault((place.node, place.kind), row)
    return list(rows.values())


def look(session: Session, asked: TermQuestion) -> None:
    """Search for missing terms at the present values, in a process of its own."""
    kinds = FORMS if asked.kinds is None else tuple(asked.kinds)
    if asked.channels is not None and not asked.channels:
        kinds = tuple(kind for kind in kinds if kind not in (*OF_CHANNELS, "map"))
    scope = SearchScope(_patterns(asked.channels), _patterns(asked.nodes), kinds, asked.least)
    start_search(session, scope)


def _patterns(names: Sequence[str] | None) -> tuple[str, ...]:
    """Return patterns that match these names only."""
    return ("*",) if names is None else tuple(map(escape, names))


def stop_looking(session: Session) -> None:
    """Stop the search, and keep what it has found."""
    session.term_search.stop()


def term(session: Session, asked: AskedTerm) -> ShownTerm:
    """Return a proposal with its picture, and the change of the formula and of the project file."""
    own, picture = proposal_at(session, asked.number, asked.place), picture_of(session, asked.number)
    problem, kind = session.require_view().model.problem, own.term.kind
    old = session.term_search.subject != session.subject
    change = term_patch(session, own)
    texts = {} if old else {session.path.name: change.project_text}
    if change.function is not None and not old:
        texts = {session.formula_file: change.function_text} | texts
    parameter, fitted, units = own.parameter, asked.place is None, _channel_units(session)
    return ShownTerm(
        parameter="" if parameter is None else parameter.name,
        input="recording" if kind == "offset" else own.term.channel,
        input_unit=units.get(own.term.channel, ""),
        second=own.term.second,
        second_unit=units.get(own.term.second, ""),
        # recordings count from 1, as the parameter will
        points=tuple(point + 1 for point in own.term.breakpoints) if kind == "offset" else own.term.breakpoints,
        second_points=own.term.second_breakpoints,
        now=_numbers(parameter.values) if parameter is not None else [],
        deviation=finite_list(picture.deviation) if fitted else [],
        value_unit=value_unit(problem, own.term),
        neutral=1.0 if kind == "multiply" else 0.0,
        fitted=fitted,
        criterion=picture.criterion,
        unit=picture.unit,
        counts=picture.counts.tolist(),
        files=[ChangedFile(name, _changed_lines(session.text_of(name), text)) for name, text in texts.items()],
        text="" if change.function is not None else sentence(own),
        reason=change.reason,
        edges=picture.edges,
        before=picture.before,
        after=picture.after if fitted else np.full_like(picture.after, np.nan),
        x=picture.x,
        error=picture.error,
    )


def _numbers(values: Float) -> list[float]:
    """Return numbers with six digits of the largest of them: a pinned value is 0 up to rounding."""
    largest = float(np.abs(values).max(initial=0.0)) or 1.0
    return [float(f"{round(value / largest, 6) * largest:.6g}") for value in values.ravel().tolist()]


def _changed_lines(before: str, after: str) -> list[ChangedLine]:
    """Return the lines that differ, with one line around them."""
    old, new = (text.removeprefix("\ufeff").splitlines() for text in (before, after))
    rows: list[ChangedLine] = []
    for group in SequenceMatcher(None, old, new, autojunk=False).get_grouped_opcodes(CONTEXT):
        rows += [ChangedLine(" ", 0, "…")] if rows else []
        for kind, first, last, begin, end in group:
            if kind == "equal":
                rows += [ChangedLine(" ", begin + k + 1, old[first + k]) for k in range(last - first)]
                continue
            rows += [ChangedLine("-", at + 1, old[at]) for at in range(first, last)]
            rows += [ChangedLine("+", at + 1, new[at]) for at in range(begin, end)]
    return rows


def apply(session: Session, asked: AskedTerm) -> AppliedTerm:
    """Add a term to the formula and its table to the project, as one command."""
    return AppliedTerm(apply_term(session, asked.number, asked.place))
