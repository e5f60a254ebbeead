"""Undo and redo."""

from kennfeld.app.session.session import Session
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class HistoryStep:
    """The title of the command that was taken back or done again; empty if there is none."""

    title: str


def undo(session: Session) -> HistoryStep:
    """Take the last command back."""
    return HistoryStep(session.undo())


def redo(session: Session) -> HistoryStep:
    """Bring back what was undone."""
    return HistoryStep(session.redo())
