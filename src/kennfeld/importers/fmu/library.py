"""The library of an FMU in this process: loaded, and its functions called to create an instance."""

import ctypes
import os
import sys
from collections.abc import Callable, Iterable
from itertools import count
from pathlib import Path
from typing import Any

from kennfeld.base.errors import InputError, Location
from kennfeld.base.fmi_platform import platform_folder
from kennfeld.base.machine_code.call_record import CallRecord
from kennfeld.base.machine_code.engine import compile_functions
from kennfeld.base.machine_code.external import c_function, provide
from kennfeld.importers.fmu.description import FmuDescription, FmuInterface
from kennfeld.importers.fmu.fmu_archive import library_of, unpack
from kennfeld.importers.fmu.library_format import find_library_problem
from kennfeld.importers.fmu.logger_code import can_format, write_logger

LOADING = "loading its library"  # which runs code as well
READING = "reading its variables"
_MODEL_EXCHANGE = 0
_MOST_MESSAGES, _MOST_CHARACTERS = 20, 300
_numbers = count()


class _Callbacks2(ctypes.Structure):
    """`fmi2CallbackFunctions`."""

    _fields_ = [
        ("logger", ctypes.c_void_p),
        ("allocateMemory", ctypes.c_void_p),
        ("freeMemory", ctypes.c_void_p),
        ("stepFinished", ctypes.c_void_p),
        ("componentEnvironment", ctypes.c_void_p),
    ]


