"""Generic section tree of Simulink files and its XML, JSON and brace syntaxes.

XML: external documents are never loaded, and entity declarations (which could read local files or expand without bound)
are rejected. JSON (newest releases) has the structure of the XML under the same names. Brace syntax (classic `.mdl`):
`Kind { key value ... }`, one entry a line; a value is a quoted string, continued on the lines below it, or the rest of
the line; a matrix may span lines; lines starting with `#` are comments. The syntax is not published; the rules are
those of files written by Simulink 2 to R2021a.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from kennfeld.errors import Finding, InputError

MAX_DEPTH = 200  # nested sections; a subsystem takes two, and models nest about ten subsystems
MAX_SECTIONS = 1_000_000  # in one part of a file; a model of 10 000 blocks has about 30 000

_MAX_FINDINGS = 50  # of each kind; a garbled file has thousands

_DAMAGED = "The file may be truncated or damaged: use a complete copy."

_LINE = re.compile(r"([^\s{}\"]++)\s*+(.*)\Z", re.DOTALL)
_STRING = re.compile(r'"((?:[^"\\]|\\.)*)"?', re.DOTALL)
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r"}
_ENCODING = re.compile(rb'^[ \t]*+SavedCharacterEncoding[ \t]++"([^"\n]{1,40})"', re.MULTILINE)
_ENCODINGS = {
    "utf-8": "utf-8",
    "us-ascii": "utf-8",
    "windows-1252": "cp1252",
    "windows-1250": "cp1250",
    "windows-1251": "cp1251",
    "iso-8859-1": "latin-1",
    "iso-8859-15": "iso8859-15",
    "shift_jis": "cp932",
    "windows-31j": "cp932",
    "gbk": "gbk",
    "gb2312": "gb18030",
    "gb18030": "gb18030",
    "big5": "big5",
    "euc-jp": "euc_jp",
    "euc-kr": "cp949",
    "windows-949": "cp949",
}
_HEAD = 65536
_BRACE_ELEMENTS = ("Cell", "String")
_MAX_MATRIX_LINES = 2000  # lines

_CLASS, _NUMBER, _PROPERTIES, _ELEMENTS, _VALUE = "_object_class", "_id", "_properties", "_elements", "_value"


@dataclass(slots=True)
class SectionNode:
    """One section: an XML element, or braces and their content.

    `keys` are attributes, `<P Name="key">value</P>`, or lines `key value`, without a leading `$`; `links` are keys
    whose value is stored in another part of the file, with the name of that part.
    """

    kind: str
    line: int
    keys: dict[str, str] = field(default_factory=dict)
    parts: list["SectionNode"] = field(default_factory=list)
    links: dict[str, str] = field(default_factory=dict)
    text: str = ""

    def all(self, *kinds: str) -> Iterator["SectionNode"]:
        """Yield the direct child sections of one of the kinds."""
        return (part for part in self.parts if part.kind in kinds)

    def first(self, *kinds: str) -> "SectionNode | None":
        """Return the first direct child section of one of the kinds."""
        return next(self.all(*kinds), None)

    def get(self, key: str, default: str = "") -> str:
        """Return the value of a key, or the text of a child section of that kind."""
        if key in self.keys:
            return self.keys[key]
        part = self.first(key)
        return part.text if part is not None else default

    def every(self) -> Iterator["SectionNode"]:
        """Yield this section and all below it, parents first."""
        waiting = [self]
        while waiting:
            section = waiting.pop()
            yield section
            waiting.extend(reversed(section.parts))

    def classed(self, name: str) -> Iterator["SectionNode"]:
        """Yield the sections below, at any depth, that contain an object of a class."""
        return (section for section in self.every() if name in (section.keys.get("ClassName"), section.kind))


class FileRejectedError(Exception):
    """Ends the reading of one part of a file; the error is already recorded."""


@dataclass
class ReadDiagnostics:
    """Findings and remarks of one file."""

    file: str
    errors: list[Finding] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def error(self, place: str, message: str, remedy: str = "") -> None:
        """Record an error; `place` is within the file and may be empty."""
        if len(self.errors) < _MAX_FINDINGS:
            self.errors.append(Finding(f"{self.file} {place}".rstrip(), message, remedy))

    def refuse(self, place: str, message: str, remedy: str = "") -> FileRejectedError:
        """Record an error and return the exception that ends the reading."""
        self.error(place, message, remedy)
        return FileRejectedError()

    def remark(self, sentence: str) -> None:
        """Record a remark on skipped content."""
        if len(self.remarks) < _MAX_FINDINGS:
            self.remarks.append(sentence)

    def raise_if_errors(self) -> tuple[str, ...]:
        """Return the remarks; raise `InputError` with all findings if there was an error."""
        if self.errors:
            raise InputError(self.errors)
        return tuple(self.remarks)


def xml_section(raw: bytes, part: str, diagnostics: ReadDiagnostics, fold: bool = True) -> SectionNode | None:
    """Return the root of an XML part, None with an error recorded if it is malformed or rejected.

    `fold` turns `<P Name="key">value</P>` into a key of its parent; otherwise it stays a section.
    """
    builder = _XmlSectionBuilder(part, diagnostics, fold)
    try:
        builder.parser.Parse(raw.lstrip(), True)
    except FileRejectedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        place = f"{part} line {getattr(error, 'lineno', 1)}"
        diagnostics.error(place, f"is not well-formed XML: {message}", _DAMAGED)
        return None
    return builder.root


class _XmlSectionBuilder:
    def __init__(self, part: str, diagnostics: ReadDiagnostics, fold: bool) -> None:
        self.part = part
        self.fold = fold
        self.diagnostics = diagnostics
        self.root: SectionNode | None = None
        self.open: list[SectionNode] = []
        self.key: str | None = None
        self.pieces: list[str] = []
        self.count = 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self.pieces.append
        self.parser.EntityDeclHandler = self._entity
        self.parser.SkippedEntityHandler = self._skipped

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.fold and name == "P" and "Name" in attributes and self.open and self.key is None:
            self._key(attributes)
            return
        self.pieces.clear()
        section = SectionNode(name.rpartition(":")[2], self.parser.CurrentLineNumber, attributes)
        if self.open:
            self.open[-1].parts.append(section)
        elif self.root is None:
            self.root = section
        self.open.append(section)
        if len(self.open) > MAX_DEPTH:
            raise self._refused(f"has elements more than {MAX_DEPTH} levels deep")
        if self.count > MAX_SECTIONS:
            raise self._refused(f"has more than {MAX_SECTIONS} elements")

    def _key(self, attributes: dict[str, str]) -> None:
        self.pieces.clear()
        key = attributes["Name"]
        if "Ref" in attributes:
            self.open[-1].links[key] = attributes["Ref"]
        self.key = key

    def _end(self, name: str) -> None:
        if self.key is not None and name == "P":
            section = self.open[-1]
            if self.key not in section.links:
                section.keys[self.key] = "".join(self.pieces)
            self.key = None
            self.pieces.clear()
            return
        section = self.open.pop()
        if self.pieces and not section.parts:
            section.text = "".join(self.pieces)
        self.pieces.clear()

    def _entity(self, name: str, *_: object) -> None:
        raise self._refused(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _skipped(self, name: str, _: bool) -> None:
        raise self._refused(f"uses the undeclared entity {name[:60]}", "Replace it by its characters.")

    def _refused(self, message: str, remedy: str = "") -> FileRejectedError:
        return self.diagnostics.refuse(f"{self.part} line {self.parser.CurrentLineNumber}", message, remedy)


def normalize_name(name: str) -> str:
    r"""Return a name with each run of white space, line ends included, replaced by one blank.

    >>> normalize_name("engine +\n impeller")
    'engine + impeller'
    """
    return " ".join(name.split())


def brace_text(raw: bytes) -> str:
    """Decode a classic file in the encoding it names; undecodable characters are replaced."""
    named = _ENCODING.search(raw[:_HEAD])
    encoding = _ENCODINGS.get(named[1].decode("ascii", "replace").lower(), "") if named else ""
    for candidate in (encoding, "utf-8", "cp1252"):
        try:
            return raw.decode(candidate) if candidate else raw.decode("utf-8")
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def brace_sections(text: str, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """Return the top-level sections ("Model", "Stateflow", "MatData"); errors are recorded."""
    reader = _BraceParser(re.split(r"\r\n|\r|\n", text), diagnostics)
    try:
        reader.read()
    except FileRejectedError:
        return []
    return reader.top


class _BraceParser:
    def __init__(self, lines: list[str], diagnostics: ReadDiagnostics) -> None:
        self.lines = lines
        self.diagnostics = diagnostics
        self.at = 0
        self.top: list[SectionNode] = []
        self.open: list[SectionNode] = []
        self.count = 0
        self.whole = True  # True if every matrix so far had its closing bracket

    def read(self) -> None:
        while self.at < len(self.lines):
            line = self.lines[self.at].strip()
            self.at += 1
            if not line or line[0] == "#":
                continue
            if line == "}":
                self._close()
            else:
                self._line(line)
        if self.open:
            first = self.open[-1]
            message = f"is truncated: {first.kind[:60]} of line {first.line} is never closed"
            self.diagnostics.error(f"line {len(self.lines)}", message, "Use a complete copy of the file.")

    def _line(self, line: str) -> None:
        match = _LINE.match(line)
        if match is None:
            raise self._wrong(line)
        key, value = match.groups()
        if value == "{":
            self._open(key)
        elif not self.open:
            raise self._wrong(line)
        else:
            self._key(key.removeprefix("$"), self._value(value))

    def _key(self, key: str, value: str) -> None:
        """Add a key; all elements of an array have the same key."""
        if key in _BRACE_ELEMENTS and self.open[-1].kind == "Array":
            self.open[-1].parts.append(SectionNode(key, self.at, text=value))
        else:
            self.open[-1].keys[key] = value

    def _open(self, kind: str) -> None:
        section = SectionNode(kind, self.at)
        (self.open[-1].parts if self.open else self.top).append(section)
        self.open.append(section)
        self.count += 1
        if len(self.open) > MAX_DEPTH:
            raise self.diagnostics.refuse(f"line {self.at}", f"has sections more than {MAX_DEPTH} levels deep")
        if self.count > MAX_SECTIONS:
            raise self.diagnostics.refuse(f"line {self.at}", f"has more than {MAX_SECTIONS} sections")

    def _close(self) -> None:
        if not self.open:
            raise self.diagnostics.refuse(f"line {self.at}", "has an unmatched }", "Use a complete copy of the file.")
        self.open.pop()

    def _value(self, value: str) -> str:
        if value.startswith('"'):
            return self._string(value)
        return self._matrix(value) if "[" in value and self.whole else value

    def _string(self, value: str) -> str:
        pieces = [_piece(value)]
        while self.at < len(self.lines):
            line = self.lines[self.at].strip()
            if not line.startswith('"'):
                break
            pieces.append(_piece(line))
            self.at += 1
        return _ESCAPE.sub(lambda match: _ESCAPED.get(match[1], match[1]), "".join(pieces))

    def _matrix(self, value: str) -> str:
        """Return a matrix continued on further lines up to its closing bracket."""
        depth, start = value.count("[") - value.count("]"), self.at
        pieces = [value]
        while depth > 0 and self.at < min(len(self.lines), start + _MAX_MATRIX_LINES):
            line = self.lines[self.at].strip()
            if line in ("}", "") or line.endswith("{"):
                break
            pieces.append(line)
            depth += line.count("[") - line.count("]")
            self.at += 1
        if depth > 0:  # looking ahead again for each would take quadratic time
            self.at, self.whole = start, False
            return value
        return " ".join(pieces)

    def _wrong(self, line: str) -> FileRejectedError:
        message = f"is neither a key with its value nor a section: {line[:60]}"
        return self.diagnostics.refuse(f"line {self.at}", message, "Use a complete copy of the file.")


def _piece(value: str) -> str:
    """Return the text between the first quotes of a line."""
    match = _STRING.match(value)
    return match[1] if match else value.strip('"')


def json_section(raw: bytes, part: str, diagnostics: ReadDiagnostics) -> SectionNode | None:
    """Return the root of a JSON part, None with an error recorded if it is malformed.

    A root with a single member is that member: `{"BlockDiagram": {...}}`.
    """
    try:
        root = json.loads(raw)
    except (ValueError, RecursionError) as error:
        diagnostics.error(part, f"is not well-formed JSON: {str(error)[:120]}", _DAMAGED)
        return None
    if not isinstance(root, dict):
        diagnostics.error(part, "is not a JSON object", _DAMAGED)
        return None
    converter = _Converter(part, diagnostics)
    if len(root) == 1 and isinstance(inner := next(iter(root.values())), dict):
        return converter.section(next(iter(root)), inner)
    return converter.section("", root)


class _Converter:
    def __init__(self, part: str, diagnostics: ReadDiagnostics) -> None:
        self.part = part
        self.diagnostics = diagnostics
        self.count = 0

    def section(self, kind: str, members: dict[str, Any], depth: int = 0) -> SectionNode:
        self.count += 1
        if depth > MAX_DEPTH or self.count > MAX_SECTIONS:
            raise self.diagnostics.refuse(self.part, f"has more than {MAX_SECTIONS} elements or {MAX_DEPTH} levels")
        section = SectionNode(kind, 0)
        for key, value in members.items():
            if key == _PROPERTIES and isinstance(value, dict):
                inner = self.section(kind, value, depth + 1)
                section.keys |= inner.keys
                section.parts += inner.parts
            else:
                self._add(section, key, value, depth)
        return section

    def _add(self, section: SectionNode, key: str, value: Any, depth: int) -> None:
        if key in (_CLASS, _NUMBER):
            section.keys["ClassName" if key == _CLASS else "ObjectID"] = str(value)
        elif isinstance(value, dict) and _VALUE in value:
            section.keys[key] = _text(value[_VALUE])
        elif isinstance(value, dict):
            elements = value.get(_ELEMENTS)
            if isinstance(elements, list):
                section.parts.append(self._array(key, elements, depth))
            else:
                section.parts.append(self._named(key, value, depth))
        elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
            section.parts += [self.section(key, inner, depth + 1) for inner in value if isinstance(inner, dict)]
        else:
            section.keys[key] = _text(value)

    def _named(self, key: str, value: dict[str, Any], depth: int) -> SectionNode:
        section = self.section(key, value, depth + 1)
        section.keys.setdefault("PropName", key)
        return section

    def _array(self, key: str, elements: list[Any], depth: int) -> SectionNode:
        objects = [self.section("Object", inner, depth + 1) for inner in elements if isinstance(inner, dict)]
        return SectionNode("Array", 0, {"PropName": key}, objects)


def _text(value: Any) -> str:
    """Return a value as the XML of other releases writes it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else "" if value is None else json.dumps(value)
