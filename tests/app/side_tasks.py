"""Work for the tests of processes beside a session."""

import threading
from dataclasses import dataclass

from kennfeld.app.session.side_work import PartialOutcome, Tell, WorkStep
from kennfeld.base.errors import InputError, Location


@dataclass(frozen=True)
class Counting:
    """Tells 1, and returns 2; waits for ever, fails or dies in between if asked to."""

    then: str = "end"

    def run(self, tell: Tell) -> int:
        tell(WorkStep("counting", 1, 2))
        tell(PartialOutcome(1))
        if self.then == "wait":
            threading.Event().wait()
        if self.then == "fail":
            raise InputError.of(Location("bench"), "has no numbers")
        if self.then == "die":
            import os

            os._exit(3)
        return 2
