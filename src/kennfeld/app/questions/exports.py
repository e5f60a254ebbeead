"""Export of the present values: calibration files, the report, all files of a run, and a script that repeats it."""

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.app.desktop import has_desktop, open_on_desktop
from kennfeld.app.folders import confined, writable
from kennfeld.app.questions.calibrations import RoundedRow, rounded
from kennfeld.app.questions.existing_files import ExistingFile
from kennfeld.app.session.calibration_source import initial_image, is_image
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.term_search import current_findings
from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import endings, losses
from kennfeld.calfiles import write as write_parameters
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.search.problem_digest import problem_digest
from kennfeld.project import Project
from kennfeld.project.proposal_file import store_proposals
from kennfeld.project.results import FOLDER, RESULT, results_folder, write_text

SHOWN = (".html", ".csv", ".json", ".mf4", ".mat", ".parquet", ".lab")  # results that are opened, beside values
SCRIPT = '''\
"""Repeat a calibration."""

from pathlib import Path

import kennfeld as kf

folder = Path(__file__).parent
project = kf.Project.read(folder / {project!r})
for finding in project.check():
    print(finding)
result = project.calibrate(progress=lambda step: print(f"{{step.stage}} {{step.iteration}}: RMSE {{step.rmse:.6g}}"))
print(result)
result.parameters.save(folder / {parameters!r})
'''


@dataclass(frozen=True)
class ExportFormats:
    """Extensions that values can be written as.

    Attributes:
        formats: all, those of the project first.
        own: those of the project.
        folder: the results folder.
        stored: true if it has the files of a run.
        opens: true if files can be opened on the desktop of this machine.
    """

    formats: Sequence[str]
    own: Sequence[str]
    folder: str
    stored: bool
    opens: bool


@dataclass(frozen=True)
class ExportCommand:
    """Files that are written into the results folder.

    Attributes:
        formats: extensions of files with the present values.
        report: the report on them.
        script: a script that repeats the run.
        whole: all files of a run.
        stored: the report on the run whose files are in the results folder.
        simulation: extension of a file with all nodes over all datasets; empty for none.
        force: replace another file with the name of the script.
    """

    formats: Sequence[str] = ()
    report: bool = False
    script: bool = False
    whole: bool = False
    stored: bool = False
    simulation: str = ""
    force: bool = False


@dataclass(frozen=True)
class OpenedFile:
    """A file of the project's folder to open; empty for the results folder."""

    file: str = ""


@dataclass(frozen=True)
class ExportedFiles:
    """Files that were written, remarks, and values that an image does not store exactly."""

    files: Sequence[str]
    findings: Sequence[str]
    rounded: Sequence[RoundedRow]


def formats(session: Session) -> ExportFormats:
    """Return the extensions that values can be written as, those of the project first."""
    own = () if session.project is None else session.project.formats
    image = initial_image(session)
    special = (
        ".msq",
        ".par",
        *(ending for ending in (".esdl", ".axl", ".amd") if not _is_of_function(session, ending)),
        *(ending for ending in IMAGE_ENDINGS if image is None or image[0].suffix.lower() != ending),
    )
    known = [each for each in endings() if each not in special or each in own]
    return ExportFormats(
        formats=list(dict.fromkeys([*own, *known])),
        own=own,
        folder=str(_folder(session)),
        stored=(_folder(session) / RESULT).is_file(),
        opens=has_desktop(),
    )


def _is_of_function(session: Session, ending: str) -> bool:
    """Return True if the function's file has an ending, so that values can be written into a copy of it."""
    return session.project is not None and session.project.file.model.file.lower().endswith(ending)


def _folder(session: Session) -> Path:
    return session.path.parent / FOLDER


def export(session: Session, asked: ExportCommand) -> ExportedFiles | ExistingFile:
    """Write the present values into the results folder.

    Another file with the name of the script is replaced only with `force`; without it, nothing is written.
    """
    known = endings()
    for ending in asked.formats:
        if ending not in known:
            raise ArgumentError(f"unknown format {ending!r}")
    script = _script(session, asked) if asked.script else None
    if script is not None and not asked.force and _would_replace(*script):
        return ExistingFile(script[0].name)
    with ExitStack() as stack:
        evaluates = asked.simulation or asked.whole or asked.report or asked.stored
        project = stack.enter_context(session.evaluated()) if evaluates else session.project
        return _export(session, project, asked, script)


def open_file(session: Session, asked: OpenedFile) -> None:
    """Open a file of the project, or the results folder, on the desktop of the user.

    Raises:
        ArgumentError: it is not a file of the folder, of a kind that is not written here, or there is no desktop.
    """
    folder = _folder(session) if _folder(session).is_dir() else session.path.parent
    path = confined(session.path.parent, asked.file) if asked.file else folder.resolve()
    # a desktop runs files of other kinds, scripts for instance, that somebody has put into the folder
    if asked.file and path.suffix.lower() not in (*endings(), *SHOWN):
        raise ArgumentError(f"{path.name} is not of a kind that is opened here; open its folder instead")
    open_on_desktop(path)


