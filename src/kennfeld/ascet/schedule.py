"""Task schedules of ASCET applications (`.app` files): the methods of each task in their order, and its period."""

from typing import Final

from kennfeld.ascet.expression_parser import EsdlReader, EsdlSyntaxError
from kennfeld.ascet.lexer import MAX_CHARACTERS, tokens_of
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass

STARTUP: Final = "startup"
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GROUPS: Final = (STARTUP, "shutdown")


@dataclass(frozen=True)
class Task:
    """A task: the qualified names of its processes in their order, and when they run.

    Attributes:
        name: name of the task.
        processes: the processes.
        period: in s, None if the task is not periodic.
        priority: the task with the lower number comes first.
        delay: time of the first run in s.
    """

    name: str
    processes: tuple[str, ...]
    period: float | None = None
    priority: int = 0
    delay: float = 0.0


@dataclass(frozen=True)
class Schedule:
    """The classes of an application, its tasks, and the processes that run once at startup."""

    name: str
    classes: tuple[str, ...] = ()
    tasks: tuple[Task, ...] = ()
    startup: tuple[str, ...] = ()


def parse_schedule(text: str, name: str = "text") -> Schedule:
    """Parse an application file.

    Raises:
        InputError: the text is not an application file.

    >>> schedule = parse_schedule("schedule { task T period 10ms { process a.C.calc } }")
    >>> schedule.tasks[0].period, schedule.tasks[0].processes
    (0.01, ('a.C.calc',))
    """
    if len(text) > MAX_CHARACTERS:
        raise InputError.of(Location(name), f"the file has {len(text)} characters; the maximum is {MAX_CHARACTERS}")
    reader = _ScheduleReader(tokens_of(text))
    try:
        return reader.schedule(name)
    except EsdlSyntaxError as error:
        place = error.token.place
        raise InputError.of(Location(name, place.line, column=place.column), error.message, error.remedy) from None


class _ScheduleReader(EsdlReader):
    def schedule(self, name: str) -> Schedule:
        classes: list[str] = []
        tasks: list[Task] = []
        while self.token.kind != "end":
            if self.accept("application"):
                classes += self._classes()
            else:
                self.expect("schedule")
                self.expect("{")
                while not self.accept("}"):
                    tasks.append(self._task())
        startup = tuple(process for task in tasks if task.name == STARTUP for process in task.processes)
        return Schedule(name, tuple(classes), tuple(task for task in tasks if task.name not in _GROUPS), startup)

    def _classes(self) -> list[str]:
        """Read the classes of an application; their representations are skipped."""
        self.expect("{")
        classes: list[str] = []
        depth = 1
        while depth:
            if self.token.kind == "end":
                raise self.fault("} is missing")
            if depth == 1 and self.accept("class"):
                classes.append(self.qualified_name())
                continue
            text = self.take().text
            depth += (text == "{") - (text == "}")
        return classes

    def _task(self) -> Task:
        name = self.take().text if self.is_at(*_GROUPS) else ""
        if not name:
            self.expect("task")
            name = self.name()
        period: float | None = None
        priority, delay = 0, 0.0
        while not self.accept("{"):
            if self.token.kind == "end":
                raise self.fault("{ is missing")
            if self.accept("period"):
                period = self._period()
            elif self.accept("delay"):
                delay = self._time("delay")
            elif self.accept("priority"):
                priority = self._priority()
            else:
                self.take()
        processes: list[str] = []
        while not self.accept("}"):
            self.expect("process")
            processes.append(self.qualified_name())
            self.accept(";")
        return Task(name, tuple(processes), period, priority, delay)

    def _period(self) -> float:
        period = self._time("period")
        if not period > 0:
            raise self.fault(f"a period must be a finite time > 0, got {period:g}")
        return period

    def _priority(self) -> int:
        sign = -1 if self.accept("-") else 1
        try:
            return sign * int(self.take().text) if self.token.kind == "number" else 0
        except ValueError:
            raise self.fault("a priority must be an integer") from None

    def _time(self, kind: str) -> float:
        """Read a time with its unit, in s."""
        if self.token.kind != "number":
            raise self.fault(f"expected a {kind} such as 10ms")
        number = self.take().text.replace("_", "")
        if self.token.text not in _SECONDS:
            raise self.fault(f"expected one of the units {', '.join(_SECONDS)} behind a {kind}")
        try:
            time = float(number) * _SECONDS[self.take().text]
        except ValueError:
            raise self.fault(f"invalid {kind} {number}") from None
        if not 0 <= time < float("inf"):
            raise self.fault(f"a {kind} must be a finite time, got {number}")
        return time
