"""Puts a demo project into a folder."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from kennfeld.atomic_files import write_whole
from kennfeld.calfiles import write as write_parameters
from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import InputError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet

__all__ = ["NAMES", "closing", "prepare", "projects", "write"]

NAMES = ("torque", "exhaust", "idle")  # each a module beside this one, with its project file
PROJECT = "kennfeld.toml"


def write(name: str, folder: str | Path) -> Path:
    """Write the demo of that name into a folder and give the path of its project file.

    A folder that holds the demo already is taken as it is, with all that was changed in it; only missing files are
    added. Raises `InputError` for an unknown demo, for a folder that holds something else, and where nothing can be
    written.
    """
    if name not in NAMES:
        remedy = nearest(name, NAMES) or f"The demos are: {', '.join(NAMES)}."
        raise InputError.of("demo", f"there is no demo {name}", remedy)
    target = Path(folder)
    settings = Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8")
    try:
        _claim(target, settings.partition("\n")[0])
        _complete(target, name, settings)
    except OSError as error:
        message = f"the demo cannot be written here: {error.strerror or error}"
        raise InputError.of(str(target), message, "Name another folder with --dir.") from None
    return target / PROJECT


def projects(name: str) -> tuple[tuple[str, str], ...]:
    """The project files of a demo in their order, each with the folder of its results."""
    return tuple(getattr(_module(name), "PROJECTS", ((PROJECT, "results"),)))


def prepare(name: str, folder: Path, report: Callable[[str], None]) -> None:
    """What has to be made before the first project can run; `report` hears of it."""
    make = getattr(_module(name), "prepare", None)
    if make is not None:
        make(folder, report)


def closing(name: str, folder: Path) -> list[list[str]]:
    """A table of what the truth behind the data says of the results; of one cell, where a sentence does."""
    demo = _module(name)
    if hasattr(demo, "closing"):
        return list(demo.closing(folder))
    return [[f"The sensor's noise is {demo.NOISE} {demo.UNIT}: on points it never saw, no model can come below that."]]


def _module(name: str) -> Any:
    """What a demo is made of: `FILES` says for each file what makes its content, a text, a dataset or a parameter set.

    `NOISE` and `UNIT` are those of its sensor. A demo of several projects has `PROJECTS`, and may `prepare` something
    for them and have a `closing` of its own.
    """
    return import_module(f"kennfeld.project.demo.{name}")


def _claim(folder: Path, first_line: str) -> None:
    """Make the folder; refuse one that holds anything but this demo."""
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        return
    project = folder / PROJECT
    if not (project.is_file() and project.read_bytes().startswith(first_line.encode())):
        message = "the folder is not empty, and what it holds is not this demo"
        raise InputError.of(str(folder), message, "Name another folder with --dir.")


def _complete(folder: Path, name: str, settings: str) -> None:
    """Write the files that are not there yet, each whole or not at all; the one that claims the folder comes first."""
    contents = {PROJECT: lambda: settings} | _module(name).FILES
    for file, content in contents.items():
        if not (folder / file).exists():
            _put(folder / file, content())


def _put(path: Path, content: str | Dataset | ParameterSet) -> None:
    if isinstance(content, ParameterSet):
        write_parameters(content, path)
    else:
        write_whole(path, content if isinstance(content, str) else _csv(content))


def _csv(data: Dataset) -> str:
    """Time, if any, and the channels of a dataset: a row of names, a row of units, a row a sample."""
    time = () if data.time is None else (Channel("time", data.time, "s"),)
    columns = (*time, *data.channels)
    heads = [",".join(c.name for c in columns), ",".join(c.unit for c in columns)]
    rows = zip(*(channel.values.tolist() for channel in columns), strict=True)
    form = ",".join(["%.10g"] * len(columns))
    return "\n".join([*heads, *(form % row for row in rows), ""])
