"""Parsing of C text, with types that it does not define, and past the first syntax error."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from pycparser.c_parser import CParser, ParseError

from kennfeld.base.errors import Findings, InputError
from kennfeld.importers.c.declarations import CFile, read_declarations
from kennfeld.importers.c.number_types import KNOWN_TYPES, CType, UnsupportedCError
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
_DEFINITION: Final = re.compile(r"^(?=\w)[^(){};=]*?\b([A-Za-z_]\w*)\s*\([^(){};]*\)\s*\{", re.MULTILINE)
_REMEDY: Final = "Macros and types of included files are not known unless the files are in the folder."


def parse_source(source: CSource, known: Mapping[str, CType] | None = None) -> CFile:
    """Parse a text to its declarations.

    A type that is not defined is taken as a struct whose members are not known; `known` are those of numbers. Functions
    that are not C are listed as unsupported, as long as there are others.

    Raises:
        InputError: the text is not C; names all places.
    """
    findings = Findings()
    lines = [line.text for line in source.lines]
    types = _AssumedTypes()
    remaining = _MAX_PARSED
    broken: dict[str, UnsupportedCError] = {}
    is_whole = True  # but for functions
    for run in range(_MAX_RUNS):
        parser, text = CParser(), _text(lines, types.names)
        try:
            tree = parser.parse(text, "c")
            file = read_declarations(tree, len(KNOWN_TYPES) + len(types.names), known)
            if not ((file.functions or file.unsupported) and is_whole):
                findings.finish()
            file.unsupported |= broken
            return file
        except ParseError as error:
            line, column, message = _place(error, parser)
        except RecursionError:
            raise InputError.of(source.location(0), "it is nested too deeply", "Split its expressions.") from None
        remaining -= len(text)
        # an unknown word may be a type; else the function around the error is removed, to find further errors
        if remaining > 0 and run + 1 < _MAX_RUNS and types.assume(lines, line, column):
            continue
        reason = f"not valid C: {message[:120]}"
        findings.error(source.location(line, column), reason, _REMEDY)
        removed = _remove(lines, line) if remaining > 0 else ""
        if not removed:
            break
        is_whole &= _is_function(removed)
        for name in _defined_functions(removed):
            broken[name] = UnsupportedCError(reason, line, column=column, remedy=_REMEDY)
    findings.finish()
    raise AssertionError


class _AssumedTypes:
    """Types that a text does not define."""

    def __init__(self) -> None:
        self.names: dict[str, None] = {}
        self._tried: list[str] = []  # those assumed for the error at the place
        self._place = (0, 0)

    def assume(self, lines: list[str], line: int, column: int) -> bool:
        """Take a word of a line as a type, if it can be one; return True if there is one that was not tried.

        An error may need several types, of a result and of arguments: they are kept together if it is gone, and
        forgotten together if it stays.
        """
        if (line, column) > self._place:
            self._place, self._tried = (line, column), []
        name = next((name for name in _unknown_types(lines, line) if name not in self.names), "")
        if name:
            self.names[name] = None
            self._tried.append(name)
            return True
        for name in self._tried:
            del self.names[name]
        self._tried = []
        return False


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


def _remove(lines: list[str], line: int) -> str:
    """Remove the function or declaration around a line; return its text, which is empty if it cannot be found."""
    at = min(max(line - 1, 0), len(lines) - 1)
    if at < 0:
        return ""
    first, depth = 0, 0
    for number, text in enumerate(lines):
        start = depth
        for character in text:
            depth += (character == "{") - (character == "}")
            depth = max(depth, 0)
        # a declaration ends outside of braces: with ; or with the brace of a function
        ends = depth == 0 and (start > 0 or text.rstrip().endswith((";", "}")))
        if ends and number >= at:
            removed = "\n".join(lines[first : number + 1]).strip()
            lines[first : number + 1] = [""] * (number + 1 - first)
            return removed
        if ends:
            first = number + 1
    return ""


def _is_function(text: str) -> bool:
    """Return True for a text that defines or declares functions, not variables or types."""
    head = text.partition("{")[0]
    return re.search(r"\w\s*\(", head) is not None and not re.search(r"=|\b(typedef|struct|union|enum)\s*\w*\s*$", head)


def _defined_functions(text: str) -> list[str]:
    """Return the names of the functions that a text defines."""
    return [match[1] for match in _DEFINITION.finditer(text) if match[1] not in _KEYWORDS]