def _script(session: Session, asked: ExportCommand) -> tuple[Path, str]:
    """Return the file of the script beside the project, and its text."""
    ending = next(iter(asked.formats), ".json")
    text = SCRIPT.format(project=session.path.name, parameters=f"parameters{ending}")
    return writable(session.path.parent, "calibrate.py"), text


def _would_replace(path: Path, text: str) -> bool:
    return path.exists() and not (path.is_file() and path.read_bytes() == text.encode())


def _export(
    session: Session, project: Project | None, asked: ExportCommand, script: tuple[Path, str] | None
) -> ExportedFiles:
    view = session.require_view()
    assert project is not None
    folder = results_folder(session.path)
    with convert_errors(folder, "cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
    values, findings, written = view.now.parameters.without(project.surrogates), list[Finding](), list[Path]()
    rounding: list[RoundedRow] = []
    for ending in asked.formats:
        path, (image, a2l) = writable(folder, f"parameters{ending}"), initial_image(session) or (None, None)
        image = image if is_image(path.name) else None
        own = project.change_of_function(values, ending)
        findings += [*write_parameters(own, path, image, a2l), *losses(own, path)]
        rounding += rounded(own, path, a2l)
        written.append(path)
    if asked.simulation:
        remarks = Findings()
        written.append(_write_simulation(session, project, asked.simulation, remarks))
        findings += remarks
    result = _result(session, project) if asked.whole or (asked.report and session.runs) else None
    if asked.whole and result is not None:
        from kennfeld.project.results import write

        written += write(result, project, folder)
        if session.validation is not None:
            text = json.dumps(session.validation.as_json(), indent=2, ensure_ascii=False, allow_nan=False)
            written.append(write_text(f"{text}\n", folder / "cross_validation.json"))
        if (terms := current_findings(session)) is not None:
            written.append(store_proposals(project, terms.drawn, terms.scope, result.parameters, folder))
    if asked.report:
        written.append(_write_report(session, project, result, folder))
    if asked.stored:
        written.append(_write_stored_report(project, folder))
    if script is not None:
        written.append(write_text(script[1], script[0]))
    files = [path.relative_to(session.path.parent).as_posix() for path in dict.fromkeys(written)]
    return ExportedFiles(files, list(dict.fromkeys(map(str, findings))), rounding)


def _write_simulation(session: Session, project: Project, ending: str, findings: Findings) -> Path:
    """Write every node over every dataset at the present values, as `kennfeld simulate` does."""
    from kennfeld.project.simulation_files import SIMULATIONS, write_simulation

    if ending not in SIMULATIONS:
        raise ArgumentError(f"unknown format {ending!r} of a simulation")
    simulation = project.simulation(session.require_view().now.parameters)
    return write_simulation(simulation, writable(session.path.parent, f"simulation{ending}"), findings=findings)


def _result(session: Session, project: Project) -> Result:
    """Return the last result with the present values, without what only the values and the data of the run have.

    Raises `InputError` if there was no run.
    """
    if not session.runs:
        raise InputError.of(Location(session.path.name), "there is no result yet", "Run the calibration first.")
    last, view = session.runs[-1], session.require_view()
    start, now = view.start.parameters, view.now.parameters
    scores = Scorer(project.problem()).scores(start, now)
    result = replace(last.result, parameters=now, start=start, quality=scores.quality, recordings=scores.recordings)
    change = _change_since(last, project, now)
    if not change:
        return result
    message = f"{change} run {last.number}, which ended with status {last.result.status}. Calibrate again."
    unknown = float("nan")
    return replace(
        result, status="stopped", message=message, cost_before=unknown, cost_after=unknown, starts=(), inspection=None,
        certificate=None,
    )  # fmt: skip


def _change_since(run: Run, project: Project, now: ParameterSet) -> str:
    """Return what has changed since a run ended; empty if its result is that of the present values and data."""
    if run.part:
        return f"Only {run.part} was fitted in"
    problem, result = project.problem(), run.result.parameters
    if run.problem is not None and run.problem is not problem:
        first, second = (problem_digest(each, project.options) for each in (run.problem, problem))
        if first != second:
            return "The project or its data have changed since"
    for name in problem.free_names:
        same = name in result and result[name].has_grid_of(now[name])
        if not same or not np.array_equal(result[name].values, now[name].values):
            return "The values differ from those of"
    return ""


def _write_stored_report(project: Project, folder: Path) -> Path:
    """Write the report on an earlier run, as `kennfeld report` does."""
    from kennfeld.report import from_folder

    return write_text(from_folder(project, folder), folder / "report.html")


def _write_report(session: Session, project: Project, result: Result | None, folder: Path) -> Path:
    from kennfeld.report import document
    from kennfeld.report.report_data import ReportedProposals

    terms = current_findings(session)
    proposals = None if terms is None else ReportedProposals(terms.drawn, terms.scope)
    return write_text(document(project, result, session.findings, proposals=proposals), folder / "report.html")
