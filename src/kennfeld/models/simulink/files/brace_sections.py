"""The classic `.mdl` syntax: `Kind { key value ... }`, a line each.

A value is a quoted string (those on the lines below it belong to it) or the rest of the line; a matrix may go on over
several lines. Lines that begin with `#` are comments. The syntax is not published; the rules are those of the files
that Simulink 2 to R2021a wrote.
"""

import re

from kennfeld.models.simulink.files.section import DEEPEST, MOST_SECTIONS, Section
from kennfeld.models.simulink.files.trouble import RefusedError, Trouble

__all__ = ["brace_sections", "brace_text"]

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
_ELEMENTS = ("Cell", "String")
_LONGEST_MATRIX = 2000  # lines


def brace_text(raw: bytes) -> str:
    """The characters of a classic file, in the encoding that it names; unreadable ones are replaced."""
    named = _ENCODING.search(raw[:_HEAD])
    encoding = _ENCODINGS.get(named[1].decode("ascii", "replace").lower(), "") if named else ""
    for candidate in (encoding, "utf-8", "cp1252"):
        try:
            return raw.decode(candidate) if candidate else raw.decode("utf-8")
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def brace_sections(text: str, trouble: Trouble) -> list[Section]:
    """The sections at the top of a file ("Model", "Stateflow", "MatData"); errors are noted."""
    reader = _Reader(re.split(r"\r\n|\r|\n", text), trouble)
    try:
        reader.read()
    except RefusedError:
        return []
    return reader.top


class _Reader:
    def __init__(self, lines: list[str], trouble: Trouble) -> None:
        self.lines = lines
        self.trouble = trouble
        self.at = 0
        self.top: list[Section] = []
        self.open: list[Section] = []
        self.count = 0
        self.whole = True  # whether every matrix so far had its closing bracket

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
            what = f"is cut off: {first.kind[:60]} of line {first.line} is never closed"
            self.trouble.error(f"line {len(self.lines)}", what, "Take a complete copy of the file.")

    def _line(self, line: str) -> None:
        found = _LINE.match(line)
        if found is None:
            raise self._wrong(line)
        key, value = found.groups()
        if value == "{":
            self._open(key)
        elif not self.open:
            raise self._wrong(line)
        else:
            self._key(key.removeprefix("$"), self._value(value))

    def _key(self, key: str, value: str) -> None:
        """A key with its value; the elements of an array all have the same key."""
        if key in _ELEMENTS and self.open[-1].kind == "Array":
            self.open[-1].parts.append(Section(key, self.at, text=value))
        else:
            self.open[-1].keys[key] = value

    def _open(self, kind: str) -> None:
        section = Section(kind, self.at)
        (self.open[-1].parts if self.open else self.top).append(section)
        self.open.append(section)
        self.count += 1
        if len(self.open) > DEEPEST:
            raise self.trouble.refuse(f"line {self.at}", f"has sections more than {DEEPEST} levels deep")
        if self.count > MOST_SECTIONS:
            raise self.trouble.refuse(f"line {self.at}", f"has more than {MOST_SECTIONS} sections")

    def _close(self) -> None:
        if not self.open:
            raise self.trouble.refuse(
                f"line {self.at}", "has a } that closes nothing", "Take a complete copy of the file."
            )
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
        return _ESCAPE.sub(lambda found: _ESCAPED.get(found[1], found[1]), "".join(pieces))

    def _matrix(self, value: str) -> str:
        """A matrix that goes on over further lines, up to the bracket that closes it."""
        depth, start = value.count("[") - value.count("]"), self.at
        pieces = [value]
        while depth > 0 and self.at < min(len(self.lines), start + _LONGEST_MATRIX):
            line = self.lines[self.at].strip()
            if line in ("}", "") or line.endswith("{"):
                break
            pieces.append(line)
            depth += line.count("[") - line.count("]")
            self.at += 1
        if depth > 0:  # looking ahead once more for each of them would take forever
            self.at, self.whole = start, False
            return value
        return " ".join(pieces)

    def _wrong(self, line: str) -> RefusedError:
        what = f"is neither a key with its value nor a section: {line[:60]}"
        return self.trouble.refuse(f"line {self.at}", what, "Take a complete copy of the file.")


def _piece(value: str) -> str:
    """What stands between the first quotes of a line."""
    found = _STRING.match(value)
    return found[1] if found else value.strip('"')
