"""Threads of linear algebra (BLAS)."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

LARGE = 1500  # values; above, a factorisation gains from a second thread


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
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=None if values > LARGE else 1, user_api="blas"):
        yield
