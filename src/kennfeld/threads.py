"""How many threads linear algebra may use."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

__all__ = ["blas_threads"]

LARGE = 1500  # values from which a factorisation gains from a second thread


@contextmanager
def blas_threads(values: int) -> Iterator[None]:
    """One thread for matrices of moderate size.

    Threads of a BLAS wait for each other by spinning: with other work on the machine, a Cholesky factorisation of 500
    values was seen to take thirty times as long on two threads as on one.
    """
    with threadpool_limits(limits=None if values > LARGE else 1, user_api="blas"):
        yield
