"""Questions that tests ask of a session as a page does, and sessions whose work elsewhere can be waited for."""

import threading
from pathlib import Path
from typing import Any

from kennfeld.app.answer import Answer
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.app.session.side_work import SideWork
from kennfeld.app.session.surrogate_training import SurrogateTraining

WAIT = 120.0  # s, at most


def ask(session: Session, question: str, **arguments: Any) -> Answer:
    """Ask a question, or give a command."""
    return (QUESTIONS.get(question) or COMMANDS[question])(session, arguments)


class WaitingSession:
    """A session whose work in another process can be waited for."""

    def __init__(self, path: Path) -> None:
        self._news = threading.Event()
        self.session = Session(path, self._news.set)

    def ask(self, question: str, **arguments: Any) -> dict[str, Any]:
        """Ask a question without arrays in its answer, or give a command."""
        return dict(ask(self.session, question, **arguments).head)

    def wait(self, work: SideWork[Any] | SurrogateTraining) -> str:
        """Handle the reports until some work has ended; return its state."""
        while work.state == "running":
            assert self._news.wait(WAIT)
            self._news.clear()
            self.session.pump()
        return work.state
