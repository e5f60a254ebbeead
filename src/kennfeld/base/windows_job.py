"""Job objects of Windows: processes that end together, within limits of number and memory.

Source: Microsoft, "Job Objects", JOBOBJECT_EXTENDED_LIMIT_INFORMATION.
"""

import ctypes
import os
from typing import Any

_EXTENDED_LIMITS = 9  # JobObjectExtendedLimitInformation
_ACTIVE_PROCESSES, _JOB_MEMORY, _KILL_ON_CLOSE = 0x8, 0x200, 0x2000
_SILENT_BREAKAWAY = 0x1000  # what the processes start is not in the job
_SET_QUOTA_AND_TERMINATE = 0x0100 | 0x0001  # rights to a process that is put into a job


class _BasicLimits(ctypes.Structure):
    _fields_ = (
        ("PerProcessUserTimeLimit", ctypes.c_int64),
        ("PerJobUserTimeLimit", ctypes.c_int64),
        ("LimitFlags", ctypes.c_uint32),
        ("MinimumWorkingSetSize", ctypes.c_size_t),
        ("MaximumWorkingSetSize", ctypes.c_size_t),
        ("ActiveProcessLimit", ctypes.c_uint32),
        ("Affinity", ctypes.c_size_t),
        ("PriorityClass", ctypes.c_uint32),
        ("SchedulingClass", ctypes.c_uint32),
    )


class _ExtendedLimits(ctypes.Structure):
    _fields_ = (
        ("BasicLimitInformation", _BasicLimits),
        ("IoInfo", ctypes.c_uint64 * 6),
        ("ProcessMemoryLimit", ctypes.c_size_t),
        ("JobMemoryLimit", ctypes.c_size_t),
        ("PeakProcessMemoryUsed", ctypes.c_size_t),
        ("PeakJobMemoryUsed", ctypes.c_size_t),
    )


def _kernel() -> Any:
    """Return the functions of Windows; None on other systems."""
    return getattr(ctypes, "WinDLL")("kernel32") if os.name == "nt" else None  # noqa: B009 - unknown to their types


class WindowsJob:
    """A job that ends its processes when it is closed, or when this process ends; elsewhere it does nothing.

    Args:
        processes: number that may run at the same time; 0 for any.
        memory: bytes that they may use together; 0 for any.
        breakaway: leave out the processes that those of the job start.
    """

    def __init__(self, processes: int = 0, memory: int = 0, *, breakaway: bool = False) -> None:
        self._flags = _KILL_ON_CLOSE | (_SILENT_BREAKAWAY if breakaway else 0)
        self._handle: Any = None
        self._library: Any = None
        self._library = _kernel()
        if self._library is None:
            return
        for name in ("CreateJobObjectW", "OpenProcess"):
            # handles have 64 bits, of which the default type would cut the upper half
            getattr(self._library, name).restype = ctypes.c_void_p
        self._handle = ctypes.c_void_p(self._library.CreateJobObjectW(None, None))
        self.set_limits(processes, memory)

    def set_limits(self, processes: int = 0, memory: int = 0) -> None:
        """Replace the limits; processes beyond them cannot start, and memory beyond them cannot be had."""
        if self._handle is None:
            return
        limits = _ExtendedLimits()
        limits.BasicLimitInformation.LimitFlags = (
            self._flags | (_ACTIVE_PROCESSES if processes else 0) | (_JOB_MEMORY if memory else 0)
        )
        limits.BasicLimitInformation.ActiveProcessLimit = processes
        limits.JobMemoryLimit = memory
        size = ctypes.sizeof(limits)
        self._library.SetInformationJobObject(self._handle, _EXTENDED_LIMITS, ctypes.byref(limits), size)

    def most_memory(self) -> int:
        """Return the bytes that the processes took together at most; 0 elsewhere."""
        if self._handle is None:
            return 0
        limits = _ExtendedLimits()
        size = ctypes.sizeof(limits)
        self._library.QueryInformationJobObject(self._handle, _EXTENDED_LIMITS, ctypes.byref(limits), size, None)
        return int(limits.PeakJobMemoryUsed)

    def add(self, process: int) -> None:
        """Put a process into the job, and those that it starts from now on."""
        if self._handle is None:
            return
        handle = ctypes.c_void_p(self._library.OpenProcess(_SET_QUOTA_AND_TERMINATE, False, process))
        self._library.AssignProcessToJobObject(self._handle, handle)
        self._library.CloseHandle(handle)

    def close(self) -> None:
        """End all processes of the job."""
        if self._handle is not None:
            self._library.CloseHandle(self._handle)
            self._handle = None
