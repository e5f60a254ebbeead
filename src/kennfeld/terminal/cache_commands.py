"""The command on files that are kept between runs."""

from pathlib import Path

import click

from kennfeld.terminal.command_line import DONE, argument, option
from kennfeld.terminal.output import align, print_lines, print_values


@click.command
@argument("path", "[PROJECT]", "The project file, or its folder.", required=False)
@option("--clear", "Remove them; the next run reads and compiles again.")
def cache(path: Path | None, clear: bool) -> int:
    """Show what is kept between runs to save time, or remove it."""
    from kennfeld.base.formatting import count_noun
    from kennfeld.project.kept_files import kept_files

    kept = kept_files(path)
    rows = [
        (each.kind, count_noun(len(each.files), "file"), f"{each.size / 1e6:.1f} MB", str(each.folder)) for each in kept
    ]
    print_values(*align(rows))
    if clear:
        for each in kept:
            each.remove()
        print_lines("Removed.")
    return DONE
