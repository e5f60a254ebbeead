"""Splits DCM text into blocks, before their content is interpreted.

DCM is line oriented: the first word of a line is its keyword. Every statement keeps its line number, so that a finding
can point at it and the writer can replace single numbers in place.
"""

import re
from dataclasses import field

from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.format import FileFindings

Statement = tuple[int, str, str]  # line number, keyword, the rest of the line

_SIZE_COUNTS = {"FESTWERT": 0, "TEXTSTRING": 0, "STUETZSTELLENVERTEILUNG": 1}  # keyword: how many sizes follow the name
_SIZE_COUNTS |= {"KENNLINIE": 1, "FESTKENNLINIE": 1, "GRUPPENKENNLINIE": 1}
_SIZE_COUNTS |= {"KENNFELD": 2, "FESTKENNFELD": 2, "GRUPPENKENNFELD": 2}
_BLOCKS = frozenset({*_SIZE_COUNTS, "FESTWERTEBLOCK"})
_LIST_KEYWORDS = frozenset({"FUNKTIONEN", "VARIANTENKODIERUNG"})
_SINGLE_LINES = frozenset({"KONSERVIERUNG_FORMAT", "MODULKOPF"})
_BLOCK_KEYWORDS = frozenset(
    {"WERT", "TEXT", "ST/X", "ST/Y", "ST_TX/X", "ST_TX/Y"}
    | {"LANGNAME", "DISPLAYNAME", "VAR", "FUNKTION", "EINHEIT_X", "EINHEIT_Y", "EINHEIT_W"}
)
_KEYWORDS = sorted(_BLOCKS | _LIST_KEYWORDS | _SINGLE_LINES | _BLOCK_KEYWORDS | {"END"})
_GROUP_AXIS = re.compile(r"\s*\*\s*(SSTX|SSTY|SST)(?:\s+(.*?))?\s*$")
_SIZE = re.compile(r"[1-9]\d{0,9}")
_BLOCK_HEADER = re.compile(r"(\S+)\s+(\d+)(?:\s*@\s*(\d+))?\s*$")
_WORD = re.compile(r'"([^"]*)"|([^\s"]+)')
_ESCAPED = re.compile(r'\\(["\\])')
_MAX_GUESSES = 20  # a garbled file must not spend its time on guessing keywords


@dataclass(slots=True)
class DcmBlock:
    """One block from its header to its END; `sizes` is None if the header could not be read."""

    keyword: str
    name: str
    line: int
    sizes: tuple[int, ...] | None = ()
    statements: list[Statement] = field(default_factory=list)
    end: int = 0  # the line of its END

    def text_of(self, keyword: str) -> str:
        """Return the quoted text of an attribute, or an empty text."""
        return unquote(self.rest_of(keyword))

    def rest_of(self, keyword: str) -> str:
        """Return the rest of the line after a keyword, verbatim."""
        return next((rest for _, key, rest in self.statements if key == keyword), "")

    @property
    def functions(self) -> tuple[str, ...]:
        """The functions that use it, quoted or not, each once."""
        words = (word for _, key, rest in self.statements if key == "FUNKTION" for word in split_words(rest))
        return tuple(dict.fromkeys(filter(None, words)))


def split_words(rest: str) -> list[str]:
    """Return the words of a line; a quoted text is one.

    >>> split_words('Engine "Basic functions" 2')
    ['Engine', 'Basic functions', '2']
    """
    return [quoted or bare for quoted, bare in _WORD.findall(rest)]


def unquote(rest: str) -> str:
    r"""Return the text between the first and the last quote of a line, or the bare words.

    >>> unquote(r'"say \"yes\"" ')
    'say "yes"'
    """
    first, last = rest.find('"'), rest.rfind('"')
    if first < 0:
        return rest.strip()
    inner = rest[first + 1 : last if last > first else None]
    return _ESCAPED.sub(r"\1", inner) if "\\" in inner else inner


