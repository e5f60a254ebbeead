"""Refuses pipes, sockets and devices that a command would open by name: reading them may never end.

The names come from projects of strangers, so that every file counts that Python opens, whichever module or library
opens it. Python reports each one before it is opened (PEP 578).
"""

import os
import pathlib
import stat
import sys
from contextlib import suppress
from errno import EINVAL
from typing import Any

_STREAMS = ("/dev/fd/", "/dev/std", "/dev/tty", "/dev/pts/", "/proc/self/fd/")  # of this process, which its user names


def refuse_special_files() -> None:
    """Raise `OSError` from now on where this process opens a pipe, socket or device by name."""
    sys.addaudithook(_check)


def _check(event: str, arguments: tuple[Any, ...]) -> None:
    # a number is a stream that is open already
    if event != "open" or isinstance(arguments[0], int):
        return
    path = os.fsdecode(arguments[0])
    if is_special(path):
        raise OSError(EINVAL, "it is a pipe or a device, not a file", path)


def is_special(path: str) -> bool:
    """Return True for what is neither a file nor a folder, except for an empty device and the user's own streams."""
    with suppress(OSError, ValueError):
        mode = pathlib.Path(path).stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            return path != os.devnull and not path.startswith(_STREAMS)
    return False
