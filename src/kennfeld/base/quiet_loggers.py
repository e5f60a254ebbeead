"""Silence for the loggers of a library while this package calls it: what it logs is reported as a finding.

Levels and handlers of loggers belong to the whole process, and to whoever uses the library as well. A filter
that asks the context drops the records of the call alone, in its own thread.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_quiet: ContextVar[frozenset[str]] = ContextVar("quiet", default=frozenset())


class _Silence(logging.Filter):
    def filter(self, record: logging.LogRecord) -> bool:
        return record.name.partition(".")[0] not in _quiet.get()


_silence = _Silence()


@contextmanager
def quiet_loggers(library: str) -> Iterator[None]:
    """Drop what the loggers of a library, which is imported, log in this thread.

    >>> with quiet_loggers("somebody"):
    ...     logging.getLogger("somebody").warning("not shown")
    """
    names = [library, *(name for name in logging.root.manager.loggerDict if name.startswith(f"{library}."))]
    for name in names:
        logging.getLogger(name).addFilter(_silence)  # once: it finds itself there
    token = _quiet.set(_quiet.get() | {library})
    try:
        yield
    finally:
        _quiet.reset(token)