class DcmLines:
    """The blocks of a file, its version (1 if none is stated) and the criteria that distinguish variants."""

    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.version = "1"
        self.blocks: list[DcmBlock] = []
        self.block: DcmBlock | None = None  # the one that is open
        self.criteria: set[str] = set()
        self.unknown: dict[str, tuple[int, str]] = {}  # keyword: its first line and block
        self.guessed = 0

    def feed(self, number: int, line: str, keyword: str, rest: str) -> None:
        """Take a line that begins with a keyword, followed by the rest."""
        if self.block is not None and keyword in _BLOCK_KEYWORDS:
            self.block.statements.append((number, keyword, rest))
        # a comment; as `*SSTX name` it states the group axis of a table
        elif keyword[0] in "*!.":
            match = _GROUP_AXIS.match(line) if self.block is not None and "SST" in line else None
            if match and self.block is not None:
                self.block.statements.append((number, match[1], match[2] or ""))
        elif keyword == "END":
            self._end(number)
        elif keyword in _LIST_KEYWORDS:
            self.close_open_block()
            self.block = DcmBlock(keyword, "", number)
        elif keyword in _BLOCKS:
            self.close_open_block()
            self._open(number, keyword, rest)
        elif keyword in _SINGLE_LINES:
            self.close_open_block()
            if keyword == "KONSERVIERUNG_FORMAT":
                self.version = rest.strip() or "2.0"
        elif self.block is None:
            self._stranger_outside(number, keyword, rest)
        elif keyword == "KRITERIUM" and self.block.keyword == "VARIANTENKODIERUNG":
            self.criteria.update(split_words(rest)[:1])
        elif self.block.keyword in _BLOCKS:
            self.unknown.setdefault(keyword, (number, self.block.name))

    def _open(self, number: int, keyword: str, rest: str) -> None:
        name, sizes = _parse_header(keyword, rest)
        self.block = DcmBlock(keyword, name, number, sizes)
        if sizes is None:
            header = "a name and its size, like 'Name 7' or 'Name 4 @ 2'"
            if keyword in _SIZE_COUNTS:
                header = ("only a name", "a name and one size", "a name and two sizes, x and y")[_SIZE_COUNTS[keyword]]
            self.findings.error(number, name, f"{keyword} needs {header}", "", f"{keyword} {rest}")

    def _end(self, number: int) -> None:
        if self.block is None:
            self.findings.error(number, "", "END without a block", "Delete it, or restore the block's first line.")
        elif self.block.keyword in _BLOCKS:
            self.block.end = number
            self.blocks.append(self.block)
        self.block = None

    def close_open_block(self) -> None:
        """Report the block that another one, or the end of the file, interrupts."""
        if self.block is not None and self.block.keyword:
            message = f"{self.block.keyword} has no END"
            remedy = "The file may be truncated: use a complete copy, or add the missing lines."
            self.findings.error(self.block.line, self.block.name, message, remedy)
        self.block = None

    def _stranger_outside(self, number: int, keyword: str, rest: str) -> None:
        """Handle a keyword that opens no block; one similar to a known one is an error."""
        if keyword in _BLOCK_KEYWORDS:
            self.findings.error(number, "", f"{keyword} is outside any block", "", f"{keyword} {rest}")
            return
        self.guessed += 1
        guess = nearest(keyword[:60], _KEYWORDS) if self.guessed <= _MAX_GUESSES else ""
        if guess:
            self.findings.error(number, rest.split(" ")[0], f"unknown keyword {keyword}", guess)
        else:
            self.unknown.setdefault(keyword, (number, ""))
        # takes the lines of the unknown block, up to its END
        self.block = DcmBlock("", "", number)


def split_blocks(text: str, findings: FileFindings) -> DcmLines:
    """Split DCM text into blocks; other content is reported with its line."""
    lines = DcmLines(findings)
    for number, line in enumerate(text.split("\n"), 1):
        parts = line.split(None, 1)
        # nearly all lines of a file are these, so they take the short way
        if len(parts) == 2 and parts[0] in _BLOCK_KEYWORDS and lines.block is not None:
            lines.block.statements.append((number, parts[0], parts[1]))
        elif parts:
            lines.feed(number, line, parts[0], parts[1] if len(parts) > 1 else "")
    lines.close_open_block()
    for keyword, (number, item) in lines.unknown.items():
        findings.warning(number, item, f"unknown keyword {keyword[:60]}; skipped")
    return lines


def _parse_header(keyword: str, rest: str) -> tuple[str, tuple[int, ...] | None]:
    if keyword == "FESTWERTEBLOCK":
        match = _BLOCK_HEADER.match(rest)
        name, sizes = (match[1], [size for size in match.groups()[1:] if size]) if match else (rest.strip(), [])
        usable = bool(sizes)
    else:
        parts = rest.split()
        count = max(len(parts) - _SIZE_COUNTS[keyword], 1)
        # Only group axes are known to have names with blanks.
        count = count if keyword == "STUETZSTELLENVERTEILUNG" else 1
        name, sizes = " ".join(parts[:count]), parts[count:]
        usable = bool(name) and len(sizes) == _SIZE_COUNTS[keyword]
    return name, tuple(map(int, sizes)) if usable and all(map(_SIZE.fullmatch, sizes)) else None
