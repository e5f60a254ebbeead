"""Arguments and options that several commands have, and exit statuses."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.output_paths import named
from kennfeld.terminal.output import quiet
from kennfeld.terminal.project_argument import find_project

DONE, NOT_CONVERGED, DIFFERENT, WRONG_INPUT, INTERRUPTED = 0, 1, 1, 2, 130
PATH = click.Path(path_type=Path)

Function = TypeVar("Function", bound=Callable[..., Any])


class _PresentArgument(click.Argument):
    """An argument that is not empty, as that of an empty variable of a shell is."""

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the value for the command; raise `click.BadParameter` if it is empty."""
        if "" in _words(value):
            raise click.BadParameter("must not be empty.", ctx, self)
        return super().process_value(ctx, value)


class _ValueOption(click.Option):
    """An option with a value that is not empty, and not another option whose own value precedes it.

    Both happen if a shell replaces a variable by nothing: `--output "$DIR"`, and `--output $DIR --resume`.
    """

    def __init__(self, *names: Any, may_be_empty: bool = False, **settings: Any) -> None:
        super().__init__(*names, **settings)
        self._may_be_empty = may_be_empty

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the value for the command; raise `click.BadOptionUsage` if it is missing."""
        if self.name is not None and ctx.get_parameter_source(self.name) is ParameterSource.COMMANDLINE:
            for word in _words(value):
                self._require_value(ctx, word)
        return super().process_value(ctx, value)

    def _require_value(self, ctx: click.Context, word: str) -> None:
        options = {name for each in ctx.command.get_params(ctx) if isinstance(each, click.Option) for name in each.opts}
        name = " / ".join(self.opts)
        if word.partition("=")[0] in options:
            raise click.BadOptionUsage(name, f"Option {name} requires a value, got the option {word}.", ctx)
        if not word and not self._may_be_empty:
            raise click.BadOptionUsage(name, f"Option {name} requires a value, got an empty one.", ctx)


def _words(value: Any) -> list[str]:
    return [word for word in (value if isinstance(value, tuple | list) else [value]) if isinstance(word, str)]


def argument(name: str, metavar: str, text: str, **settings: Any) -> Callable[[Function], Function]:
    """Declare a positional argument, by default a path that must be given."""
    settings = {"type": PATH, "cls": _PresentArgument, **settings}
    return click.argument(name, metavar=metavar, help=text, **settings)


def option(
    names: str, text: str, metavar: str | None = None, shown: str | bool = False, **settings: Any
) -> Callable[[Function], Function]:
    """Declare an option by its names, separated by blanks; the last may be that of the function's parameter.

    `shown` describes the default in the help; True shows its value. Without `metavar`, the option is a flag; with it,
    it requires a value, which is not empty unless `may_be_empty`.
    """
    # click 8.2 and later take `is_flag=False` for an option whose value may be missing
    kind: dict[str, Any] = {"is_flag": True} if metavar is None else {"cls": _ValueOption}
    return click.option(*names.split(), help=text, metavar=metavar, show_default=shown, **kind, **settings)


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


def _find_project(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    return None if path is None else find_project(path)


_PROJECT = "The project file, or the folder of a kennfeld.toml."
project_file = argument("path", "PROJECT", _PROJECT, callback=_find_project)
optional_project_file = argument("path", "[PROJECT]", _PROJECT, required=False, callback=_find_project)
description_file = option(
    "--a2l",
    "A2L file that describes an image (.hex, .s19) or a .par.",
    "FILE",
    "the A2L file of the same name",
    type=PATH,
)
as_json = option("--json as_json", "Print JSON.")
force = option("--force", "Replace existing files.")
trusted = option("--trust", "Run the code and use the addresses that the project names without asking.")
only_problems = option(
    "-q --quiet", "Print only warnings and errors.", callback=_be_quiet, expose_value=False, is_eager=True
)
