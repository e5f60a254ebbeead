"""Memory that reading recordings leaves behind."""

import ctypes
import sys
from contextlib import suppress


def return_unused() -> None:
    """Return freed memory to the operating system, where it can be asked to take it."""
    if "pyarrow" in sys.modules:
        import pyarrow as pa

        pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library than glibc
            ctypes.CDLL(None).malloc_trim(0)
