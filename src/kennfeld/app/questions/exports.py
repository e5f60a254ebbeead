"""Export of the present values: calibration files, the report, all files of a run, and a script that repeats it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kennfeld.app.answer import Answer, Given
from kennfeld.app.session.session import Session
from kennfeld.atomic_files import write_whole
from kennfeld.calfiles import endings, losses
from kennfeld.calfiles import write as write_parameters
from kennfeld.calfiles.flash.description import IMAGE_ENDINGS
from kennfeld.errors import ArgumentError, Finding, InputError, Location
from kennfeld.optimize.quality import Scorer
from kennfeld.optimize.result import Result
from kennfeld.project import Project

SCRIPT = '''\
"""Repeats the calibration of {project}."""

from pathlib import Path

import kennfeld as kf

folder = Path(__file__).parent
project = kf.Project.read(folder / "{project}")
for finding in project.check():
    print(finding)
result = project.calibrate(progress=lambda step: print(f"{{step.stage}} {{step.iteration}}: RMSE {{step.rmse:.6g}}"))
print(result)
result.parameters.save(folder / "parameters{ending}")
'''


def formats(session: Session, given: Given) -> Answer:
    """Return the extensions that values can be written as, those of the project first."""
    own = () if session.project is None else session.project.formats
    known = [each for each in endings() if each not in (*IMAGE_ENDINGS, ".msq") or each in own]
    return Answer({"formats": list(dict.fromkeys([*own, *known])), "own": list(own), "folder": str(_folder(session))})


def _folder(session: Session) -> Path:
    return session.path.parent / "results"


def export(session: Session, given: Given) -> Answer:
    """Write the present values into the results folder.

    `formats` are extensions; `report`, `script` and `whole` add the report, a script, and all files of a run.
    """
    view, project, folder = session.require_view(), session.project, _folder(session)
    assert project is not None
    known = endings()
    for ending in given.get("formats", ()):
        if ending not in known:
            raise ArgumentError(f"unknown format {ending!r}")
    folder.mkdir(parents=True, exist_ok=True)
    values, findings, written = view.now.parameters.without(project.surrogates), list[Finding](), list[Path]()
    for ending in given.get("formats", ()):
        path = folder / f"parameters{ending}"
        findings += [*write_parameters(values, path), *losses(values, path)]
        written.append(path)
    whole, report = given.get("whole"), given.get("report")
    result = _result(session) if whole or (report and session.runs) else None
    if whole and result is not None:
        from kennfeld.project.results import write

        written += write(result, project, folder)
    if report:
        written.append(_write_report(project, result, session.findings, folder))
    if given.get("script"):
        ending = next(iter(given.get("formats", ())), ".json")
        path = session.path.with_name("calibrate.py")
        write_whole(path, SCRIPT.format(project=session.path.name, ending=ending))
        written.append(path)
    return Answer({"files": [str(path) for path in dict.fromkeys(written)], "findings": [str(f) for f in findings]})


def _result(session: Session) -> Result:
    """Return the last result with the present values. Raises `InputError` if there was no run."""
    if not session.runs:
        raise InputError.of(Location(session.path.name), "there is no result yet", "Run the calibration first.")
    last, view = session.runs[-1].result, session.require_view()
    start, now = view.start.parameters, view.now.parameters
    return replace(last, parameters=now, start=start, quality=Scorer(view.model.problem).quality(start, now))


def _write_report(project: Project, result: Result | None, findings: Sequence[Finding], folder: Path) -> Path:
    from kennfeld.report import document

    path = folder / "report.html"
    write_whole(path, document(project, result, findings))
    return path
