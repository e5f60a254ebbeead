"""Threads: one for each processor where work can be divided, fewer in linear algebra (BLAS)."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, wraps
from threading import RLock
from typing import TYPE_CHECKING, TypeVar, TypeVarTuple

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

LARGE = 1500  # values; above, a factorisation gains from a second thread

_Item = TypeVar("_Item")  # Python 3.11
_Outcome = TypeVar("_Outcome")
_Arguments = TypeVarTuple("_Arguments")


def available_cores() -> int:
    """Return how many processor cores this process may use, which may be fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):  # not known on all systems
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def let_blas_threads_sleep() -> None:
    """Let idle threads of OpenBLAS sleep at once instead of spinning; to be called before numpy is loaded.

    Spinning costs 50 ms at the end of every process. On a busy machine, `cholesky` of 1600 values took 0.05 s instead
    of up to 2 s without it.
    """
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")  # 2**4 cycles, the least


@contextmanager
def blas_threads(values: int) -> Iterator[None]:
    """Limit BLAS to one thread for matrices of moderate size.

    BLAS threads wait for each other by spinning: with other load on the machine, a Cholesky factorisation of 500
    values took thirty times as long on two threads as on one.
    """
    with _blas_libraries("scipy.linalg._fblas" in sys.modules).limit(limits=None if values > LARGE else 1):
        yield


@cache
def _blas_libraries(scipy: bool) -> "ThreadpoolController":
    """Return the BLAS libraries that are loaded: that of numpy, and another one with scipy.

    To look for them among all loaded libraries takes milliseconds, as long as a small fit.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def map_in_order(work: Callable[[_Item], _Outcome], items: Sequence[_Item]) -> Iterator[_Outcome]:
    """Yield the results of `work` in the order of the items, which threads process a few items ahead.

    An error of an item is raised in its turn; items after it are not begun any more.

    >>> list(map_in_order(abs, [-1, 2, -3]))
    [1, 2, 3]
    """
    count = min(available_cores(), len(items))
    if count < 2:
        yield from map(work, items)
        return
    pending: deque[Future[_Outcome]] = deque()
    with ThreadPoolExecutor(count) as pool:
        try:
            for item in items:
                # one more than there are threads, so that none waits until results are taken
                if len(pending) > count:
                    yield pending.popleft().result()
                pending.append(pool.submit(work, item))
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def computed_once(work: Callable[[*_Arguments], _Outcome]) -> Callable[[*_Arguments], _Outcome]:
    """Keep results as `functools.cache` does, and let threads that ask for one wait until it is computed.

    With `functools.cache` alone, threads that ask at the same time compute a result each, and get different objects.
    """
    # reentrant, as a computation may ask for another result
    cached, lock = cache(work), RLock()

    @wraps(work)
    def look_up(*args: *_Arguments) -> _Outcome:
        with lock:
            return cached(*args)

    return look_up
