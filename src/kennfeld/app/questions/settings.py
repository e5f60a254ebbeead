"""The settings of the project: keys of the project file, and the text of the function."""

import math
from collections.abc import Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

from kennfeld.app.answer import Answer, Given
from kennfeld.app.folders import writable
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetText
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.project.schema import read_project
from kennfeld.project.toml_file import parse_value

Changes = Sequence[tuple[Sequence[str | int], Any]]


def settings(session: Session, given: Given) -> Answer:
    """Return the tables of the project file, and the texts of the project file and the function."""
    text, file = session.state.texts[session.path.name], session.formula_file
    known = file in session.state.texts or (session.path.parent / file).is_file()
    function = session.text_of(file) if file and known else ""
    if function:
        session.note_shown(file, function)
    return Answer({"settings": _plain(session.settings), "text": text, "file": file, "function": function})


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


def set_keys(session: Session, given: Given) -> Answer:
    """Set keys of the project file: `changes` are pairs of a path and a value, null removes the key."""
    changes = [(tuple(path), _toml(value)) for path, value in given["changes"]]
    session.do(_command(session, given, changes), str(given.get("drag", "")))
    return Answer()


def _command(session: Session, given: Given, changes: Changes) -> SetKeys:
    name = session.path.name
    return SetKeys(str(given["title"]), name, changes, session.saved.texts.get(name, ""))


def set_toml(session: Session, given: Given) -> Answer:
    """Set the key at `path` to a value that is written as TOML: `text`. An empty text removes the key.

    Raises:
        InputError: the text is not a value, or the project file reports an error of it.
    """
    path, text = tuple(given["path"]), str(given["text"]).strip()
    value = parse_value(str(path[-1]), text) if text else None
    command = _command(session, given, [(path, value)])
    refusals = _new_errors(session, command)
    if refusals:
        raise InputError(refusals)
    session.do(command)
    return Answer()


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


def set_text(session: Session, given: Given) -> Answer:
    """Replace the text of the function, or of the project file if `file` is empty."""
    file = str(given["file"]) or session.path.name
    if file not in (session.path.name, session.formula_file):
        raise InputError.of(Location(file[:200]), "is not a file of this project")
    writable(session.path.parent, file)
    session.do(SetText(str(given["title"]), file, str(given["text"])), str(given.get("drag", "")))
    return Answer()


def save(session: Session, given: Given) -> Answer:
    """Write what was edited to the files of the project.

    Files that another program has changed since they were read are replaced only with `force`; without it, nothing is
    written, and the answer has them as `conflicts`, each with its text on disk and that of the session.
    """
    conflicts = [] if given.get("force") else session.conflicts
    if conflicts:
        return Answer({"conflicts": [{"file": c.file, "disk": c.disk, "own": c.own} for c in conflicts]})
    session.save(replace=bool(given.get("force")))
    return Answer()


def reload(session: Session, given: Given) -> Answer:
    """Take over what another program wrote to the files of the project; undo brings back what was edited here."""
    session.reload()
    return Answer()


def recover(session: Session, given: Given) -> Answer:
    """Take over the edits of a session that ended without saving; `discard` forgets them."""
    session.recover(discard=bool(given.get("discard")))
    return Answer()
