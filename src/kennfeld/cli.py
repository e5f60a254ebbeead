"""The command line: runs a command and returns its exit status. `kennfeld.terminal` holds the commands."""

import gc
import os
import sys
from collections.abc import Sequence

import click

from kennfeld import __version__
from kennfeld.base.errors import InputError, KennfeldError
from kennfeld.base.task_runner import WorkersDiedError
from kennfeld.base.threads import let_blas_threads_sleep
from kennfeld.base.watch_folder import WATCHER
from kennfeld.terminal import (
    cache_commands,
    design_commands,
    editor_commands,
    export_command,
    file_commands,
    project_commands,
    proposal_commands,
)
from kennfeld.terminal.command_line import DONE, INTERRUPTED, WRONG_INPUT
from kennfeld.terminal.output import findings_json, print_findings, print_values
from kennfeld.terminal.shell_completion import COMPLETE, register_powershell
from kennfeld.terminal.signals import end_like_ctrl_c
from kennfeld.terminal.special_files import refuse_special_files
from kennfeld.terminal.watched_commands import APP, call_limit

JSON = "--json"


class _Commands(click.Group):
    """Commands that the help lists in the order in which they were added; Ctrl-C ends them without a word of click."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> int | None:
        try:
            status: int | None = super().invoke(ctx)
        except KeyboardInterrupt:
            return INTERRUPTED
        return status


@click.group(cls=_Commands, no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message="kennfeld %(version)s")
def app() -> None:
    """Calibrate sensor models of engine control units: formula and measurement in, curves and maps out."""


@click.group(no_args_is_help=False)
def surrogate() -> None:
    """Train data-driven models, which formula text can call."""


for command in (
    *(project_commands.demo, project_commands.app, project_commands.check, project_commands.calibrate),
    *(project_commands.simulate, project_commands.report, proposal_commands.propose),
    *(design_commands.design, export_command.export),
    *(file_commands.info, file_commands.convert, file_commands.diff, file_commands.merge),
):
    app.add_command(command)
surrogate.add_command(project_commands.train)
app.add_command(surrogate)
app.add_command(cache_commands.cache)
app.add_command(editor_commands.schema)
app.add_command(editor_commands.completion)


def main() -> None:
    """Run the command `kennfeld` and end the process."""
    gc.set_threshold(200_000, 50, 50)  # a short process leaves little to collect; looking for it takes a tenth of it
    let_blas_threads_sleep()
    refuse_special_files()
    status = _run_safely(sys.argv[1:])
    gc.freeze()  # the end of the process then does not search all objects once more
    sys.exit(status)


def _run_safely(arguments: Sequence[str]) -> int:
    """Run a command line, in a process of its own if its project calls foreign code, which may crash."""
    if WATCHER in os.environ:
        from kennfeld.base.process_limits import limit_foreign_code
        from kennfeld.terminal.watched_process import watched_process

        if arguments[:1] != [APP]:  # the browser that it opens would be limited as well
            limit_foreign_code()
        with watched_process() as statuses:
            statuses.append(run(arguments))
        return statuses[0]
    if COMPLETE in os.environ:
        register_powershell()
    end_like_ctrl_c()
    limit = call_limit(arguments)
    if limit is None:
        return run(arguments)
    from kennfeld.terminal.watching import run_watched

    try:
        return run_watched(arguments, limit)
    except KeyboardInterrupt:
        return INTERRUPTED


def run(arguments: Sequence[str]) -> int:
    """Run a command line in this process and return its exit status.

    0 done, 1 not converged or files differ, 2 wrong input, 130 after Ctrl-C, SIGTERM or SIGHUP. `help COMMAND` is the
    same as `COMMAND --help`.
    """
    if list(arguments[:1]) == ["help"]:
        arguments = [*arguments[1:], "--help"]
    try:
        return app(list(arguments) or ["--help"], prog_name="kennfeld", standalone_mode=False) or DONE
    except WorkersDiedError as error:
        from kennfeld.base.machine_code.crash_report import worker_findings

        print_findings(*(worker_findings() or error.findings))
    except InputError as error:
        print_findings(*error.findings)
        if JSON in arguments:
            print_values(findings_json(error.findings))
    except KennfeldError as error:
        print_findings(str(error))
    except click.ClickException as error:
        print_findings(_usage_sentence(error))
    except OSError as error:
        print_findings(f"{error.filename or 'the system'}: {error.strerror or error}")
    except MemoryError as error:
        detail = f" ({error})" if str(error) else ""
        print_findings(f"Not enough memory{detail}. Use fewer samples or breakpoints.")
    except click.Abort as abort:
        if isinstance(abort.__cause__, EOFError):  # which click takes for the end of what somebody types
            raise abort.__cause__ from None
        return INTERRUPTED
    except KeyboardInterrupt:
        return INTERRUPTED
    return WRONG_INPUT


def _usage_sentence(error: click.ClickException) -> str:
    text = error.format_message().strip()
    context = getattr(error, "ctx", None)
    end = "" if text.endswith((".", "?", "!")) else "."
    return f"{text}{end} See {context.command_path if context else 'kennfeld'} --help."
