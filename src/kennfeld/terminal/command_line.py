"""Options that several commands have, and exit statuses."""

from pathlib import Path
from typing import Annotated, Any

import typer

DONE, NOT_CONVERGED, DIFFERENT, WRONG_INPUT, INTERRUPTED = 0, 1, 1, 2, 130


def option(names: str, text: str, metavar: str | None = None, default: str | bool = False, **limits: Any) -> Any:
    """Declare an option by its names, separated by blanks; `default` describes it in the help, True shows its value."""
    return typer.Option(*names.split(), help=text, metavar=metavar, show_default=default, **limits)


ProjectFile = Annotated[
    Path, typer.Argument(metavar="PROJECT", help="The project file, kennfeld.toml.", show_default=False)
]
Subsystem = Annotated[str, option("--subsystem", "Path of a subsystem of a Simulink model.", "PATH")]
Folders = Annotated[
    list[Path] | None,
    option("--folder", "Additional folder to search for libraries of a model. Repeatable.", "FOLDER"),
]
ClassName = Annotated[str, option("--class", "Class of an ESDL file.", "NAME")]
Methods = Annotated[
    list[str] | None, option("--method", "Method of the class that a step calls. Repeatable, in order.", "NAME")
]
Task = Annotated[str, option("--task", "Task of an ASCET application.", "NAME")]
VariableFiles = Annotated[
    list[Path] | None, option("--parameters", "File with values of a Simulink model's variables. Repeatable.", "FILE")
]
Bindings = Annotated[
    list[str] | None,
    option(
        "--bind",
        'Replace a block of a Simulink model by a channel or formula, "PATH=FORMULA". Repeatable.',
        "BINDING",
    ),
]
DescriptionFile = Annotated[
    Path | None,
    option("--a2l", "A2L file that describes an image (.hex, .s19).", "FILE", "the A2L file of the same name"),
]
Json = Annotated[bool, option("--json", "Print JSON.")]
Force = Annotated[bool, option("--force", "Replace existing files.")]
