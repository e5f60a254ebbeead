"""Packages that are installed on request, and the message where one is missing."""

from collections.abc import Iterator
from contextlib import contextmanager

from kennfeld.base.errors import InputError, Location


@contextmanager
def optional_package(location: Location, extra: str) -> Iterator[None]:
    """Convert an `ImportError` within the block to an `InputError` with the command that installs the package.

    Args:
        location: what needs the package: a file, or a section of the project file.
        extra: the extra of `pyproject.toml` that installs it.

    >>> with optional_package(Location("drive.mf4"), "mdf"):
    ...     import asamMDF
    Traceback (most recent call last):
    kennfeld.InputError: drive.mf4: the package asamMDF is not installed. Run: pip install "kennfeld[mdf]"
    """
    try:
        yield
    except ImportError as error:
        package = (error.name or str(error)).partition(".")[0]
        message = f"the package {package} is not installed"
        raise InputError.of(location, message, install_command(extra)) from error


def install_command(extra: str) -> str:
    """Return the remedy that installs an extra.

    >>> install_command("cluster")
    'Run: pip install "kennfeld[cluster]"'
    """
    return f'Run: pip install "kennfeld[{extra}]"'
