"""Reads a project file as plain tables. Syntax errors carry their line."""

import ast
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors

_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_HEAD = re.compile(r"\s*\[{1,2}([^\[\]]+)\]")
_SECTION_TWICE = re.compile(r"Cannot (?:declare|redefine namespace|mutate immutable namespace) (\(.*\))(?: twice)?")
_KEY_TWICE = re.compile(r"Cannot overwrite a value|Duplicate inline table key '(.*)'")
_LISTS = ("dataset", "criterion", "limit", "step")
_MAX_EXCERPT = 120  # characters
_MAX_SIZE = 20_000_000  # bytes
_MAX_KEY_PARTS = 32  # of a dotted key: time and memory of tomllib grow with the square
_NAME = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(
    rf"(?:^[ \t]*\[{{0,2}}|[{{,])[ \t]*({_NAME}(?:[ \t]*\.[ \t]*{_NAME}){{{_MAX_KEY_PARTS}}})", re.MULTILINE
)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file. Raises `InputError` if it is missing, binary, or not valid TOML."""
    return parse_toml(path.name, read_text(path))


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Return the tables of the text of a file. Raises `InputError` if it is not valid TOML."""
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start(1)) + 1
        message = f"the key {deep[1][:40]}... has more than {_MAX_KEY_PARTS} parts"
        raise InputError.of(Location(name, line), message, "Keys of a project file have at most three.")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError([_syntax(name, text, str(error))]) from None
    except RecursionError:
        raise InputError.of(Location(name), "brackets are nested too deeply") from None
    except (ValueError, OverflowError) as error:  # numbers and dates that Python cannot hold
        raise InputError.of(Location(name), f"a value cannot be read: {error}") from None


def parse_value(key: str, text: str) -> Any:
    """Return the value of a key that is written as TOML. Raises `InputError` if the text is not one value.

    >>> parse_value("bounds", "[0, inf]")
    [0, inf]
    """
    tables = parse_toml(key, f"value = {text}")
    if list(tables) != ["value"]:
        raise InputError.of(Location(key), f"must be one value, got {text[:_MAX_EXCERPT]!r}")
    return tables["value"]


def is_training(tables: Mapping[str, Any]) -> bool:
    """Return if these are the tables of a training file for `kennfeld surrogate train`, not of a project.

    >>> is_training({"surrogate": {}, "dataset": []}), is_training({"surrogate": {}, "model": {}})
    (True, False)
    """
    return "surrogate" in tables and not tables.keys() & {"model", "criterion", "calibration"}


def read_text(path: Path) -> str:
    """Return the text of a TOML file, with line feeds only. Raises `InputError` if it is missing or binary."""
    name = Location(path.name)
    missing = {"missing": "the project file does not exist", "advice": "Check the path."}
    with convert_errors(path, "the project file cannot be read", "Name a .toml file.", **missing):
        if path.stat().st_size > _MAX_SIZE:
            size = path.stat().st_size / 1e6
            message = f"the project file has {size:.0f} MB; the maximum is {_MAX_SIZE / 1e6:.0f} MB"
            remedy = "Move large tables into a calibration file and name it under `initial`."
            raise InputError.of(name, message, remedy)
        content = path.read_bytes()
    if b"\0" in content:
        raise InputError.of(name, "this is a binary file", "A project file is TOML in UTF-8.")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = f"byte {content[error.start]:#04x} is not valid UTF-8"
        raise InputError.of(Location(path.name, line), message, "Save the file as UTF-8.") from None


def _syntax(name: str, text: str, error: str) -> Finding:
    at = _AT.search(error)
    message = error[: at.start()] if at else error
    # "at end of document" has no number: the last line with text
    line = int(at[1]) if at and at[1] else text.rstrip().count("\n") + 1
    location = Location(name, line)
    if repeated := _find_repetition(message, text.split("\n"), line):
        return Finding(location, *repeated)
    if not at or at[1] is None:
        return Finding(location, f"{message}: unexpected end of file", "Is the file truncated?")
    column, shown = int(at[2]), text.split("\n")[line - 1][:_MAX_EXCERPT]
    excerpt = f"{shown}\n{' ' * (column - 1)}^" if column <= _MAX_EXCERPT else shown
    return Finding(replace(location, column=column), message, _syntax_remedy(message, shown), excerpt)


def _find_repetition(message: str, lines: Sequence[str], line: int) -> tuple[str, str] | None:
    """Return message and remedy if a section or a key is repeated; tomllib words each case differently."""
    section = _SECTION_TWICE.fullmatch(message)
    if section:
        name = ".".join(ast.literal_eval(section[1]))
        first = next((at for at, text in enumerate(lines[: line - 1], 1) if _begins_section(text, name)), None)
        where = "" if first is None else f", which begins in line {first}"
        several = f" A list of them is written [[{name}]]." if name in _LISTS else ""
        return f"duplicate of section [{name}]{where}", f"Merge the two sections.{several}"
    key = _KEY_TWICE.fullmatch(message)
    if key:
        # tomllib names the key of a table in braces only
        name = key[1] or lines[line - 1].partition("=")[0].strip() or "this key"
        return f"duplicate key {name}", "Remove one of them."
    return None


def _begins_section(line: str, name: str) -> bool:
    heading = _HEAD.match(line)
    return heading is not None and heading[1].replace(" ", "") == name


def _syntax_remedy(message: str, line: str) -> str:
    if "\\" in line and ("escape" in message or "hex" in message):
        return "Write paths with / or in single quotes."
    if "Invalid value" in message:
        return 'Text needs quotes: "text".'
    return "Write key = value."
