"""The search for missing terms of a session: its work, the pictures of what it finds, and how a term is applied."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from kennfeld.analysis.missing.picture import DrawnProposals, TermArtist, TermPicture
from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
from kennfeld.analysis.missing.proposing import PartialSearch, SearchScope
from kennfeld.app.folders import writable
from kennfeld.app.session.session import Session
from kennfeld.app.session.side_work import PartialOutcome, Tell, WorkStep
from kennfeld.app.session.state import Command, SetTables, SetText, Several
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_state import version_of
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.project import Project
from kennfeld.project.missing_terms import Patch, patch, propose
from kennfeld.project.proposal_file import VALUES, ProposalSubject, read_proposals
from kennfeld.project.results import FOLDER, PROPOSALS

_BOM = "\ufeff"


@dataclass(frozen=True, eq=False)
class TermFindings:
    """The outcome of a search.

    Attributes:
        drawn: the proposals with their pictures and fitted values.
        scope: what took part.
        stopped: candidates that were fitted, and all that were to be; None if the search has ended.
    """

    drawn: DrawnProposals
    scope: SearchScope
    stopped: tuple[int, int] | None = None

    @property
    def found(self) -> TermProposals:
        """The proposals, without the problem and the fits."""
        return self.drawn.found

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
        artist = TermArtist()

        def report(text: str) -> None:
            tell(WorkStep(text, fitted, to_fit))

        def watch(search: PartialSearch) -> None:
            nonlocal fitted, to_fit
            fitted, to_fit = search.fitted, search.to_fit
            tell(PartialOutcome(TermFindings(artist.drawn(search.found), self.scope, (fitted, to_fit))))

        project = Project.read(self.path, self.unsaved)
        report("reading the recordings")
        try:
            return TermFindings(artist.drawn(propose(project, self.scope, report, self.parameters, watch)), self.scope)
        finally:
            project.close()


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


def adopt_stored(session: Session) -> None:
    """Take the proposals in the results folder for the outcome, as long as there was no search of this session.

    They are about the present values if nothing has changed; about the same function, project and data in any case.
    """
    work, project = session.term_search, session.project
    if work.state != "idle" or project is None or session.view is None:
        return
    folder = session.path.parent / FOLDER
    checked = session.subject, version_of((folder / PROPOSALS,))
    if session.checked_proposals == checked:
        return
    session.checked_proposals = checked
    work.subject = None
    with suppress(InputError):  # a damaged list is none
        stored = read_proposals(folder)
        if stored is None:
            return
        change = stored.subject.change(ProposalSubject.of(project, session.view.now.parameters))
        # one that was taken over stays, as after a search of this session
        if change in ("", VALUES):
            work.outcome = TermFindings(stored.drawn, stored.scope)
            work.seconds = sum(stored.drawn.found.seconds)
        if not change:
            work.subject = session.subject


def current_findings(session: Session) -> TermFindings | None:
    """Return the outcome of a search that has ended, if it is about the present values; else None."""
    findings: TermFindings | None = session.term_search.outcome
    if findings is None or findings.stopped is not None or session.term_search.subject != session.subject:
        return None
    return findings


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
    return findings.drawn.pictures[number]


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
        fitted: ParameterSet = session.term_search.outcome.drawn.values[number]
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
