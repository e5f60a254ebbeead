"""Forms of the values of keys: each reads, writes and describes one kind of value.

A section is a dataclass whose fields are keys, see `file_keys.key`. The annotation of a field gives its form, unless
the field names one.
"""

import re
import types
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np

from kennfeld.base.errors import Fix
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.project.section import Section, as_finite, list_words, show

# Editors pass infinite numbers of TOML to the schema as null, which JSON has instead.
INFINITE = {"type": ["number", "string", "null"], "pattern": r"^\s*[+-]?[iI][nN][fF]\s*$"}
_LINK = re.compile(r"\[([^\]]+)\]\([^)]+\)")  # of Markdown
MOST_INTEGER = 2**53 - 1  # larger ones are not exact as float


class Form:
    """One kind of value."""

    @property
    def blank(self) -> Any:
        """Stands for a required value that is missing or invalid."""
        return None

    @property
    def label(self) -> str:
        """The type, as the documentation names it."""
        return ""

    def read(self, section: Section, key: str) -> Any:
        """Return the value of a key that is present; None, with findings, if it is invalid."""
        raise NotImplementedError

    def write(self, value: Any) -> Any:
        """Return the value as TOML has it: tuples and arrays are lists."""
        return _with_lists(value)

    def json_schema(self) -> dict[str, Any]:
        """Return the JSON schema of the value."""
        return {}


def _with_lists(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _with_lists(inner) for name, inner in value.items()}
    if isinstance(value, tuple):
        return [_with_lists(inner) for inner in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


@dataclass(frozen=True)
class TextForm(Form):
    """A text, which is not blank unless `may_be_empty`."""

    may_be_empty: bool = False
    blank = ""
    label = "text"

    def read(self, section: Section, key: str) -> str | None:
        value = section.values[key]
        if not isinstance(value, str):
            section.report(key, f"must be a text, got {show(value)}", f'Write {key} = "..." in quotes.')
        elif value.isspace() and not self.may_be_empty:
            section.report(key, "must not be empty", "Fill it in, or remove the key.")
        else:
            return value
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"type": "string"}


@dataclass(frozen=True)
class NumberForm(Form):
    """A finite number >= `least` or > `above`; or one of the `words`."""

    least: float | None = None
    above: float | None = None
    words: tuple[str, ...] = ()
    blank = 0.0

    @property
    def label(self) -> str:
        return " or ".join([f"number{self._range}", *(f'`"{word}"`' for word in self.words)])

    @property
    def _range(self) -> str:
        if self.above is not None:
            return f" > {self.above:g}"
        return "" if self.least is None else f" >= {self.least:g}"

    def read(self, section: Section, key: str) -> float | str | None:
        value = section.values[key]
        if isinstance(value, str) and value in self.words:
            return value
        number = as_finite(value)
        if isinstance(value, str) and self.words and self._range:
            section.report(key, f"must be a number{self._range} or {list_words(self.words)}, got {value!r}")
        elif number is None:
            section.report(key, f"must be a number, got {show(value)}", fixes=_as_number(section, key, value))
        elif (self.least is not None and number < self.least) or (self.above is not None and number <= self.above):
            section.report(key, f"must be{self._range}, got {number:g}")
        else:
            return number
        return None

    def json_schema(self) -> dict[str, Any]:
        limits = {"minimum": self.least, "exclusiveMinimum": self.above}
        schema = {"type": "number", **{name: limit for name, limit in limits.items() if limit is not None}}
        return {"anyOf": [schema, {"enum": list(self.words)}]} if self.words else schema


def _as_number(section: Section, key: str, value: Any) -> list[Fix]:
    """Return the fix for a number that is written as a text, such as "0.1" or "0,1"."""
    try:
        number = as_finite(float(value.replace(",", "."))) if isinstance(value, str) else None
    except ValueError:
        return []
    return [] if number is None else [Fix.set((*section.keys, key), number)]


