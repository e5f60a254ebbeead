"""Functions outside of a module of machine code, which it calls through pointers in its data."""

import ctypes
import re
import sys
from functools import cache
from typing import NamedTuple

from kennfeld.base.machine_code.ir import FunctionWriter

_POINTER = re.compile(r"@(kf\.[\w.]+)")
_WRITTEN: dict[str, "External"] = {}  # by the names of their pointers
_PROVIDED: dict[str, int] = {}  # addresses of functions of other libraries, by name


class External(NamedTuple):
    """A function that code calls, found again by its name in another process.

    Without `module`, it is one that was provided, or a function of the C library. Otherwise the function `name` of that
    module writes it, called with `arguments`.
    """

    module: str
    name: str
    arguments: tuple[int, ...] = ()

    @property
    def pointer(self) -> str:
        """The name of the pointer in the data of the code."""
        return ".".join(("kf", *filter(None, [self.module]), self.name, *map(str, self.arguments)))


def load_pointer(f: FunctionWriter, external: External) -> str:
    """Return a register of a function under construction that holds the address of an external function."""
    _WRITTEN.setdefault(external.pointer, external)
    return f.new(f"load ptr, ptr @{external.pointer}")


def externals_of(text: str) -> tuple[External, ...]:
    """Return the functions to which IR has pointers."""
    return tuple(_WRITTEN[name] for name in sorted(set(_POINTER.findall(text))))


def c_pointer(f: FunctionWriter, name: str) -> str:
    """Return a register that holds the address of a function of the C library."""
    return load_pointer(f, External("", name))


def provide(name: str, address: int) -> None:
    """Let code call the function at an address by a name that the C library does not have."""
    _PROVIDED[name] = address


def address_of(name: str) -> int:
    """Return the address of a function that was provided, or else of a function of the C library."""
    return _PROVIDED.get(name) or c_function(name)


@cache
def c_function(name: str) -> int:
    """Return the address of a function of the C library."""
    # None is the program itself, which the C library is loaded into
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert address is not None
    return address
