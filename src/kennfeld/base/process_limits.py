"""Limits that a process sets for itself, so that foreign code in it cannot take the whole machine."""

import math
import os
import shutil
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

_LINUX = sys.platform.startswith("linux")
MEMORY_EXCEEDED = 77  # exit status of a process that ends itself because it exceeds its memory
MOST_PROCESSES = 64 + 4 * (os.cpu_count() or 1)  # that foreign code may start
_HARMLESS = 384 << 20  # bytes that reading any file may take
_PER_BYTE = 1000  # bytes for each byte of the file: the best compression
_MOST_TASKS = 1024  # processes and threads in addition to those of the whole system
_SPARE_DISK = 2  # a file may take this part of the free disk space
_WATCH_INTERVAL = 0.05  # s
_CGROUP = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def limit_foreign_code() -> None:
    """Limit this process and those that it starts; Windows has job objects instead.

    Memory: that of the machine, for each process (Linux). Size of a file: half of the free disk space. Processes and
    threads of this user: 1024 more than run now on the whole system; the superuser is exempt. No core files.
    """
    if os.name == "nt":
        return
    import resource

    memory, tasks = machine_memory(), _running_tasks()
    if memory and _LINUX:
        _lower(resource.RLIMIT_DATA, memory)
    if tasks:
        _lower(resource.RLIMIT_NPROC, tasks + _MOST_TASKS)
    places = [folder for folder in (Path.cwd(), Path(tempfile.gettempdir())) if folder.is_dir()]
    free = max((shutil.disk_usage(folder).free for folder in places), default=0)
    if free:
        _lower(resource.RLIMIT_FSIZE, free // _SPARE_DISK)
    _lower(resource.RLIMIT_CORE, 0)


def machine_memory() -> int:
    """Return the memory of the machine, or of the container, in bytes; 0 if it is unknown."""
    sizes = [_windows_memory()] if os.name == "nt" else []
    with suppress(AttributeError, ValueError, OSError):
        sizes.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for path in _CGROUP:
        with suppress(OSError, ValueError):
            sizes.append(int(path.read_text("ascii")))
    return min((size for size in sizes if size > 0), default=0)


def _windows_memory() -> int:
    """Return the memory of a machine with Windows in bytes, from MEMORYSTATUSEX."""
    import ctypes

    status = (ctypes.c_uint64 * 8)()  # its size and the load in the first word, then the total
    status[0] = ctypes.sizeof(status)
    library = getattr(ctypes, "WinDLL")("kernel32")  # noqa: B009 - unknown to the types of other systems
    return int(status[1]) if library.GlobalMemoryStatusEx(ctypes.byref(status)) else 0


def memory_bound(size: int) -> int:
    """Return the bytes of memory that reading a file of so many bytes may take; a file that claims more is damaged.

    >>> memory_bound(80_000) // 10**6
    482
    """
    return _HARMLESS + _PER_BYTE * size


def limit_memory(size: int) -> None:
    """Let this process have `size` bytes more than it has now; a later call replaces an earlier one.

    On Linux, what exceeds them raises `MemoryError`. On macOS, whose kernel knows no such limit, the process ends with
    `MEMORY_EXCEEDED`. On Windows, the process that started this one puts it into a job.
    """
    if os.name == "nt":
        return
    import resource

    if _LINUX:
        # the pages of the address space, which RLIMIT_AS limits
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        wanted = pages * os.sysconf("SC_PAGE_SIZE") + size
        wanted = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))
        return
    # a peak, so that a later call counts from the most that was used before
    _MemoryWatch.limit = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss + size
    if not _MemoryWatch.started:
        _MemoryWatch.started = True
        threading.Thread(target=_MemoryWatch.watch, daemon=True).start()


class _MemoryWatch:
    """Ends this process if it takes more memory than a limit."""

    limit = 0
    started = False

    @classmethod
    def watch(cls) -> None:
        import resource

        while resource.getrusage(resource.RUSAGE_SELF).ru_maxrss <= cls.limit:  # bytes on macOS
            time.sleep(_WATCH_INTERVAL)
        os._exit(MEMORY_EXCEEDED)


def limit_time(seconds: float) -> None:
    """Let this process compute for so many seconds from now on; then it ends with SIGXCPU. Not on Windows."""
    if os.name == "nt":
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    wanted = math.ceil(used.ru_utime + used.ru_stime + seconds)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CPU, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))


def _running_tasks() -> int:
    """Return the number of processes, on Linux with their threads, of the whole system; 0 if it is unknown."""
    with suppress(OSError, ValueError, IndexError):
        if _LINUX:
            # `0.1 0.2 0.3 2/345 6789`: behind the stroke are all processes and threads
            return int(Path("/proc/loadavg").read_text("ascii").split()[3].partition("/")[2])
        import subprocess

        listed = subprocess.run(["ps", "-axo", "pid="], capture_output=True, check=False, timeout=5)
        return listed.stdout.count(b"\n")
    return 0


def _lower(limit: int, wanted: int) -> None:
    """Lower a soft limit; a process may raise it again, unlike the hard one."""
    import resource

    with suppress(OSError, ValueError):
        soft, hard = resource.getrlimit(limit)
        known = [value for value in (soft, hard, wanted) if value != resource.RLIM_INFINITY]
        resource.setrlimit(limit, (min(known), hard))
