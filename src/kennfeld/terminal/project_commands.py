"""Commands on projects: demo, check, calibrate, simulate, report, train. Each returns an exit status.

What a command needs is imported inside it, so that `kennfeld --help` starts at once.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kennfeld.base.errors import Finding, Findings, InputError, KennfeldError, Location
from kennfeld.base.formatting import count_noun
from kennfeld.terminal.command_line import (
    DONE,
    INTERRUPTED,
    NOT_CONVERGED,
    PATH,
    WRONG_INPUT,
    argument,
    as_json,
    only_problems,
    option,
    optional_project_file,
    project_file,
    trusted,
)
from kennfeld.terminal.opened_project import opened_project
from kennfeld.terminal.output import (
    align,
    findings_json,
    is_quiet,
    print_findings,
    print_lines,
    print_progress,
    print_values,
)
from kennfeld.terminal.project_argument import find_project

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.analysis.missing.hints import Hints
    from kennfeld.domain.parameter_set import ParameterSet
    from kennfeld.optimize.fit.result import Result
    from kennfeld.project import Project
    from kennfeld.project.simulation import Simulation

FOLDS = ("auto", "files", "blocks", "random")
by_file = option("--by-file", "Print the errors and the worst stretch of each file, the worst first.")


def _demo_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    from kennfeld.project.demo import NAMES

    return [name for name in NAMES if name.startswith(incomplete)]


@click.command
@argument(
    *("name", "[NAME]", "torque, exhaust or idle.  [default: torque]"),
    type=str,
    default="torque",
    shell_complete=_demo_names,
)
@option("--dir folder", "Folder to create.", "DIR", "kennfeld-demo-NAME", type=PATH)
@only_problems
def demo(name: str, folder: Path | None) -> int:
    """Write an example project with its data, and calibrate it."""
    from kennfeld.project import Project
    from kennfeld.project.demo import all_or_none, closing, prepare, projects, write

    target = folder or Path(f"kennfeld-demo-{name}")
    with all_or_none(target):
        path = write(name, target)
        prepare(name, path.parent, print_lines)
    status = DONE
    for file, results in projects(name):
        status = max(status, _calibrate(Project.read(path.with_name(file)), path.parent / results))
        print_lines("")
    print_lines(*align(closing(name, path.parent)), "")
    print_lines(f"Next: look into {path}, change it, and run", f"  kennfeld calibrate {path}")
    return status


@click.command
@optional_project_file
@option("--port", "Port of the server.", "N", "a free one", type=click.IntRange(0, 65535), default=0)
@option("--no-browser", "Do not open the browser.")
def app(path: Path | None, port: int, no_browser: bool) -> int:
    """Open the web app: calibrate without writing files.

    The first line on stdout is the address of the page, which only this user can open. Ctrl-C ends it.
    """
    from kennfeld.app.launch import launch

    launch(path, port, browser=not no_browser)
    return DONE


@click.command
@project_file
@option("--no-run", "Run no code of FMUs and Python files; name the checks that would need it.")
@trusted
@as_json
def check(path: Path, no_run: bool, trust: bool, as_json: bool) -> int:
    """Report all problems of a project or training file.

    The first 20 are printed on stderr, with location and fix; --json prints all on stdout. Nothing is fitted, and no
    scheduler is joined.
    """
    from kennfeld.optimize.limits.projection import movable
    from kennfeld.project.toml_file import is_training, read_toml

    if is_training(read_toml(path)):
        return _check_training(path, as_json)
    with opened_project(path, trust=trust, run=not no_run, connect=False) as project:
        findings = project.check() if not no_run else [*project.check(), *_unchecked(project)]
        # without errors, stdout gets all findings as JSON, and stderr none
        verdict = _print_warnings([] if as_json and not _has_errors(findings) else findings)
        problem = project.problem()
    if as_json:
        print_lines(findings_json(findings))
        return DONE
    samples = [f"{data.counting.sum()} {data.use} samples in {data.name}" for data in problem.datasets]
    if problem.partitions is not None:
        samples = [f"{problem.partitions.samples} training samples in {len(problem.partitions.training)} partitions"]
    print_lines(f"{path}: {verdict}")
    values = f"{count_noun(movable(problem), 'value')} of {count_noun(len(problem.free_names), 'parameter')}"
    print_lines(f"{values} to fit; {', '.join(samples)}")
    return DONE


def _unchecked(project: "Project") -> Iterator[Finding]:
    """Yield a remark on the code that was not run; nothing if the project has errors."""
    from kennfeld.terminal.foreign_code import unchecked_code

    with suppress(InputError):
        yield from unchecked_code(project.problem().graph.nodes, project.path)


def _has_errors(findings: Sequence[Finding]) -> bool:
    return any(finding.severity == "error" for finding in findings)


def _check_training(path: Path, as_json: bool) -> int:
    from kennfeld.project.surrogate_training import read_training

    training = read_training(path)
    datasets, findings = training.check()
    if as_json and not _has_errors(findings):
        print_lines(findings_json(findings))
        return DONE
    verdict = _print_warnings(findings)
    samples = [f"{data.samples} {data.use} samples in {data.name}" for data in datasets]
    print_lines(f"{path}: a training file, {verdict}")
    print_lines(f"{training.settings.kind} surrogate {training.formula}; {', '.join(samples)}")
    print_lines(f"Next: kennfeld surrogate train {path}")
    return DONE


def _print_warnings(findings: Sequence[Finding]) -> str:
    """Print findings and return a verdict on the project; raise `InputError` with all of them if there are errors."""
    severities = {finding.severity for finding in findings}
    if "error" in severities:
        raise InputError(findings)
    print_findings(*findings)
    return "ready, with warnings" if "warning" in severities else "no problem found"


@click.command
@project_file
@option("-o --output", "Folder for the results.", "DIR", "results/ next to the project file", type=PATH)
@option(
    *("--workers", "Number of processes for several starts, or for partitions.", "N", "one per core"),
    type=click.IntRange(1),
)
@option("--scheduler", "Dask scheduler to use, instead of that in [cluster].", "ADDRESS")
@option(
    *("--max-seconds", "Stop the search after this time, with the best values so far.", "S", "that in [optimizer]"),
    type=click.FloatRange(0, min_open=True),
)
@option("--resume", "Resume from the checkpoints in the results folder (see save_every).")
@option("--cross-validate folds", "After calibrating, run K-fold cross-validation.", "K", type=int)
@option("--parts", "How to form the folds: auto, files, blocks or random.", "KIND", True, default="auto")
@by_file
@trusted
@only_problems
def calibrate(
    path: Path,
    output: Path | None,
    workers: int | None,
    scheduler: str | None,
    max_seconds: float | None,
    resume: bool,
    folds: int | None,
    parts: str,
    by_file: bool,
    trust: bool,
) -> int:
    """Fit the free parameters to the data and write the results.

    Ctrl-C, SIGTERM and SIGHUP stop the search; the best values so far are written.
    """
    from kennfeld.project.results import results_folder

    if folds is not None and folds < 2:
        raise InputError.of(Location("--cross-validate"), f"must be >= 2, got {folds}")
    if parts not in FOLDS:
        message = f"unknown kind of folds {parts!r}"
        raise InputError.of(Location("--parts"), message, "Write auto, files, blocks or random.")
    folder = results_folder(path, output)
    with opened_project(path, scheduler, workers, trust=trust) as project:
        status = _calibrate(project, folder, workers, max_seconds, resume, by_file)
        if folds is None or status == INTERRUPTED:
            return status
        return max(status, _cross_validate(project, folder, folds, parts))


def _calibrate(
    project: "Project",
    folder: Path,
    workers: int | None = None,
    max_seconds: float | None = None,
    resume: bool = False,
    by_file: bool = False,
) -> int:
    from kennfeld.analysis.extrapolation import find_extrapolation
    from kennfeld.optimize.tuning.shift_estimation import apply_shifts
    from kennfeld.project.fallback import write_somewhere
    from kennfeld.project.results import require_room
    from kennfeld.report import document_safely
    from kennfeld.terminal.progress import Interrupt, display
    from kennfeld.terminal.result_lines import resume_lines

    # before the search, whose result would be lost in a folder that cannot be written
    require_room(folder)
    findings = project.check()
    _print_warnings(findings)
    if resume:
        points = project.saves(folder).resume_points()
        print_findings(*points.findings)
        for line in resume_lines(points.states, project.file.optimizer.starts):
            print_progress(line)
    write_findings = Findings()
    try:
        # the report and the files are written within it, so that the first Ctrl-C does not leave half of them
        with Interrupt() as interrupt:
            with display("compiling", project.file.optimizer.starts) as shown:
                result = project.calibrate(
                    interrupt.watch(shown), folder=folder, workers=workers, resume=resume, max_seconds=max_seconds
                )
            # inputs shifted as in the fit, which has estimated by how much
            extrapolations = find_extrapolation(apply_shifts(project.problem(), result.shifts), result.parameters)
            missing = _hints(project, result)
            text = document_safely(project, result, findings, extrapolations, missing)
            further: dict[str, Any] = {}
            if extrapolations:
                further["surrogates"] = [row.as_json() for row in extrapolations]
            further |= {} if missing is None else {"missing": missing.as_json()}
            written = write_somewhere(result, project, folder, {"report.html": text}, further, write_findings)
    except KeyboardInterrupt:
        return _stop()
    _print_result(result, findings, extrapolations, by_file, project.path)
    print_lines(*([] if missing is None else missing.lines()))
    print_findings(*write_findings)
    _print_paths(project, result, written)
    if interrupt.pressed:
        return INTERRUPTED
    if write_findings.has_errors:
        return WRONG_INPUT
    return DONE if result.converged else NOT_CONVERGED


def _hints(project: "Project", result: "Result") -> "Hints | None":
    """Return what the function or the search lacks; None if that cannot be computed."""
    from kennfeld.analysis.missing.hints import hints

    # a result is never lost over this
    with suppress(ArithmeticError, ValueError, KennfeldError):
        return hints(project.problem(), result)
    return None


def _stop() -> int:
    print_findings("Stopped before there was anything to write.")
    return INTERRUPTED


def _print_result(
    result: "Result", known: Sequence[Finding], extrapolations: "Sequence[Extrapolation]", by_file: bool, path: Path
) -> None:
    """Print a result, without the warnings that the check has printed before."""
    from kennfeld.optimize.trust.undetermined import undetermined_lines
    from kennfeld.terminal.result_lines import MORE, choice_lines, extrapolation_lines

    print_lines(*align(result.table()), "")
    if result.rounding is not None:
        print_lines(*align(result.rounding.table()), *result.rounding.advice(), "")
    if by_file:
        print_lines(*align(result.recordings_table()), "")
    if len(result.starts) > 1:
        print_lines(*align(result.starts_table()), "")
    print_lines(f"{result.status}: {result.message}")
    # the line above is not printed if quiet
    if is_quiet() and not result.converged:
        print_findings(Finding(Location(), f"{result.status}: {result.message}", severity="warning"))
    reported = {finding.message for finding in known}
    print_findings(*(each for each in result.warnings if each.message not in reported))
    print_lines(*choice_lines(result))
    print_lines(f"{result.free_values} values, {result.iterations} iterations, {result.seconds.total:.2f} s")
    settle = f"kennfeld design {Location.of_file(path)} --direction 1"
    print_lines(*undetermined_lines(result.trust, MORE, settle), *extrapolation_lines(extrapolations))


def _print_paths(project: "Project", result: "Result", written: Sequence[Path]) -> None:
    from kennfeld.calfiles.json_file import write_json

    if written:
        print_lines(f"Written to {written[0].parent}: {', '.join(path.name for path in written)}")
    else:
        print_values("The values, as parameters.json:", write_json(result.parameters.without(project.surrogates), "-"))


def _cross_validate(project: "Project", folder: Path, folds: int, parts: Any) -> int:
    from kennfeld.analysis.cross_validation import cross_validate
    from kennfeld.project.fallback import write_validation_somewhere
    from kennfeld.project.results import RESULT, write_text
    from kennfeld.report import from_folder
    from kennfeld.terminal.progress import Interrupt, display

    try:
        with Interrupt() as interrupt, display("compiling") as shown:
            progress, options = interrupt.watch(shown), project.options
            validation = cross_validate(project.problem(), folds=folds, kind=parts, options=options, progress=progress)
    except KeyboardInterrupt:
        return _stop()
    print_lines("", *align(validation.table()), "", *validation.summary(), *validation.conclusions())
    findings = Findings()
    written = [*write_validation_somewhere(validation.as_json(), folder, findings)]
    if not findings.has_errors and (folder / RESULT).is_file():
        # the report shows the validation as well
        written.append(write_text(from_folder(project, folder), folder / "report.html"))
    print_findings(*findings)
    if written:
        print_lines(f"Written to {', '.join(map(str, written))}")
    if interrupt.pressed:
        return INTERRUPTED
    return WRONG_INPUT if findings.has_errors else DONE


@click.command
@project_file
@option("-p --parameters", "Calibration file to use.", "FILE", "the project's initial values", type=PATH)
@option(
    "-o --output",
    "Output file, .parquet, .csv, .mf4 or .mat.",
    "FILE",
    "simulation.parquet next to the project file",
    type=PATH,
)
@option("--deviation", "Add a column with the predictive deviation of each surrogate.")
@by_file
@as_json
@trusted
@only_problems
def simulate(
    path: Path,
    parameters: Path | None,
    output: Path | None,
    deviation: bool,
    by_file: bool,
    as_json: bool,
    trust: bool,
) -> int:
    """Evaluate the function over all datasets.

    .mf4 and .mat hold each recording with its own time stamps: nodes, targets, errors and inputs.
    """
    from kennfeld.project.replaced_values import replaced_value_findings
    from kennfeld.project.results import output_file
    from kennfeld.project.simulation_files import require_simulation_format, write_simulation

    target = output_file(path, output or path.parent / "simulation.parquet")
    require_simulation_format(target)
    with opened_project(path, trust=trust) as project:
        values = None
        if parameters is not None:
            values, skipped_values = project.read_values_with_findings(parameters)
            print_findings(*skipped_values)
        shifts = _stored_shifts(project, parameters)
        simulation = project.simulation(values, shifts, deviation=deviation)
        remarks = Findings()
        if values is not None and parameters is not None:
            remarks.add(*replaced_value_findings(project.problem(), values, Location(parameters.name)))
        # a link that the user has named stays one; any other is replaced by the file
        written = write_simulation(simulation, target, follow=output is not None, findings=remarks)
        print_findings(*remarks, *map(_unknown_deviation, simulation.without_deviation))
        locations = {entry.name: entry.location for entry in project.file.datasets}
        for name, skipped in simulation.skipped.items():
            print_findings(skipped.finding(locations.get(name, Location(f"dataset {name}"))))
        if as_json:
            print_values(json.dumps(_as_dict(simulation, written), indent=2))
            return DONE
        print_lines(*(f"{name}: {samples} samples" for name, samples in simulation.samples.items()))
        _print_fit(project, values, shifts, by_file)
    print_lines(f"Written to {written}")
    return DONE


def _unknown_deviation(surrogate: str) -> Finding:
    message = "its deviation is not known, so no column is written"
    remedy = "Train it with `kennfeld surrogate train`."
    return Finding(Location(f"surrogate {surrogate}"), message, remedy, severity="warning")


def _as_dict(simulation: "Simulation", written: Path) -> dict[str, Any]:
    """Return the numbers of samples of a simulation, and those that are skipped, for JSON."""
    datasets = [
        {"name": name, "samples": samples, "skipped": skipped.as_dict() if skipped else None}
        for name, samples in simulation.samples.items()
        for skipped in [simulation.skipped.get(name)]
    ]
    return {"file": str(written), "datasets": datasets}


def _print_fit(
    project: "Project", values: "ParameterSet | None", shifts: "Mapping[str, Mapping[str, float]]", by_file: bool
) -> None:
    """Print the errors by file on request, and the use of surrogates outside their training data."""
    if not (by_file or project.surrogates):
        return
    from kennfeld.optimize.tuning.shift_estimation import apply_shifts
    from kennfeld.project.simulation import replace_parameters

    problem = apply_shifts(project.problem(), shifts)
    parameters = replace_parameters(problem, values)
    if by_file:
        from kennfeld.optimize.quality.quality import Scorer
        from kennfeld.optimize.quality.recording_quality import recordings_table

        rows = Scorer(problem).scores(parameters, parameters).recordings
        print_lines("", *align(recordings_table(rows, before=False)), "")
    if project.surrogates:
        from kennfeld.analysis.extrapolation import find_extrapolation
        from kennfeld.terminal.result_lines import extrapolation_lines

        print_lines(*extrapolation_lines(find_extrapolation(problem, parameters), ""))


def _stored_shifts(project: "Project", parameters: Path | None) -> dict[str, dict[str, float]]:
    """Return the estimated shifts of the result that calibrated values belong to, and print them."""
    from kennfeld.project.results import RESULT, read_shifts

    sought = project.problem().unknown_shifts
    stored = read_shifts(parameters.parent) if sought and parameters is not None else {}
    shifts = {name: own for name, own in stored.items() if name in sought}
    if parameters is not None:
        place = parameters.parent / RESULT
        print_lines(
            *(
                f"shift of {channel} in {name}: {by:g}, from {place}"
                for name, own in shifts.items()
                for channel, by in own.items()
            )
        )
    for name in sought:
        if name not in shifts:
            message = 'channels with shift = "auto" are not shifted'
            remedy = "Use parameters in the results folder of a calibration, or write numbers."
            print_findings(Finding(Location(f"dataset {name}"), message, remedy, severity="warning"))
    return shifts


@click.command
@project_file
@option("-o --output", "Output file, .html.", "FILE", "report.html in the results folder", type=PATH)
@option("-r --results", "Folder of the results.", "DIR", "results/ next to the project file", type=PATH)
@option("--title", "Heading of the report, instead of that in [report].", "TEXT", may_be_empty=True)
@option("--author", "Author of the calibration, instead of that in [report].", "TEXT", may_be_empty=True)
@only_problems
@option("--comment", "Text below the heading, instead of that in [report].", "TEXT", may_be_empty=True)
@trusted
def report(path: Path, output: Path | None, results: Path | None, trust: bool, **heading: str | None) -> int:
    """Write the report on the results of an earlier run.

    Without results, it covers the initial values only.
    """
    from kennfeld.project.results import output_file, results_folder, write_text
    from kennfeld.report import from_folder

    folder = results_folder(path, results)
    target = folder / "report.html" if output is None else output_file(path, output)
    with opened_project(path, trust=trust) as project:
        changed = {name: text for name, text in heading.items() if text is not None}
        text = from_folder(project, folder, replace(project.file.report, **changed))
    print_lines(f"Written to {write_text(text, target, follow=output is not None)}")
    return DONE


@click.command
@argument("path", "FILE", "The training file, surrogate.toml.")
@only_problems
def train(path: Path) -> int:
    """Train a surrogate on recordings and write it as a file that projects can use.

    Ctrl-C, SIGTERM and SIGHUP stop the training; the best surrogate so far is written.
    """
    from kennfeld.project.fallback import write_surrogate_somewhere
    from kennfeld.project.surrogate_training import read_training
    from kennfeld.surrogate.surrogate_file import surrogate_notes
    from kennfeld.terminal.progress import Interrupt
    from kennfeld.terminal.surrogate_lines import describe_surrogate, quality_table

    training = read_training(find_project(path, "a training file"))
    try:
        with Interrupt() as interrupt:
            surrogate = training.train(print_lines, interrupt.stopped, print_findings)
            findings = Findings()
            written = write_surrogate_somewhere(surrogate, training.target, findings)
    except KeyboardInterrupt:
        return _stop()
    print_lines(describe_surrogate(surrogate), *surrogate_notes(surrogate))
    print_lines("", *align(quality_table(surrogate)), "")
    print_findings(*findings)
    if written is not None:
        print_lines(f"Written to {written}")
    if findings.has_errors:
        return WRONG_INPUT
    if interrupt.pressed:
        message = "the training was stopped; the surrogate is the best so far"
        print_findings(Finding(Location(training.target.name), message, "Train again.", severity="warning"))
        return INTERRUPTED
    return DONE
