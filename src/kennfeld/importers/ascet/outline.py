"""Choices that an ESDL file or an application offers, without importing it."""

from pathlib import Path

from kennfeld.ascet.schedule import Task
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.importing import classes_of
from kennfeld.importers.ascet.method_choice import APPLICATION, read_schedule


@dataclass(frozen=True)
class ClassOutline:
    """A class with the methods that a step can call."""

    name: str
    methods: tuple[str, ...]


@dataclass(frozen=True)
class ProgramOutline:
    """The classes of a file, or the tasks of an application that have processes."""

    classes: tuple[ClassOutline, ...] = ()
    tasks: tuple[Task, ...] = ()


def read_outline(path: Path) -> ProgramOutline:
    """Read what a file offers; raises `InputError` if it cannot be read."""
    if path.suffix.lower() == APPLICATION:
        return ProgramOutline(tasks=tuple(task for task in read_schedule(path).tasks if task.processes))
    return ProgramOutline(
        tuple(
            ClassOutline(
                # those that `methods` may name: private ones run where others call them
                item.name,
                tuple(method.name for method in item.methods if "public" in method.modifiers or len(item.methods) == 1),
            )
            for item in classes_of(path)
        )
    )
