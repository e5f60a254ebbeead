"""Commands for shells and editors: the completion of the command line, and the schema of project files."""

from pathlib import Path

import click

from kennfeld.base.errors import InputError, Location
from kennfeld.terminal.command_line import DONE, PATH, argument, force, option, require_new
from kennfeld.terminal.output import print_lines, print_values
from kennfeld.terminal.shell_completion import SHELLS, completion_script

_SHELLS = f"{', '.join(SHELLS[:-1])} or {SHELLS[-1]}"


@click.command
@argument("shell", "SHELL", f"{_SHELLS}.", type=click.Choice(SHELLS), required=False)
@click.pass_context
def completion(context: click.Context, shell: str | None) -> int:
    """Print the script by which a shell completes commands, options and files."""
    if shell is None:
        raise InputError.of(Location("completion"), "requires the name of a shell", f"Name {_SHELLS}.")
    print_values(*completion_script(context.find_root().command, shell).splitlines())
    return DONE


@click.command
@option("--training", "The schema of training files of surrogates.")
@option("-o --output target", "File to write, instead of printing.", "FILE", type=PATH)
@force
def schema(training: bool, target: Path | None, force: bool) -> int:
    """Print the JSON schema by which editors complete and check project files."""
    from kennfeld.base.atomic_files import write_whole
    from kennfeld.project.schemas import PROJECT_SCHEMA, TRAINING_SCHEMA, schema_text

    text = schema_text(TRAINING_SCHEMA if training else PROJECT_SCHEMA)
    if target is None:
        print_values(*text.splitlines())
        return DONE
    require_new(force, target)
    write_whole(target, text)
    print_lines(f"Written to {target}")
    return DONE