class FmuLibrary:
    """A library in this process, and the different messages it logged; both stay until the process ends.

    `listener` is called with each of these.

    `creation` holds the addresses of what it needs to create instances, by name; `record` what runs.
    """

    def __init__(self, source: Path, description: FmuDescription, interface: FmuInterface, record: CallRecord) -> None:
        """Unpack an FMU and load the library of an interface.

        Raises:
            InputError: there is none for this platform, or it cannot be loaded.
        """
        self.description, self.source, self.record = description, source, record
        unpacked = unpack(source)
        path, self._resources = library_of(unpacked, description.version, interface.identifier), unpacked / "resources"
        if not path.is_file():
            message = f"has no library {path.name} for {platform_folder(description.version)}"
            raise InputError.of(Location(str(source)), message, "Export the FMU for this platform.")
        self.messages: list[str] = []
        self.listener: Callable[[str], None] = _ignore
        self.creation: dict[str, int] = {}
        self._kept: list[Any] = []  # objects whose memory the library refers to
        problem = find_library_problem(path)
        if problem:
            message = f"its library {path.name} cannot be loaded: {problem}"
            raise InputError.of(Location(str(source)), message, "Export the FMU again, for this platform.")
        folder = Path.cwd()
        try:
            os.chdir(path.parent)  # where some libraries look for others
            with record.during(LOADING):
                self._library = ctypes.CDLL(str(path))
        except OSError as error:
            raise InputError.of(Location(str(source)), f"its library cannot be loaded: {error}") from None
        finally:
            os.chdir(folder)

    def address(self, name: str) -> int:
        """Return the address of a function; 0 if the library has none of this name."""
        try:
            return ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value or 0
        except AttributeError:
            return 0

    def provide(self, names: Iterable[str], prefix: str) -> None:
        """Let machine code call functions of the library as `prefix_name`.

        Raises:
            InputError: the library has no function of one of these names.
        """
        for name in names:
            address = self.address(name)
            if not address:
                raise InputError.of(Location.of_file(self.source), f"its library has no function {name}")
            provide(f"{prefix}_{name}", address)

    def provide_creation(self, prefix: str) -> None:
        """Let machine code read what `creation` holds, which `prepare` fills."""
        for name, address in self.creation.items():
            provide(f"{prefix}_{name}", address)

    def instantiate(self) -> int:
        """Create an instance for model exchange, and return its address.

        Raises:
            InputError: the library refuses.
        """
        pointer, text, second = ctypes.c_void_p, ctypes.c_char_p, self.description.version == "2.0"
        name, token, where, log = self.prepare()
        function = "fmi2Instantiate" if second else "fmi3InstantiateModelExchange"
        with self.record.during(function):
            if second:
                create = self._function(function, text, ctypes.c_int, text, text, pointer, *[ctypes.c_int] * 2)
                instance = create(name, _MODEL_EXCHANGE, token, where, log, 0, 0)
            else:
                kinds = (text, text, text, ctypes.c_bool, ctypes.c_bool, pointer, pointer)
                create = self._function(function, *kinds)
                instance = create(name, token, where, False, False, None, log)
        if not instance:
            reasons = f": {'; '.join(self.messages)}" if self.messages else ""
            message = f"its code does not create an instance{reasons}"
            raise InputError.of(Location.of_file(self.source), message, "Try the FMU in the tool that exported it.")
        return instance

    def prepare(self) -> tuple[bytes, bytes, bytes, int]:
        """Prepare name, token, place of resources and callbacks or logger, whose address it returns; see `creation`."""
        second = self.description.version == "2.0"
        # FMI 2.0 takes a URI; FMI 3.0 a path that ends in a separator
        where = self._resources.as_uri() if second else f"{self._resources}{os.sep}"
        # kept like the callbacks: some FMUs keep the pointers that the standard lets them read during the call only
        texts = [text.encode() for text in (self.source.stem, self.description.token, where)]
        log = self._callbacks_2() if second else self._logger_3()
        for part, content in zip(("name", "token", "resources"), texts, strict=True):
            buffer = ctypes.create_string_buffer(content)
            self._kept.append(buffer)
            self.creation[part] = ctypes.addressof(buffer)
        self.creation["log"] = log
        return texts[0], texts[1], texts[2], log

    def _callbacks_2(self) -> int:
        allocate, free = c_function("calloc"), c_function("free")
        # the standard demands memory that is set to 0, hence calloc
        callbacks = _Callbacks2(self._logger_2(), allocate, free, None, None)
        self._kept.append(callbacks)
        return ctypes.addressof(callbacks)

    def _logger_2(self) -> int:
        """Return the address of a logger that formats messages, if that is possible."""
        pointer, text = ctypes.c_void_p, ctypes.c_char_p
        # without vsnprintf, a message is its format, with the % signs
        if not can_format():
            plain = ctypes.CFUNCTYPE(None, pointer, text, ctypes.c_int, text, text)(
                lambda _env, _name, _status, _category, message: self._log(message)
            )
            self._kept.append(plain)
            return ctypes.cast(plain, pointer).value or 0
        # ctypes cannot take variable arguments: machine code formats them and calls this with the text
        sink = ctypes.CFUNCTYPE(None, ctypes.c_int64, text)(lambda _status, message: self._log(message))
        name, place = f"fmu_log_{next(_numbers)}", ctypes.c_void_p()
        provide(name, ctypes.cast(sink, pointer).value or 0)
        logger = compile_functions(*write_logger(name))["logger"]
        logger(ctypes.addressof(place))
        self._kept += [sink, logger]
        return place.value or 0

    def _logger_3(self) -> int:
        text = ctypes.c_char_p
        logger = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, text, text)(
            lambda _env, _status, _category, message: self._log(message)
        )
        self._kept.append(logger)
        return ctypes.cast(logger, ctypes.c_void_p).value or 0

    def _function(self, name: str, *kinds: Any) -> Callable[..., int | None]:
        address = self.address(name)
        if not address:
            raise InputError.of(Location.of_file(self.source), f"its library has no function {name}")
        # read as a pointer: `fmi2Instantiate` returns one, which an int of C would cut to 32 bits
        result: Callable[..., int | None] = ctypes.CFUNCTYPE(ctypes.c_void_p, *kinds)(address)
        return result

    def _log(self, message: bytes | None) -> None:
        if message and len(self.messages) < _MOST_MESSAGES:
            text = message.decode("utf-8", errors="replace").strip()[:_MOST_CHARACTERS]
            if text not in self.messages:
                self.messages.append(text)
                self.listener(text)


def _ignore(_: str) -> None:
    """Ignore a message, which `messages` keep."""


def yield_address() -> int:
    """Return the address of the function by which a thread lets others run."""
    if sys.platform == "win32":
        return ctypes.cast(ctypes.WinDLL("kernel32").SwitchToThread, ctypes.c_void_p).value or 0
    return c_function("sched_yield")


def thread_address() -> int:
    """Return the address of the function that returns a number of the thread that calls it."""
    if sys.platform == "win32":
        return ctypes.cast(ctypes.WinDLL("kernel32").GetCurrentThreadId, ctypes.c_void_p).value or 0
    return c_function("pthread_self")
