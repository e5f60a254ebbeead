"""The commands. What they need is loaded inside them, so that `kennfeld --help` answers at once."""

import gc
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kennfeld import __version__
from kennfeld.errors import Finding, InputError, KennfeldError
from kennfeld.terminal.output import print_findings, print_lines
from kennfeld.terminal.signals import end_like_ctrl_c

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.optimize import Result
    from kennfeld.project import Project

__all__ = ["app", "main", "run"]

DONE, NOT_CONVERGED, DIFFERENT, WRONG_INPUT, INTERRUPTED = 0, 1, 1, 2, 130

app = typer.Typer(
    name="kennfeld",
    help="Calibrate sensor models of engine control units: formula and measurement in, curves and maps out.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ProjectFile = Annotated[
    Path, typer.Argument(metavar="PROJECT", help="The project file, kennfeld.toml.", show_default=False)
]

Subsystem = Annotated[
    str, typer.Option("--subsystem", help="The part of a Simulink model.", show_default=False, metavar="PATH")
]
Folders = Annotated[
    list[Path] | None,
    typer.Option(
        "--folder",
        help="Where a Simulink model's libraries are, besides beside it; repeatable.",
        show_default=False,
        metavar="FOLDER",
    ),
]
VariableFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--parameters", help="Values of a Simulink model's variables; repeatable.", show_default=False, metavar="FILE"
    ),
]
Bindings = Annotated[
    list[str] | None,
    typer.Option(
        "--bind",
        help='A channel or formula in place of a block of a Simulink model, "PATH=FORMULA"; repeatable.',
        show_default=False,
        metavar="BINDING",
    ),
]
DescriptionFile = Annotated[
    Path | None,
    typer.Option(
        "--a2l", help="Describes an image (.hex, .s19).", show_default="the A2L file beside it", metavar="FILE"
    ),
]

Force = Annotated[bool, typer.Option("--force", help="Replace files that exist already.")]


