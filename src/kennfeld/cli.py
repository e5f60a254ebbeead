"""The command line: declarations of commands and their options. `kennfeld.terminal.commands` holds what they do."""

import gc
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from kennfeld import __version__
from kennfeld.errors import InputError, KennfeldError
from kennfeld.terminal import commands
from kennfeld.terminal.commands import DONE, INTERRUPTED, WRONG_INPUT
from kennfeld.terminal.output import print_findings, print_lines
from kennfeld.terminal.signals import end_like_ctrl_c

app = typer.Typer(
    name="kennfeld",
    help="Calibrate sensor models of engine control units: formula and measurement in, curves and maps out.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
surrogates = typer.Typer(help="Train data-driven models, which formula text can call.")
app.add_typer(surrogates, name="surrogate")

ProjectFile = Annotated[
    Path, typer.Argument(metavar="PROJECT", help="The project file, kennfeld.toml.", show_default=False)
]
Subsystem = Annotated[
    str,
    typer.Option("--subsystem", help="Path of a subsystem of a Simulink model.", show_default=False, metavar="PATH"),
]
Folders = Annotated[
    list[Path] | None,
    typer.Option(
        "--folder",
        help="Additional folder to search for a Simulink model's libraries. Repeatable.",
        show_default=False,
        metavar="FOLDER",
    ),
]
VariableFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--parameters",
        help="File with values of a Simulink model's variables. Repeatable.",
        show_default=False,
        metavar="FILE",
    ),
]
Bindings = Annotated[
    list[str] | None,
    typer.Option(
        "--bind",
        help='Replace a block of a Simulink model by a channel or formula, "PATH=FORMULA". Repeatable.',
        show_default=False,
        metavar="BINDING",
    ),
]
DescriptionFile = Annotated[
    Path | None,
    typer.Option(
        "--a2l",
        help="A2L file that describes an image (.hex, .s19).",
        show_default="the A2L file of the same name",
        metavar="FILE",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files.")]


def main() -> None:
    """Run the command `kennfeld` and end the process."""
    gc.set_threshold(200_000, 50, 50)  # a short process leaves little to collect; looking for it takes a tenth of it
    end_like_ctrl_c()
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit status.

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
        detail = f" ({error})" if str(error) else ""
        print_findings(f"Not enough memory{detail}. Use fewer samples or breakpoints.")
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
    text = getattr(error, "format_message", error.__str__)().strip()
    context = getattr(error, "ctx", None)
    end = "" if text.endswith((".", "?", "!")) else "."
    return f"{text}{end} See {context.command_path if context else 'kennfeld'} --help."


def _show_version(wanted: bool) -> None:
    if wanted:
        print_lines(f"kennfeld {__version__}")
        raise typer.Exit


@app.callback()
def _kennfeld(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    name: Annotated[str, typer.Argument(help="torque, exhaust or idle.")] = "torque",
    folder: Annotated[
        Path | None,
        typer.Option("--dir", help="Folder to create.", show_default="kennfeld-demo-NAME", metavar="DIR"),
    ] = None,
) -> int:
    """Write an example project with its data, and calibrate it."""
    return commands.demo(name, folder)


@app.command()
def check(path: ProjectFile) -> int:
    """Report all problems of a project or training file.

    Each is printed on stderr, with location and fix. Nothing is fitted.
    """
    return commands.check(path)


@app.command()
def calibrate(
    path: ProjectFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Folder for the results.",
            show_default="results/ next to the project file",
            metavar="DIR",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(help="Number of processes for several starts.", min=1, show_default="one per core", metavar="N"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Resume from the checkpoints in the results folder (see save_every)."),
    ] = False,
    folds: Annotated[
        int | None,
        typer.Option(
            "--cross-validate",
            help="After calibrating, run K-fold cross-validation.",
            show_default=False,
            metavar="K",
        ),
    ] = None,
    parts: Annotated[
        str, typer.Option("--parts", help="How to form the folds: auto, files, blocks or random.", metavar="KIND")
    ] = "auto",
) -> int:
    """Fit the free parameters to the data and write the results.

    Ctrl-C, SIGTERM and SIGHUP stop the search; the best values so far are written.
    """
    return commands.calibrate(path, output, workers, resume, folds, parts)


@app.command()
def simulate(
    path: ProjectFile,
    parameters: Annotated[
        Path | None,
        typer.Option(
            "-p",
            "--parameters",
            help="Calibration file to use.",
            show_default="the project's initial values",
            metavar="FILE",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Output file, .parquet or .csv.",
            show_default="simulation.parquet next to the project file",
            metavar="FILE",
        ),
    ] = None,
) -> int:
    """Evaluate the function over all datasets."""
    return commands.simulate(path, parameters, output)


@app.command()
def report(
    path: ProjectFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Output file, .html.",
            show_default="report.html in the results folder",
            metavar="FILE",
        ),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            "-r",
            "--results",
            help="Folder of the results.",
            show_default="results/ next to the project file",
            metavar="DIR",
        ),
    ] = None,
) -> int:
    """Write the report on the results of an earlier run.

    Without results, it covers the initial values only.
    """
    return commands.report(path, output, results)


