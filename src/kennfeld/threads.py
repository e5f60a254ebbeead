"""Threads of linear algebra (BLAS)."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

LARGE = 1500  # values; above, a factorisation gains from a second thread


@contextmanager
def blas_threads(values: int) -> Iterator[None]:
    """Limit BLAS to one thread for matrices of moderate size.

    BLAS threads wait for each other by spinning: with other load on the machine, a Cholesky factorisation of 500
    values took thirty times as long on two threads as on one.
    """
    with threadpool_limits(limits=None if values > LARGE else 1, user_api="blas"):
        yield
