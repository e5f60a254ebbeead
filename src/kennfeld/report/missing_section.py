"""Report section of terms that the function may lack."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.analysis.missing.hints import Hints
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.markup import MISSING, Html, decimal, details, element, note, quantity, table
from kennfeld.report import figures
from kennfeld.report.figures import Pictures
from kennfeld.report.report_data import ReportData, ReportedProposals

if TYPE_CHECKING:
    from kennfeld.analysis.missing.picture import TermPicture
    from kennfeld.analysis.missing.proposal import RmseChange, TermProposal, TermProposals
    from kennfeld.analysis.missing.proposing import SearchScope

Entries = Sequence[tuple[str, str]]  # of the table of contents

FITTED = (
    "All numbers are from fits. The fits for the held-out errors have not seen the parts on which they are judged; "
    "these choose. A term explains the root of the difference of the squared held-out errors."
)


def render_missing(report: ReportData, pictures: Pictures) -> tuple[Html, Entries] | None:
    """Return what the function lacks, with entries of the table of contents; None if nothing is known of that.

    That are the proposals of a search, if it was about this result, else the estimate of the calibration.
    """
    proposals, hints, name = report.proposals, report.missing, report.project.path.name
    if proposals is not None and not proposals.change:
        return _render_proposals(proposals, hints, pictures, name)
    outdated = None if proposals is None else note(_outdated(proposals, name))
    if hints is None or not hints.lines():
        return None if outdated is None else (element("div", outdated), ())
    return _render_hints(hints, name, outdated), ()


def _outdated(proposals: ReportedProposals, project: str) -> str:
    """Return why the proposals of a search are not shown."""
    return (
        f"The list of proposals of {proposals.made} is not shown: {proposals.change} changed since. "
        f"Run kennfeld propose {project} again."
    )


def _render_hints(hints: Hints, project: str, outdated: Html | None) -> Html:
    """Return what the best term would take off the cost, and what the values themselves would."""
    method = (
        "Estimated by one linearisation of the function, not by a fit. For proposals that are fitted and judged on "
        f"held-out data, over all recorded channels, run kennfeld propose {project}."
    )
    lines = [element("p", line) for line in hints.lines()]
    return element("div", lines, note(method) if hints.scored and outdated is None else None, outdated)


def _render_proposals(
    proposals: ReportedProposals, hints: Hints | None, pictures: Pictures, project: str
) -> tuple[Html, Entries]:
    found = proposals.drawn.found
    rows = list(enumerate(zip(found.proposals, proposals.drawn.pictures, strict=True), 1))
    entries = [(_anchor(number), own.change) for number, (own, _) in rows]
    left = [] if hints is None else hints.left_lines()
    content = element(
        "div",
        [element("p", line) for line in left],
        element("p", found.message),
        note(_origin(proposals, project)),
        _table(found) if rows else None,
        note(FITTED) if rows else None,
        [_render_term(number, own, pictures.place(*_figure(own, picture))) for number, (own, picture) in rows],
        element("ul", [element("li", text) for text in found.remarks], class_="remarks") if found.remarks else None,
        _folded("Rejected candidates", found.rejected),
        _folded("Channels that take no part", [f"{name}: {reason}" for name, reason in found.excluded.items()]),
    )
    return content, entries


def _anchor(number: int) -> str:
    return f"missing-{number}"


def _table(found: "TermProposals") -> Html:
    unit = f" [{found.unit}]" if found.unit else ""
    tested = any(own.test is not None for own in found.proposals)
    head = ["", "term", f"RMSE{unit}", "with it", "held out", "with it", "explains", "better parts"]
    head += ["test", "with it"] if tested else []
    rows = []
    for number, own in enumerate(found.proposals, 1):
        cells = [*_change(own.rmse), *_change(own.held_out), decimal(own.held_out.explained, 3)]
        cells.append(f"{own.better} of {own.parts}")
        rows.append([str(number), own.change, *cells, *(_change(own.test) if tested else [])])
    return table(head, rows, words=2, class_="wide")


def _change(rmse: "RmseChange | None") -> list[str]:
    return [MISSING, MISSING] if rmse is None else [decimal(rmse.before), decimal(rmse.after)]


def _figure(own: "TermProposal", picture: "TermPicture") -> tuple[figures.Figure | None, str, str]:
    """Return the figure of a proposal, its caption and its label."""
    node, channel = own.term.node, own.term.channel
    if own.term.kind == "lag":
        caption = f"Step response of {node} with the fitted time constant, and by one standard deviation more or less."
    elif own.term.kind == "offset":
        caption = f"Fitted offset of each recording at {node}, with its standard deviation."
    else:
        fitted = "values" if own.term.second else "curve with its standard deviation"
        caption = (
            f"Above, the fitted {fitted}. Below, the errors of {picture.criterion} over {channel}, their mean without "
            "the term and with it, and the number of samples."
        )
    return figures.term(own, picture), caption, own.change


def _render_term(number: int, own: "TermProposal", picture: Html | None) -> Html:
    place = f"Node {own.term.node}: {own.location}." if own.location else ""
    parts = [[part.name, str(part.samples), *_change(part.rmse)] for part in own.held_out_parts]
    return element(
        "div",
        element("h3", f"{number}  {own.change}", id=_anchor(number)),
        element("p", own.remark) if own.remark else None,
        note(place) if place else None,
        picture,
        details("Held-out parts", table(["part", "samples", "RMSE", "with it"], parts)) if parts else None,
        details("Change of the files", element("pre", own.patch)) if own.patch else None,
    )


def _origin(proposals: ReportedProposals, project: str) -> str:
    """Return which search found the proposals, and which calibration they belong to."""
    found = proposals.drawn.found
    searched = f"kennfeld propose {project}, {proposals.made}" if proposals.made else "The search in the app"
    text = f"{searched}, for the calibration of this report: {count_noun(found.candidates, 'candidate')} scored."
    return " ".join([text, *_restrictions(proposals.scope, found.unit)])


def _restrictions(scope: "SearchScope", unit: str) -> list[str]:
    """Return sentences on the restrictions of a search."""
    from kennfeld.analysis.missing.terms import FORMS  # a report without proposals does without the search

    limited = [
        f"{kind} {join_names(list(names))}"
        for kind, names in (("channels", scope.channels), ("nodes", scope.nodes))
        if tuple(names) != ("*",)
    ]
    if set(scope.kinds) != set(FORMS):
        limited.append(f"kinds {join_names(list(scope.kinds))}")
    texts = [f"Restricted to {'; '.join(limited)}."] if limited else []
    if scope.least:
        texts.append(f"Terms that explain less than {quantity(scope.least, unit)} were left out.")
    return texts


def _folded(what: str, lines: Sequence[str]) -> Html | None:
    return details(f"{what}: {len(lines)}", element("ul", [element("li", line) for line in lines])) if lines else None