@app.command()
def info(
    path: Annotated[
        Path, typer.Argument(metavar="FILE", help="A measurement, calibration, formula, Simulink or project file.")
    ],
    as_json: Json = False,
    search: Annotated[
        str,
        typer.Option(
            "--search",
            help="Show only entries whose name or description contains TEXT.",
            show_default=False,
            metavar="TEXT",
        ),
    ] = "",
    a2l: DescriptionFile = None,
    subsystem: Subsystem = "",
    values: VariableFiles = None,
    folders: Folders = None,
    bind: Bindings = None,
) -> int:
    """Show the contents of a file.

    --search ignores case; if TEXT contains * or ?, it must match the whole name. For a Simulink model, the output
    lists what can be calibrated and what prevents it.
    """
    return commands.info(path, as_json, search, a2l, subsystem, values or (), folders or (), bind or ())


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Calibration file or Simulink model to read.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Output file. The extension selects the format.")],
    image: Annotated[
        Path | None,
        typer.Option("--image", help="Image to write the values into.", show_default=False, metavar="FILE"),
    ] = None,
    a2l: DescriptionFile = None,
    subsystem: Subsystem = "",
    values: VariableFiles = None,
    folders: Folders = None,
    bind: Bindings = None,
    force: Force = False,
) -> int:
    """Convert a calibration file or a Simulink model.

    Calibration files are .dcm, .csv (INCA CVX), .cdfx, .json, .xlsx (one sheet per table), .m and .mat (MATLAB), and
    .msq (only from a tune). A model (.slx, .mdl) becomes formula text (.kf), with its parameters in a .json file of
    the same name.
    """
    return commands.convert(source, target, image, a2l, subsystem, values or (), folders or (), bind or (), force)


@app.command()
def diff(
    left: Annotated[Path, typer.Argument(metavar="A", help="First calibration file.", show_default=False)],
    right: Annotated[Path, typer.Argument(metavar="B", help="Second calibration file.", show_default=False)],
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", help="Absolute tolerance, in the unit of the values.", min=0.0, metavar="T"),
    ] = 0.0,
    relative: Annotated[float, typer.Option("--relative", help="Relative tolerance.", min=0.0, metavar="R")] = 0.0,
    as_json: Json = False,
    a2l: DescriptionFile = None,
) -> int:
    """Compare two calibration files.

    Compares values, axes and units, and lists names in only one of the files. The exit status is 0 if they are equal
    and 1 if they differ.
    """
    return commands.diff(left, right, tolerance, relative, as_json, a2l)


@app.command()
def merge(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE", help="Calibration files; later files override earlier ones.", show_default=False
        ),
    ],
    target: Annotated[Path, typer.Option("-o", "--output", help="Output file.", metavar="FILE", show_default=False)],
    a2l: DescriptionFile = None,
    force: Force = False,
) -> int:
    """Merge calibration files and list what was replaced or added."""
    return commands.merge(sources, target, a2l, force)


@surrogates.command()
def train(
    path: Annotated[
        Path, typer.Argument(metavar="FILE", help="The training file, surrogate.toml.", show_default=False)
    ],
) -> int:
    """Train a surrogate on recordings and write it as a file that projects can use."""
    return commands.train(path)
