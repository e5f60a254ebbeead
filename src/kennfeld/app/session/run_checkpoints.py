"""Checkpoints of a run of the app, from which an interrupted one is resumed.

With `save_every` of the project they are those of `kennfeld calibrate`, in the results folder. Without it, the last
seconds of a run are kept beside the recovery file, and removed once the run has converged.
"""

import shutil
from contextlib import suppress
from pathlib import Path

from kennfeld.app.session.recovery import FOLDER
from kennfeld.base.errors import InputError
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import below
from kennfeld.optimize.fit.result import Checkpoint
from kennfeld.project.checkpoints import ResumePoints, Saves

INTERVAL = 2.0  # s between checkpoints without `save_every`


@dataclass(frozen=True)
class RunCheckpoints:
    """The checkpoints of a run, and their folder.

    Attributes:
        project: the project file.
        every: number of accepted steps between checkpoints; 0 keeps one every few seconds.
    """

    project: Path
    every: int = 0

    @property
    def folder(self) -> Path:
        """The folder whose subfolder holds the checkpoints."""
        return self.project.parent / "results" if self.every else self.project.parent / FOLDER / self.project.stem

    def saves(self) -> Saves:
        """Return the checkpoints of the folder."""
        return Saves(self.folder, self.project)

    def points(self) -> ResumePoints:
        """Return the checkpoint of each start. Raises `InputError` if there is none."""
        return self.saves().resume_points()

    def describe(self, starts: int = 1, died: bool = False) -> str:
        """Return a sentence on an interrupted run; empty if there is none, or if all its starts have converged.

        Args:
            starts: number of starts of the project.
            died: the process of the last run ended unexpectedly, so that even converged starts have no result.
        """
        try:
            states = self.points().states
        except (InputError, OSError):
            return ""
        finished = sum(_has_converged(state) for state in states.values())
        # without `save_every`, what a run leaves was not taken over
        complete = finished == len(states) >= starts and self.every > 0 and not died
        if complete:
            return ""
        last = max(states.values(), key=lambda state: state.iteration)
        # a project may ask for fewer starts than the interrupted run had
        number = max(starts, len(states))
        several = f"{finished} of {count_noun(number, 'start')} finished, " if number > 1 else ""
        return f"A run was interrupted: {several}{count_noun(last.iteration, 'iteration')}, cost {last.cost:.5g}."

    def remove(self) -> None:
        """Forget the checkpoints, unless they are those of the results folder."""
        if not self.every:
            with suppress(OSError):
                shutil.rmtree(below(self.project.parent, self.folder))


def _has_converged(state: Checkpoint) -> bool:
    return state.ended is not None and state.ended.status == "converged"
