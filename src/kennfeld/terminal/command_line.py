"""Arguments and options that several commands have, and exit statuses."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from kennfeld.errors import Finding, InputError, Location
from kennfeld.file_errors import convert_errors
from kennfeld.output_paths import named
from kennfeld.terminal.output import quiet

DONE, NOT_CONVERGED, DIFFERENT, WRONG_INPUT, INTERRUPTED = 0, 1, 1, 2, 130
PATH = click.Path(path_type=Path)

Function = TypeVar("Function", bound=Callable[..., Any])


def argument(name: str, metavar: str, text: str, **settings: Any) -> Callable[[Function], Function]:
    """Declare a positional argument, by default a path that must be given."""
    settings = {"type": PATH, **settings}
    return click.argument(name, metavar=metavar, help=text, **settings)


def option(
    names: str, text: str, metavar: str | None = None, shown: str | bool = False, **settings: Any
) -> Callable[[Function], Function]:
    """Declare an option by its names, separated by blanks; the last may be that of the function's parameter.

    `shown` describes the default in the help; True shows its value. Without `metavar`, the option is a flag.
    """
    is_flag = metavar is None
    return click.option(*names.split(), help=text, metavar=metavar, show_default=shown, is_flag=is_flag, **settings)


def require_new(force: bool, *targets: Path) -> None:
    """Raise `InputError` if a file exists that is not to be replaced, or is a link."""
    for target in targets:
        with convert_errors(target, "cannot be written", "Name another file."):
            named(target)
    existing = [target for target in targets if not force and target.exists() and not target.is_dir()]
    if existing:
        remedy = "Add --force to replace it, or name another file."
        raise InputError(Finding(Location(str(target)), "already exists", remedy) for target in existing)


def _be_quiet(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        context.with_resource(quiet())


project_file = argument("path", "PROJECT", "The project file, kennfeld.toml.")
description_file = option(
    "--a2l",
    "A2L file that describes an image (.hex, .s19) or a .par.",
    "FILE",
    "the A2L file of the same name",
    type=PATH,
)
as_json = option("--json as_json", "Print JSON.")
force = option("--force", "Replace existing files.")
only_problems = option(
    "-q --quiet", "Print only warnings and errors.", callback=_be_quiet, expose_value=False, is_eager=True
)
