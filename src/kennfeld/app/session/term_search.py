"""The search for missing terms of a session: its work, the pictures of what it finds, and how a term is applied."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
from kennfeld.analysis.missing.proposing import PartialSearch, SearchScope
from kennfeld.app.folders import writable
from kennfeld.app.session.live_model import LiveModel
from kennfeld.app.session.session import Session
from kennfeld.app.session.side_work import PartialOutcome, Tell, WorkStep
from kennfeld.app.session.state import Command, SetTables, SetText, Several
from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.problem import Problem
from kennfeld.project import Project
from kennfeld.project.missing_terms import Patch, patch, propose

BINS = 24  # of a channel, over which errors are averaged
MOST_POINTS = 1500  # samples that are drawn
_BOM = "\ufeff"


@dataclass(frozen=True, eq=False)
class TermPicture:
    """A fitted term over its channel, and the errors without it and with it; empty arrays for lags and delays.

    Attributes:
        deviation: standard deviation of the values of the term, Float[values]; inf if nothing determines one.
        criterion: number of the criterion whose errors the term changes most, from 0.
        unit: of the errors.
        edges: of the bins of the channel, Float[bins + 1].
        counts: samples by bin, Int[bins].
        before: mean error by bin without the term, Float[bins]; NaN in bins without samples.
        after: with it.
        x: channel of some samples, Float[points].
        error: their errors without the term.
    """

    deviation: Float
    criterion: int
    unit: str
    edges: Float
    counts: Int
    before: Float
    after: Float
    x: Float
    error: Float


@dataclass(frozen=True, eq=False)
class TermFindings:
    """The outcome of a search.

    Attributes:
        found: the proposals, without the problem and the fits.
        pictures: of each proposal.
        values: all values of the fit with each proposal.
        stopped: candidates that were fitted, and all that were to be; None if the search has ended.
    """

    found: TermProposals
    pictures: tuple[TermPicture, ...] = ()
    values: tuple[ParameterSet, ...] = ()
    stopped: tuple[int, int] | None = None

    @property
    def detail(self) -> str:
        """The outcome in a few words."""
        count = len(self.found)
        if count or self.stopped is not None:
            return count_noun(count, "proposal")
        return "cannot be judged" if self.found.status == "failed" else "nothing is missing"


@dataclass(frozen=True, eq=False)
class TermTask:
    """The search, in a process of its own.

    Attributes:
        path: the project file.
        unsaved: texts that replace those of files.
        parameters: the values from which the function is fitted.
        scope: what takes part.
    """

    path: Path
    unsaved: Mapping[str, str]
    parameters: ParameterSet
    scope: SearchScope

    def run(self, tell: Tell) -> TermFindings:
        """Search, and tell what is found so far."""
        fitted, to_fit = 0, 0
        pictures: dict[str, TermPicture] = {}

        def report(text: str) -> None:
            tell(WorkStep(text, fitted, to_fit))

        def watch(search: PartialSearch) -> None:
            nonlocal fitted, to_fit
            fitted, to_fit = search.fitted, search.to_fit
            findings = _findings(search.found, pictures)
            tell(PartialOutcome(replace(findings, stopped=(fitted, to_fit))))

        project = Project.read(self.path, self.unsaved)
        report("reading the recordings")
        try:
            return _findings(propose(project, self.scope, report, self.parameters, watch), pictures)
        finally:
            project.close()


def _findings(outcome: TermProposals, pictures: dict[str, TermPicture]) -> TermFindings:
    """Return proposals as they are sent, with pictures; those that were drawn before are not computed again."""
    values = []
    for proposal in outcome.proposals:
        assert outcome.problem is not None
        assert proposal.fit is not None
        if proposal.change not in pictures:
            pictures[proposal.change] = term_picture(outcome.problem, proposal)
        values.append(proposal.fit.parameters)
    plain = tuple(replace(proposal, fit=None) for proposal in outcome.proposals)
    drawn = tuple(pictures[proposal.change] for proposal in outcome.proposals)
    return TermFindings(replace(outcome, proposals=plain, problem=None), drawn, tuple(values))


def term_picture(problem: Problem, proposal: TermProposal) -> TermPicture:
    """Return the picture of a fitted proposal.

    Args:
        problem: the function as it is, at the end of its fit.
        proposal: with its fit.
    """
    addition, fit = proposal.addition, proposal.fit
    assert addition is not None
    assert fit is not None
    deviation = np.zeros(0)
    if addition.parameter is not None:
        deviation = fit.trust.deviation.get(addition.parameter.name, deviation).ravel()
    without = LiveModel(problem)
    extended = LiveModel(replace(addition.to(problem, fit.parameters), parameters=fit.parameters))
    before, after = without.evaluate(problem.parameters).errors, extended.evaluate(fit.parameters).errors
    training = [number for number, data in enumerate(without.recordings) if data.use == "training"]
    criterion = _most_changed([before[n] for n in training], [after[n] for n in training])
    x, old, new = np.zeros(0), np.zeros(0), np.zeros(0)
    if addition.term.channel:
        channel = problem.channels.get(addition.term.channel, addition.term.channel)
        x = np.concatenate([without.recordings[n].channel(channel) for n in training])
        old = np.concatenate([before[n][criterion] for n in training])
        new = np.concatenate([after[n][criterion] for n in training])
    return _binned(deviation, criterion, without.unit(criterion), x, old, new)


def _most_changed(before: Sequence[Float], after: Sequence[Float]) -> int:
    """Return the criterion whose errors differ most, in relation to their size."""
    old, new = np.concatenate(before, axis=1), np.concatenate(after, axis=1)
    size = np.nansum(old**2, axis=1)
    share = np.nansum((new - old) ** 2, axis=1) / np.where(size > 0, size, np.inf)
    return int(np.argmax(share))


def _binned(deviation: Float, criterion: int, unit: str, x: Float, old: Float, new: Float) -> TermPicture:
    known = np.isfinite(x) & np.isfinite(old) & np.isfinite(new)
    x, old, new = x[known], old[known], new[known]
    if not x.size:
        none = np.zeros(0)
        return TermPicture(deviation, criterion, unit, none, none.astype(int), none, none, none, none)
    low, high = float(x.min()), float(x.max())
    edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(at, minlength=BINS)
    size = np.where(counts, counts, np.nan)
    before, after = (np.bincount(at, weights=errors, minlength=BINS) / size for errors in (old, new))
    # evenly over the recordings, so that all operation is drawn
    some = np.linspace(0, x.size - 1, min(MOST_POINTS, x.size)).round().astype(int)
    return TermPicture(deviation, criterion, unit, edges, counts, before, after, x[some], old[some])


def start_search(session: Session, scope: SearchScope) -> None:
    """Search for missing terms at the present values.

    Raises:
        ArgumentError: a search is running, or the scope cannot be used.
        InputError: the project has errors, or its files have changed since they were read.
    """
    scope.check()
    session.require_evaluable()
    task = TermTask(session.path, session.unsaved_texts, session.parameters, scope)
    session.term_search.start(task, session.subject)


def proposal_at(session: Session, number: int, place: int | None) -> TermProposal:
    """Return a proposal, from 0, at its best place or at one of the equal ones."""
    findings: TermFindings | None = session.term_search.outcome
    if findings is None or not 0 <= number < len(findings.found):
        raise InputError.of(Location("proposal"), f"there is no proposal {number + 1} any more", "Look again.")
    proposal = findings.found[number]
    if place is None:
        return proposal
    if not 0 <= place < len(proposal.equal_places):
        raise InputError.of(Location("proposal"), "there is no such place any more", "Look again.")
    return proposal.at_place(place)


def picture_of(session: Session, number: int) -> TermPicture:
    """Return the picture of a proposal, from 0, that `proposal_at` has."""
    findings: TermFindings | None = session.term_search.outcome
    assert findings is not None
    return findings.pictures[number]


def term_patch(session: Session, proposal: TermProposal) -> Patch:
    """Return the texts of a session with a term."""
    view, project = session.require_view(), session.project
    assert project is not None
    texts = {session.path.name: session.state.texts[session.path.name]}
    if file := session.formula_file:
        texts[file] = session.text_of(file)
    change = patch(project, view.model.problem, proposal, texts)
    if change.function is None:
        return change
    try:
        writable(session.path.parent, file)
    except InputError as error:
        return replace(change, function=None, reason=" ".join(each.message for each in error.findings))
    return change


def apply_term(session: Session, number: int, place: int | None) -> str:
    """Add a term to the formula and its table to the project, as one command; return its title.

    At the best place, all values become those of the fit with the term. At an equal place, which is not fitted, the
    term has no effect until the next run.

    Raises:
        InputError: the search is older than the project, or the term cannot be written.
    """
    if session.term_search.subject != session.subject:
        raise InputError.of(Location("proposal"), "is older than the values or the function", "Look again.")
    proposal = proposal_at(session, number, place)
    change = term_patch(session, proposal)
    if change.function is None:
        raise InputError.of(Location("proposal"), change.reason, "Add the term by hand.")
    file = session.formula_file
    mark = _BOM if session.text_of(file).startswith(_BOM) else ""
    commands: list[Command] = [
        SetText("", file, mark + change.function_text),
        SetText("", session.path.name, change.project_text),
    ]
    tables: dict[str, Parameter] = {}
    if place is None and session.term_search.outcome is not None:
        fitted: ParameterSet = session.term_search.outcome.values[number]
        free = session.require_view().model.problem.free_names
        names = [*free, *([] if proposal.parameter is None else [proposal.parameter.name])]
        tables = {name: fitted[name] for name in names if name in fitted}
        commands.append(SetTables("", session.values_of(fitted, tables)))
    title = f"Applied: {proposal.change}"
    _require_valid(session, commands)
    session.do(Several(title, commands), tables=tables)
    return title


def _require_valid(session: Session, commands: Sequence[Command]) -> None:
    """Raise `InputError` if the project would have errors."""
    findings = session.read_trial(Several("", commands)).check()
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        raise InputError([Finding(Location("proposal"), "cannot be added to the project"), *errors])
