"""Parsing of C text, with types that it does not define, and past the first syntax error."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from pycparser.c_parser import CParser, ParseError

from kennfeld.base.errors import Findings, InputError
from kennfeld.importers.c.declarations import CFile, read_declarations
from kennfeld.importers.c.number_types import KNOWN_TYPES, CType
from kennfeld.importers.c.preprocessing import CSource

_MAX_RUNS: Final = 40  # of the parser
_MAX_PARSED: Final = 4_000_000  # characters in all runs but the first one
_PLACE: Final = re.compile(r"(?:.*?):(\d+):(\d+): (.*)", re.DOTALL)
_NAMED: Final = re.compile(
    r"\b([A-Za-z_]\w*)(?:\s+const\b)?(?:\s+|\s*\*+\s*(?:const\s+)?)(?=[A-Za-z_]\w*\s*[\[;,)=(]|[*)])"
)
_CAST: Final = re.compile(r"\(\s*(?:const\s+)?([A-Za-z_]\w*)\s*\*+\s*\)")
_KEYWORDS: Final = frozenset(
    [
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern"),
        *("float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed"),
        *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "_Bool"),
    ]
)
_REMEDY: Final = "Macros and types of included files are not known unless the files are in the folder."


def parse_source(source: CSource, known: Mapping[str, CType] | None = None) -> CFile:
    """Parse a text to its declarations.

    A type that is not defined is taken as a struct whose members are not known; `known` are those of numbers.

    Raises:
        InputError: the text is not C; names all places.
    """
    findings = Findings()
    lines = [line.text for line in source.lines]
    types = _AssumedTypes()
    remaining = _MAX_PARSED
    for run in range(_MAX_RUNS):
        parser, text = CParser(), _text(lines, types.names)
        try:
            tree = parser.parse(text, "c")
            findings.finish()
            return read_declarations(tree, len(KNOWN_TYPES) + len(types.names), known)
        except ParseError as error:
            line, column, message = _place(error, parser)
        except RecursionError:
            raise InputError.of(source.location(0), "it is nested too deeply", "Split its expressions.") from None
        remaining -= len(text)
        # an unknown word may be a type; else the function around the error is removed, to find further errors
        if remaining > 0 and run + 1 < _MAX_RUNS and types.assume(lines, line):
            continue
        findings.error(source.location(line, column), f"not valid C: {message[:120]}", _REMEDY)
        if remaining <= 0 or not _remove(lines, line):
            break
    findings.finish()
    raise AssertionError


class _AssumedTypes:
    """Types that a text does not define, and the lines that need them."""

    def __init__(self) -> None:
        self.names: dict[str, int] = {}
        self._wrong: set[str] = set()

    def assume(self, lines: list[str], line: int) -> bool:
        """Take a word of a line as a type, if it can be one; return True if there is one that was not tried."""
        last = next(reversed(self.names), "")
        if last and self.names[last] >= line:  # which did not help
            del self.names[last]
            self._wrong.add(last)
        name = next((n for n in _unknown_types(lines, line) if n not in self.names and n not in self._wrong), "")
        if name:
            self.names[name] = line
        return bool(name)


def _text(lines: list[str], assumed: Iterable[str]) -> str:
    # the grammar of C depends on which names are types, not on their sizes, which `TypeTable` knows
    known = "".join(f"typedef int {name}; " for name in KNOWN_TYPES)
    others = "".join(f"typedef struct {name} {name}; " for name in assumed)
    # # 1 numbers the lines behind the declarations from 1 on
    return "\n".join((f'{known}{others}\n# 1 "c"', *lines, ""))


def _place(error: ParseError, parser: CParser) -> tuple[int, int, str]:
    """Return line, column and text of an error."""
    if match := _PLACE.match(str(error)):
        return int(match[1]), int(match[2]), match[3]
    # for errors without a place, the line that the parser has reached
    return int(getattr(parser.clex, "_lineno", 0) or 0), 0, str(error).removeprefix("c: ")


def _unknown_types(lines: list[str], line: int) -> Iterator[str]:
    """Yield words of a line, or of the one before, that stand where a declaration or a cast has its type."""
    for text in lines[max(line - 2, 0) : line][::-1]:
        for match in (*_NAMED.finditer(text), *_CAST.finditer(text)):
            is_tag = re.search(r"\b(struct|union|enum)\s+$", text[: match.start()]) is not None
            if match[1] not in _KEYWORDS and match[1] not in KNOWN_TYPES and not is_tag:
                yield match[1]


def _remove(lines: list[str], line: int) -> bool:
    """Remove the function or declaration around a line; return False if it cannot be found."""
    at = min(max(line - 1, 0), len(lines) - 1)
    if at < 0:
        return False
    first, depth = 0, 0
    for number, text in enumerate(lines):
        start = depth
        for character in text:
            depth += (character == "{") - (character == "}")
            depth = max(depth, 0)
        # a declaration ends outside of braces: with ; or with the brace of a function
        ends = depth == 0 and (start > 0 or text.rstrip().endswith((";", "}")))
        if ends and number >= at:
            removed = any(part.strip() for part in lines[first : number + 1])
            lines[first : number + 1] = [""] * (number + 1 - first)
            return removed
        if ends:
            first = number + 1
    return False
