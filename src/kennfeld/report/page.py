"""The report as one self-contained HTML file: sections, table of contents, data and scripts."""

import json
import traceback
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from kennfeld import __version__
from kennfeld.analysis.extrapolation import Extrapolation
from kennfeld.analysis.missing.hints import Hints
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.markup import Html, element
from kennfeld.optimize.fit.result import Result
from kennfeld.project import Project
from kennfeld.project.manifest import KEY, check_other_files
from kennfeld.project.results import PROPOSALS
from kennfeld.project.run_schema import ReportEntry
from kennfeld.report.figures import Pictures, signals
from kennfeld.report.report_data import ReportData, ReportedProposals, collect_report_data
from kennfeld.report.sections import sections
from kennfeld.report.stored_result import READ, read_result, read_trust, read_validation

STATIC = Path(__file__).parent / "static"  # built from `web/src/report`
# load nothing, whatever a name in the data contains
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(report: ReportData) -> str:
    """Return the report as the text of an HTML file."""
    time = datetime.now().astimezone().isoformat(" ", "seconds")
    pictures = Pictures()
    parts = list(sections(report, pictures))
    title = report.heading.title or f"{report.project.name}: calibration report"
    data = {
        "version": __version__,
        "made": time,
        "result": report.written,
        "figures": pictures.data,
        "signals": signals(report.drawings),
    }
    return "<!doctype html>\n" + element(
        "html",
        element(
            "head",
            element("meta", charset="utf-8"),
            element("meta", http_equiv="Content-Security-Policy", content=POLICY),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("title", title),
            element("style", Html(_static("report.css"))),
        ),
        element(
            "body",
            _contents(parts),
            element(
                "main",
                _head(report, time),
                [element("section", element("h2", title), text, id=anchor) for anchor, title, text, _ in parts],
                element("footer", f"Created by kennfeld {__version__} at {time}. This file is self-contained."),
            ),
            element("script", _json(data), type="application/json", id="report-data"),
            element("script", Html(_static("report.js"))),
        ),
        lang="en",
    )


def _contents(parts: Any) -> Html:
    entries = []
    for anchor, title, _, below in parts:
        entries.append(element("a", title, href=f"#{anchor}"))
        links = [element("a", name, href=f"#{to}", class_="below", title=name) for to, name in below]
        entries += [element("div", links, class_="group")] if links else []
    return element("nav", element("div", "Kennfeld", class_="brand"), entries, aria_label="Contents")


def _head(report: ReportData, time: str) -> Html:
    status = "not calibrated yet" if report.result is None else report.result.status
    return element(
        "header",
        element("h1", report.heading.title or report.project.name),
        element("p", element("b", report.heading.author)) if report.heading.author else None,
        element(
            "p",
            f"Calibration report · {report.project.path.resolve()} · {time} · kennfeld {__version__} · ",
            element("span", status, class_=f"status {status.partition(' ')[0]}"),
            class_="note",
        ),
        _comment(report.heading.comment),
        element("noscript", element("p", "The figures of this report need JavaScript.")),
    )


def _comment(text: str) -> list[Html]:
    """Return the paragraphs of a comment, which empty lines separate; line breaks within one are kept."""
    groups = groupby(text.split("\n"), key=lambda line: bool(line.strip()))
    paragraphs = [list(lines) for filled, lines in groups if filled]
    return [element("p", first, [(element("br"), line) for line in more]) for first, *more in paragraphs]


@cache
def _static(name: str) -> str:
    return (STATIC / name).read_text(encoding="utf-8")


def _json(data: Any) -> Html:
    """Return JSON for a script element, escaped so that no text in it can close the element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def document(
    project: Project,
    result: Result | None = None,
    findings: Sequence[Finding] = (),
    extrapolation: Sequence[Extrapolation] | None = None,
    missing: Hints | None = None,
    proposals: ReportedProposals | None = None,
) -> str:
    """Return the report on a result, or on the start values if there is none, as the text of one HTML file.

    Args:
        project: the project.
        result: its calibration result.
        findings: the findings of `project.check()`, which the report lists.
        extrapolation: use of surrogates outside their training data; computed by default.
        missing: what the function lacks, if that is known.
        proposals: terms that a search has proposed for the result.

    Raises:
        InputError: the project does not define a problem that can be evaluated.
    """
    return page(
        collect_report_data(
            project, result, findings, extrapolation=extrapolation, missing=missing, proposals=proposals
        )
    )


def from_folder(project: Project, folder: str | Path, heading: ReportEntry | None = None) -> str:
    """Return the report on the result in a folder, or on the start values if the folder has no result.

    Args:
        project: the project.
        folder: a results folder, as written by `kennfeld calibrate`.
        heading: title, author and comment; by default those of the project file.

    Raises:
        InputError: a file of the result is missing or damaged, or the project has errors.
    """
    findings = project.check()
    stored = read_result(Path(folder), project.problem())
    if stored is None:
        return page(collect_report_data(project, None, findings, heading=heading))
    result, written = stored
    # files that the report does not read may be of another run as well
    findings += check_other_files(Path(folder), written, READ)
    contents = {key: value for key, value in written.items() if key != KEY}
    trust, validation = read_trust(Path(folder), result.parameters), read_validation(Path(folder), written)
    proposals = _proposals(project, Path(folder), result, findings)
    return page(
        collect_report_data(
            project, result, findings, trust, contents, validation=validation, heading=heading, proposals=proposals
        )
    )


def _proposals(project: Project, folder: Path, result: Result, findings: list[Finding]) -> ReportedProposals | None:
    """Return the proposals in a folder; a damaged list is a warning, as the report on the result is correct without."""
    if not (folder / PROPOSALS).is_file():
        return None
    from kennfeld.project.proposal_file import ProposalSubject, read_proposals  # most reports do without the search

    try:
        stored = read_proposals(folder)
    except InputError as error:
        findings += [replace(finding, severity="warning") for finding in error.findings]
        return None
    if stored is None:
        return None
    change = stored.subject.change(ProposalSubject.of(project, result.parameters))
    return ReportedProposals(stored.drawn, stored.scope, stored.made, change)


def document_safely(
    project: Project,
    result: Result,
    findings: Sequence[Finding] = (),
    extrapolation: Sequence[Extrapolation] | None = None,
    missing: Hints | None = None,
) -> str:
    """Return the report on a result, or a page with the error if it cannot be created: the result must not be lost."""
    try:
        return document(project, result, findings, extrapolation, missing)
    except Exception:
        sentence = "This report could not be created; the other files of the result are complete. Please report:"
        body = element("body", element("p", sentence), element("pre", traceback.format_exc()))
        return "<!doctype html>\n" + element("html", element("head", element("meta", charset="utf-8")), body)
