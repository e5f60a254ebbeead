"""The demos, calibrated once for all pictures."""

import tempfile
from functools import cache
from pathlib import Path

from kennfeld import Project, Result
from kennfeld.project import demo


@cache
def folder(name: str) -> Path:
    """Return a folder with a demo, which is removed at the end of the process."""
    path = Path(_all_demos().name) / name
    demo.write(name, path)
    demo.prepare(name, path, print)
    return path


@cache
def _all_demos() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


@cache
def project(name: str, file: str = "kennfeld.toml") -> Project:
    """Return a project of a demo."""
    return Project.read(folder(name) / file)


@cache
def result(name: str, file: str = "kennfeld.toml") -> Result:
    """Return the calibration of a demo."""
    return project(name, file).calibrate()
