"""A project that a command works on, with its progress, its cluster and the consent to run its code."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.terminal.output import print_progress

if TYPE_CHECKING:
    from kennfeld.project import Project


@contextmanager
def opened_project(
    path: Path,
    scheduler: str | None = None,
    workers: int | None = None,
    *,
    trust: bool,
    run: bool = True,
    connect: bool = True,
) -> Iterator["Project"]:
    """Yield a project that shows the progress of reading its recordings; what it has started ends with the block.

    Args:
        path: the project file.
        scheduler: address of a scheduler that replaces that of the project.
        workers: number of processes on this machine.
        trust: allow what the project asks for without a question.
        run: run code of files that the project names, once the user has allowed it.
        connect: join a scheduler.
    """
    from kennfeld.project import Project
    from kennfeld.terminal.foreign_code import Consent, asked_consent, refused_code
    from kennfeld.terminal.progress import ReadingProgress

    project = replace(Project.read(path), watch=ReadingProgress(), report=print_progress)
    if not run:
        project = project.on_no_cluster()
    elif not connect:
        project = project.on_no_scheduler()
    else:
        project = project.on_cluster(scheduler, workers, print_progress)
    consent = Consent(trust, scheduler)
    try:
        with asked_consent(consent) if run else refused_code(consent):
            if run:
                consent.require_all(project)  # other processes may be the first that run the code
            yield project
    finally:
        project.close()
