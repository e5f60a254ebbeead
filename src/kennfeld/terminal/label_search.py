"""What of a file's contents somebody searches: channels, parameters, nodes and axes, by name or description."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from typing import Any

from kennfeld.errors import InputError
from kennfeld.terminal.file_info import FileInfo, Table

__all__ = ["searched"]

_NAMES = ("name", "node")  # the keys that name a thing
_DESCRIPTIONS = ("description", "long_name")
_PLAIN = ("left_out", "ambiguous", "parameters", "inputs")  # lists whose items may be names themselves
_NESTED = "tables"  # tables of a recording, each with lists of its own
_CLOSE = 0.6
_OFFERED = 3


def searched(found: FileInfo, text: str) -> FileInfo:
    """The same contents with those things alone whose name or description has `text`, whatever its case.

    With `*` and `?` in it, the text is a pattern of a whole name. Raises `InputError` where nothing is found, with the
    nearest names.
    """
    matches = _matching(text)
    tables = [_rows(table, matches) for table in found.tables]
    as_json = _filtered(found.as_json, matches)
    left_out = [name for table in as_json.get(_NESTED, []) for name in table.get("left_out", [])]
    if not left_out and all(len(table) < 2 for table in tables):
        message = f"nothing in it has {text!r} in its name or description"
        raise InputError.of(str(found.as_json.get("file", "")), message, _offered(text, _all_names(found)))
    notes = [f"columns without numbers: {', '.join(left_out)}"] if left_out else []
    count = sum(len(table) - 1 for table in tables) + len(left_out)
    return replace(found, summary=f"{found.summary}; {count} found", tables=tables, notes=notes, as_json=as_json)


def _matching(text: str) -> Callable[[str], bool]:
    folded = text.strip().casefold()
    is_pattern = any(mark in folded for mark in "*?")
    return lambda name: fnmatchcase(name.casefold(), folded) if is_pattern else folded in name.casefold()


def _rows(table: Table, matches: Callable[[str], bool]) -> Table:
    """The heading, and the rows whose name or description fits."""
    heading, *rows = table
    said = [i for i, word in enumerate(heading) if i == 0 or word in _DESCRIPTIONS]
    return [heading, *(row for row in rows if any(matches(row[i]) for i in said))]


def _filtered(as_json: Mapping[str, Any], matches: Callable[[str], bool]) -> dict[str, Any]:
    return {key: _list(key, value, matches) if isinstance(value, list) else value for key, value in as_json.items()}


def _list(key: str, items: Sequence[Any], matches: Callable[[str], bool]) -> list[Any]:
    if key == _NESTED:
        parts = [_filtered(item, matches) for item in items]
        return [part for part in parts if any(part.get(inner) for inner in ("channels", "left_out"))]
    if key in _PLAIN and all(isinstance(item, str) for item in items):
        return [item for item in items if matches(item)]
    if all(isinstance(item, Mapping) and any(name in item for name in _NAMES) for item in items):
        return [item for item in items if any(matches(text) for text in _texts(item))]
    return list(items)


def _texts(item: Mapping[str, Any]) -> Iterator[str]:
    yield from (str(item[key]) for key in (*_NAMES, *_DESCRIPTIONS) if item.get(key))


def _all_names(found: FileInfo) -> list[str]:
    left_out = [name for table in found.as_json.get(_NESTED, []) for name in table.get("left_out", [])]
    return list(dict.fromkeys([*(row[0] for table in found.tables for row in table[1:]), *left_out]))


def _offered(text: str, names: Iterable[str]) -> str:
    """The names that are the nearest, whole or in one of their parts."""
    folded = text.strip().strip("*?").casefold()
    close = [(_likeness(folded, name.casefold()), name) for name in names]
    best = sorted((pair for pair in close if pair[0] >= _CLOSE), key=lambda pair: -pair[0])[:_OFFERED]
    return f"Did you mean {' or '.join(name for _, name in best)}?" if best else "Search for a part of a name."


def _likeness(text: str, name: str) -> float:
    return max(SequenceMatcher(None, text, part).ratio() for part in (name, *re.split(r"[\W_]+", name)))
