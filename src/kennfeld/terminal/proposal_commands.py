"""The command `propose`: which term is missing in the function of a project."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.terminal.command_line import DONE, INTERRUPTED, as_json, only_problems, option, project_file, trusted
from kennfeld.terminal.opened_project import opened_project
from kennfeld.terminal.output import print_findings, print_lines, print_progress, print_values

if TYPE_CHECKING:
    from kennfeld.analysis.missing.proposal import TermProposals
    from kennfeld.analysis.missing.proposing import SearchScope
    from kennfeld.project import Project


@click.command
@project_file
@option("--apply number", "Write proposal N into the formula text and the project file.", "N", type=click.IntRange(1))
@option("--undo", "Restore the files as they were before the last proposal was written.")
@option("--channel channels", "Pattern of the channels that take part. Repeatable.", "NAME", "all", multiple=True)
@option("--node nodes", "Pattern of the nodes that take part. Repeatable.", "NAME", "all", multiple=True)
@option("--kind kinds", "add, multiply, map, lag, delay or offset. Repeatable.", "KIND", "all", multiple=True)
@option("--least", "Effect that a proposal must explain, in the unit of the target.", "X", "0", type=float, default=0.0)
@as_json
@trusted
@only_problems
def propose(
    path: Path,
    number: int | None,
    undo: bool,
    channels: tuple[str, ...],
    nodes: tuple[str, ...],
    kinds: tuple[str, ...],
    least: float,
    as_json: bool,
    trust: bool,
) -> int:
    """Find terms that the function lacks: which channel or lag, and at which node.

    All channels of the recordings take part. The function and the project file are not changed without --apply. The
    list is kept in proposals.json of the results folder, for kennfeld report.
    """
    from kennfeld.analysis.missing.proposing import SearchScope
    from kennfeld.analysis.missing.terms import FORMS

    scope = SearchScope(channels or ("*",), nodes or ("*",), kinds or FORMS, least)  # type: ignore[arg-type]
    with opened_project(path, trust=trust) as project:
        if undo:
            return _undo(project)
        try:
            proposals = project.propose(
                channels=scope.channels,
                nodes=scope.nodes,
                kinds=scope.kinds,
                least=scope.least,
                progress=print_progress,
            )
        except ArgumentError as error:
            raise InputError.of(Location("propose"), str(error)) from None
        except KeyboardInterrupt:
            return INTERRUPTED
        kept = _kept(path, project, proposals, scope)
        if number is not None:
            _require_proposal(proposals, number)
        written = () if number is None else project.apply(proposals[number - 1])
    if as_json:
        applied = {"applied": {"number": number, "files": [str(file) for file in written]}} if written else {}
        print_values(json.dumps(proposals.as_json() | applied, indent=2, ensure_ascii=False))
        return DONE
    _print(proposals)
    if written and number is not None:
        print_lines("", f"Applied proposal {number}: {proposals[number - 1].change}.")
        print_lines(f"Written to {join_names([str(file) for file in written])}")
        print_lines(f"Next: kennfeld calibrate {path}", f"Undo: kennfeld propose {path} --undo")
        return DONE
    if proposals.proposals:
        print_lines(f"Next: kennfeld propose {path} --apply 1")
    if kept is not None:
        print_lines(f"Kept in {kept}; pictures: kennfeld report {path}")
    return DONE


def _kept(path: Path, project: "Project", proposals: "TermProposals", scope: "SearchScope") -> Path | None:
    """Write the list for reports, and return its file; None if it is about no stored calibration, or on an error."""
    from kennfeld.project.proposal_file import write_proposals
    from kennfeld.project.results import results_folder

    try:
        written = write_proposals(project, proposals, scope)
        return None if written is None else results_folder(path) / written.name
    except InputError as error:
        print_findings(*(replace(finding, severity="warning") for finding in error.findings))
        return None


def _require_proposal(proposals: "TermProposals", number: int) -> None:
    """Raise `InputError` if there is no proposal of a number."""
    if number <= len(proposals):
        return
    if proposals.proposals:
        message = f"there is no proposal {number}, only {count_noun(len(proposals), 'proposal')}"
        raise InputError.of(Location("--apply"), message, f"Write a number from 1 to {len(proposals)}.")
    rejected = "; ".join(proposals.rejected)
    remedy = f"Rejected: {rejected}." if rejected else ""
    raise InputError.of(Location("--apply"), f"there is no proposal {number}. {proposals.message}", remedy)


def _print(proposals: "TermProposals") -> None:
    scores, fits = proposals.seconds
    print_lines(*proposals.lines())
    print_lines(f"{proposals.candidates} candidates; {scores:.1f} s to score them, {fits:.1f} s to fit")


def _undo(project: "Project") -> int:
    from kennfeld.project.missing_terms import undo

    text, files = undo(project)
    print_lines(f"Undone: {text}.", f"Restored {join_names([str(file) for file in files])}")
    return DONE
