"""The part of a model that a command looks at, and the options that select it."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import click

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.terminal.command_line import PATH, option


class SimulinkSelection(NamedTuple):
    """Part of a Simulink model to import: subsystem, files with values, folders of libraries, replaced blocks, and a
    step in s that replaces the model's own.
    """

    subsystem: str = ""
    parameters: Sequence[str | Path] = ()
    folders: Sequence[str | Path] = ()
    bind: Mapping[str, str] = MappingProxyType({})
    step: float | None = None


class EsdlSelection(NamedTuple):
    """Part of an ASCET project to import: class, methods, tasks, folders of further projects, and a step in s that
    replaces the one of its tasks.
    """

    class_name: str = ""
    methods: Sequence[str] = ()
    tasks: Sequence[str] = ()
    folders: Sequence[Path] = ()
    step: float | None = None


class ModelSelection(NamedTuple):
    """Part of a model of either kind."""

    simulink: SimulinkSelection = SimulinkSelection()
    esdl: EsdlSelection = EsdlSelection()


WHOLE = ModelSelection()

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
        "Additional folder to search for libraries of a model. Repeatable.",
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
    """Give a command the options that select a part of a model; it receives them as `selection`."""

    @wraps(command)
    def select(
        *arguments: Any,
        subsystem: str,
        values: Sequence[Path],
        folders: Sequence[Path],
        bind: Sequence[str],
        step: float | None,
        class_name: str,
        methods: Sequence[str],
        tasks: Sequence[str],
        **others: Any,
    ) -> int:
        simulink = SimulinkSelection(subsystem, values, folders, _bindings(bind), step)
        esdl = EsdlSelection(class_name, methods, tasks, folders, step)
        return command(*arguments, selection=ModelSelection(simulink, esdl), **others)

    decorated: Callable[..., int] = select
    for add_option in reversed(_OPTIONS):
        decorated = add_option(decorated)
    return decorated


def _bindings(texts: Sequence[str]) -> Mapping[str, str]:
    """Return formulas by the path of the block that each replaces, from texts of the form `PATH=FORMULA`."""
    pairs = [text.partition("=") for text in texts]
    if incomplete := [path for path, sign, _ in pairs if not sign]:
        remedy = 'Write "PATH=FORMULA", such as "Sensor/Radiation=0.15 * (t - 20)".'
        raise InputError(Finding(Location("--bind", path=path), "has no formula", remedy) for path in incomplete)
    return {path.strip(): formula.strip() for path, _, formula in pairs}
