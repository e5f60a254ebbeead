"""Work beside the session: it is followed, stopped at once, and what it has reported is kept."""

import threading

import pytest

from kennfeld.app.session.side_work import SideWork, WorkStep
from kennfeld.base.errors import ArgumentError
from tests.app.side_tasks import Counting

pytestmark = pytest.mark.usefixtures("forked_workers")

WAIT = 60.0  # s, at most


class Followed:
    """Work that can be waited for."""

    def __init__(self) -> None:
        self._news = threading.Event()
        self.work: SideWork[int] = SideWork(self._news.set)

    def wait(self, outcome: int | None = None) -> str:
        """Handle what the work tells until it has ended, or has an outcome; return its state."""
        while self.work.state == "running" and (outcome is None or self.work.outcome != outcome):
            assert self._news.wait(WAIT)
            self._news.clear()
            self.work.pump()
        return self.work.state


def test_work_ends_with_its_outcome_and_the_subject_that_it_began_with() -> None:
    own = Followed()
    own.work.start(Counting(), "first")
    with pytest.raises(ArgumentError, match="stop it first"):
        own.work.start(Counting(), "second")
    assert own.wait() == "ended"
    assert (own.work.outcome, own.work.subject, own.work.step) == (2, "first", WorkStep())


def test_stopped_work_keeps_what_it_has_reported() -> None:
    own = Followed()
    own.work.start(Counting("wait"), "first")
    assert own.wait(1) == "running"
    assert own.work.step == WorkStep("counting", 1, 2)
    own.work.stop()
    assert (own.work.state, own.work.outcome) == ("stopped", 1)
    own.work.start(Counting(), "second")  # what the first one still tells is not taken for its own
    assert own.wait() == "ended"
    assert (own.work.outcome, own.work.subject) == (2, "second")


@pytest.mark.parametrize(("then", "reason"), [("fail", "has no numbers"), ("die", "ended unexpectedly")])
def test_work_that_fails_keeps_the_outcome_before_and_says_why(then: str, reason: str) -> None:
    own = Followed()
    own.work.start(Counting(then), "first")
    assert own.wait() == "failed"
    assert reason in own.work.reason
    assert own.work.outcome == 1
