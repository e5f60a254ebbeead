"""Write the types on the wire of the app for its page, from the dataclasses of its questions.

python scripts/wire_types.py web
"""

import inspect
import json
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from docstrings import parse

from kennfeld.app.project_questions import PROJECT_QUESTIONS
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import StateNews
from kennfeld.app.wire import Absent, Question, is_array, is_arrays, members, wire_fields
from kennfeld.app.workspace import ActivityNews

__all__ = ["documents", "module"]

WIDTH = 120  # of a line
_HEAD = """// The types on the wire. Written by scripts/wire_types.py from the questions of the app; do not edit.

/** A value of a project file. */
export type Toml = string | number | boolean | Toml[] | { [key: string]: Toml };

/** A key of a project file; entries of a list count from 1. */
export type Path = (string | number)[];

/** JSON or arrays of a reply that has none. */
export type Nothing = Record<string, never>;
"""
_PLAIN = {str: "string", int: "number", float: "number", bool: "boolean", NoneType: "null", Any: "unknown"}


def documents(folder: Path) -> dict[Path, str]:
    """Return the module of the types."""
    return {folder / "src" / "replies.ts": module({**QUESTIONS, **COMMANDS, **PROJECT_QUESTIONS})}


def module(questions: Mapping[str, Question[Any]]) -> str:
    """Return the interfaces of all records, and those of the questions by name."""
    types = _Types()
    rows = [line for name, question in questions.items() for line in types.question(name, question)]
    types.name(StateNews)
    types.name(ActivityNews)
    doc = _comment("Questions by name: what is asked, and the JSON and the arrays of the reply.", "")
    listed = "\n".join([*doc, "export interface Questions {", *rows, "}"])
    return "\n".join([_HEAD, *(f"{text}\n" for text in types.texts.values()), listed, ""])


