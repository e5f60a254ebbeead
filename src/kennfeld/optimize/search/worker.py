"""Starts in several processes: the side that calculates them. See `workers.py`."""

import os
import pickle
import queue
import signal
import sys
import threading
from contextlib import suppress
from typing import IO, Any

from kennfeld.arrays import silent
from kennfeld.errors import InputError
from kennfeld.optimize.result import TraceLine
from kennfeld.optimize.search.sequence import Begin, Climber
from kennfeld.optimize.search.workers import READY, STOP, pickled
from kennfeld.optimize.solver.gauss_newton import Stop

__all__ = ["main"]


def main() -> None:
    """Read a problem from stdin, then starts; write each accepted step and each end to stdout.

    The process ends with its stdin.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "wb")
    with suppress(OSError):
        os.dup2(2, 1)  # what anybody prints must not get between the pickles
    with silent():
        try:
            problem, options = pickle.load(sys.stdin.buffer)
            climber = Climber(problem, options)
        except Exception:
            sys.exit(1)  # the other side does the work itself then
        _Working(climber, sys.stdin.buffer, outgoing).serve()


class _Working:
    """A worker at work."""

    def __init__(self, climber: Climber, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self.climber, self.incoming, self.outgoing = climber, incoming, outgoing
        self.begins: queue.SimpleQueue[Begin] = queue.SimpleQueue()
        self.stopping = threading.Event()

    def serve(self) -> None:
        """Climb until nobody listens any more."""
        threading.Thread(target=self._listen, daemon=True).start()
        self._say(READY)
        while True:
            begin = self.begins.get()
            try:
                self._say(self.climber.climb(begin, self._report, self._say))
            except InputError as error:
                self._say(error.findings)

    def _listen(self) -> None:
        try:
            while True:
                said = pickle.load(self.incoming)
                if said == STOP:
                    self.stopping.set()
                else:
                    self.begins.put(said)
        finally:
            os._exit(0)

    def _report(self, line: TraceLine) -> None:
        self._say(line)
        if self.stopping.is_set():
            raise Stop

    def _say(self, content: Any) -> None:
        try:
            self.outgoing.write(pickled(content))
            self.outgoing.flush()
        except OSError:
            os._exit(1)
