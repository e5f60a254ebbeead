"""The page: sections, table of contents, data and program in one file that needs nothing else.

From a project and its result to the file that is handed on.
"""

import json
import traceback
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld import __version__
from kennfeld.errors import Finding
from kennfeld.optimize import Result
from kennfeld.project import Project
from kennfeld.project.manifest import KEY, warnings_of_others
from kennfeld.report.markup import Html, element
from kennfeld.report.pieces import Pictures
from kennfeld.report.report_data import ReportData, subject
from kennfeld.report.sections import sections
from kennfeld.report.stored_result import READ, stored, stored_trust

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation

__all__ = ["document", "from_folder", "page", "safely"]

STATIC = Path(__file__).parent / "static"
SCRIPTS = ("plot.js", "charts.js", "surface.js", "table.js", "page.js")
# nothing is loaded from anywhere, whatever a name in the data may try
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(subject: ReportData, made: datetime | None = None) -> str:
    """The report as the text of an HTML file; `made` is the time it bears, now by default."""
    time = (made or datetime.now().astimezone()).isoformat(" ", "seconds")
    pictures = Pictures()
    parts = list(sections(subject, pictures))
    title = f"{subject.project.name}: calibration report"
    data = {
        "version": __version__,
        "made": time,
        "result": subject.written,
        "figures": pictures.data,
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
            element("main", _head(subject, time), [_section(*part[:3]) for part in parts], _foot(time)),
            element("script", _json(data), type="application/json", id="report-data"),
            [element("script", Html(_static(name))) for name in SCRIPTS],
        ),
        lang="en",
    )


def _contents(parts: Any) -> Html:
    """The table of contents."""
    entries = []
    for anchor, title, _, below in parts:
        entries.append(element("a", title, href=f"#{anchor}"))
        links = [element("a", name, href=f"#{to}", class_="below", title=name) for to, name in below]
        entries += [element("div", links, class_="group")] if links else []
    return element("nav", element("div", "Kennfeld", class_="brand"), entries, aria_label="Contents")


def _head(subject: ReportData, time: str) -> Html:
    status = "not calibrated yet" if subject.result is None else subject.result.status
    return element(
        "header",
        element("h1", subject.project.name),
        element(
            "p",
            f"Calibration report · {subject.project.path.resolve()} · {time} · kennfeld {__version__} · ",
            element("span", status, class_=f"status {status.partition(' ')[0]}"),
            class_="note",
        ),
        element(
            "noscript", element("p", "The pictures of this report are drawn by the page itself: allow JavaScript.")
        ),
    )


def _section(anchor: str, title: str, content: Html) -> Html:
    return element("section", element("h2", title), content, id=anchor)


def _foot(time: str) -> Html:
    return element("footer", f"Made by kennfeld {__version__} at {time}. This file needs no network and no other file.")


@cache
def _static(name: str) -> str:
    return (STATIC / name).read_text(encoding="utf-8")


def _json(data: Any) -> Html:
    """JSON within a script element, which no text in it can end."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def document(
    project: Project,
    result: Result | None = None,
    findings: Sequence[Finding] = (),
    left: "Sequence[Extrapolation] | None" = None,
) -> str:
    """The report on a result as the text of one HTML file; without a result, on the start as given.

    Args:
        project: what was calibrated.
        result: what came of it.
        findings: the messages of `project.check()`, which the report repeats.
        left: where surrogates are used outside the data they were trained on; computed where it is not given.

    Raises `InputError` where the project has no problem to compute.

    >>> import kennfeld as kf
    >>> project = kf.Project.read("kennfeld.toml")  # doctest: +SKIP
    >>> text = document(project, project.calibrate(), project.check())  # doctest: +SKIP
    """
    return page(subject(project, result, findings, left=left))


def from_folder(project: Project, folder: str | Path) -> str:
    """The report on the result that an earlier run left in a folder; on the start where there is none.

    Raises `InputError` where a file of the result is missing or damaged, and where the project has errors.
    """
    findings = project.check()
    found = stored(Path(folder), project.problem())
    if found is None:
        return document(project, None, findings)
    result, written = found
    findings += warnings_of_others(Path(folder), written, READ)
    said = {key: value for key, value in written.items() if key != KEY}
    return page(subject(project, result, findings, stored_trust(Path(folder), result.parameters), said))


def safely(
    project: Project, result: Result, findings: Sequence[Finding] = (), left: "Sequence[Extrapolation] | None" = None
) -> str:
    """The report on a result; where it cannot be made, a page that says so, because the result must not be lost."""
    try:
        return document(project, result, findings, left)
    except Exception:
        sentence = "This report could not be made; the other files of the result are complete. Please report this:"
        said = element("body", element("p", sentence), element("pre", traceback.format_exc()))
        return "<!doctype html>\n" + element("html", element("head", element("meta", charset="utf-8")), said)
