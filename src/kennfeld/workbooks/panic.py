"""Calls of a library that is written in Rust and gives up on damaged files."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["PanicError", "panics"]


class PanicError(ValueError):
    """The library gave up; what it said."""


@contextmanager
def panics() -> Iterator[None]:
    """Turn what derives from no `Exception` into a `PanicError`; what the library prints about itself is dropped."""
    try:
        with _no_stderr():
            yield
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # a class that no module offers
            raise
        said = str(error)
    else:
        return
    raise PanicError(said)


@contextmanager
def _no_stderr() -> Iterator[None]:
    try:
        kept = os.dup(2)
    except OSError:  # a program without a console
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
