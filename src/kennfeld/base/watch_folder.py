"""The folder that a process shares with the one that watches it, which removes it at the end.

It holds what must not outlive a crash: records of calls of foreign code, unpacked files, and the names of temporary
files elsewhere.
"""

import os
import sys
import threading
from contextlib import suppress
from pathlib import Path

DEFAULT_LIMIT = 60.0  # s that one call of foreign code may take
FOLDER = "KENNFELD_WATCH"  # environment variable with its path; other processes of the command inherit it
WATCHER = "KENNFELD_WATCHER"  # environment variable of a process that is watched: the number of the one that watches
_WINDOWS_QUERY, _WINDOWS_RUNNING = 0x1000, 259  # PROCESS_QUERY_LIMITED_INFORMATION, STILL_ACTIVE
_NAMES = ".temporary"  # ending of lists of temporary files


def watch_folder() -> Path | None:
    """Return the folder; None if nobody watches this process."""
    path = os.environ.get(FOLDER)
    return Path(path) if path and Path(path).is_dir() else None


def note_temporary(path: Path) -> None:
    """Let the process that watches this one remove a file that is left behind."""
    folder = watch_folder()
    if folder is not None:
        # a list for each thread, so that lines of two never mix
        name = f"{os.getpid()}-{threading.get_ident()}{_NAMES}"
        with suppress(OSError), (folder / name).open("a", encoding="utf-8", errors="surrogateescape") as file:
            file.write(f"{path.absolute()}\0")


def remove_noted(folder: Path) -> None:
    """Remove the temporary files that processes have left behind."""
    for names in folder.glob(f"*{_NAMES}"):
        with suppress(OSError):
            for name in names.read_text(encoding="utf-8", errors="surrogateescape").split("\0")[:-1]:
                with suppress(OSError):
                    Path(name).unlink(missing_ok=True)


def is_running(process: int) -> bool:
    """Return if the process of a number runs."""
    if sys.platform == "win32":  # where signal 0 ends a process
        import ctypes

        library, status = ctypes.windll.kernel32, ctypes.c_ulong(0)
        handle = library.OpenProcess(_WINDOWS_QUERY, False, process)
        library.GetExitCodeProcess(handle, ctypes.byref(status))
        library.CloseHandle(handle)
        return status.value == _WINDOWS_RUNNING
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return True
