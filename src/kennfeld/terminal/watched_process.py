"""The part of a watched process: it gets its signals from the one that watches it, and tells it how it ended.

`terminal.watching` is the other part. What both know are files of the watch folder: one holds the number of the
process, the other its exit status once its work is done.
"""

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kennfeld.base.watch_folder import WATCHER, remove_noted, watch_folder
from kennfeld.terminal.signals import FORWARDED, obey_forwarded

PROCESS, ENDED = "process", "ended"  # files
_INTERVAL = 1.0  # s between looks at the process that watches this one


@contextmanager
def watched_process() -> Iterator[list[int]]:
    """Run the block as a watched process; it appends its exit status to the list."""
    watcher, folder = int(os.environ.pop(WATCHER)), watch_folder()  # processes that this one starts are not watched
    obey_forwarded()
    if folder is None:  # it was removed, with the process that watches
        sys.exit(1)
    (folder / PROCESS).write_text(str(os.getpid()), encoding="ascii")
    if FORWARDED is not None:  # on Windows, a process does not know that its parent has gone
        threading.Thread(target=_end_with, args=(watcher, folder), daemon=True).start()
    statuses: list[int] = []
    try:
        yield statuses
    finally:  # not reached if foreign code ends the process
        with suppress(OSError):
            (folder / ENDED).write_text("".join(map(str, statuses)), encoding="ascii")


def _end_with(watcher: int, folder: Path) -> None:
    while os.getppid() == watcher:
        time.sleep(_INTERVAL)
    # what the process that has gone would have done
    remove_noted(folder)
    shutil.rmtree(folder, ignore_errors=True)
    # ends the process from this thread, also within a call of foreign code that never returns
    os._exit(1)
