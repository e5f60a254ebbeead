"""Task schedules of ASCET applications (`.app` files): the methods of each task in their order, and its period."""

from dataclasses import dataclass
from typing import Final

from kennfeld.ascet.expression_parser import EsdlSyntaxError, TokenReader
from kennfeld.ascet.lexer import MAX_CHARACTERS, tokens_of
from kennfeld.errors import InputError, Location

STARTUP: Final = "startup"
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GROUPS: Final = (STARTUP, "shutdown")


@dataclass(frozen=True)
class Task:
    """A task: the qualified names of its processes in their order, and its period in s, None if not periodic."""

    name: str
    processes: tuple[str, ...]
    period: float | None = None


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


class _ScheduleReader(TokenReader):
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
        while not self.accept("{"):
            if self.token.kind == "end":
                raise self.fault("{ is missing")
            period = self._period() if self.accept("period") else self._other(period)
        processes: list[str] = []
        while not self.accept("}"):
            self.expect("process")
            processes.append(self.qualified_name())
            self.accept(";")
        return Task(name, tuple(processes), period)

    def _other(self, period: float | None) -> float | None:
        self.take()
        return period

    def _period(self) -> float:
        if self.token.kind != "number":
            raise self.fault("expected a period such as 10ms")
        number = self.take().text.replace("_", "")
        if self.token.text not in _SECONDS:
            raise self.fault(f"expected one of the units {', '.join(_SECONDS)} behind a period")
        try:
            period = float(number) * _SECONDS[self.take().text]
        except ValueError:
            raise self.fault(f"invalid period {number}") from None
        if not 0 < period < float("inf"):
            raise self.fault(f"a period must be a finite time > 0, got {number}")
        return period
