"""From a project and its result to the file that is handed on."""

import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.errors import Finding
from kennfeld.optimize import Result
from kennfeld.project import Project
from kennfeld.project.manifest import KEY, warnings_of_others
from kennfeld.report.markup import element
from kennfeld.report.page import page
from kennfeld.report.stored import READ, stored
from kennfeld.report.stored_trust import stored_trust
from kennfeld.report.subject import subject

if TYPE_CHECKING:  # most projects have no surrogates
    from kennfeld.analysis.leaving import Leaving

__all__ = ["document", "from_folder", "safely"]


def document(
    project: Project,
    result: Result | None = None,
    findings: Sequence[Finding] = (),
    left: "Sequence[Leaving] | None" = None,
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
    project: Project, result: Result, findings: Sequence[Finding] = (), left: "Sequence[Leaving] | None" = None
) -> str:
    """The report on a result; where it cannot be made, a page that says so, because the result must not be lost."""
    try:
        return document(project, result, findings, left)
    except Exception:
        sentence = "This report could not be made; the other files of the result are complete. Please report this:"
        said = element("body", element("p", sentence), element("pre", traceback.format_exc()))
        return "<!doctype html>\n" + element("html", element("head", element("meta", charset="utf-8")), said)
