"""Functions outside of a module of machine code, which it calls through pointers in its data."""

import ctypes
import sys
from collections.abc import Callable
from functools import cache, partial

from kennfeld.machine_code.ir import FunctionWriter

PREFIX = "kf."
_ADDRESSES: dict[str, Callable[[], int]] = {}


def external(f: FunctionWriter, name: str, address: Callable[[], int]) -> str:
    """Return a register that holds the address of a function.

    Args:
        f: the function under construction, which calls it.
        name: letters, digits, dots and underscores; the same name always stands for the same function.
        address: gives its address when the code is loaded.
    """
    _ADDRESSES.setdefault(PREFIX + name, address)
    return f.new(f"load ptr, ptr @{PREFIX}{name}")


def address_of(name: str) -> int:
    """Return the address of a function by the name of its pointer."""
    return _ADDRESSES[name]()


def c_pointer(f: FunctionWriter, name: str) -> str:
    """Return a register that holds the address of a function of the C library."""
    return external(f, f"c.{name}", partial(c_function, name))


@cache
def c_function(name: str) -> int:
    """Return the address of a function of the C library."""
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert address is not None
    return address
