"""The state of a session, the commands that change it, and the history of both.

A state is frozen, and a command is a value: it turns one state into the next and knows its inverse. What a user sees is
computed from a state; nothing else is edited.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter
from kennfeld.project.document import ProjectDocument

Texts = Mapping[str, str]
Values = Mapping[str, Float]


def _nothing() -> Mapping[str, str]:
    return FrozenDict({})


@dataclass(frozen=True, eq=False)
class SessionState:
    """Everything that a user can change.

    Attributes:
        texts: contents of the project file and of formula files, by path relative to the folder of the project.
        values: values of parameters that differ from the initial files, by name, in the shape of the table; also
            breakpoints that a run has moved, see `edited_values`.
        tables: by name the table for which values were given, with its breakpoints; missing if it is not known yet.
    """

    texts: Texts = field(default_factory=_nothing)
    values: Values = field(default_factory=dict)
    tables: Mapping[str, Parameter] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SessionState):
            return NotImplemented
        return self.texts == other.texts and same_values(self.values, other.values)

    def __hash__(self) -> int:
        # arrays have no hash; equal states have equal texts
        return hash(tuple(sorted(self.texts.items())))


def same_values(first: Values, second: Values) -> bool:
    """Return True if both hold the same numbers."""
    return first.keys() == second.keys() and all(np.array_equal(first[name], second[name]) for name in first)


class Command(Protocol):
    """A change of the state; `title` names it in the history: `Dragged MapX at 3, 4`."""

    @property
    def title(self) -> str:
        """The command in a few words."""

    def apply(self, state: SessionState) -> SessionState:
        """Return the state after the command."""


@dataclass(frozen=True, eq=False)
class Restore:
    """Set texts and values of parameters to earlier ones; None removes them. The inverse of every command."""

    title: str
    texts: Mapping[str, str | None] = field(default_factory=dict)
    values: Mapping[str, Float | None] = field(default_factory=dict)

    def apply(self, state: SessionState) -> SessionState:
        """Return the state with these contents."""
        texts = {**state.texts, **self.texts}
        values = {**state.values, **self.values}
        return replace(
            state,
            texts={name: text for name, text in texts.items() if text is not None},
            values={name: table for name, table in values.items() if table is not None},
        )


def inverse(before: SessionState, after: SessionState, title: str = "") -> Restore:
    """Return the command that leads from a state back to the one before."""
    texts = {
        name: before.texts.get(name)
        for name in {**before.texts, **after.texts}
        if before.texts.get(name) != after.texts.get(name)
    }
    # by content: a table that was set to what it was has not changed
    changed = [
        name
        for name in {**before.values, **after.values}
        if not np.array_equal(before.values.get(name, ()), after.values.get(name, ()))
    ]
    return Restore(title, texts, {name: before.values.get(name) for name in changed})


@dataclass(frozen=True, eq=False)
class SetValues:
    """Set values of one parameter.

    Attributes:
        parameter: its name.
        values: all values after the change, in the shape of the table.
    """

    title: str
    parameter: str
    values: Float

    def apply(self, state: SessionState) -> SessionState:
        """Return the state with these values."""
        return replace(state, values={**state.values, self.parameter: self.values})


@dataclass(frozen=True, eq=False)
class SetTables:
    """Set the values of several parameters, such as those of a run; None takes the initial values again."""

    title: str
    values: Mapping[str, Float | None]

    def apply(self, state: SessionState) -> SessionState:
        """Return the state with these values."""
        return Restore("", values=self.values).apply(state)


@dataclass(frozen=True)
class SetText:
    """Replace the content of a text file: the project file or formula text."""

    title: str
    file: str
    text: str

    def apply(self, state: SessionState) -> SessionState:
        """Return the state with this text."""
        return replace(state, texts={**state.texts, self.file: self.text})


@dataclass(frozen=True, eq=False)
class SetKeys:
    """Set keys of the project file; None removes one. Comments, order and notation of everything else stay.

    Attributes:
        file: name of the project file.
        changes: path and value of each key; entries of a list count from 1. Tables that lose their last key are
            removed, too.
        saved: text of the file as it was saved, whose notation is restored with its values.
    """

    title: str
    file: str
    changes: Sequence[tuple[Sequence[str | int], Any]]
    saved: str = ""

    def apply(self, state: SessionState) -> SessionState:
        """Return the state with these keys.

        Raises:
            InputError: the text of the project file is not valid TOML.
        """
        document = ProjectDocument(state.texts[self.file], Path(self.file), earlier=[self.saved] if self.saved else [])
        for path, value in self.changes:
            if value is None:
                document.remove(path)
                document.remove_empty(path[:-1])
            else:
                document.set(path, value)
        return replace(state, texts={**state.texts, self.file: document.text})


@dataclass(frozen=True, eq=False)
class Several:
    """Several commands as one."""

    title: str
    commands: Sequence[Command]

    def apply(self, state: SessionState) -> SessionState:
        """Return the state after all of them, in order."""
        for command in self.commands:
            state = command.apply(state)
        return state


@dataclass(frozen=True, eq=False)
class Entry:
    """A state in the history, and the command that led to it."""

    state: SessionState
    title: str


class History:
    """States in order, and which of them is the present one. Undo is unlimited.

    >>> history = History(SessionState({"a": "1"}))
    >>> history.do(SetText("Edited a", "a", "2"))
    >>> history.undo(), history.state.texts["a"], history.redo(), history.state.texts["a"]
    ('Edited a', '1', 'Edited a', '2')
    """

    def __init__(self, start: SessionState) -> None:
        self._entries = [Entry(start, "")]
        self._at = 0
        self._open = ""  # what a drag in progress changes: its moves are one entry

    @property
    def state(self) -> SessionState:
        """The present state."""
        return self._entries[self._at].state

    def do(self, command: Command, drag: str = "", tables: Mapping[str, Parameter] | None = None) -> None:
        """Apply a command; what was undone is discarded. Commands of the same `drag` are one entry.

        `tables` are those for which the values of the command were given, as far as they are known.
        """
        before, state = self.state, command.apply(self.state)
        # by identity: a command that sets values makes new arrays, for which the table is another
        same = {n: table for n, table in before.tables.items() if state.values.get(n) is before.values.get(n)}
        state = replace(state, tables={**same, **(tables or {})})
        joined = self.joins(drag)
        keep = self._at + (0 if joined else 1)
        self._entries[keep:] = [Entry(state, command.title)]
        self._at, self._open = keep, drag

    def joins(self, drag: str) -> bool:
        """Return if a command of this drag would be a part of the present entry."""
        return bool(drag) and drag == self._open

    def amend(self, command: Command) -> None:
        """Apply a command to the present state without an entry of its own; what was undone is discarded."""
        entry = self._entries[self._at]
        self._entries[self._at :] = [Entry(command.apply(entry.state), entry.title)]

    def hold(self, texts: Texts, saved: SessionState) -> SessionState:
        """Add texts, as they are on disk, to the states that lack them, and return `saved` with them.

        Once a command has replaced such a text and it is saved, the disk no longer has what an undo brings back.
        """
        completed = {
            id(entry.state): replace(entry.state, texts={**texts, **entry.state.texts}) for entry in self._entries
        }
        self._entries = [Entry(completed[id(entry.state)], entry.title) for entry in self._entries]
        return completed.get(id(saved)) or replace(saved, texts={**texts, **saved.texts})

    def note_tables(self, tables: Mapping[str, Parameter]) -> None:
        """Note the tables for which the present values were given, if they are not known yet."""
        entry = self._entries[self._at]
        unknown = {name: tables[name] for name in entry.state.values if name in tables.keys() - entry.state.tables}
        if unknown:
            state = replace(entry.state, tables={**entry.state.tables, **unknown})
            self._entries[self._at] = Entry(state, entry.title)

    def undo(self) -> str:
        """Go back by one entry; return its title, empty if there is none."""
        # a further move of this drag is an entry of its own
        self._open = ""
        if not self._at:
            return ""
        self._at -= 1
        return self._entries[self._at + 1].title

    def redo(self) -> str:
        """Go forward by one entry; return its title, empty if there is none."""
        self._open = ""
        if self._at + 1 == len(self._entries):
            return ""
        self._at += 1
        return self._entries[self._at].title

    @property
    def undoable(self) -> str:
        """Title of the entry that `undo` takes back, empty if there is none."""
        return self._entries[self._at].title

    @property
    def redoable(self) -> str:
        """Title of the entry that `redo` brings back, empty if there is none."""
        following = self._entries[self._at + 1 : self._at + 2]
        return following[0].title if following else ""

    def titles_since(self, saved: SessionState) -> list[str]:
        """Return the titles of the commands since a state, in order; all if it is not in the history.

        Commands up to that state that were undone since are `Undone: Dragged MapX`; if the present state is the same,
        there is none.
        """
        if self.state == saved:
            return []
        states = [entry.state for entry in self._entries]
        # after reading from disk, the saved state is an equal one
        places = [k for k, state in enumerate(states) if state is saved] or [
            k for k, state in enumerate(states) if state == saved
        ]
        begin = max((place for place in places if place <= self._at), default=None)
        if begin is None and places:
            return [f"Undone: {entry.title}" for entry in self._entries[self._at + 1 : places[0] + 1]]
        return [entry.title for entry in self._entries[(begin or 0) + 1 : self._at + 1]]
