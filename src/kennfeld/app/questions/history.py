"""Undo and redo."""

from kennfeld.app.answer import Answer, Given
from kennfeld.app.session.session import Session


def undo(session: Session, given: Given) -> Answer:
    """Take the last command back."""
    return Answer({"title": session.undo()})


def redo(session: Session, given: Given) -> Answer:
    """Bring back what was undone."""
    return Answer({"title": session.redo()})
