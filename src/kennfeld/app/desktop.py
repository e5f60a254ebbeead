"""Opens files with the programs of the desktop on which the app runs."""

import os
import subprocess
import sys
from pathlib import Path

from kennfeld.base.errors import ArgumentError


def has_desktop() -> bool:
    """Return if there is a desktop, which a server that is reached through SSH lacks."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_on_desktop(path: Path) -> None:
    """Show a file in the program that the desktop has for it, or a folder in its window.

    Raises:
        ArgumentError: there is no desktop, or no such program.
    """
    if not has_desktop():
        raise ArgumentError(f"this machine has no desktop on which {path.name} can be opened; download it instead")
    try:
        if sys.platform == "win32":
            os.startfile(path)
        else:
            program = "open" if sys.platform == "darwin" else "xdg-open"
            null = subprocess.DEVNULL
            subprocess.Popen([program, str(path)], stdin=null, stdout=null, stderr=null, start_new_session=True)
    except OSError as error:
        raise ArgumentError(f"{path.name} cannot be opened: {error.strerror or error}") from None
