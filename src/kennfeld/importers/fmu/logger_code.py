"""Machine code of the logger of FMI 2.0, whose messages are formats of `printf` with their arguments."""

import platform
import sys

from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import FunctionWriter

MOST_BYTES = 1024  # of a message
# 64 bytes hold the va_list of all platforms: 24 on x86-64, 32 on arm64, a pointer of 8 on macOS with arm64
_VARIADIC = """
declare void @llvm.va_start(ptr)
declare void @llvm.va_end(ptr)
define void @log(ptr %environment, ptr %name, i32 %status, ptr %category, ptr %message, ...) {
  %arguments = alloca [8 x i64], align 16
  call void @llvm.va_start(ptr %arguments)
  %number = sext i32 %status to i64
  call void @say(i64 %number, ptr %message, ptr %arguments)
  call void @llvm.va_end(ptr %arguments)
  ret void
}
"""


def can_format() -> bool:
    """Return True if the C library has the function that formats; that of Windows does not."""
    return sys.platform != "win32"


def write_logger(sink: str) -> list[FunctionWriter]:
    """Write functions of which `logger(place)` writes the address of a logger to a place.

    Args:
        sink: name by which `void sink(int64_t status, const char *message)` was provided.
    """
    f = FunctionWriter("say", [("i64", "status"), ("ptr", "message"), ("ptr", "arguments")], "noinline")
    buffer, arguments = f.slot("i8", MOST_BYTES), "%arguments"
    if sys.platform == "darwin" and platform.machine() == "arm64":
        arguments = f.load("%arguments", kind="ptr")  # a list of arguments is a pointer there, elsewhere a structure
    with f.when(f.new("icmp ne ptr %message, null")):
        f.new(f"call i32 {c_pointer(f, 'vsnprintf')}(ptr {buffer}, i64 {MOST_BYTES}, ptr %message, ptr {arguments})")
        f.do(f"call void {c_pointer(f, sink)}(i64 %status, ptr {buffer})")
    logger = FunctionWriter("logger", [("ptr", "place")], before=_VARIADIC)
    logger.store("@log", "%place", kind="ptr")
    return [f, logger]
