"""Generic section tree of Simulink files and its XML, JSON and brace syntaxes.

XML: external documents are never loaded, and entity declarations (which could read local files or expand without bound)
are rejected. JSON (newest releases) has the structure of the XML under the same names. Brace syntax (classic `.mdl`):
`Kind { key value ... }`, one entry a line; a value is a quoted string, continued on the lines below it, or the rest of
the line; a matrix may span lines; lines starting with `#` are comments. The syntax is not published; the rules are
those of files written by Simulink 2 to R2021a.
"""

import contextlib
import json
import re
from collections.abc import Iterator
from dataclasses import field
from typing import Any
from xml.parsers import expat

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass

MAX_DEPTH = 200  # nested sections; a subsystem takes two, and models nest about ten subsystems
MAX_SECTIONS = 1_000_000  # in one part of a file; a model of 10 000 blocks has about 30 000

_MAX_FINDINGS = 50  # of each kind; a garbled file has thousands

COMPLETE_COPY = "Use a complete copy of the file."
_DAMAGED = "The file may be truncated or damaged: use a complete copy."

# a key up to white space, a brace or a quote; the rest is its value
_LINE = re.compile(r"([^\s{}\"]++)\s*+(.*)\Z", re.DOTALL)
_STRING = re.compile(r'"((?:[^"\\]|\\.)*)"?', re.DOTALL)
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r"}
_ENCODING = re.compile(rb'^[ \t]*+SavedCharacterEncoding[ \t]++"([^"\n]{1,40})"', re.MULTILINE)
_ENCODINGS = {
    "utf-8": "utf-8", "us-ascii": "utf-8", "windows-1252": "cp1252", "windows-1250": "cp1250",
    "windows-1251": "cp1251", "iso-8859-1": "latin-1", "iso-8859-15": "iso8859-15", "shift_jis": "cp932",
    "windows-31j": "cp932", "gbk": "gbk", "gb2312": "gb18030", "gb18030": "gb18030", "big5": "big5",
    "euc-jp": "euc_jp", "euc-kr": "cp949", "windows-949": "cp949",
}  # fmt: skip
_HEAD = 65536
_BRACE_ELEMENTS = ("Cell", "String")
_MAX_MATRIX_LINES = 2000  # lines

_CLASS, _NUMBER, _PROPERTIES, _ELEMENTS, _VALUE = "_object_class", "_id", "_properties", "_elements", "_value"


@dataclass(slots=True)
class SectionNode:
    """One section: an XML element, or braces and their content.

    `keys` are attributes, `<P Name="key">value</P>`, or lines `key value`, without a leading `$`; keys whose value is
    stored in another part of the file are left out, and have its name in `elsewhere`.
    """

    kind: str
    line: int
    keys: dict[str, str] = field(default_factory=dict)
    parts: list["SectionNode"] = field(default_factory=list)
    text: str = ""
    elsewhere: dict[str, str] = field(default_factory=dict)

    def all(self, *kinds: str) -> Iterator["SectionNode"]:
        """Yield the direct child sections of one of the kinds."""
        return (part for part in self.parts if part.kind in kinds)

    def first(self, *kinds: str) -> "SectionNode | None":
        """Find the first direct child section of one of the kinds."""
        for part in self.parts:
            if part.kind in kinds:
                return part
        return None

    def get(self, key: str, default: str = "") -> str:
        """Look up the value of a key, or the text of a child section of that kind."""
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
    """Errors of one file, and warnings about skipped content; of a garbled file, the first ones."""

    file: str
    errors: list[Finding] = field(default_factory=list)
    warnings: list[Finding] = field(default_factory=list)

    def error(self, part: str, message: str, remedy: str = "", line: int = 0) -> None:
        """Record an error at a line of the file or of a part of it, or at a block; `part` may be empty."""
        location = Location(f"{self.file} {part}".rstrip(), line) if line else Location(self.file, path=part)
        if len(self.errors) < _MAX_FINDINGS:
            self.errors.append(Finding(location, message, remedy))

    def refuse(self, part: str, message: str, remedy: str = "", line: int = 0) -> FileRejectedError:
        """Record an error and return the exception that ends the reading."""
        self.error(part, message, remedy, line)
        return FileRejectedError()

    def warn(self, sentence: str) -> None:
        """Record a sentence on skipped content."""
        if len(self.warnings) < _MAX_FINDINGS:
            self.warnings.append(Finding(Location(), sentence, severity="warning"))

    def raise_if_errors(self) -> None:
        """Raise `InputError` with all errors if there is one."""
        if self.errors:
            raise InputError(self.errors)