@dataclass(frozen=True)
class IntegerForm(Form):
    """An integer from `least` to `most`."""

    least: int = 0
    most: int = MOST_INTEGER
    blank = 0

    @property
    def label(self) -> str:
        return f"integer >= {self.least}" + (f", <= {self.most}" if self.most < MOST_INTEGER else "")

    def read(self, section: Section, key: str) -> int | None:
        value = section.values[key]
        # a bool is an int in Python
        if isinstance(value, bool) or not isinstance(value, int) or not self.least <= value <= MOST_INTEGER:
            section.report(key, f"must be an integer >= {self.least}, got {show(value)}")
        elif value > self.most:
            section.report(key, f"must be <= {self.most}, got {value}")
        else:
            return value
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"type": "integer", "minimum": self.least, "maximum": self.most}


class FlagForm(Form):
    """True or false."""

    blank = False
    label = "`true` or `false`"

    def read(self, section: Section, key: str) -> bool | None:
        value = section.values[key]
        if isinstance(value, bool):
            return value
        words = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
        meant = words.get(value.lower()) if isinstance(value, str) else None
        fixes = [] if meant is None else [Fix.set((*section.keys, key), meant)]
        section.report(key, f"must be true or false, got {show(value)}", "Write it without quotes.", fixes)
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"type": "boolean"}


@dataclass(frozen=True)
class ChoiceForm(Form):
    """One of several words."""

    words: tuple[str, ...]

    @property
    def label(self) -> str:
        return " or ".join(f'`"{word}"`' for word in self.words)

    def read(self, section: Section, key: str) -> str | None:
        value = TextForm().read(section, key)
        if value is None or value in self.words:
            return value
        if not value:
            fixes = [Fix.choose((*section.keys, key), self.words)]
            section.report(key, "must not be empty", "Fill it in, or remove the key.", fixes)
            return None
        remedy = nearest(value, self.words) or f"Write {list_words(self.words)}."
        section.report(key, f"unknown value {value!r}", remedy, [Fix.choose((*section.keys, key), self.words)])
        return None

    def json_schema(self) -> dict[str, Any]:
        return {"enum": list(self.words)}


@dataclass(frozen=True)
class TextsForm(Form):
    """A text or a list of texts, without duplicates; with `remedy`, an empty list is an error."""

    remedy: str = ""
    blank = ()
    label = "text or list of texts"

    def read(self, section: Section, key: str) -> tuple[str, ...] | None:
        value = section.values[key]
        items = [value] if isinstance(value, str) else value
        if items == [] and self.remedy:
            section.report(key, "the list is empty", self.remedy)
        elif isinstance(items, list) and all(isinstance(item, str) and item.strip() for item in items):
            return tuple(dict.fromkeys(items))
        else:
            message = f"must be a text or a list of texts, got {show(value)}"
            section.report(key, message, f'Write {key} = ["...", "..."].')
        return None

    def json_schema(self) -> dict[str, Any]:
        text = {"type": "string", "pattern": r"\S"}
        return {"anyOf": [text, {"type": "array", "items": text}]}


def read_table(section: Section, key: str) -> Section | None:
    """Return the table of a key, `[key]` in the file or `key = { ... }` in a section; None, with a finding, if none."""
    value = section.values[key]
    path = f"[{key}]" if section.is_root else key
    if isinstance(value, dict):
        return section.inner(value, path, key)
    if section.is_root:
        message = f"must be one section, got {f'[[{key}]]' if isinstance(value, list) else show(value)}"
        section.report(path, message, f"Write [{key}] with single brackets.")
    elif isinstance(value, list):
        section.report(key, "must be a table, got a list", f"Write {key} = {{ ... }}.")
    else:
        section.report(key, f"must be a table, got {show(value)}", f"Write {key} = {{ ... }}.")
    return None