@dataclass
class _Types:
    """The interfaces that have been written, by name, and those that pages send."""

    texts: dict[str, str] = field(default_factory=dict)
    written: dict[str, type] = field(default_factory=dict)
    sent: set[str] = field(default_factory=set)

    def question(self, name: str, question: Question[Any]) -> Iterator[str]:
        """Yield the lines of a question."""
        replies = [each for each in members(question.reply) if each is not NoneType]
        asked = question.asked
        asks = "Nothing" if asked is None else self.name(asked, sent=True)
        head = " | ".join(map(self.head, replies)) or "Nothing"
        arrays = " | ".join(dict.fromkeys(map(self.arrays, replies))) or "Nothing"
        key = name if name.isidentifier() else json.dumps(name)
        line = f"  {key}: {{ asks: {asks}; head: {head}; arrays: {arrays} }};"
        if len(line) <= WIDTH:
            yield line
        else:
            yield from (f"  {key}: {{", f"    asks: {asks};", f"    head: {head};", f"    arrays: {arrays};", "  };")

    def head(self, record: type) -> str:
        """Return the type of the JSON of a reply."""
        fields = [own for own in wire_fields(record) if not is_array(own.kind) and not is_arrays(own.kind)]
        return self.name(record) if fields else "Nothing"

    def name(self, record: type, *, sent: bool = False) -> str:
        """Return the name of a record, whose interface is written if it is new."""
        name = record.__name__
        if self.written.setdefault(name, record) is not record:
            raise ValueError(f"two types on the wire are called {name}")
        optional = [own for own in wire_fields(record) if not own.required and Absent not in members(own.kind)]
        if name in self.texts and optional and sent != (name in self.sent):
            raise ValueError(f"{name} has defaults, and is both asked and replied")
        if name not in self.texts:
            self.sent |= {name} if sent else set()
            self.texts[name] = ""  # holds the place of a record that is within itself
            self.texts[name] = "\n".join(self.interface(record, sent=sent))
        return name

    def interface(self, record: type, *, sent: bool) -> Iterator[str]:
        """Yield the lines of an interface, without arrays."""
        doc = parse(inspect.getdoc(record) or "")
        yield from _comment(" ".join(doc.description), "")
        yield f"export interface {record.__name__} {{"
        for own in wire_fields(record):
            if is_array(own.kind) or is_arrays(own.kind):
                continue
            yield from _comment(doc.entries.get("Attributes", {}).get(own.attribute, ""), "  ")
            optional = (sent and not own.required) or Absent in members(own.kind)
            yield from _member(f"{own.name}{'?' * optional}", self.alternatives(own.kind, sent=sent))
        yield "}"

    def arrays(self, record: type) -> str:
        """Return the type of the arrays of a reply."""
        doc = parse(inspect.getdoc(record) or "").entries.get("Attributes", {})
        lines = []
        for own in wire_fields(record):
            if is_array(own.kind):
                optional = "?" * (NoneType in members(own.kind))
                lines += [*_comment(doc.get(own.attribute, ""), "  "), f"  {own.name}{optional}: Float32Array;"]
            elif is_arrays(own.kind):
                lines += [*_comment(doc.get(own.attribute, ""), "  "), "  [name: string]: Float32Array;"]
        if not lines:
            return "Nothing"
        name = f"{record.__name__.removesuffix('Reply')}Arrays"
        comment = _comment(f"The arrays of {record.__name__}.", "")
        self.texts[name] = "\n".join([*comment, f"export interface {name} {{", *lines, "}"])
        return name

    def alternatives(self, kind: Any, *, sent: bool) -> list[str]:
        """Return the alternatives of a type, each as TypeScript has it; null is the last."""
        texts = dict.fromkeys(self.typescript(each, sent=sent) for each in members(kind) if each is not Absent)
        flat = [part for text in texts for part in ([text] if text.startswith(("{", "[")) else text.split(" | "))]
        return sorted(dict.fromkeys(flat), key=lambda text: text == "null")

    def typescript(self, kind: Any, *, sent: bool) -> str:
        """Return a type as TypeScript has it."""
        if kind in _PLAIN:
            return _PLAIN[kind]
        origin, parts = get_origin(kind), get_args(kind)
        if origin is Annotated:
            return str(parts[1])
        if origin is Literal:
            return " | ".join(map(json.dumps, parts))
        if is_dataclass(kind) and isinstance(kind, type):
            return self.name(kind, sent=sent)
        if origin is Mapping:
            return f"Record<string, {self.union(parts[1], sent=sent)}>"
        if origin is Sequence or (origin is tuple and parts[1:] == (...,)):
            inner = self.union(parts[0], sent=sent)
            return f"({inner})[]" if " | " in inner and not inner.startswith("[") else f"{inner}[]"
        if origin is tuple:
            return f"[{', '.join(self.union(each, sent=sent) for each in parts)}]"
        raise TypeError(f"{kind} has no type on the wire")

    def union(self, kind: Any, *, sent: bool) -> str:
        """Return the alternatives of a type in one line."""
        return " | ".join(self.alternatives(kind, sent=sent))


def _member(name: str, alternatives: Sequence[str]) -> Iterable[str]:
    line = f"  {name}: {' | '.join(alternatives)};"
    if len(line) <= WIDTH:
        return [line]
    return [f"  {name}:", *(f"    | {each}" for each in alternatives[:-1]), f"    | {alternatives[-1]};"]


def _comment(text: str, indent: str) -> list[str]:
    """Return the lines of a comment of TypeScript."""
    text = text[:1].upper() + text[1:]
    if not text:
        return []
    if len(indent) + len(text) + 7 <= WIDTH:
        return [f"{indent}/** {text} */"]
    lines = textwrap.wrap(text, WIDTH - len(indent) - 3, break_long_words=False, break_on_hyphens=False)
    return [f"{indent}/**", *(f"{indent} * {line}" for line in lines), f"{indent} */"]


if __name__ == "__main__":
    for path, text in documents(Path(sys.argv[1])).items():
        path.write_text(text, encoding="utf-8", newline="\n")
