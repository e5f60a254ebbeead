"""The command that writes the calibrated function for control units and simulation tools."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kennfeld.base.errors import Finding, Location
from kennfeld.terminal.command_line import DONE, PATH, only_problems, option, project_file, trusted
from kennfeld.terminal.opened_project import opened_project
from kennfeld.terminal.output import print_findings, print_lines

if TYPE_CHECKING:
    from kennfeld.domain.parameter_set import ParameterSet
    from kennfeld.project import Project


@click.command
@project_file
@option(
    *("--to", "Language: C99, an FMU, or a function of MATLAB.", "c|fmu|m"),
    type=click.Choice(["c", "fmu", "m"]),
    required=True,
)
@option("-o --output folder", "Folder to write to.", "DIR", "the folder of the project file", type=PATH)
@option(
    "-p --parameters", "Calibration file to use.", "FILE", "results/parameters.json, or the initial values", type=PATH
)
@option("--name", "Name of the code.", "NAME", "that of the function's file")
@option("--node outputs", "Node to compute; may be repeated.", "NAME", "the outputs of the function", multiple=True)
@option(
    "--precision",
    "Precision of C code.",
    "double|float",
    True,
    type=click.Choice(["double", "float"]),
    default="double",
)
@option("--fmi", "Version of FMI.", "2|3", True, type=click.Choice(["2", "3"]), default="2")
@option(
    "--inputs",
    "When the inputs of an FMU count that are set before a step.",
    "start|end",
    True,
    type=click.Choice(["start", "end"]),
    default="end",
)
@option("--step", "Step of an FMU in s.", "S", "that of the function or its data", type=float)
@option(
    "--platform platforms",
    "Machine for which an FMU has a library in addition to this one: x86_64-windows, x86_64-linux, aarch64-linux, "
    "x86_64-darwin or aarch64-darwin. May be repeated; needs the extra platforms.",
    "MACHINE",
    multiple=True,
    type=click.Choice(["x86_64-windows", "x86_64-linux", "aarch64-linux", "x86_64-darwin", "aarch64-darwin"]),
)
@option("--stored", "Write values in C as a control unit stores them, by [calibration] rounding.")
@option("--no-check", "Do not compile the code and compare it with a simulation of the data.")
@trusted
@only_problems
def export(
    path: Path, folder: Path | None, parameters: Path | None, no_check: bool, trust: bool, fmi: str, **settings: Any
) -> int:
    """Write the calibrated function as C99, as an FMU or as a function of MATLAB.

    With a C compiler, the code is compiled and compared with a simulation of the project's data.
    """
    from kennfeld.export.api import ExportSettings, export_project
    from kennfeld.project.results import results_folder

    asked = ExportSettings(**settings, fmi=int(fmi), check=not no_check)  # type: ignore[arg-type]
    target = path.parent if folder is None else results_folder(path, folder)
    with opened_project(path, trust=trust) as project:
        done = export_project(project, _values(project, parameters), target, asked)
    print_findings(*done.findings)
    if done.comparison is not None:
        print_lines(str(done.comparison))
    print_lines(f"Written to {', '.join(map(str, done.files))}")
    return DONE


def _values(project: "Project", parameters: Path | None) -> "ParameterSet | None":
    """Return the calibration to write, and print where it is from."""
    from kennfeld.project.results import results_folder

    if parameters is None:
        calibrated = results_folder(project.path) / "parameters.json"
        if not calibrated.is_file():
            message, remedy = "has no results: the initial values are exported", "Calibrate it, or name a file with -p."
            print_findings(Finding(Location(project.path.name), message, remedy, severity="warning"))
            return None
        parameters = calibrated
    print_lines(f"values: {parameters}")
    values, findings = project.read_values_with_findings(parameters)
    print_findings(*findings)
    return values
