"""Writes a demo project into a folder."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.base.output_paths import is_link, within
from kennfeld.calfiles import write as write_parameters
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.project.schemas import DIRECTIVE, PROJECT_SCHEMA, schema_text

NAMES = ("torque", "exhaust", "idle")  # each a module of this package, with its project file
PROJECT = "kennfeld.toml"


def write(name: str, folder: str | Path) -> Path:
    """Write a demo into a folder and return the path of its project file.

    If the folder contains the demo already, only missing files are added; changed files are kept. Raises `InputError`
    if the demo is unknown, or if the folder has other contents or cannot be written.
    """
    if name not in NAMES:
        remedy = nearest(name, NAMES) or f"The demos are: {', '.join(NAMES)}."
        raise InputError.of(Location("demo"), f"unknown demo {name}", remedy)
    target = Path(folder)
    settings = Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8")
    with convert_errors(target, "the demo cannot be written", "Name another folder with --dir."), all_or_none(target):
        _claim(target, _title(settings))
        _complete(target, name, settings)
    return target / PROJECT


@contextmanager
def all_or_none(folder: Path) -> Iterator[None]:
    """Remove what the block has written into a folder that was empty, or did not exist, if it raises an exception."""
    # before anything is written: a folder that was there stays
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    new = folder.is_dir() and not is_link(folder) and not any(folder.iterdir())
    try:
        yield
    # KeyboardInterrupt too
    except BaseException:
        for path in folder.iterdir() if new else ():
            _remove(path)
        if folder in created:
            shutil.rmtree(folder, ignore_errors=True)
        for path in created[1:]:
            with suppress(OSError):
                path.rmdir()
        raise


def _remove(path: Path) -> None:
    if path.is_dir() and not is_link(path):
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink()


def projects(name: str) -> tuple[tuple[str, str], ...]:
    """Return the project files of a demo in order, each with the folder of its results."""
    return tuple(getattr(_module(name), "PROJECTS", ((PROJECT, "results"),)))


def prepare(name: str, folder: Path, report: Callable[[str], None]) -> None:
    """Create what the first project needs; `report` receives lines on progress."""
    make = getattr(_module(name), "prepare", None)
    if make is not None:
        make(folder, report)


def closing(name: str, folder: Path) -> list[list[str]]:
    """Return a table that compares the results with the truth behind the data; one cell for a sentence."""
    demo = _module(name)
    if hasattr(demo, "closing"):
        return list(demo.closing(folder))
    return [[f"The noise of the sensor is {demo.NOISE} {demo.UNIT}, a lower bound of the RMSE on unseen points."]]


def _module(name: str) -> Any:
    """Import a demo: `FILES` has a function for each file that returns a text, a dataset or a parameter set.

    `NOISE` and `UNIT` are those of its sensor. A demo with several projects has `PROJECTS`, and optionally functions
    `prepare` and `closing`.
    """
    return import_module(f"kennfeld.project.demo.{name}")


def _title(settings: str) -> str:
    """Return the line that identifies the demo: the first one, after that which names the schema."""
    return next((line for line in settings.splitlines() if not line.startswith(DIRECTIVE)), "")


def _claim(folder: Path, title: str) -> None:
    """Create the folder; refuse one with other contents than this demo."""
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        return
    project = folder / PROJECT
    if not (project.is_file() and _title(project.read_text("utf-8-sig", errors="replace")) == title):
        message = "the folder is not empty and does not contain this demo"
        raise InputError.of(Location(str(folder)), message, "Name another folder with --dir.")


def _complete(folder: Path, name: str, settings: str) -> None:
    """Write missing files, each completely or not at all; the project file, which identifies the demo, comes first."""
    contents = {PROJECT: lambda: settings, PROJECT_SCHEMA: lambda: schema_text(PROJECT_SCHEMA)} | _module(name).FILES
    for file, make in contents.items():
        path = within(folder, file)
        content = None if path.exists() else make()
        if isinstance(content, ParameterSet):
            write_parameters(content, path)
        elif content is not None:
            write_whole(path, content if isinstance(content, str) else _csv(content))


def _csv(data: Dataset) -> str:
    """Return a dataset as CSV: a row of names, a row of units, a row per sample."""
    time = () if data.time is None else (Channel("time", data.time, "s"),)
    columns = (*time, *data.channels)
    heads = [",".join(c.name for c in columns), ",".join(c.unit for c in columns)]
    rows = zip(*(channel.values.tolist() for channel in columns), strict=True)
    form = ",".join(["%.10g"] * len(columns))
    return "\n".join([*heads, *(form % row for row in rows), ""])
