"""Search for channels, parameters, nodes and axes of a file by name or description."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from typing import Any

from kennfeld.base.errors import InputError, Location
from kennfeld.files.file_info import FileInfo, Table

_NAMES = ("name", "node")  # keys whose value is a name
_DESCRIPTIONS = ("description", "long_name")
_NAME_LISTS = ("left_out", "ambiguous", "parameters", "inputs")  # keys whose value may be a list of names
_NESTED = "tables"  # of a recording, each with lists of its own
_MIN_SIMILARITY = 0.6
_MAX_SUGGESTIONS = 3


def find_entries(info: FileInfo, text: str) -> FileInfo:
    """Select the entries whose name or description contains `text`, ignoring case.

    If the text contains `*` or `?`, it is a pattern of the whole name. Raises `InputError` with the most similar names
    if nothing matches.
    """
    matches = _matcher(text)
    tables = [_filter_rows(table, matches) for table in info.tables]
    as_json = _filter_json(info.as_json, matches)
    left_out = _skipped_columns(as_json)
    if not left_out and all(len(table) < 2 for table in tables):
        message = f"no name or description contains {text!r}"
        location = Location(str(info.as_json.get("file", "")))
        names = [row[0] for table in info.tables for row in table[1:]] + _skipped_columns(info.as_json)
        raise InputError.of(location, message, _suggestion(text, dict.fromkeys(names)))
    notes = [f"columns without numbers: {', '.join(left_out)}"] if left_out else []
    count = sum(len(table) - 1 for table in tables) + len(left_out)
    return replace(info, summary=f"{info.summary}; {count} found", tables=tables, notes=notes, as_json=as_json)


def _matcher(text: str) -> Callable[[str], bool]:
    folded = text.strip().casefold()
    if "*" in folded or "?" in folded:
        return lambda name: fnmatchcase(name.casefold(), folded)
    return lambda name: folded in name.casefold()


def _filter_rows(table: Table, matches: Callable[[str], bool]) -> Table:
    heading, *rows = table
    # names are in the first column
    searched = [i for i, word in enumerate(heading) if i == 0 or word in _DESCRIPTIONS]
    return [heading, *(row for row in rows if any(matches(row[i]) for i in searched))]


def _filter_json(as_json: Mapping[str, Any], matches: Callable[[str], bool]) -> dict[str, Any]:
    return {
        key: _filter_list(key, value, matches) if isinstance(value, list) else value for key, value in as_json.items()
    }


def _filter_list(key: str, items: Sequence[Any], matches: Callable[[str], bool]) -> list[Any]:
    if key == _NESTED:
        parts = [_filter_json(item, matches) for item in items]
        return [part for part in parts if any(part.get(inner) for inner in ("channels", "left_out"))]
    if key in _NAME_LISTS and all(isinstance(item, str) for item in items):
        return [item for item in items if matches(item)]
    if all(isinstance(item, Mapping) and any(name in item for name in _NAMES) for item in items):
        keys = (*_NAMES, *_DESCRIPTIONS)
        return [item for item in items if any(matches(str(item[key])) for key in keys if item.get(key))]
    return list(items)


def _skipped_columns(as_json: Mapping[str, Any]) -> list[str]:
    return [name for table in as_json.get(_NESTED, []) for name in table.get("left_out", [])]


def _suggestion(text: str, names: Iterable[str]) -> str:
    folded = text.strip().strip("*?").casefold()
    ranked = sorted(((_similarity(folded, name.casefold()), name) for name in names), key=lambda pair: -pair[0])
    best = [pair for pair in ranked if pair[0] >= _MIN_SIMILARITY][:_MAX_SUGGESTIONS]
    return f"Did you mean {' or '.join(name for _, name in best)}?" if best else "Search for part of a name."


def _similarity(text: str, name: str) -> float:
    """Return the similarity to a name or the most similar part of it, 0 to 1."""
    return max(SequenceMatcher(None, text, part).ratio() for part in (name, *re.split(r"[\W_]+", name)))
