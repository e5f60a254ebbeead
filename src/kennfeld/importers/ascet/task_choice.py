"""Choice of tasks of an application, and the step in which several of them run."""

from collections.abc import Iterable, Sequence
from typing import Final

from kennfeld.ascet.schedule import Task
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names, nearest, number_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.sample_times import common_step

ALL_TASKS: Final = "*"
_MOST_STEPS: Final = 1_000  # of a common step in the shortest period


@dataclass(frozen=True)
class TaskChoice:
    """Names of tasks, `*` for all periodic ones; no names for the only task."""

    names: tuple[str, ...] = ()

    @staticmethod
    def of(task: str | Iterable[str]) -> "TaskChoice":
        """Return the choice of a name or several names; an empty text names none."""
        names = (task,) if isinstance(task, str) else tuple(task)
        return TaskChoice(tuple(dict.fromkeys(name for name in names if name)))

    @property
    def is_several(self) -> bool:
        """True if the tasks run at periods of their own, each in some of the steps."""
        return len(self.names) > 1 or ALL_TASKS in self.names

    def admits(self, task: Task) -> bool:
        """Return True if a task is named, or if none is."""
        return not self.names or ALL_TASKS in self.names or task.name in self.names

    def tasks(self, tasks: Sequence[Task], location: Location, known: Iterable[str]) -> list[Task]:
        """Return the chosen tasks, those that are due at the same time in the order in which they run.

        Args:
            tasks: tasks with processes, in the order of the schedule.
            location: file for messages.
            known: names of all tasks, for messages.

        Raises:
            InputError: a task is unknown, or not periodic.
        """
        if ALL_TASKS in self.names:
            chosen = [task for task in tasks if task.period is not None]
            if not chosen:
                raise InputError.of(location, "no periodic task has processes")
        else:
            chosen = [task for task in tasks if task.name in self.names]
            names, missing = [*known], set(self.names) - {task.name for task in chosen}
            if missing:
                raise InputError(_unknown(name, names, location) for name in self.names if name in missing)
        if unperiodic := [task.name for task in chosen if task.period is None]:
            remedy = "Leave it out, or import it alone."
            raise InputError(Finding(location, f"the task {name} has no period", remedy) for name in unperiodic)
        # a stable sort: tasks of one priority run in the order of the schedule
        return sorted(chosen, key=lambda task: task.priority)


def skipped_tasks(choice: TaskChoice, tasks: Sequence[Task]) -> list[str]:
    """Return the tasks that the choice of all leaves out, because they have no period."""
    return [task.name for task in tasks if task.period is None] if ALL_TASKS in choice.names else []


def _unknown(name: str, known: Sequence[str], location: Location) -> Finding:
    if name in known:
        return Finding(location, f"the task {name} has no processes here", "Leave it out.")
    remedy = nearest(name, known) or (f"It has {join_names(known, 8)}." if known else "")
    return Finding(location, f"unknown task {name}", remedy)


def step_of_tasks(tasks: Sequence[Task], step: float | None, location: Location) -> float:
    """Return the step in s that hits all periods and delays: the longest one, or the given one if it does.

    Raises:
        InputError: there is none, or the given one does not hit all.
    """
    times = [time for task in tasks for time in (task.period, task.delay) if time]
    common = common_step(times)
    # periods without a simple ratio have a common step that is far too short
    if common is None or common * _MOST_STEPS < min(times):
        listed = join_names([f"{number_text(time)} s" for time in dict.fromkeys(times)], 8)
        message = f"the periods and delays {listed} have no common step"
        raise InputError.of(location, message, "Name tasks whose periods are multiples of one step.")
    if step is None:
        return common
    ratio = common / step
    # 1e-6: periods such as 0.1 s have no exact binary form
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        message = (
            f"the step {number_text(step)} s does not divide {number_text(common)} s, the common step of the tasks"
        )
        raise InputError.of(location, message, f"Leave it out, or choose {number_text(common)} s.")
    return step