@dataclass(frozen=True)
class TableOfForm(Form):
    """A table of values of one form, by name; empty values are skipped."""

    values: Form
    names: tuple[str, ...] = ()  # the only ones, if there are any
    remedy: str = ""

    @property
    def blank(self) -> dict[str, Any]:
        return {}

    @property
    def label(self) -> str:
        return "table by axis" if self.names else "table of texts" if isinstance(self.values, TextForm) else "table"

    def read(self, section: Section, key: str) -> dict[str, Any] | None:
        value = section.values[key]
        if isinstance(value, str) and value in getattr(self.values, "words", ()):
            section.report(key, f'{key} = "{value}" must name a channel', f'Write {key} = {{ Channel = "{value}" }}.')
            return None
        table = read_table(section, key)
        if table is None:
            return None
        known = self.names or tuple(table.values)
        values = {}
        for name in (each for each in known if each in table.values):
            with table.removable(name):
                values[name] = self.values.read(table, name)
        table.report_unknown(known)
        return {name: value for name, value in values.items() if value not in (None, "")}

    def json_schema(self) -> dict[str, Any]:
        inner = self.values.json_schema()
        if not self.names:
            return {"type": "object", "additionalProperties": inner}
        return {"type": "object", "properties": dict.fromkeys(self.names, inner), "additionalProperties": False}


@dataclass(frozen=True)
class EitherForm(Form):
    """A value of one form, or a table of another."""

    plain: Form
    table: Form

    @property
    def label(self) -> str:
        return f"{self.plain.label}, or {self.table.label}"

    def read(self, section: Section, key: str) -> Any:
        return (self.table if isinstance(section.values[key], dict) else self.plain).read(section, key)

    def write(self, value: Any) -> Any:
        return (self.table if isinstance(value, Mapping) else self.plain).write(value)

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [self.plain.json_schema(), self.table.json_schema()]}


@dataclass(frozen=True)
class EntryForm(Form):
    """A table of known keys."""

    entry: type
    label = "table"

    @property
    def blank(self) -> Any:
        required = [part for part in keys_of(self.entry).values() if is_required(part)]
        return self.entry(**{part.name: form_of(part).blank for part in required})

    def read(self, section: Section, key: str) -> Any:
        table = read_table(section, key)
        return None if table is None else read_entry(self.entry, table)

    def write(self, value: Any) -> dict[str, Any]:
        return write_entry(value)

    def json_schema(self) -> dict[str, Any]:
        return entry_schema(self.entry)


@dataclass(frozen=True)
class FilesForm(Form):
    """A file or a table that describes one, or a list of them, without duplicates.

    Attributes:
        entry: the class of a table.
        word: what the table describes.
        remedy: the remedy for anything else.
    """

    entry: type
    word: str = ""
    remedy: str = ""
    blank = ()
    label = "text, table, or list of them"

    def read(self, section: Section, key: str) -> tuple[Any, ...]:
        value = section.values[key]
        items = enumerate(value if isinstance(value, list) else [value], 1)
        files = (self._item(section, key, number, item) for number, item in items)
        return tuple(dict.fromkeys(file for file in files if file is not None))

    def _item(self, section: Section, key: str, number: int, item: Any) -> Any:
        if isinstance(item, dict):
            keys = (key, number) if isinstance(section.values[key], list) else (key,)
            entry = read_entry(self.entry, section.inner(item, key, *keys))
            # without its file, an entry has been reported and is left out
            required = (part.name for part in keys_of(self.entry).values() if is_required(part))
            return entry if all(getattr(entry, name) for name in required) else None
        if isinstance(item, str) and item.strip():
            return item
        section.report(key, f"must be a file, got {item!r}", self.remedy)
        return None

    def write(self, value: Iterable[Any]) -> Any:
        return [item if isinstance(item, str) else write_entry(item) for item in value]

    def json_schema(self) -> dict[str, Any]:
        item = {"anyOf": [{"type": "string", "pattern": r"\S"}, entry_schema(self.entry)]}
        return {"anyOf": [*item["anyOf"], {"type": "array", "items": item}]}


