"""The command `design`: what to measure next."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kennfeld.base.errors import InputError, Location
from kennfeld.terminal.command_line import (
    DONE,
    INTERRUPTED,
    PATH,
    as_json,
    only_problems,
    option,
    project_file,
    trusted,
)
from kennfeld.terminal.opened_project import opened_project
from kennfeld.terminal.output import align, print_findings, print_lines, print_values

if TYPE_CHECKING:
    from kennfeld.design import Design


@click.command
@project_file
@option(
    "-n points", "Number of steady points to measure.", "N", "20 for data without time stamps", type=click.IntRange(1)
)
@option("--segments", "Number of pieces of recordings to drive.", "N", "15 for recordings", type=click.IntRange(1))
@option("--reduce", "Find the recordings of the training data that add nothing.")
@option("--keep", "With --reduce: number of recordings to keep.", "N", type=click.IntRange(1))
@option(
    "--from candidates",
    "Recordings, points or time tables to choose from, or a pattern; may be repeated.",
    "FILES",
    multiple=True,
)
@option("--for names", "Parameter, or pattern, that points should determine; may be repeated.", "NAME", multiple=True)
@option(
    "--direction", "Undetermined direction that points should determine, 1 for the first.", "N", type=click.IntRange(1)
)
@option(
    "--use", "Cycle or recording of the operation that matters, or a pattern; may be repeated.", "FILES", multiple=True
)
@option(
    *("--max-seconds", "End the choice after this time, with what was chosen so far.", "S", "that in [design]"),
    type=click.FloatRange(0, min_open=True),
)
@option(
    "--compare earlier", "Compare what a design predicted, a .json file, with a fit of all data.", "FILE", type=PATH
)
@option("-o --output", "File for the design: .csv, .xlsx, .parquet, .mf4 or .json.", "FILE", type=PATH)
@as_json
@trusted
@only_problems
def design(
    path: Path,
    points: int | None,
    segments: int | None,
    reduce: bool,
    keep: int | None,
    candidates: tuple[str, ...],
    names: tuple[str, ...],
    direction: int | None,
    use: tuple[str, ...],
    max_seconds: float | None,
    earlier: Path | None,
    output: Path | None,
    as_json: bool,
    trust: bool,
) -> int:
    """Find out what to measure next, or which recordings add nothing.

    The project is calibrated first, unless its points fill ranges. [design] in the project file has ranges, limits,
    manoeuvres and the order of the bench.
    """
    if earlier is not None:
        asked = (points, segments, reduce or None, keep, candidates, names, direction, use, max_seconds, output)
        if any(value not in (None, ()) for value in asked):
            raise InputError.of(Location("--compare"), "cannot be combined with a new design", "Run two commands.")
        return _compare(path, earlier, as_json, trust)
    from kennfeld.design.api import Request, design_project
    from kennfeld.design.design_files import require_design_format
    from kennfeld.project.results import output_file
    from kennfeld.terminal.progress import Interrupt, display

    request = Request(points, segments, reduce, keep, names, direction)
    request.check()
    target = None if output is None else output_file(path, output)
    if target is not None:
        require_design_format(target)
    with opened_project(path, trust=trust) as project:
        try:
            with Interrupt() as interrupt, display("compiling") as shown:
                use = tuple(str(Path.cwd() / pattern) for pattern in use)
                ended_fit: bool | None = None

                def watch(made: object) -> bool:
                    nonlocal ended_fit
                    stopped = interrupt.stopped()
                    # a signal before the first choice has ended the fit, not the choice
                    ended_fit = stopped if ended_fit is None else ended_fit
                    return stopped and not ended_fit

                settings = {"max_seconds": max_seconds} if max_seconds is not None else {}
                shown_fit = interrupt.watch(shown)
                proposal = design_project(project, request, candidates, use, shown_fit, settings, watch)
        except KeyboardInterrupt:
            print_findings("Stopped before there was anything to write.")
            return INTERRUPTED
    print_findings(*proposal.findings)
    if target is not None:
        proposal.save(target, follow=True)
    if as_json:
        print_values(json.dumps(proposal.as_json(), indent=2))
        return INTERRUPTED if interrupt.pressed else DONE
    _print_design(proposal)
    if target is not None:
        print_lines(f"Written to {target}")
    return INTERRUPTED if interrupt.pressed else DONE


def _compare(path: Path, earlier: Path, as_json: bool, trust: bool) -> int:
    from kennfeld.design import Design
    from kennfeld.terminal.progress import Interrupt, display

    predicted = Design.read(earlier)
    with opened_project(path, trust=trust) as project:
        try:
            with Interrupt() as interrupt, display("compiling") as shown:
                reached = predicted.compare(project.calibrate(interrupt.watch(shown)))
        except KeyboardInterrupt:
            print_findings("Stopped before there was anything to compare.")
            return INTERRUPTED
    print_findings(*reached.findings)
    if as_json:
        print_values(json.dumps(reached.as_json(), indent=2))
    else:
        print_lines(*align(reached.table()), "", *reached.summary())
    return INTERRUPTED if interrupt.pressed else DONE


def _print_design(proposal: "Design") -> None:
    rows = proposal.table()
    if rows:
        print_lines(*align(rows), "")
    print_lines(*proposal.summary())
