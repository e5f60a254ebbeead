"""The text of a project file as plain tables; syntax errors with their line."""

import ast
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest

__all__ = ["is_training", "read_toml"]

_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_HEAD = re.compile(r"\s*\[{1,2}([^\[\]]+)\]")
_SECTION_TWICE = re.compile(r"Cannot (?:declare|redefine namespace|mutate immutable namespace) (\(.*\))(?: twice)?")
_KEY_TWICE = re.compile(r"Cannot overwrite a value|Duplicate inline table key '(.*)'")
_LISTS = ("dataset", "criterion", "limit", "step")
_WIDEST = 120
_LARGEST = 20_000_000  # bytes
_DEEPEST = 32  # names of a dotted key; the time and memory that tomllib takes grow with the square of it
_NAME = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(
    rf"(?:^[ \t]*\[{{0,2}}|[{{,])[ \t]*({_NAME}(?:[ \t]*\.[ \t]*{_NAME}){{{_DEEPEST}}})", re.MULTILINE
)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises `InputError` where it is missing, no text, or no TOML."""
    text = _text(path)
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start(1)) + 1
        what = f"the key {deep[1][:40]}... has more than {_DEEPEST} names with dots between them"
        raise InputError.of(f"{path.name} line {line}", what, "No key of a project file has more than three.")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError([_syntax(path.name, text, str(error))]) from None
    except RecursionError:
        raise InputError.of(path.name, "brackets are nested too deeply to be read") from None
    except (ValueError, OverflowError) as error:  # numbers and dates that Python cannot hold
        raise InputError.of(path.name, f"a value cannot be read: {error}") from None


def is_training(tables: Mapping[str, Any]) -> bool:
    """Whether these are the tables of a training file for `kennfeld surrogate train`, not of a project.

    >>> is_training({"surrogate": {}, "dataset": []}), is_training({"surrogate": {}, "model": {}})
    (True, False)
    """
    return "surrogate" in tables and not tables.keys() & {"model", "criterion", "calibration"}


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _LARGEST:
            what = f"the project file has {path.stat().st_size / 1e6:.0f} MB, at most {_LARGEST / 1e6:.0f} are read"
            raise InputError.of(path.name, what, "Put large tables into a calibration file, named by `initial`.")
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError([_missing(path)]) from None
    except OSError as error:
        what = f"the project file cannot be read: {error.strerror or error}"
        raise InputError.of(str(path), what, "Name a file that ends in .toml.") from None
    if b"\0" in content:
        raise InputError.of(path.name, "this is no text but a binary file", "A project file is TOML, as UTF-8 text.")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        what = f"byte {content[error.start]:#04x} is no UTF-8"
        raise InputError.of(f"{path.name} line {line}", what, "Save the file as UTF-8.") from None


def _missing(path: Path) -> Finding:
    beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
    return Finding(str(path), "there is no such project file", nearest(path.name, beside) or "Check the path.")


def _syntax(name: str, text: str, message: str) -> Finding:
    found = _AT.search(message)
    what = message[: found.start()] if found else message
    last = text.rstrip().count("\n") + 1
    if repeated := _repeated(what, text.split("\n"), int(found[1]) if found and found[1] else last):
        return Finding(f"{name} line {found[1] if found and found[1] else last}", *repeated)
    if not found or found[1] is None:
        return Finding(f"{name} line {last}", f"{what}: the file ends too early", "Is it cut off?")
    line, column = int(found[1]), int(found[2])
    shown = text.split("\n")[line - 1][:_WIDEST]
    excerpt = f"{shown}\n{' ' * (column - 1)}^" if column <= _WIDEST else shown
    return Finding(f"{name} line {line}, column {column}", what, _syntax_mend(what, shown), excerpt)


def _repeated(what: str, lines: Sequence[str], line: int) -> tuple[str, str] | None:
    """What is wrong and how to correct it, if a section or a key stands twice; TOML has another word for each case."""
    section = _SECTION_TWICE.fullmatch(what)
    if section:
        name = ".".join(ast.literal_eval(section[1]))
        first = next((at for at, text in enumerate(lines[: line - 1], 1) if _heads(text, name)), None)
        where = "" if first is None else f"; it begins in line {first}"
        return f"there is a section [{name}] already{where}", _merge(name)
    key = _KEY_TWICE.fullmatch(what)
    if key:
        name = key[1] or lines[line - 1].partition("=")[0].strip() or "this key"
        return f"{name} has a value already", "Remove one of them."
    return None


def _heads(line: str, name: str) -> bool:
    """Whether a line begins a section or a list of sections."""
    found = _HEAD.match(line)
    return found is not None and found[1].replace(" ", "") == name


def _merge(name: str) -> str:
    several = f" Several of them begin with [[{name}]] each." if name in _LISTS else ""
    return f"Merge the two sections.{several}"


def _syntax_mend(what: str, line: str) -> str:
    if "\\" in line and ("escape" in what or "hex" in what):
        return "Write paths with / or in single quotes."
    if "Invalid value" in what:
        return 'Text needs quotes: "text".'
    return "Write key = value."