@dataclass(frozen=True)
class EntriesForm(Form):
    """A list of tables of known keys.

    Attributes:
        entry: the class of each.
        word: what messages call an entry, followed by its number.
        fault: the message if the value is something else; it ends with the value if `shows`.
        remedy: its remedy.
        takes_one: one table may stand for a list of one.
        fills: an empty list is an error.
    """

    entry: type
    word: str = ""
    fault: str = "must be a list of tables"
    remedy: str = ""
    shows: bool = False
    takes_one: bool = False
    fills: bool = False
    blank = ()
    label = "list of tables"

    def read(self, section: Section, key: str) -> tuple[Any, ...] | None:
        value = section.values[key]
        tables = [value] if self.takes_one and isinstance(value, dict) else value
        is_empty = self.fills and not tables
        if not isinstance(tables, list) or is_empty or not all(isinstance(item, dict) for item in tables):
            self._refuse(section, key)
            return None
        entries = []
        for number, table in enumerate(tables, 1):
            keys = (key, number) if isinstance(value, list) else (key,)
            with section.removable(*keys):
                entries.append(
                    read_entry(self.entry, section.inner(table, self._path(section, key, number, tables), *keys))
                )
        return tuple(entries)

    def _refuse(self, section: Section, key: str) -> None:
        value = section.values[key]
        if section.is_root:
            path, remedy = f"[[{key}]]", f"Write [[{key}]] with double brackets."
            section.report(path, f"must be a section, got {show(value)}", remedy)
        else:
            section.report(key, f"{self.fault}, got {value!r}" if self.shows else self.fault, self.remedy)

    def _path(self, section: Section, key: str, number: int, tables: list[Any]) -> str:
        if section.is_root:
            return f"[[{key}]] {number}"
        return f"{self.word} {number}" if not self.takes_one or len(tables) > 1 else self.word

    def write(self, value: Iterable[Any]) -> list[dict[str, Any]]:
        return [write_entry(entry) for entry in value]

    def json_schema(self) -> dict[str, Any]:
        entry = entry_schema(self.entry)
        tables = {"type": "array", "items": entry, **({"minItems": 1} if self.fills else {})}
        return {"anyOf": [entry, tables]} if self.takes_one else tables


@dataclass(frozen=True)
class NamedEntriesForm(Form):
    """Sections by name, `[key.NAME]`."""

    entry: type
    label = "sections by name"

    def read(self, section: Section, key: str) -> dict[str, Any] | None:
        table = read_table(section, key)
        if table is None:
            return None
        entries = {}
        for name, value in table.values.items():
            if isinstance(value, dict):
                inner = section.inner(value, f"[{key}.{name}]", key, name)
                with table.removable(name):
                    entries[name] = read_entry(self.entry, inner, name=name)
            else:
                with table.removable(name):
                    table.report(name, f"must be a section, got {show(value)}", f"Write a section [{key}.{name}].")
        return entries

    def write(self, value: Mapping[str, Any]) -> dict[str, Any]:
        return {name: write_entry(entry) for name, entry in value.items()}

    def json_schema(self) -> dict[str, Any]:
        return {"type": "object", "additionalProperties": entry_schema(self.entry)}


def keys_of(entry: type) -> Mapping[str, Field[Any]]:
    """Return the fields of an entry that are keys of the file, by key."""
    return {part.metadata["name"] or part.name: part for part in fields(entry) if "meaning" in part.metadata}


@cache
def form_of(part: Field[Any]) -> Form:
    """Return the form of a key, of its annotation if it names none."""
    return part.metadata.get("form") or _form_of_type(part.type, part.metadata)


def _form_of_type(annotation: Any, metadata: Mapping[str, Any]) -> Form:
    origin, arguments = get_origin(annotation), get_args(annotation)
    limits = {name: metadata[name] for name in ("least", "above", "most") if name in metadata}
    if origin in (Union, types.UnionType):
        first, *others = (part for part in arguments if part is not type(None))
        # float | Literal["auto"]: a number or one of these words
        if first is float and others:
            return NumberForm(**limits, words=get_args(others[0]))
        return _form_of_type(first, metadata)
    if origin is Literal:
        return ChoiceForm(arguments)
    if origin is tuple:
        if arguments[0] is str:
            return TextsForm()
        # tuple[str | Entry, ...]: a file, or a table that describes one
        if str in get_args(arguments[0]):
            entry = next(part for part in get_args(arguments[0]) if is_dataclass(part))
            return FilesForm(entry, metadata.get("word", ""), metadata.get("remedy", ""))  # type: ignore[arg-type]
        names = ("word", "fault", "remedy", "shows", "takes_one", "fills")
        return EntriesForm(arguments[0], **{name: metadata[name] for name in names if name in metadata})
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return TableOfForm(_form_of_type(arguments[1], metadata))
    if is_dataclass(annotation):
        return EntryForm(annotation)  # type: ignore[arg-type]
    simple: dict[Any, type[Form]] = {str: TextForm, float: NumberForm, int: IntegerForm, bool: FlagForm}
    return simple[annotation](**limits)


