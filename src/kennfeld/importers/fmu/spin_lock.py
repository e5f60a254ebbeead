"""Machine code of a lock: a thread that waits for it yields the processor again and again."""

from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import FunctionWriter

YIELD = "yield_processor"


def write_acquire(f: FunctionWriter, lock: str, kind: str) -> None:
    """Wait until a lock is free, and take it.

    Args:
        f: where to write.
        lock: its address; it is 0 while it is free.
        kind: its type, `i32` or `i64`.
    """
    # one pass from 0 to 1, in which the position advances only once the lock was free
    with f.walk(1) as (_, position):
        busy = f.new(f"icmp ne {kind} {f.new(f'atomicrmw xchg ptr {lock}, {kind} 1 acquire')}, 0")
        with f.when(busy):
            f.new(f"call i32 {c_pointer(f, YIELD)}()")
        position.set(f.new(f"select i1 {busy}, i64 0, i64 1"))


def write_release(f: FunctionWriter, lock: str, kind: str) -> None:
    """Free a lock; the arguments are those of `write_acquire`."""
    f.do(f"store atomic {kind} 0, ptr {lock} release, align {int(kind[1:]) // 8}")
