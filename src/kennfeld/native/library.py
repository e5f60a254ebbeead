"""The elementary functions of the C library, as generated code calls them: by address.

LLVM translates a call of an address four times as fast as one of a name, which may lie anywhere.
"""

import ctypes
import sys
from collections.abc import Sequence
from functools import cache

from kennfeld.native.ir import Function

__all__ = ["ELEMENTARY", "c_function", "c_library", "call_elementary"]

ELEMENTARY = frozenset(
    {
        *("exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "pow", "erfc"),
    }
)


@cache
def c_library() -> ctypes.CDLL:
    """The C library with the elementary functions, by each system's own name."""
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


@cache
def c_function(name: str) -> int:
    """The address of a function of the C library."""
    address = ctypes.cast(getattr(c_library(), name), ctypes.c_void_p).value
    assert address is not None
    return address


def call_elementary(f: Function, name: str, arguments: Sequence[str]) -> str:
    """A double from one of `ELEMENTARY`."""
    given = ", ".join(f"double {argument}" for argument in arguments)
    return f.new(f"call double inttoptr (i64 {c_function(name)} to ptr)({given}) nounwind memory(none)")
