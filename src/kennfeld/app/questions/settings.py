"""The settings of the project: keys of the project file, and the text of the function."""

import math
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

from kennfeld.app.folders import writable
from kennfeld.app.session.files_on_disk import Conflict
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetText
from kennfeld.app.wire import ABSENT, Absent, KeyChange, KeyPath, Toml
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.project.schema import read_project
from kennfeld.project.toml_file import parse_value


@dataclass(frozen=True)
class SettingsReply:
    """The project file and the function: tables and text of the former, name and text of the latter."""

    settings: Mapping[str, Toml]
    text: str
    file: str
    function: str


@dataclass(frozen=True)
class KeysEdit:
    """Keys of the project file with their new values. Edits of one `drag` are one entry of the history."""

    changes: Sequence[KeyChange]
    title: str
    drag: str = ""


@dataclass(frozen=True)
class TomlEdit:
    """A key of the project file, and its value as TOML; an empty text removes the key."""

    path: KeyPath
    text: str
    title: str


@dataclass(frozen=True)
class TextEdit:
    """The text of the function, or of the project file if `file` is empty."""

    file: str
    text: str
    title: str
    drag: str = ""


@dataclass(frozen=True)
class SaveCommand:
    """With `force`, files that another program has changed are replaced."""

    force: bool = False


@dataclass(frozen=True)
class SaveReply:
    """Files that another program has changed, if there are any; nothing was written then."""

    conflicts: Sequence[Conflict] | Absent = ABSENT


@dataclass(frozen=True)
class RecoverCommand:
    """With `discard`, the edits are forgotten."""

    discard: bool = False


def settings(session: Session) -> SettingsReply:
    """Return the tables of the project file, and the texts of the project file and the function."""
    text, file = session.state.texts[session.path.name], session.formula_file
    known = file in session.state.texts or (session.path.parent / file).is_file()
    function = session.text_of(file) if file and known else ""
    if function:
        session.note_shown(file, function)
    return SettingsReply(_plain(session.settings), text, file, function)


def _plain(value: Any) -> Any:
    """Return TOML values for JSON: infinite numbers as text."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "inf" if value > 0 else "-inf" if value < 0 else "nan"
    return value.isoformat() if isinstance(value, date | time) else value


def _toml(value: Any) -> Any:
    """Return values of JSON for TOML: "inf" within a list is a number."""
    if isinstance(value, list):
        return [float(each) if each in ("inf", "-inf") else _toml(each) for each in value]
    if isinstance(value, dict):
        return {key: _toml(inner) for key, inner in value.items()}
    return value


def set_keys(session: Session, asked: KeysEdit) -> None:
    """Set keys of the project file."""
    changes = [(path, _toml(value)) for path, value in asked.changes]
    session.do(session.key_command(asked.title, changes), asked.drag)


def set_toml(session: Session, asked: TomlEdit) -> None:
    """Set a key to a value that is written as TOML.

    Raises:
        InputError: the text is not a value, or the project file reports an error of it.
    """
    path, text = asked.path, asked.text.strip()
    value = parse_value(str(path[-1]), text) if text else None
    command = session.key_command(asked.title, [(path, value)])
    refusals = _new_errors(session, command)
    if refusals:
        raise InputError(refusals)
    session.do(command)


def _new_errors(session: Session, command: SetKeys) -> list[Finding]:
    """Return the errors of the project file that a command would add."""
    name = session.path.name
    before, after = (
        _errors(session.path, state.texts[name]) for state in (session.state, command.apply(session.state))
    )
    known = {(finding.location.path, finding.message) for finding in before}
    return [finding for finding in after if (finding.location.path, finding.message) not in known]


def _errors(path: Path, text: str) -> tuple[Finding, ...]:
    try:
        read_project(path, {path.name: text.removeprefix("\ufeff").replace("\r\n", "\n")})
    except InputError as error:
        return error.findings
    return ()


def set_text(session: Session, asked: TextEdit) -> None:
    """Replace the text of the function or of the project file."""
    file = asked.file or session.path.name
    if file not in (session.path.name, session.formula_file):
        raise InputError.of(Location(file[:200]), "is not a file of this project")
    writable(session.path.parent, file)
    session.do(SetText(asked.title, file, asked.text), asked.drag)


def save(session: Session, asked: SaveCommand) -> SaveReply:
    """Write what was edited to the files of the project.

    Files that another program has changed since they were read are replaced only with `force`; without it, nothing is
    written, and the reply has them, each with its text on disk and that of the session.
    """
    conflicts = [] if asked.force else session.conflicts
    if conflicts:
        return SaveReply(conflicts)
    session.save(replace=asked.force)
    return SaveReply()


def reload(session: Session) -> None:
    """Take over what another program wrote to the files of the project; undo brings back what was edited here."""
    session.reload()


def discard(session: Session) -> None:
    """Take back everything that is not saved; undo brings it back."""
    session.discard()


def recover(session: Session, asked: RecoverCommand) -> None:
    """Take over the edits of a session that ended without saving, or forget them."""
    session.recover(discard=asked.discard)
