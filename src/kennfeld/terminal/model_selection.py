"""The part of a model that a command looks at, and the options that select it."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from pathlib import Path
from typing import Any

import click

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.terminal.command_line import PATH, option

_OPTIONS = (
    option("--subsystem", "Path of a subsystem of a Simulink model.", "PATH", default=""),
    option(
        "--parameters values",
        "File with values of a Simulink model's variables. Repeatable.",
        "FILE",
        type=PATH,
        multiple=True,
    ),
    option(
        "--folder folders",
        "Additional folder to search for files that a model or its scripts need. Repeatable.",
        "FOLDER",
        type=PATH,
        multiple=True,
    ),
    option(
        "--bind",
        'Replace a block of a Simulink model by a channel or formula, "PATH=FORMULA". Repeatable.',
        "BINDING",
        multiple=True,
    ),
    option(
        "--step",
        "Time step in s that replaces the one of a model.",
        "SECONDS",
        type=click.FloatRange(0.0, math.inf, min_open=True, max_open=True),
    ),
    option("--class class_name", "Class of an ESDL file or of an .axl archive.", "NAME", default=""),
    option("--method methods", "Method of the class that a step calls. Repeatable, in order.", "NAME", multiple=True),
    option("--task tasks", 'Task of an ASCET application, "*" for all. Repeatable.', "NAME", multiple=True),
)


def model_options(command: Callable[..., int]) -> Callable[..., int]:
    """Give a command the options that select a part of a model; it receives them as `part`."""

    @wraps(command)
    def select(
        *arguments: Any,
        subsystem: str,
        values: tuple[Path, ...],
        folders: tuple[Path, ...],
        bind: Sequence[str],
        step: float | None,
        class_name: str,
        methods: tuple[str, ...],
        tasks: tuple[str, ...],
        **others: Any,
    ) -> int:
        from kennfeld.models.importer import ImportOptions  # loads numpy, which help does without

        part = ImportOptions(
            step=step,
            folders=folders,
            subsystem=subsystem,
            parameters=values,
            bind=tuple(_bindings(bind)),
            class_name=class_name,
            methods=methods,
            task=tasks,
        )
        return command(*arguments, part=part, **others)

    decorated: Callable[..., int] = select
    # the decorator that is applied last is the first in the help
    for add_option in reversed(_OPTIONS):
        decorated = add_option(decorated)
    return decorated


def _bindings(texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the path of each block with the formula that replaces it, from texts of the form `PATH=FORMULA`."""
    pairs = [text.partition("=") for text in texts]
    if incomplete := [path for path, sign, _ in pairs if not sign]:
        remedy = 'Write "PATH=FORMULA", such as "Sensor/Radiation=0.15 * (t - 20)".'
        raise InputError(Finding(Location("--bind", path=path), "has no formula", remedy) for path in incomplete)
    yield from ((path.strip(), formula.strip()) for path, _, formula in pairs)
