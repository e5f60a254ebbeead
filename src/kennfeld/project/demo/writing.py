"""Puts a demo project into a folder."""

import os
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from kennfeld.calfiles import write as write_parameters
from kennfeld.dataset import Dataset
from kennfeld.errors import InputError, nearest

__all__ = ["NAMES", "noise", "write"]

NAMES = ("torque",)  # each a module beside this one, with its project file
PROJECT, START = "kennfeld.toml", "start.dcm"


def write(name: str, folder: str | Path) -> Path:
    """Write the demo of that name into a folder and give the path of its project file.

    A folder that holds the demo already is taken as it is, with all that was changed in it; only missing files are
    added. Raises `InputError` for an unknown demo, for a folder that holds something else, and where nothing can be
    written.
    """
    if name not in NAMES:
        mend = nearest(name, NAMES) or f"The demos are: {', '.join(NAMES)}."
        raise InputError.of("demo", f"there is no demo {name}", mend)
    target = Path(folder)
    settings = Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8")
    try:
        _claim(target, settings.partition("\n")[0])
        _complete(target, name, settings)
    except OSError as error:
        what = f"the demo cannot be written here: {error.strerror or error}"
        raise InputError.of(str(target), what, "Name another folder with --dir.") from None
    return target / PROJECT


def noise(name: str) -> str:
    """The standard deviation of the noise in the data of a demo, with its unit."""
    return f"{import_module(f'kennfeld.project.demo.{name}').NOISE} Nm"


def _claim(folder: Path, first_line: str) -> None:
    """Make the folder; refuse one that holds anything but this demo."""
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        return
    project = folder / PROJECT
    if not (project.is_file() and project.read_bytes().startswith(first_line.encode())):
        what = "the folder is not empty, and what it holds is not this demo"
        raise InputError.of(str(folder), what, "Name another folder with --dir.")


def _complete(folder: Path, name: str, settings: str) -> None:
    """Write the files that are not there yet, each whole or not at all; the one that claims the folder comes first."""
    wanted = {PROJECT, f"{name}.kf", "bench.csv", "fresh.csv", START}
    if all((folder / file).exists() for file in wanted):
        return
    demo = import_module(f"kennfeld.project.demo.{name}")
    _add(folder, {PROJECT: settings, f"{name}.kf": demo.FORMULA})
    _add(folder, {"bench.csv": _csv(demo.bench()), "fresh.csv": _csv(demo.fresh())})
    if not (folder / START).exists():
        write_parameters(demo.start(), folder / START)


def _add(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        beside = folder / f".{name}.{os.getpid()}"
        if (folder / name).exists():
            continue
        try:
            beside.write_text(text, encoding="utf-8", newline="\n")
            beside.replace(folder / name)
        finally:
            beside.unlink(missing_ok=True)


def _csv(data: Dataset) -> str:
    """The channels of a dataset: a row of names, a row of units, a row a sample."""
    heads = [",".join(c.name for c in data.channels), ",".join(c.unit for c in data.channels)]
    rows = zip(*(channel.values.tolist() for channel in data.channels), strict=True)
    return "\n".join([*heads, *(",".join(f"{value:.10g}" for value in row) for row in rows), ""])