def read_entry(entry: type, section: Section, **further: Any) -> Any:
    """Return an entry from its table. Missing and invalid values become defaults, with findings.

    Args:
        entry: a dataclass, with an optional method `problems` that yields contradictions between its keys.
        section: the table.
        further: fields that are no keys; those that the entry does not have are ignored.
    """
    known = keys_of(entry)
    values = {}
    for key, part in known.items():
        form, value = form_of(part), None
        if key in section.values:
            with nullcontext() if is_required(part) else section.removable(key):
                value = form.read(section, key)
        elif "missing" in part.metadata:
            _report_missing(section, key, form, part.metadata["missing"])
        if value is not None:
            values[part.name] = value
        elif is_required(part):
            values[part.name] = form.blank
    section.report_unknown(known)
    others = {"location": section.location, **further}
    plain = [part.name for part in fields(entry) if "meaning" not in part.metadata]
    result = entry(**values, **{name: others[name] for name in plain if name in others})
    # by the keys that are present: a default contradicts nothing
    for key, message, remedy, *settled in result.problems(section.values) if hasattr(result, "problems") else ():
        changes = [((*section.keys, name), value) for keys in settled for name, value in keys.items()]
        fixes = [Fix(" and ".join(Fix.set(*each).title for each in changes), tuple(changes))] if changes else []
        with section.removable(key) if key in section.values else nullcontext():
            section.report(key, message, remedy, fixes)
    return result


def _report_missing(section: Section, key: str, form: Form, remedy: str) -> None:
    if section.is_root:
        path = f"[[{key}]]" if isinstance(form, EntriesForm) else f"[{key}]"
        section.report(path, "the section is missing", remedy)
    else:
        section.report(key, "the key is missing", remedy)


def is_required(part: Field[Any]) -> bool:
    """Return if a key has no default."""
    return part.default is MISSING and part.default_factory is MISSING


def default_of(part: Field[Any]) -> Any:
    """Return the default of a key, None for a required one."""
    if part.default_factory is not MISSING:
        return part.default_factory()
    return None if part.default is MISSING else part.default


def write_entry(entry: Any) -> dict[str, Any]:
    """Return the table of an entry; keys that equal their default are omitted."""
    table = {}
    for key, part in keys_of(type(entry)).items():
        value, default = getattr(entry, part.name), default_of(part)
        # of one type: 1 and True are equal, and so are 0 and False
        is_default = not is_required(part) and type(value) is type(default) and value == default
        if value is not None and not is_default:
            table[key] = form_of(part).write(value)
    return table


def meaning_of(part: Field[Any]) -> str:
    """Return what a key sets, with its unit (Markdown)."""
    unit, meaning = part.metadata.get("unit", ""), str(part.metadata["meaning"])
    return f"{unit}; {meaning}" if unit else meaning


def without_links(markdown: str) -> str:
    """Return Markdown with the text of links in their place."""
    return _LINK.sub(r"\1", markdown)


def entry_schema(entry: type) -> dict[str, Any]:
    """Return the JSON schema of a table."""
    known = keys_of(entry)
    required = [key for key, part in known.items() if "missing" in part.metadata]
    return {
        "type": "object",
        "properties": {key: _describe(part) for key, part in known.items()},
        "additionalProperties": False,
        **({"required": required} if required else {}),
    }


def _describe(part: Field[Any]) -> dict[str, Any]:
    meaning, default = without_links(meaning_of(part)), default_of(part)
    has_default = isinstance(default, int | float | str) and default != "" and "default_text" not in part.metadata
    return {
        **({"description": meaning} if meaning else {}),
        **({"default": default} if has_default else {}),
        **form_of(part).json_schema(),
    }