def main() -> None:
    """The command `kennfeld`; ends the process."""
    gc.set_threshold(200_000, 50, 50)  # a short process leaves little to collect; looking for it takes a tenth of it
    end_like_ctrl_c()
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run a command line and give its exit status.

    0 done, 1 not converged or files differ, 2 wrong input, 130 after Ctrl-C, SIGTERM or SIGHUP.
    """
    try:
        return app(list(arguments) or ["--help"], prog_name="kennfeld", standalone_mode=False) or DONE
    except InputError as error:
        print_findings(*error.findings)
    except (KennfeldError, typer.TyperException) as error:
        print_findings(_sentence(error))
    except OSError as error:
        print_findings(f"{error.filename or 'the system'}: {error.strerror or error}")
    except MemoryError as error:
        print_findings(
            f"There is not enough memory{f' ({error})' if str(error) else ''}. Use fewer samples or breakpoints."
        )
    except typer.Abort as abort:
        if isinstance(abort.__cause__, EOFError):  # which typer takes for the end of what somebody types
            raise abort.__cause__ from None
        return INTERRUPTED
    except KeyboardInterrupt:
        return INTERRUPTED
    return WRONG_INPUT


def _sentence(error: Exception) -> str:
    if isinstance(error, KennfeldError):
        return str(error)
    said = getattr(error, "format_message", error.__str__)().strip()
    context = getattr(error, "ctx", None)
    end = "" if said.endswith((".", "?", "!")) else "."
    return f"{said}{end} See {context.command_path if context else 'kennfeld'} --help."


def _show_version(wanted: bool) -> None:
    if wanted:
        print_lines(f"kennfeld {__version__}")
        raise typer.Exit


surrogates = typer.Typer(help="Data-driven models: trained on recordings, called in formula text.")
app.add_typer(surrogates, name="surrogate")


@surrogates.command()
def train(
    path: Annotated[
        Path, typer.Argument(metavar="FILE", help="The training file, surrogate.toml.", show_default=False)
    ],
) -> int:
    """Train a data-driven model on recordings, and write it as one file that a project can name."""
    from kennfeld.project.surrogate_training import read_training
    from kennfeld.surrogate import write_surrogate
    from kennfeld.terminal.result_lines import summary

    training = read_training(path)
    made = training.train(lambda line: print_lines(line))
    print_lines(*summary(made), "")
    write_surrogate(made, training.target)
    print_lines(f"Written to {training.target}")
    return DONE


@app.callback()
def _kennfeld(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    name: Annotated[str, typer.Argument(help="Which demo: torque, exhaust or idle.")] = "torque",
    folder: Annotated[
        Path | None,
        typer.Option("--dir", help="Folder to write it to.", show_default="kennfeld-demo-NAME", metavar="DIR"),
    ] = None,
) -> int:
    """Write a ready project with its data, and run it."""
    from kennfeld.project import Project
    from kennfeld.project.demo import closing, prepare, projects, write
    from kennfeld.terminal.output import aligned

    path = write(name, folder or Path(f"kennfeld-demo-{name}"))
    prepare(name, path.parent, print_lines)
    status = DONE
    for file, results in projects(name):
        status = max(status, _calibrate(Project.read(path.with_name(file)), path.parent / results))
        print_lines("")
    print_lines(*aligned(closing(name, path.parent)), "")
    print_lines(f"Next: look into {path}, change it, and run", f"  kennfeld calibrate {path}")
    return status


@app.command()
def check(path: ProjectFile) -> int:
    """Name every problem of a project and its files, or of a training file.

    Each comes with its place and the mend, on stderr; nothing is fitted.
    """
    from kennfeld.optimize.projection import movable
    from kennfeld.project import Project
    from kennfeld.project.toml_file import is_training, read_toml

    if is_training(read_toml(path)):
        return _check_training(path)
    project = Project.read(path)
    findings = _sound(project)
    print_findings(*findings)
    problem = project.problem()
    samples = [f"{data.counting.sum()} {data.use} samples in {data.name}" for data in problem.datasets]
    print_lines(f"{path}: {_soundness(findings)}")
    print_lines(f"{movable(problem)} values of {len(problem.free_names)} parameters to fit; {', '.join(samples)}")
    return DONE


def _soundness(findings: Sequence[Finding]) -> str:
    return "ready, with warnings" if any(f.severity == "warning" for f in findings) else "no problem found"


def _check_training(path: Path) -> int:
    from kennfeld.project.surrogate_training import read_training

    training = read_training(path)
    datasets, findings = training.check()
    if any(finding.severity == "error" for finding in findings):
        raise InputError(findings)
    print_findings(*findings)
    settings = training.settings
    called = f"{settings.output} = {settings.name}({', '.join(settings.inputs)})"
    samples = [f"{data.samples} {data.use} samples in {data.name}" for data in datasets]
    print_lines(f"{path}: a training file, {_soundness(findings)}")
    print_lines(f"{settings.kind} surrogate {called}; {', '.join(samples)}")
    print_lines(f"Next: kennfeld surrogate train {path}")
    return DONE


@app.command()
def calibrate(
    path: ProjectFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Folder for the results.", show_default="results beside the project", metavar="DIR"
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(help="Processes for several starts.", min=1, show_default="one a core", metavar="N"),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the states that save_every kept in the results folder.")
    ] = False,
    folds: Annotated[
        int | None,
        typer.Option(
            "--cross-validate", help="Then hold back each of K parts in turn.", show_default=False, metavar="K"
        ),
    ] = None,
    parts: Annotated[
        str, typer.Option("--parts", help="What is held back: auto, files, blocks or random.", metavar="KIND")
    ] = "auto",
) -> int:
    """Find the values that fit best, and write them.

    Ctrl-C stops at the best values so far and still writes the results; so do SIGTERM and SIGHUP.
    """
    from kennfeld.project import Project

    if folds is not None and folds < 2:
        raise InputError.of("--cross-validate", f"{folds} is no number of parts", "Write 2 or more.")
    if parts not in ("auto", "files", "blocks", "random"):
        raise InputError.of("--parts", f"{parts!r} is unknown", "Write auto, files, blocks or random.")
    project, folder = Project.read(path), output or path.parent / "results"
    status = _calibrate(project, folder, workers, resume)
    if folds is None or status == INTERRUPTED:
        return status
    return max(status, _cross_validate(project, folder, folds, parts))


def _cross_validate(project: "Project", folder: Path, folds: int, parts: Any) -> int:
    import json

    from kennfeld.analysis import cross_validated
    from kennfeld.project.results import write_text
    from kennfeld.terminal.output import aligned
    from kennfeld.terminal.progress import Interrupt, display

    try:
        with Interrupt() as interrupt, display("compiling") as shown:
            found = cross_validated(project.problem(), folds, parts, 0, project.options, interrupt.watch(shown))
    except KeyboardInterrupt:
        print_findings("Stopped before there was anything to write.")
        return INTERRUPTED
    text = json.dumps(found.as_json(), indent=2, ensure_ascii=False, allow_nan=False)
    print_lines("", *aligned(found.table()), "", *found.summary())
    path = write_text(f"{text}\n", folder / "cross_validation.json")
    print_lines(f"Written to {path}")
    return INTERRUPTED if interrupt.pressed else DONE


def _calibrate(project: "Project", folder: Path, workers: int | None = None, resume: bool = False) -> int:
    from kennfeld.calfiles.json_file import write_json
    from kennfeld.project.fallback import write_somewhere
    from kennfeld.project.results import require_room
    from kennfeld.report import safely
    from kennfeld.terminal.output import aligned
    from kennfeld.terminal.progress import Interrupt, display
    from kennfeld.terminal.result_lines import choices, extrapolation_lines, undetermined_lines

    require_room(folder)
    findings = _sound(project)
    print_findings(*findings)
    if resume:
        print_findings(*project.saves(folder).found().findings)
    told: list[Finding] = []
    try:
        with Interrupt() as interrupt:
            with display("compiling", project.file.optimizer.starts) as shown:
                result = project.calibrate(interrupt.watch(shown), folder=folder, workers=workers, resume=resume)
            left = _left(project, result)
            text = safely(project, result, findings, left)
            further = {"surrogates": [row.as_json() for row in left]} if left else None
            written = write_somewhere(result, project, folder, {"report.html": text}, further, told)
    except KeyboardInterrupt:
        print_findings("Stopped before there was anything to write.")
        return INTERRUPTED
    print_lines(*aligned(result.table()), "")
    if len(result.starts) > 1:
        print_lines(*aligned(result.starts_table()), "")
    print_lines(f"{result.status}: {result.message}")
    print_findings(*result.warnings)
    print_lines(*choices(result))
    print_lines(f"{result.free_values} values, {result.iterations} iterations, {result.seconds.total:.2f} s")
    print_lines(*undetermined_lines(result.trust), *extrapolation_lines(left))
    print_findings(*told)
    if written:
        print_lines(f"Written to {written[0].parent}: {', '.join(path.name for path in written)}")
    else:
        print_lines("The values, as parameters.json:", write_json(result.parameters.without(project.surrogates), "-"))
    if interrupt.pressed:
        return INTERRUPTED
    if any(finding.severity == "error" for finding in told):
        return WRONG_INPUT
    return DONE if result.converged else NOT_CONVERGED


def _left(project: "Project", result: "Result") -> "Sequence[Extrapolation]":
    """Where surrogates are used outside the data they were trained on."""
    if not project.surrogates:
        return ()
    from kennfeld.analysis.extrapolation import find_extrapolation
    from kennfeld.optimize.tuning.shift_estimation import moved

    return find_extrapolation(moved(project.problem(), result.shifts), result.parameters)


def _sound(project: "Project") -> list[Finding]:
    """The warnings about a project; raises `InputError` where there are errors."""
    findings = project.check()
    if any(finding.severity == "error" for finding in findings):
        raise InputError(findings)
    return findings


@app.command()
def simulate(
    path: ProjectFile,
    parameters: Annotated[
        Path | None,
        typer.Option(
            "-p", "--parameters", help="Calibration file to use.", show_default="the project's start", metavar="FILE"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help=".parquet or .csv.",
            show_default="simulation.parquet beside the project",
            metavar="FILE",
        ),
    ] = None,
) -> int:
    """Compute the function over all datasets."""
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
        from kennfeld.project.project import replaced
        from kennfeld.terminal.result_lines import extrapolation_lines

        problem = project.problem()
        print_lines(*extrapolation_lines(find_extrapolation(problem, replaced(problem, values)), ""))
    print_lines(f"Written to {written}")
    return DONE


@app.command()
def report(
    path: ProjectFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="The .html file.", show_default="report.html in the folder", metavar="FILE"
        ),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            "-r", "--results", help="Folder of the results.", show_default="results beside the project", metavar="DIR"
        ),
    ] = None,
) -> int:
    """Make the report on the results of an earlier run.

    Without results it tells about the start alone.
    """
    from kennfeld.project import Project
    from kennfeld.project.results import write_text
    from kennfeld.report import from_folder

    folder = results or path.parent / "results"
    text = from_folder(Project.read(path), folder)
    print_lines(f"Written to {write_text(text, output or folder / 'report.html')}")
    return DONE


@app.command()
def info(
    path: Annotated[
        Path, typer.Argument(metavar="FILE", help="A measurement, calibration, formula, Simulink or project file.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    search: Annotated[
        str,
        typer.Option(
            "--search", help="Show what has this in its name or description.", show_default=False, metavar="TEXT"
        ),
    ] = "",
    a2l: DescriptionFile = None,
    subsystem: Subsystem = "",
    values: VariableFiles = None,
    folders: Folders = None,
    bind: Bindings = None,
) -> int:
    """Show what is in a file.

    With --search, only channels, parameters and nodes whose name or description has the text, whatever its case; with
    * and ? in it, those whose whole name fits. Of a Simulink model, what can be calibrated and what stops it.
    """
    import json

    from kennfeld.terminal.file_info import SimulinkSelection, contents
    from kennfeld.terminal.label_search import searched

    found = contents(path, a2l, SimulinkSelection(subsystem, values or (), folders or (), _bindings(bind)))
    if search.strip():
        found = searched(found, search)
    print_lines(*([json.dumps(found.as_json, indent=2)] if as_json else found.lines()))
    return DONE


def _bindings(texts: list[str] | None) -> dict[str, str]:
    """Formulas by the paths of the blocks that they take the place of."""
    pairs = [text.partition("=") for text in texts or ()]
    if odd := [path for path, sign, _ in pairs if not sign]:
        remedy = 'Write "PATH=FORMULA", such as "Sensor/Radiation=0.15 * (t - 20)".'
        raise InputError(Finding(f"--bind {path}", "says no formula", remedy) for path in odd)
    return {path.strip(): formula.strip() for path, _, formula in pairs}


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="The calibration file to read.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write; its ending says the format.")],
    image: Annotated[
        Path | None,
        typer.Option("--image", help="The image to write the values into.", show_default=False, metavar="FILE"),
    ] = None,
    a2l: DescriptionFile = None,
    subsystem: Subsystem = "",
    values: VariableFiles = None,
    folders: Folders = None,
    bind: Bindings = None,
    force: Force = False,
) -> int:
    """Turn a calibration file into another format, or a Simulink model into formula text.

    The formats are .dcm, .csv (INCA's CVX), .cdfx, .json, .xlsx (a sheet for each table), .m and
    .mat (MATLAB), and .msq (into the tune that was read). A model (.slx, .mdl) becomes a .kf, with
    its parameters in a .json of the same name.
    """
    from kennfeld import calfiles

    is_model = source.suffix.lower() in (".slx", ".mdl", ".slxp")
    companion = [target.with_suffix(".json")] if is_model and target.suffix.lower() == ".kf" else []
    _require_new(force, target, *companion)
    if is_model:
        from kennfeld.models.simulink.formula_export import write_formula

        made = write_formula(source, target, subsystem, values or (), folders or (), _bindings(bind))
        print_lines(*(f"Written to {path}" for path in made))
        return DONE

    [parameters], remarks = calfiles.read_several([source], a2l)
    print_findings(*remarks)
    print_findings(*calfiles.write(parameters, target, image, a2l), *calfiles.losses(parameters, target))
    print_lines(f"Written to {target}")
    return DONE


def _require_new(force: bool, *targets: Path) -> None:
    """Raise `InputError` for each file that would be replaced without having been asked to."""
    found = [target for target in targets if not force and target.exists() and not target.is_dir()]
    if found:
        remedy = "Add --force to replace it, or name another file."
        raise InputError(Finding(str(target), "exists already", remedy) for target in found)


@app.command()
def diff(
    left: Annotated[Path, typer.Argument(metavar="A", help="A calibration file.", show_default=False)],
    right: Annotated[Path, typer.Argument(metavar="B", help="The one to compare with.", show_default=False)],
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", help="Numbers this close are equal, in their own unit.", min=0.0, metavar="T"),
    ] = 0.0,
    relative: Annotated[
        float,
        typer.Option("--relative", help="So are numbers whose difference is this share of them.", min=0.0, metavar="R"),
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    a2l: DescriptionFile = None,
) -> int:
    """Compare two calibration files: values, axes, units, and what only one has.

    The exit status is 0 where they are equal and 1 where they differ.
    """
    import json

    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import differing, labels

    allowed = calfiles.Tolerance(tolerance, relative)
    (one, other), remarks = calfiles.read_several([left, right], a2l)
    print_findings(*remarks)
    found = calfiles.compare(one, other, allowed)
    if as_json:
        head = {"left": str(left), "right": str(right), "equal": found.equal, "compared": found.compared}
        differences = [difference.as_json for difference in found.differences]
        print_lines(json.dumps(head | {"differences": differences}, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        first, second = labels([left, right])
        print_lines(*differing(found, first, second))
    return DONE if found.equal else DIFFERENT


@app.command()
def merge(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="Calibration files; later ones win.", show_default=False),
    ],
    target: Annotated[Path, typer.Option("-o", "--output", help="The file to write.", metavar="C", show_default=False)],
    a2l: DescriptionFile = None,
    force: Force = False,
) -> int:
    """Put several calibration files together, and tell what was replaced or added."""
    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import changed, labels

    if len(sources) < 2:
        raise InputError.of("merge", f"{sources[0]} alone is nothing to merge", "Name two files or more.")
    _require_new(force, target)
    sets, remarks = calfiles.read_several(sources, a2l)
    print_findings(*remarks)
    merged = calfiles.merge(list(zip(labels(sources), sets, strict=True)))
    print_findings(*calfiles.write(merged.parameters, target), *calfiles.losses(merged.parameters, target))
    print_lines(*changed(merged.changes), "", f"Written to {target}")
    return DONE
