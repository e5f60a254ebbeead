"""Changes a project file and leaves everything else in it as it was: comments, order, and notation."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.formatting import toml_text
from kennfeld.project.forms import NamedEntriesForm, form_of, keys_of
from kennfeld.project.schema import ProjectFile
from kennfeld.project.section import KeyPath
from kennfeld.project.toml_file import parse_toml, read_text
from kennfeld.project.toml_keys import KeySpan, TomlKeys

_BOM = "\ufeff"
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_BLANK_LINES = re.compile(r"(?:[ \t]*\r?\n)*")


class ProjectDocument:
    r"""The text of a project file, changed by path.

    A path consists of keys of TOML; entries of a list count from 1. If a change restores values that the text had
    before, or an `earlier` text, it restores that text, too.

    >>> document = ProjectDocument('[model]\nfile = "a.kf"  # the sensor\n')
    >>> document.set(("model", "file"), "b.kf")
    >>> document.set(("optimizer", "starts"), 4)
    >>> print(document.text)
    [model]
    file = "b.kf"  # the sensor
    <BLANKLINE>
    [optimizer]
    starts = 4
    <BLANKLINE>
    """

    def __init__(
        self, text: str, path: Path | None = None, entry: type = ProjectFile, earlier: Iterable[str] = ()
    ) -> None:
        self.path, self._name = path, path.name if path else "text"
        self._mark = _BOM if text.startswith(_BOM) else ""
        self._order = {key: form_of(part) for key, part in keys_of(entry).items()}
        self._break = "\r\n" if "\r\n" in text else "\n"
        self._texts: dict[str, str] = {}  # by their values
        # values -> text that had them, so that an undo brings back comments and notation, too
        for each in (other.removeprefix(_BOM) for other in earlier):
            self._texts.setdefault(_canonical(parse_toml(self._name, each.replace("\r\n", "\n"))), each)
        self._load(text.removeprefix(_BOM))

    @classmethod
    def read(cls, path: str | Path, entry: type = ProjectFile) -> "ProjectDocument":
        """Read a project file, or a training file if `entry` is `TrainingFile`.

        Raises:
            InputError: the file cannot be read, or is not valid TOML.
        """
        path = Path(path)
        read_text(path)  # which reports files that are missing, binary or too large
        return cls(path.read_bytes().decode("utf-8"), path, entry)

    @property
    def text(self) -> str:
        """The text as it will be saved."""
        return self._mark + self._text

    def save(self) -> None:
        """Write the file, completely or not at all. Raises `OSError`."""
        assert self.path is not None, "a document without a path is not saved"
        write_whole(self.path, self.text, follow=True)

    def get(self, *path: str | int) -> Any:
        """Return the value at a path, None if there is none."""
        value: Any = self._values
        for key in path:
            if isinstance(key, int) and isinstance(value, list) and 1 <= key <= len(value):
                value = value[key - 1]
            elif isinstance(key, str) and isinstance(value, dict) and key in value:
                value = value[key]
            else:
                return None
        return value

    def set(self, path: Sequence[str | int], value: Any) -> None:
        """Set the value at a path: text, number, flag, list or table. Keys of a table that it lacks are removed.

        The number after the last entry of a list appends to it. New sections are placed in the documented order.
        """
        self._set(tuple(path), value)
        self._load(self._texts.get(_canonical(self._values), self._text))

    def remove(self, path: Sequence[str | int]) -> None:
        """Remove a key, a section or an entry of a list."""
        if self.get(*path) is not None:
            self._remove(tuple(path))
            self._load(self._texts.get(_canonical(self._values), self._text))

    def remove_empty(self, path: Sequence[str | int]) -> None:
        """Remove a table, and those around it, if they are empty. Entries of lists and headings with comments stay."""
        table = tuple(path)
        while table and self.get(*table) == {} and not isinstance(table[-1], int) and not self._has_comment(table):
            self.remove(table)
            table = table[:-1]

    def _has_comment(self, path: KeyPath) -> bool:
        """Return if a section has a comment between its heading and the next one."""
        # a comment below the heading belongs to it; one after an empty line may belong to the next section
        starts = [start for start, heading in self._keys.headings if heading == path]
        if not starts:
            return False
        stop = min((start for start, _ in self._keys.headings if start > starts[0]), default=len(self._text))
        return "#" in self._text[starts[0] : stop].partition("\n\n")[0]

    def _load(self, text: str) -> None:
        self._text = text
        self._values = parse_toml(self._name, text.replace("\r\n", "\n"))
        self._keys = TomlKeys(text)
        self._texts.setdefault(_canonical(self._values), text)

    def _replace(self, start: int, end: int, text: str) -> None:
        self._load(self._text[:start] + text.replace("\n", self._break) + self._text[end:])

    def _set(self, path: KeyPath, value: Any) -> None:
        present = self.get(*path)
        if present is not None and _canonical(present) == _canonical(value):
            return
        span = self._keys.spans.get(path)
        if isinstance(present, dict) and isinstance(value, Mapping):
            self._set_table(path, present, value)
        # the tables of a list in braces can be changed one by one only if it keeps its length
        elif _are_tables(present) and _are_tables(value) and (len(present) == len(value) or _is_heading(span)):
            self._set_tables(path, len(present), value)
        elif span is not None and span.has_value:
            self._replace(span.value, span.end, format_toml(value))
        else:
            if present is not None:
                self._remove(path)
            self._insert(path, value)

    def _headings(self) -> list[KeyPath]:
        return [path for _, path in self._keys.headings]

    def _set_table(self, path: KeyPath, present: Mapping[str, Any], value: Mapping[str, Any]) -> None:
        for key, inner in value.items():
            self._set((*path, key), inner)
        for key in present:
            if key not in value:
                self._remove((*path, key))

    def _set_tables(self, path: KeyPath, count: int, value: Sequence[Any]) -> None:
        for number, table in enumerate(value, 1):
            self._set((*path, number), table)
        # from the end, as each removal renumbers the entries behind it
        for number in range(count, len(value), -1):
            self._remove((*path, number))

    def _insert(self, path: KeyPath, value: Any) -> None:
        *parent, name = path
        around = self._keys.spans.get(tuple(parent))
        if isinstance(name, int) and _is_heading(around):
            self._insert_text(tuple(parent), _format_section(tuple(parent), value, "[[]]"))
        elif isinstance(name, int):
            self._set(tuple(parent), [*(self.get(*parent) or ()), value])
        elif len(path) == 1 or (self._is_section(path, value) and not (around and around.has_value)):
            self._insert_sections(path, value)
        elif around is None:
            self._insert(tuple(parent), {name: value})
        elif around.has_value:
            self._insert_inline(around, f"{format_key(name)} = {format_toml(value)}")
        else:
            self._insert_line(tuple(parent), f"{format_key(name)} = {format_toml(value)}")

    def _is_section(self, path: KeyPath, value: Any) -> bool:
        """Return if a table gets a heading, as `[parameters.Gain]` does."""
        named = isinstance(self._order.get(str(path[0])), NamedEntriesForm)
        return len(path) == 2 and named and isinstance(value, Mapping)

    def _insert_sections(self, path: KeyPath, value: Any) -> None:
        if isinstance(value, Mapping) and value and all(self._is_section((*path, key), value[key]) for key in value):
            for name, table in value.items():
                self._insert_text((*path, name), _format_section((*path, name), table))
        elif isinstance(value, Mapping):
            self._insert_text(path, _format_section(path, value))
        elif _are_tables(value):
            for table in value:
                self._insert_text(path, _format_section(path, table, "[[]]"))
        else:
            line = f"{format_key(str(path[0]))} = {format_toml(value)}\n"
            self._replace(self._keys.block_end(()), self._keys.block_end(()), line)

    def _insert_text(self, path: KeyPath, text: str) -> None:
        """Insert a section behind the last one that precedes it in the documented order, a part behind its siblings."""
        if len(path) > 2:
            before = [heading for heading in self._headings() if heading[:2] == path[:2]]
        else:
            before = [heading for heading in self._headings() if self._rank(heading) <= self._rank(path)]
        # not above keys without a heading, such as model.file = "a.kf", which it would take into the section
        at = self._keys.block_end(before[-1] if before else ())
        # an empty line between sections
        lead = "" if at == 0 else "\n" if self._text[:at].endswith("\n") else "\n\n"
        follow = "\n" if at == 0 and self._text else ""
        self._replace(at, at, lead + text + follow)

    def _rank(self, path: KeyPath) -> int:
        order = list(self._order)
        return order.index(str(path[0])) if path[0] in order else len(order)

    def _insert_inline(self, around: KeySpan, text: str) -> None:
        inside = self._text[around.value + 1 : around.end - 1]
        at = around.value + 1 + len(inside.rstrip())
        self._replace(at, around.end - 1, f", {text} " if inside.strip() else f" {text} ")

    def _insert_line(self, parent: KeyPath, line: str) -> None:
        """Insert a key behind the last one of its table, with the same dotted names and indentation."""
        # the innermost section around the key; what lies between is written as dotted names
        headings = [heading for heading in self._headings() if heading == parent[: len(heading)]]
        heading = max(headings, key=len, default=())
        names = "".join(f"{format_key(str(name))}." for name in parent[len(heading) :])
        inside = [(at, span) for at, span in self._keys.spans.items() if at[: len(parent)] == parent and names]
        last = max((span.end for _, span in inside), default=0)
        at = self._keys.line_end(last) if names else self._keys.block_end(heading)
        # that of the line before
        indent = re.match(r"[ \t]*", self._text[self._line_start(at - 1) :]) if at else None
        lead = "" if at == 0 or self._text[:at].endswith("\n") else "\n"
        self._replace(at, at, f"{lead}{indent[0] if indent else ''}{names}{line}\n")

    def _line_start(self, offset: int) -> int:
        return self._text.rfind("\n", 0, max(offset, 0)) + 1

    def _remove(self, path: KeyPath) -> None:
        span = self._keys.spans.get(path)
        headings = [heading for heading in self._headings() if heading[: len(path)] == path]
        if isinstance(path[-1], int) and not headings:
            items = self.get(*path[:-1])
            self._set(path[:-1], [*items[: path[-1] - 1], *items[path[-1] :]])
        elif span is not None and span.has_value:
            self._replace(*self._extent(path, span), "")
        else:
            # from the end of the text, so that the offsets of the others stay valid
            for heading in reversed(headings):
                self._remove_block(heading)
            if isinstance(path[-1], str):
                for inner in list(self.get(*path) or ()):  # dotted keys
                    self._remove((*path, inner))

    def _extent(self, path: KeyPath, span: KeySpan) -> tuple[int, int]:
        """Return the range of a key and its value, with a comma within a table, otherwise with the whole line."""
        if not self._is_inline(path, span):
            return self._line_start(span.start), self._keys.line_end(span.end)
        comma = re.compile(r"[ \t]*,[ \t]*").match(self._text, span.end)
        if comma:
            return span.start, comma.end()
        # the last key of a table in braces takes the comma before it along
        before = self._text[: span.start].rstrip(" \t")
        return (len(before) - 1 if before.endswith(",") else span.start), span.end

    def _is_inline(self, path: KeyPath, span: KeySpan) -> bool:
        around = (self._keys.spans.get(path[:length]) for length in range(1, len(path)))
        return any(other and other.value <= span.start < other.end for other in around)

    def _remove_block(self, heading: KeyPath) -> None:
        start = next(start for start, path in reversed(self._keys.headings) if path == heading)
        start, end = self._line_start(start), self._keys.block_end(heading)
        blank = _BLANK_LINES.match(self._text, end)
        end = blank.end() if blank else end
        # at the end of the text, the blank lines before the section go with it
        if end == len(self._text):
            start = len(self._text[:start].rstrip()) + len(self._break) if self._text[:start].strip() else start
        self._replace(start, end, "")


def _is_heading(span: KeySpan | None) -> bool:
    return span is not None and span.kind == "heading"


def _are_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _format_section(path: KeyPath, table: Mapping[str, Any], brackets: str = "[]") -> str:
    middle = len(brackets) // 2
    heading = (
        brackets[:middle] + ".".join(format_key(name) for name in path if isinstance(name, str)) + brackets[middle:]
    )
    return "".join(f"{line}\n" for line in (heading, *_format_lines(table)))


def _format_lines(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        yield f"{format_key(key)} = {format_toml(value)}"


def format_key(name: str) -> str:
    """Return a key of TOML, in quotes if it requires them."""
    return name if _BARE.fullmatch(name) else format_toml(name)


def format_toml(value: Any) -> str:
    r"""Return a value as TOML.

    >>> format_toml({"x": [0, float("inf")], "at top": "a", "free": True})
    '{ x = [0, inf], "at top" = "a", free = true }'
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return f"{{ {', '.join(_format_lines(value))} }}" if value else "{}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(format_toml, value))}]"
    return str(value)  # a date or time


def _canonical(value: Any) -> str:
    """Return a text that is equal for equal values; 1 equals 1.0, as in most programs that write values."""
    return json.dumps(_with_floats(value), sort_keys=True, default=str)


def _with_floats(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _with_floats(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_with_floats(inner) for inner in value]
    # larger integers would lose digits, and different ones be equal
    is_small = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53
    return float(value) if is_small else value
