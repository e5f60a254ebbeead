"""Bodies of the commands that `kennfeld.cli` declares. Each prints its results and returns an exit status.

What a command needs is imported inside it, so that `kennfeld --help` starts at once.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.errors import Finding, InputError
from kennfeld.terminal.output import aligned, print_findings, print_lines

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.optimize.result import Result
    from kennfeld.project import Project


DONE, NOT_CONVERGED, DIFFERENT, WRONG_INPUT, INTERRUPTED = 0, 1, 1, 2, 130

FOLDS = ("auto", "files", "blocks", "random")


def demo(name: str, folder: Path | None) -> int:
    """Write a demo project and calibrate it."""
    from kennfeld.project import Project
    from kennfeld.project.demo import closing, prepare, projects, write

    path = write(name, folder or Path(f"kennfeld-demo-{name}"))
    prepare(name, path.parent, print_lines)
    status = DONE
    for file, results in projects(name):
        status = max(status, _calibrate(Project.read(path.with_name(file)), path.parent / results))
        print_lines("")
    print_lines(*aligned(closing(name, path.parent)), "")
    print_lines(f"Next: look into {path}, change it, and run", f"  kennfeld calibrate {path}")
    return status


def check(path: Path) -> int:
    """Report the problems of a project or training file on stderr."""
    from kennfeld.optimize.projection import movable
    from kennfeld.project import Project
    from kennfeld.project.toml_file import is_training, read_toml

    if is_training(read_toml(path)):
        return _check_training(path)
    project = Project.read(path)
    findings = _warnings(project)
    print_findings(*findings)
    problem = project.problem()
    samples = [f"{data.counting.sum()} {data.use} samples in {data.name}" for data in problem.datasets]
    print_lines(f"{path}: {_verdict(findings)}")
    print_lines(f"{movable(problem)} values of {len(problem.free_names)} parameters to fit; {', '.join(samples)}")
    return DONE


def _check_training(path: Path) -> int:
    from kennfeld.project.surrogate_training import read_training

    training = read_training(path)
    datasets, findings = training.check()
    if any(finding.severity == "error" for finding in findings):
        raise InputError(findings)
    print_findings(*findings)
    samples = [f"{data.samples} {data.use} samples in {data.name}" for data in datasets]
    print_lines(f"{path}: a training file, {_verdict(findings)}")
    print_lines(f"{training.settings.kind} surrogate {training.formula}; {', '.join(samples)}")
    print_lines(f"Next: kennfeld surrogate train {path}")
    return DONE


def _verdict(findings: Sequence[Finding]) -> str:
    return "ready, with warnings" if any(f.severity == "warning" for f in findings) else "no problem found"


def _warnings(project: "Project") -> list[Finding]:
    """Return the warnings about a project; raise `InputError` if there are errors."""
    findings = project.check()
    if any(finding.severity == "error" for finding in findings):
        raise InputError(findings)
    return findings


def calibrate(path: Path, output: Path | None, workers: int | None, resume: bool, folds: int | None, parts: str) -> int:
    """Calibrate a project, write its results, and optionally cross-validate it."""
    from kennfeld.project import Project

    if folds is not None and folds < 2:
        raise InputError.of("--cross-validate", f"must be >= 2, got {folds}")
    if parts not in FOLDS:
        raise InputError.of("--parts", f"unknown kind of folds {parts!r}", "Write auto, files, blocks or random.")
    project, folder = Project.read(path), output or path.parent / "results"
    status = _calibrate(project, folder, workers, resume)
    if folds is None or status == INTERRUPTED:
        return status
    return max(status, _cross_validate(project, folder, folds, parts))


def _calibrate(project: "Project", folder: Path, workers: int | None = None, resume: bool = False) -> int:
    from kennfeld.project.fallback import write_somewhere
    from kennfeld.project.results import require_room
    from kennfeld.report import safely
    from kennfeld.terminal.progress import Interrupt, display

    require_room(folder)
    findings = _warnings(project)
    print_findings(*findings)
    if resume:
        print_findings(*project.saves(folder).found().findings)
    write_findings: list[Finding] = []
    try:
        with Interrupt() as interrupt:
            with display("compiling", project.file.optimizer.starts) as shown:
                result = project.calibrate(interrupt.watch(shown), folder=folder, workers=workers, resume=resume)
            extrapolations = _extrapolations(project, result)
            text = safely(project, result, findings, extrapolations)
            further = {"surrogates": [row.as_json() for row in extrapolations]} if extrapolations else None
            written = write_somewhere(result, project, folder, {"report.html": text}, further, write_findings)
    except KeyboardInterrupt:
        return _stop()
    _print_result(result, extrapolations)
    print_findings(*write_findings)
    _print_paths(project, result, written)
    if interrupt.pressed:
        return INTERRUPTED
    if any(finding.severity == "error" for finding in write_findings):
        return WRONG_INPUT
    return DONE if result.converged else NOT_CONVERGED


def _stop() -> int:
    print_findings("Stopped before there was anything to write.")
    return INTERRUPTED


def _extrapolations(project: "Project", result: "Result") -> "Sequence[Extrapolation]":
    if not project.surrogates:
        return ()
    from kennfeld.analysis.extrapolation import find_extrapolation
    from kennfeld.optimize.tuning.shift_estimation import apply_shifts

    return find_extrapolation(apply_shifts(project.problem(), result.shifts), result.parameters)


def _print_result(result: "Result", extrapolations: "Sequence[Extrapolation]") -> None:
    from kennfeld.terminal.result_lines import choice_lines, extrapolation_lines, undetermined_lines

    print_lines(*aligned(result.table()), "")
    if len(result.starts) > 1:
        print_lines(*aligned(result.starts_table()), "")
    print_lines(f"{result.status}: {result.message}")
    print_findings(*result.warnings)
    print_lines(*choice_lines(result))
    print_lines(f"{result.free_values} values, {result.iterations} iterations, {result.seconds.total:.2f} s")
    print_lines(*undetermined_lines(result.trust), *extrapolation_lines(extrapolations))


def _print_paths(project: "Project", result: "Result", written: Sequence[Path]) -> None:
    from kennfeld.calfiles.json_file import write_json

    if written:
        print_lines(f"Written to {written[0].parent}: {', '.join(path.name for path in written)}")
    else:
        print_lines("The values, as parameters.json:", write_json(result.parameters.without(project.surrogates), "-"))


def _cross_validate(project: "Project", folder: Path, folds: int, parts: Any) -> int:
    from kennfeld.analysis.cross_validation import cross_validated
    from kennfeld.project.results import write_text
    from kennfeld.terminal.progress import Interrupt, display

    try:
        with Interrupt() as interrupt, display("compiling") as shown:
            validation = cross_validated(project.problem(), folds, parts, 0, project.options, interrupt.watch(shown))
    except KeyboardInterrupt:
        return _stop()
    text = json.dumps(validation.as_json(), indent=2, ensure_ascii=False, allow_nan=False)
    print_lines("", *aligned(validation.table()), "", *validation.summary())
    path = write_text(f"{text}\n", folder / "cross_validation.json")
    print_lines(f"Written to {path}")
    return INTERRUPTED if interrupt.pressed else DONE


def simulate(path: Path, parameters: Path | None, output: Path | None) -> int:
    """Simulate a project over all of its datasets and write the result."""
    from kennfeld.calfiles import read
    from kennfeld.project import Project
    from kennfeld.project.results import write_simulation

    project = Project.read(path)
    values = None if parameters is None else read(parameters)
    datasets = project.simulate(values)
    written = write_simulation(datasets, output or path.parent / "simulation.parquet")
    print_lines(*(f"{data.name}: {data.samples} samples" for data in datasets))
    if project.surrogates:
        from kennfeld.analysis.extrapolation import find_extrapolation
        from kennfeld.project.project import replace_parameters
        from kennfeld.terminal.result_lines import extrapolation_lines

        problem = project.problem()
        print_lines(*extrapolation_lines(find_extrapolation(problem, replace_parameters(problem, values)), ""))
    print_lines(f"Written to {written}")
    return DONE


def report(path: Path, output: Path | None, results: Path | None) -> int:
    """Write the report on the results of an earlier run."""
    from kennfeld.project import Project
    from kennfeld.project.results import write_text
    from kennfeld.report import from_folder

    folder = results or path.parent / "results"
    text = from_folder(Project.read(path), folder)
    print_lines(f"Written to {write_text(text, output or folder / 'report.html')}")
    return DONE


def info(
    path: Path,
    as_json: bool,
    search: str,
    a2l: Path | None,
    subsystem: str,
    values: Sequence[Path],
    folders: Sequence[Path],
    bind: Sequence[str],
) -> int:
    """Print the contents of a file."""
    from kennfeld.terminal.describers import SimulinkSelection
    from kennfeld.terminal.file_info import describe_file
    from kennfeld.terminal.label_search import find_entries

    shown = describe_file(path, a2l, SimulinkSelection(subsystem, values, folders, _bindings(bind)))
    if search.strip():
        shown = find_entries(shown, search)
    print_lines(*([json.dumps(shown.as_json, indent=2)] if as_json else shown.lines()))
    return DONE


def _bindings(texts: Sequence[str]) -> Mapping[str, str]:
    """Return formulas by the path of the block that each replaces, from texts of the form `PATH=FORMULA`."""
    pairs = [text.partition("=") for text in texts]
    if incomplete := [path for path, sign, _ in pairs if not sign]:
        remedy = 'Write "PATH=FORMULA", such as "Sensor/Radiation=0.15 * (t - 20)".'
        raise InputError(Finding(f"--bind {path}", "has no formula", remedy) for path in incomplete)
    return {path.strip(): formula.strip() for path, _, formula in pairs}


def convert(
    source: Path,
    target: Path,
    image: Path | None,
    a2l: Path | None,
    subsystem: str,
    values: Sequence[Path],
    folders: Sequence[Path],
    bind: Sequence[str],
    force: bool,
) -> int:
    """Convert a calibration file into another format, or a Simulink model into formula text."""
    from kennfeld import calfiles

    is_model = source.suffix.lower() in (".slx", ".mdl", ".slxp")
    companion = [target.with_suffix(".json")] if is_model and target.suffix.lower() == ".kf" else []
    _require_new(force, target, *companion)
    if is_model:
        from kennfeld.models.simulink.formula_export import write_formula

        paths = write_formula(source, target, subsystem, values, folders, _bindings(bind))
        print_lines(*(f"Written to {path}" for path in paths))
        return DONE
    [parameters], remarks = calfiles.read_several([source], a2l)
    print_findings(*remarks)
    print_findings(*calfiles.write(parameters, target, image, a2l), *calfiles.losses(parameters, target))
    print_lines(f"Written to {target}")
    return DONE


def _require_new(force: bool, *targets: Path) -> None:
    existing = [target for target in targets if not force and target.exists() and not target.is_dir()]
    if existing:
        remedy = "Add --force to replace it, or name another file."
        raise InputError(Finding(str(target), "already exists", remedy) for target in existing)


def diff(left: Path, right: Path, tolerance: float, relative: float, as_json: bool, a2l: Path | None) -> int:
    """Print the differences between two calibration files."""
    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import difference_lines, file_labels

    tolerances = calfiles.Tolerance(tolerance, relative)
    (first, second), remarks = calfiles.read_several([left, right], a2l)
    print_findings(*remarks)
    comparison = calfiles.compare(first, second, tolerances)
    if as_json:
        head = {"left": str(left), "right": str(right), "equal": comparison.equal, "compared": comparison.compared}
        differences = [difference.as_json for difference in comparison.differences]
        print_lines(json.dumps(head | {"differences": differences}, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        left_label, right_label = file_labels([left, right])
        print_lines(*difference_lines(comparison, left_label, right_label))
    return DONE if comparison.equal else DIFFERENT


def merge(sources: Sequence[Path], target: Path, a2l: Path | None, force: bool) -> int:
    """Merge calibration files and print what was replaced or added."""
    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import change_lines, file_labels

    if len(sources) < 2:
        raise InputError.of("merge", f"needs at least two files, got only {sources[0]}", "Name another file.")
    _require_new(force, target)
    sets, remarks = calfiles.read_several(sources, a2l)
    print_findings(*remarks)
    merged = calfiles.merge(list(zip(file_labels(sources), sets, strict=True)))
    print_findings(*calfiles.write(merged.parameters, target), *calfiles.losses(merged.parameters, target))
    print_lines(*change_lines(merged.changes), "", f"Written to {target}")
    return DONE


def train(path: Path) -> int:
    """Train a surrogate and write it as one file."""
    from kennfeld.project.surrogate_training import read_training
    from kennfeld.surrogate.surrogate_file import write_surrogate
    from kennfeld.terminal.result_lines import summarize_surrogate

    training = read_training(path)
    surrogate = training.train(print_lines)
    print_lines(*summarize_surrogate(surrogate), "")
    write_surrogate(surrogate, training.target)
    print_lines(f"Written to {training.target}")
    return DONE
