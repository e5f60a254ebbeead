"""The command line: runs a command and returns its exit status. `kennfeld.terminal` holds the commands."""

import gc
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from kennfeld import __version__
from kennfeld.errors import InputError, KennfeldError
from kennfeld.terminal import file_commands, project_commands
from kennfeld.terminal.command_line import DONE, INTERRUPTED, WRONG_INPUT
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
for command in (
    *(project_commands.demo, project_commands.app, project_commands.check, project_commands.calibrate),
    *(project_commands.simulate, project_commands.report),
    *(file_commands.info, file_commands.convert, file_commands.diff, file_commands.merge),
):
    app.command()(command)
surrogates = typer.Typer(help="Train data-driven models, which formula text can call.")
surrogates.command()(project_commands.train)
app.add_typer(surrogates, name="surrogate")


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
    except KennfeldError as error:
        print_findings(str(error))
    except typer.TyperException as error:
        print_findings(_usage_sentence(error))
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


def _usage_sentence(error: typer.TyperException) -> str:
    text = error.format_message().strip()
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
