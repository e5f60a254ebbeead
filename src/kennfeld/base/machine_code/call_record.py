"""Records of calls of foreign code: what is being computed, for the process that reports a crash or an endless loop.

A record is memory that is mapped to a file of the watch folder, so that it survives its process. Without such a folder
it is memory of the process, and the code that writes it is the same. Writing it costs a few stores a call.

    record = CallRecord("plant.fmu", ["fmi2GetReal", "fmi2DoStep"])
    with record.during("fmi2DoStep"):
        ...

Machine code writes the same by `write_place`, `write_begin` and `write_end`, with the address of a slot. Threads that
call at the same time need a slot each.
"""

import ctypes
import json
import math
import mmap
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from kennfeld.base.watch_folder import watch_folder

if TYPE_CHECKING:
    from kennfeld.base.machine_code.ir import FunctionWriter

SLOT_SIZE = 32  # bytes: number of the function, or 0; number of calls so far; instance; time as a double
_FUNCTION, _CALLS, _INSTANCE, _TIME = range(4)  # their places, in words of 8 bytes
_HEAD = 8192  # bytes of JSON before the slots
_ENDING = ".calls"
_INHERIT_NONE = 2  # VM_INHERIT_NONE of macOS
_numbers = count()


class ForeignCall(NamedTuple):
    """A call of foreign code that has not returned.

    Attributes:
        file: name of the file of the code.
        function: name of the function; a participle phrase such as `loading the library` if it is none.
        instance: number of the instance, >= 0.
        time: time in s; NaN if it does not matter.
        number: number of the call, different for each call of a slot.
        process: number of the process.
        slot: place of the record, for comparison.
    """

    file: str
    function: str
    instance: int
    time: float
    number: int
    process: int
    slot: tuple[str, int]


class CallRecord:
    """The record of calls of the code of a file in this process.

    Args:
        file: name of the file.
        functions: names of the functions that are called.
        slots: number of calls that may run at the same time.
    """

    def __init__(self, file: str, functions: Sequence[str], slots: int = 1) -> None:
        self.functions = tuple(functions)
        head = json.dumps({"file": file, "process": os.getpid(), "functions": self.functions}).encode()
        content = head.ljust(_HEAD, b"\0") + bytes(SLOT_SIZE * slots)
        # a longer head reaches into the slots, so that nobody could read such a record
        self._memory = _shared_memory(content) if len(head) <= _HEAD else None
        if self._memory is None:
            self._memory = mmap.mmap(-1, len(content))
        # two views of the same slots, as times are doubles
        self._words = (ctypes.c_int64 * (4 * slots)).from_buffer(self._memory, _HEAD)
        self._times = (ctypes.c_double * (4 * slots)).from_buffer(self._memory, _HEAD)
        for slot in range(slots):
            self._words[4 * slot + _INSTANCE], self._times[4 * slot + _TIME] = slot, math.nan

    def address(self, slot: int = 0) -> int:
        """Return the address of a slot, for machine code."""
        return ctypes.addressof(self._words) + SLOT_SIZE * slot

    def number(self, function: str) -> int:
        """Return the number by which machine code names a function."""
        # 0 means none
        return self.functions.index(function) + 1

    def begin(self, function: int, slot: int = 0) -> None:
        """Write that the function of this number is about to be called, at no time."""
        at = 4 * slot
        # the function comes last, so that a reader sees a complete call or none
        self._words[at + _CALLS] += 1
        self._times[at + _TIME] = math.nan
        self._words[at + _FUNCTION] = function

    def end(self, slot: int = 0) -> None:
        """Write that it has returned."""
        self._words[4 * slot + _FUNCTION] = 0

    @contextmanager
    def during(self, function: str, slot: int = 0) -> Iterator[None]:
        """Run a block that calls a function."""
        self.begin(self.number(function), slot)
        try:
            yield
        finally:
            self.end(slot)


def write_place(f: "FunctionWriter", slot: str, time: str, instance: str = "") -> None:
    """Write the time of the calls that follow, and their instance if it is not always the number of the slot.

    The arguments are registers, `slot` that of an address.
    """
    f.store(time, slot, _TIME)
    if instance:
        f.store(instance, slot, _INSTANCE, "i64")


def write_begin(f: "FunctionWriter", slot: str, function: int) -> None:
    """Write that the function of this number is about to be called."""
    f.store(f.add(f.load(slot, _CALLS, "i64"), 1), slot, _CALLS, "i64")
    f.store(str(function), slot, _FUNCTION, "i64")


def write_end(f: "FunctionWriter", slot: str) -> None:
    """Write that all functions have returned."""
    f.store("0", slot, _FUNCTION, "i64")


def read_calls(folder: Path) -> tuple[ForeignCall, ...]:
    """Return the calls that have not returned, of all processes that share a watch folder."""
    calls: list[ForeignCall] = []
    for path in sorted(folder.glob(f"*{_ENDING}")):
        with suppress(OSError, ValueError, LookupError):
            calls += _calls_of(path)
    return tuple(calls)


def recorded_files(folder: Path) -> tuple[str, ...]:
    """Return the names of the files whose code processes that share a watch folder have called."""
    names: list[str] = []
    for path in sorted(folder.glob(f"*{_ENDING}")):
        with suppress(OSError, ValueError, LookupError):
            names.append(_head_of(path.read_bytes())["file"])
    return tuple(dict.fromkeys(names))


def _calls_of(path: Path) -> Iterator[ForeignCall]:
    content = path.read_bytes()
    head = _head_of(content)
    slots = (len(content) - _HEAD) // SLOT_SIZE
    words = (ctypes.c_int64 * (4 * slots)).from_buffer_copy(content, _HEAD)
    times = (ctypes.c_double * (4 * slots)).from_buffer_copy(content, _HEAD)
    for slot in range(slots):
        function, number, instance = words[4 * slot : 4 * slot + 3]
        if function:
            name, time = head["functions"][function - 1], times[4 * slot + _TIME]
            yield ForeignCall(head["file"], name, instance, time, number, head["process"], (path.name, slot))


def _head_of(content: bytes) -> dict[str, Any]:
    head: dict[str, Any] = json.loads(content[:_HEAD].rstrip(b"\0"))
    return head


def _shared_memory(content: bytes) -> mmap.mmap | None:
    folder = watch_folder()
    if folder is None:
        return None
    try:
        with (folder / f"{os.getpid()}-{next(_numbers)}{_ENDING}").open("x+b") as file:
            file.write(content)
            file.flush()
            memory = mmap.mmap(file.fileno(), len(content))
    except (OSError, ValueError):
        return None
    _keep_from_forks(memory)
    return memory


def _keep_from_forks(memory: mmap.mmap) -> None:
    """Unmap a record in processes that foreign code forks: one that returns from its call ends there.

    It would go on with the run beside its parent, and be forked in its next call as well.
    """
    with suppress(OSError, AttributeError):
        if hasattr(mmap, "MADV_DONTFORK"):
            memory.madvise(mmap.MADV_DONTFORK)
        elif sys.platform == "darwin":
            address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
            ctypes.CDLL(None).minherit(ctypes.c_void_p(address), ctypes.c_size_t(len(memory)), _INHERIT_NONE)
