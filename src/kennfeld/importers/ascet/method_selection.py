"""Selected methods of a program: those of a step by task, and those that run once before."""

from kennfeld.ascet import syntax as e
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.instances import ClassInstance
from kennfeld.models.sample_times import SampleTime


@dataclass(frozen=True)
class Process:
    """A method of an instance that is called in a step."""

    instance: ClassInstance
    method: e.Method

    @property
    def label(self) -> str:
        """The label of the method."""
        return f"{self.instance.label}.{self.method.name}"


@dataclass(frozen=True)
class ScheduledTask:
    """The methods of a task in their order, and when they run; without a rate in every step, with its duration."""

    name: str
    processes: tuple[Process, ...]
    rate: SampleTime | None = None


@dataclass(frozen=True)
class MethodSelection:
    """The tasks in their order, methods that run once before, and the step in s, None for the data's."""

    tasks: tuple[ScheduledTask, ...]
    startup: tuple[Process, ...] = ()
    step: float | None = None
    remarks: tuple[Finding, ...] = ()

    @property
    def processes(self) -> tuple[Process, ...]:
        """The methods of all tasks in their order."""
        return tuple(process for task in self.tasks for process in task.processes)
