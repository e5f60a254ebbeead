"""Messages about trajectories of FMUs that stopped, and messages of the FMUs themselves; each one is reported once."""

import ctypes
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from kennfeld.importers.fmu.instance_calls import DISCARD, ERROR, FATAL, PENDING
from kennfeld.importers.fmu.library import FmuLibrary
from kennfeld.importers.fmu.trajectory_code import (
    EARLY,
    LOST,
    NO_INSTANCE,
    NOT_A_NUMBER,
    ORDER,
    TERMINATED,
    UNEVEN,
)

_LOGGER: Final = logging.getLogger("kennfeld.fmu")
_SENTENCES: Final = {
    DISCARD: "its code discarded the step to t = {time:g} s",
    ERROR: "its code reported an error at t = {time:g} s",
    FATAL: "its code reported a fatal error at t = {time:g} s and cannot run any more",
    PENDING: "its code did not complete the step to t = {time:g} s",
    ORDER: "the time t = {time:g} s does not follow the last one",
    UNEVEN: "it needs steps of equal length, but the step to t = {time:g} s has another one; set `step` under [model]",
    NOT_A_NUMBER: "an input is not a number at t = {time:g} s",
    EARLY: "its code returned early from the step to t = {time:g} s, although that was not allowed",
    TERMINATED: "its code ended the simulation at t = {time:g} s",
    LOST: "its instance was needed by another simulation before t = {time:g} s; run fewer at once",
    NO_INSTANCE: "its code does not create an instance",
}


class StopReports:
    """Messages about the trajectories of an FMU; threads of machine code report at `address`.

    Attributes:
        sentences: the messages.
        reasons: all reasons why trajectories stopped, those without a message as well.
    """

    def __init__(self, source: Path, library: FmuLibrary) -> None:
        self.sentences: list[str] = []
        self.reasons: set[int] = set()
        self._source, self._library = source, library
        self._said: set[int] = set()
        self._library.listener = self._hear
        # trajectories in several threads of machine code report at once
        self._lock = threading.Lock()
        self._callback = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_double)(self._report)

    @contextmanager
    def muted(self) -> Iterator[None]:
        """Run a block whose messages do not matter."""
        said, self._said = self._said, set(_SENTENCES)
        self._library.listener = lambda _: None
        try:
            yield
        finally:
            self._library.messages.clear()
            self._library.listener, self._said = self._hear, said

    @property
    def address(self) -> int:
        """Address of `void report(int reason, double time)`."""
        return ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def _hear(self, message: str) -> None:
        _LOGGER.warning("%s logged: %s", self._source.name, message)

    def _report(self, reason: int, time: float) -> None:
        # one said reason is enough: a fit would repeat it at each of its trial steps
        with self._lock:
            self.reasons.add(reason)
            if reason in self._said:
                return
            self._said.add(reason)
        sentence = _SENTENCES.get(reason, _SENTENCES[ERROR]).format(time=time)
        since = "afterwards" if reason == TERMINATED else "from there on"
        self.sentences.append(f"{self._source.name}: {sentence}; its outputs are NaN {since}")
        _LOGGER.warning(self.sentences[-1])