def xml_section(raw: bytes, part: str, diagnostics: ReadDiagnostics, fold: bool = True) -> SectionNode | None:
    """Parse an XML part to its root, None with an error recorded if it is malformed or rejected.

    `fold` turns `<P Name="key">value</P>` into a key of its parent; otherwise it stays a section.
    """
    builder = _XmlSectionBuilder(part, diagnostics, fold)
    try:
        # expat refuses white space before the XML declaration
        builder.parser.Parse(raw.lstrip(), True)
    except FileRejectedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        diagnostics.error(part, f"is not well-formed XML: {message}", _DAMAGED, getattr(error, "lineno", 1))
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
        self.reference: str | None = None  # the part that contains the value of the key, if it is another one
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
        self.pieces.clear()
        if self.fold and name == "P" and "Name" in attributes and self.open and self.key is None:
            self.key, self.reference = attributes["Name"], attributes.get("Ref")
            return
        # without the prefix of a namespace
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

    def _end(self, name: str) -> None:
        if self.key is not None and name == "P":
            if self.reference is None:
                self.open[-1].keys[self.key] = "".join(self.pieces)
            else:
                self.open[-1].elsewhere[self.key] = self.reference
            self.key = None
            self.pieces.clear()
            return
        section = self.open.pop()
        # text between child elements is indentation
        if self.pieces and not section.parts:
            section.text = "".join(self.pieces)
        self.pieces.clear()

    def _entity(self, name: str, *_: object) -> None:
        raise self._refused(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _skipped(self, name: str, _: bool) -> None:
        raise self._refused(f"uses the undeclared entity {name[:60]}", "Replace it by its characters.")

    def _refused(self, message: str, remedy: str = "") -> FileRejectedError:
        return self.diagnostics.refuse(self.part, message, remedy, self.parser.CurrentLineNumber)


def normalize_name(name: str) -> str:
    r"""Replace each run of white space in a name, line ends included, by one blank.

    >>> normalize_name("engine +\n impeller")
    'engine + impeller'
    """
    return " ".join(name.split())


def brace_text(raw: bytes) -> str:
    """Decode a classic file in the encoding it names; undecodable characters are replaced."""
    named = _ENCODING.search(raw[:_HEAD])
    encoding = _ENCODINGS.get(named[1].decode("ascii", "replace").lower(), "") if named else ""
    # cp1252 lacks five bytes, latin-1 none
    for candidate in (encoding or "utf-8", "utf-8", "cp1252"):
        with contextlib.suppress(UnicodeDecodeError):
            return raw.decode(candidate)
    return raw.decode("latin-1")


def brace_sections(text: str, diagnostics: ReadDiagnostics) -> list[SectionNode]:
    """Parse the top-level sections ("Model", "Stateflow", "MatData"); errors are recorded."""
    # not `splitlines`, which also ends lines at form feeds and separators of Unicode within a text
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
            if line != "}":
                self._line(line)
            elif not self.open:
                raise self._refused("has an unmatched }", COMPLETE_COPY)
            else:
                self.open.pop()
        if self.open:
            first = self.open[-1]
            message = f"is truncated: {first.kind[:60]} of line {first.line} is never closed"
            self.diagnostics.error("", message, COMPLETE_COPY, len(self.lines))

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
            self._add(key.removeprefix("$"), self._value(value))

    def _add(self, key: str, value: str) -> None:
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
            raise self._refused(f"has sections more than {MAX_DEPTH} levels deep")
        if self.count > MAX_SECTIONS:
            raise self._refused(f"has more than {MAX_SECTIONS} sections")

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
            # the matrix was never closed: these belong to the sections around it
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
        return self._refused(f"is neither a key with its value nor a section: {line[:60]}", COMPLETE_COPY)

    def _refused(self, message: str, remedy: str = "") -> FileRejectedError:
        return self.diagnostics.refuse("", message, remedy, self.at)


def _piece(value: str) -> str:
    """Return the text between the first quotes of a line."""
    match = _STRING.match(value)
    return match[1] if match else value.strip('"')


def json_section(raw: bytes, part: str, diagnostics: ReadDiagnostics) -> SectionNode | None:
    """Parse a JSON part to its root, None with an error recorded if it is malformed.

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
                # properties in a group of their own become keys and parts of the object, as in XML
                inner = self.section(kind, value, depth + 1)
                section.keys |= inner.keys
                section.parts += inner.parts
            else:
                self._add(section, key, value, depth)
        return section

    def _add(self, section: SectionNode, key: str, value: Any, depth: int) -> None:
        if key in (_CLASS, _NUMBER):
            # the names that these have in XML and in the brace syntax
            section.keys["ClassName" if key == _CLASS else "ObjectID"] = str(value)
        elif isinstance(value, dict) and _VALUE in value:
            section.keys[key] = _text(value[_VALUE])
        elif isinstance(value, dict):
            elements = value.get(_ELEMENTS)
            if isinstance(elements, list):
                objects = [self.section("Object", inner, depth + 1) for inner in elements if isinstance(inner, dict)]
                section.parts.append(SectionNode("Array", 0, {"PropName": key}, objects))
                return
            section.parts.append(self.section(key, value, depth + 1))
            # as in XML, an object names the property whose value it is
            section.parts[-1].keys.setdefault("PropName", key)
        elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
            section.parts += [self.section(key, inner, depth + 1) for inner in value if isinstance(inner, dict)]
        else:
            section.keys[key] = _text(value)


def _text(value: Any) -> str:
    """Return a value as the XML of other releases writes it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else "" if value is None else json.dumps(value)
