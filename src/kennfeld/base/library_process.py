"""A process of its own for a library that damaged files crash, with memory in proportion to the file.

Such a library does not check what it reads: a few wrong bytes make it request gigabytes, read beyond its memory, or
search without end. In another process that costs one message. The process serves one file after the other, as loading
the library takes longer than reading most files, and ends with the one that started it. What the library prints is
discarded.
"""

import atexit
import hashlib
import os
import pickle
import signal
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Protocol

from kennfeld.base.errors import InputError, Location
from kennfeld.base.exit_status import signal_name
from kennfeld.base.process_limits import MEMORY_EXCEEDED, limit_memory, limit_time, memory_bound
from kennfeld.base.windows_job import WindowsJob

if TYPE_CHECKING:
    import subprocess

_COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.base.library_process import main; main()"
_TIME, _TIME_PER_BYTE = 20.0, 1e-6  # s of computing for any file, and for each of its bytes
_LOADING = 512 << 20  # bytes that a job of Windows, which counts all memory, may take for Python and the library
_BLOCK = 1 << 20  # bytes
_COUNT = struct.Struct("<Q")
_REMEDY = "Copy or export it again."
_ENDLESS = "the library that reads it does not come to an end"

Work = Callable[..., Any]


class LibraryInput(Protocol):
    """A file to read: its content, its size in bytes, unpacked and as stored, and its location in findings."""

    @property
    def size(self) -> int: ...

    def stored_size(self) -> int: ...

    def open(self) -> BinaryIO: ...

    @property
    def location(self) -> Location: ...


class LibraryFailure(Exception):  # noqa: N818 - of the library, not of this program
    """A library crashed, did not come to an end, or asked for too much memory; the text says which."""


class LibraryProcess:
    """The process of one library, started when it is needed first."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._lock = Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._job = WindowsJob()
        self._endless: dict[int, set[str]] = {}  # size and hashes of files with which the library did not end

    @property
    def is_running(self) -> bool:
        """State of the process: true once the library is loaded."""
        return self._process is not None and self._owner == os.getpid()

    def call(self, work: Work, source: LibraryInput, *arguments: Any) -> Any:
        """Return `work(source, *arguments)`, a function of a module, evaluated in the process.

        Raises:
            InputError: the function raised it, or the library failed on a damaged file.
        """
        try:
            return self.attempt(work, source, *arguments)
        except LibraryFailure as failure:
            message = f"the {self._kind} file is damaged: {failure}"
            raise InputError.of(source.location, message, _REMEDY) from None

    def attempt(self, work: Work, source: LibraryInput, *arguments: Any) -> Any:
        """Return the same as `call`, but raise `LibraryFailure` if the library fails."""
        if getattr(sys, "frozen", False) or not sys.executable:  # there is no interpreter to start
            return work(source, *arguments)
        with self._lock:
            if self._is_endless(source):  # another reading of it would take as long
                raise LibraryFailure(_ENDLESS)
            process = self._started()
            try:
                bound, seconds = memory_bound(source.stored_size()), _TIME + _TIME_PER_BYTE * source.size
                self._job.set_limits(memory=self._job.most_memory() + _LOADING + bound)
                task = (work.__module__, work.__qualname__, source, arguments)
                _send(process.stdin, (*task, bound, seconds, Path.cwd()))
                good, answer = _receive(process.stdout)
            except (EOFError, OSError):
                self._end()
                reason = _reason(process.returncode, source.stored_size())
                if reason == _ENDLESS:
                    self._endless.setdefault(source.size, set()).add(_digest(source))
                raise LibraryFailure(reason) from None
            except BaseException:  # such as Ctrl-C: the answer would be taken for that of the next file
                self._end()
                raise
        if good:
            return answer
        raise answer

    def _is_endless(self, source: LibraryInput) -> bool:
        """Return whether an earlier reading of this content did not end; hashes only files of the size of such one."""
        if not self._endless:
            return False
        digests = self._endless.get(source.size)
        return digests is not None and _digest(source) in digests

    def _started(self) -> "subprocess.Popen[bytes]":
        if self._process is not None and self._owner == os.getpid() and self._process.poll() is None:
            return self._process
        import subprocess  # most files do without

        # Ctrl-C in the terminal concerns this process alone
        session: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        process = subprocess.Popen(
            [sys.executable, "-c", _COMMAND.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            **session,
        )
        self._job.add(process.pid)
        # after a fork, the process belongs to the parent
        self._process, self._owner = process, os.getpid()
        atexit.register(self._end)
        return process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        atexit.unregister(self._end)
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]


def _digest(source: LibraryInput) -> str:
    digest = hashlib.sha256()
    with source.open() as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _reason(status: int, size: int) -> str:
    """Return why the process ended with an exit status while it read a file of so many bytes."""
    if status == MEMORY_EXCEEDED:
        return _too_large(size)
    name = signal_name(status)
    if name == "SIGXCPU":
        return _ENDLESS
    return f"the library that reads it crashed ({name or f'exit status {status}'})"


def _too_large(size: int) -> str:
    return f"reading its {size / 1e6:.3g} MB takes more than {memory_bound(size) / 1e6:.0f} MB of memory"


def main() -> None:
    """Serve until the other process closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # answers go through a copy of the output, to which the library cannot print
    outgoing = os.fdopen(os.dup(1), "wb")
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 1)
    incoming = sys.stdin.buffer
    with suppress(EOFError, OSError):
        while True:
            _send(outgoing, _answer(*_receive(incoming)))


def _answer(
    module: str,
    name: str,
    source: LibraryInput,
    arguments: tuple[Any, ...],
    bound: int,
    seconds: float,
    folder: Path,
) -> tuple[bool, Any]:
    """Return whether the work was done within its memory and time, and its result or error.

    `folder` is that of relative paths.
    """
    work: Work = getattr(import_module(module), name)
    try:
        os.chdir(folder)
        limit_memory(bound)
        limit_time(seconds)
        return True, work(source, *arguments)
    except MemoryError:
        return False, LibraryFailure(_too_large(source.stored_size()))
    except InputError as error:
        return False, error
    except Exception as error:  # a fault of the program, which the other process shows with its place there
        return False, RuntimeError(f"{type(error).__name__}: {error}")


def _send(stream: IO[bytes] | None, content: Any) -> None:
    """Write a pickle, and after it the arrays that it refers to, which are not copied."""
    assert stream is not None
    buffers: list[pickle.PickleBuffer] = []
    parts = [memoryview(pickle.dumps(content, protocol=5, buffer_callback=buffers.append))]
    parts += [buffer.raw() for buffer in buffers]
    stream.write(_COUNT.pack(len(parts)) + b"".join(_COUNT.pack(part.nbytes) for part in parts))
    for part in parts:
        stream.write(part)
    stream.flush()


def _receive(stream: IO[bytes] | None) -> Any:
    assert stream is not None
    (count,) = _COUNT.unpack(_exactly(stream, _COUNT.size))
    sizes = struct.unpack(f"<{count}Q", _exactly(stream, _COUNT.size * count))
    content, *buffers = [_exactly(stream, size) for size in sizes]
    return pickle.loads(content, buffers=buffers)


def _exactly(stream: IO[bytes], size: int) -> bytearray:
    content = bytearray(size)
    view, at = memoryview(content), 0
    while at < size:
        read = stream.readinto(view[at:])  # type: ignore[attr-defined]
        if not read:
            raise EOFError
        at += read
    return content
