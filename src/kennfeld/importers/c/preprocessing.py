"""The text of C files: comments, directives of the preprocessor, and the files of the folder that it includes."""

import re
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path, PureWindowsPath
from typing import Final, NamedTuple

from kennfeld.base.errors import Findings, Location
from kennfeld.base.file_state import note_opened
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.conditions import ConditionError, condition_value
from kennfeld.importers.c.macros import Macro, MacroError, MacroExpansion, read_macro, tokens_of

MAX_BYTES: Final = 2_000_000  # of a file with all that it includes
_MAX_INCLUDES: Final = 30  # within one another
_MAX_CALL_LINES: Final = 500  # of a call of a macro
_MAX_FINDINGS: Final = 100
# comments, and the texts in which // and /* begin none
_PARTS: Final = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', re.DOTALL)
_DIRECTIVE: Final = re.compile(r"\s*#\s*(\w*)\s*(.*)")
_DEFINED: Final = re.compile(r"\bdefined\s*(?:\(\s*(\w+)\s*\)|(\w+))")
# extensions of compilers that do not change values
_IGNORED: Final = re.compile(r"\b(__attribute__\s*\(\(.*?\)\)|__inline__|__inline|__restrict|__extension__|register)")
# Generated code tests the sizes of long, which differ between a target and the machine that checks it.
_SIZES_OF_LONG: Final = re.compile(r"\bU?L{1,2}(ONG)?_MAX\b")

KNOWN_MACROS: Final = {
    "M_PI": "3.14159265358979323846", "M_PI_2": "1.57079632679489661923", "M_PI_4": "0.78539816339744830962",
    "M_E": "2.71828182845904523536", "M_LN2": "0.69314718055994530942", "M_LN10": "2.30258509299404568402",
    "M_SQRT2": "1.41421356237309504880", "M_1_PI": "0.31830988618379067154", "M_2_PI": "0.63661977236758134308",
    "DBL_EPSILON": "2.2204460492503131e-16", "DBL_MAX": "1.7976931348623157e308", "DBL_MIN": "2.2250738585072014e-308",
    "FLT_EPSILON": "1.1920928955078125e-07f", "FLT_MAX": "3.40282346638528860e38f", "FLT_MIN": "1.175494350822288e-38f",
    "FP_NAN": "0", "FP_INFINITE": "1", "FP_ZERO": "2", "FP_SUBNORMAL": "3", "FP_NORMAL": "4",
    "HUGE_VAL": "__infinity", "INFINITY": "__infinity", "NAN": "__nan", "true": "1", "false": "0", "NULL": "0",
    "rtInf": "__infinity", "rtInfF": "__infinity", "rtMinusInf": "(-__infinity)", "rtMinusInfF": "(-__infinity)",
    "rtNaN": "__nan", "rtNaNF": "__nan",
    "INT8_MIN": "(-128)", "INT8_MAX": "127", "UINT8_MAX": "255", "INT16_MIN": "(-32768)", "INT16_MAX": "32767",
    "UINT16_MAX": "65535", "INT32_MIN": "(-2147483647-1)", "INT32_MAX": "2147483647", "UINT32_MAX": "4294967295u",
    "INT_MIN": "(-2147483647-1)", "INT_MAX": "2147483647", "UINT_MAX": "4294967295u",
    "CHAR_BIT": "8", "SCHAR_MAX": "127", "UCHAR_MAX": "255", "SHRT_MAX": "32767", "SHRT_MIN": "(-32768)",
    "USHRT_MAX": "65535",
    **{f"PRI{kind}{bits}": f'"{kind}"' for kind in "diouxX" for bits in (8, 16, 32, 64)},
}  # fmt: skip
# those of stdint.h that give a literal the type of its name
_LITERALS: Final = {
    **{f"{sign}INT{bits}_C": end for bits in (8, 16, 32) for sign, end in (("", ""), ("U", "U" if bits == 32 else ""))},
    **{f"{sign}INT{bits}_C": f"{sign}LL" for bits in ("64", "MAX") for sign in ("", "U")},
}


class SourceLine(NamedTuple):
    """A line that the parser reads, with the file and the line that it comes from."""

    text: str
    file: str
    number: int


@dataclass(frozen=True)
class CSource:
    """The text that the parser reads.

    Attributes:
        lines: its lines, with where they come from.
        missing: the names of the files included in quotes that are not in the folder.
    """

    lines: tuple[SourceLine, ...]
    missing: tuple[str, ...] = ()

    def location(self, line: int, column: int = 0) -> Location:
        """Return the location of a line of the text, which counts from 1."""
        if not self.lines:
            return Location()
        if line < 1:
            return Location(self.lines[0].file)
        source = self.lines[min(line, len(self.lines)) - 1]
        return Location(source.file, source.number, column=column)


@dataclass(eq=False)
class _Preprocessor:
    findings: Findings
    folder: Path
    macros: dict[str, Macro] = field(
        default_factory=lambda: {
            **{name: Macro(tokens_of(text)) for name, text in KNOWN_MACROS.items()},
            **{name: Macro(("c", "##", end) if end else ("c",), ("c",)) for name, end in _LITERALS.items()},
        }
    )
    missing: dict[str, None] = field(default_factory=dict)
    result: list[SourceLine] = field(default_factory=list)
    # of each open #if: whether its lines count now, within those around it, and whether one of its parts has counted
    open: list[tuple[bool, bool]] = field(default_factory=list)
    file: str = ""
    size: int = 0
    depth: int = 0
    once: set[str] = field(default_factory=set)
    problems: int = 0

    def __post_init__(self) -> None:
        self.expansion = MacroExpansion(self.macros)

    def read(self, text: str, file: str) -> None:
        """Add the lines of a file."""
        outer, around = self.file, self.open
        # each #if must end in the file that it is in
        self.file, self.open = file, []
        self.size += len(text)
        lines = _plain(text).split("\n")
        at = 0
        while at < len(lines):
            at += self._line(lines, at)
        if self.open:
            self._error(0, "#if without #endif", "Add #endif.")
        self.file, self.open = outer, around

    def _line(self, lines: Sequence[str], at: int) -> int:
        """Add a line, with those that end the call of a macro in it; return their number."""
        line, number = lines[at], at + 1
        if not line:
            self.result.append(SourceLine(line, self.file, number))
            return 1
        if line.lstrip().startswith("#"):
            match = _DIRECTIVE.match(line)
            assert match is not None
            self._directive(match[1], match[2].strip(), number)
            return 1
        if not self._counts:
            return 1
        count = 1
        while (
            count < _MAX_CALL_LINES
            and self.expansion.is_open(line)
            and at + count < len(lines)
            and not lines[at + count].lstrip().startswith("#")
        ):
            line += " " + lines[at + count]
            count += 1
        self.result.append(SourceLine(self._expand(line, number), self.file, number))
        return count

    @property
    def _counts(self) -> bool:
        return not self.open or self.open[-1][0]

    def _error(self, number: int, message: str, remedy: str) -> None:
        self.problems += 1
        if self.problems <= _MAX_FINDINGS:
            self.findings.error(Location(self.file, number), message, remedy)

    def _directive(self, word: str, rest: str, number: int) -> None:
        if word in ("if", "ifdef", "ifndef"):
            counts = self._counts and self._condition(word, rest, number)
            self.open.append((counts, counts))
        elif word in ("elif", "else", "endif"):
            self._close(word, rest, number)
        elif self._counts:
            self._active(word, rest, number)

    def _close(self, word: str, rest: str, number: int) -> None:
        if not self.open:
            self._error(number, f"#{word} without #if", "Remove it.")
            return
        _, had = self.open.pop()
        if word != "endif":
            counts = self._counts and not had and (word == "else" or self._condition("if", rest, number))
            self.open.append((counts, had or counts))

    def _condition(self, word: str, rest: str, number: int) -> bool:
        if word != "if":
            return (rest.partition(" ")[0] in self.macros) == (word == "ifdef")
        if _SIZES_OF_LONG.search(rest):
            return False
        # before macros are expanded, which would replace the name behind `defined`
        defined = _DEFINED.sub(lambda match: str(int((match[1] or match[2]) in self.macros)), rest)
        try:
            return condition_value(self._expand(defined, number)) != 0
        except (ConditionError, RecursionError) as error:
            self._error(number, f"#if {rest[:60]} cannot be evaluated: {error}", "Use integers and names of macros.")
            return False

    def _active(self, word: str, rest: str, number: int) -> None:
        match word:
            case "include":
                if rest.startswith('"'):
                    self._include(rest.split('"')[1], number)
            case "define":
                self._define(rest, number)
            case "undef":
                self.macros.pop(rest, None)
            case "error":
                self._error(number, f"#error {rest[:80]}", "Define the macro that it asks for.")
            case "pragma" if rest == "once":
                self.once.add(self.file)
            case "pragma" | "line" | "warning" | "":
                return
            case _:
                self._error(number, f"unknown directive #{word[:40]}", "Remove it.")

    def _include(self, name: str, number: int) -> None:
        """Read a file that is in the folder; others are noted, since their names may be known without them."""
        file = self.folder / PureWindowsPath(name).name  # its folders may be separated by / or \
        if file.name in self.once:
            return
        note_opened(file)
        try:
            text = file.read_bytes() if file.is_file() else None
        except (OSError, ValueError):
            text = None
        if text is None or file.name != name:
            self.missing[name] = None
        elif self.depth >= _MAX_INCLUDES or self.size + len(text) > MAX_BYTES:
            self._error(number, f"the file includes too much: {name[:60]}", f"Include at most {MAX_BYTES} bytes.")
        else:
            self.depth += 1
            self.read(text.decode("utf-8-sig", errors="replace"), file.name)
            self.depth -= 1

    def _define(self, rest: str, number: int) -> None:
        try:
            name, macro = read_macro(rest)
        except MacroError as error:
            self._error(number, str(error), "Write #define NAME value.")
            return
        self.macros[name] = macro

    def _expand(self, line: str, number: int) -> str:
        try:
            return self.expansion.expand(line)
        except (MacroError, RecursionError) as error:
            message = "macros are nested too deeply" if isinstance(error, RecursionError) else str(error)
            self._error(number, message, "Correct the macro.")
            return ""


def preprocess(text: str, path: Path, findings: Findings, data: str = "") -> CSource:
    """Remove comments and directives from a text, and replace its macros.

    Files of the same folder that it includes in quotes are read; the names of `math.h`, `stdint.h`, `stdbool.h`,
    `limits.h` and `float.h` are known.

    Args:
        text: the text of the file.
        path: its path.
        findings: to be extended.
        data: the text of a second file that belongs to it, `NAME_data.c`.
    """
    preprocessor = _Preprocessor(findings, path.parent)
    preprocessor.read(text, path.name)
    if data:
        preprocessor.read(data, data_file(path).name)
    lines = tuple(line._replace(text=_IGNORED.sub("", line.text)) for line in preprocessor.result)
    return CSource(lines, tuple(preprocessor.missing))


def data_file(path: Path) -> Path:
    """Return the file in which Simulink writes the parameters of a model: `NAME_data.c` beside `NAME.c`."""
    return path.with_name(f"{path.stem}_data.c")


def _plain(text: str) -> str:
    """Return a text without comments, with lines joined that end with a backslash; lines keep their numbers."""
    # joined first, as a comment behind // may continue on the next line
    text = _joined(text.replace("\r\n", "\n").replace("\r", "\n"))
    return _PARTS.sub(lambda m: m[0] if m[0][0] in "\"'" else " " + "\n" * m[0].count("\n"), text)


def _joined(text: str) -> str:
    """Join lines that end with a backslash; empty lines keep the numbers of those that follow."""
    result: list[str] = []
    parts: list[str] = []
    for line in text.split("\n"):
        is_continued = line.endswith("\\")
        parts.append(line[:-1] if is_continued else line)
        if not is_continued:
            result += [" ".join(parts), *[""] * (len(parts) - 1)]
            parts = []
    if parts:
        result += [" ".join(parts), *[""] * (len(parts) - 1)]
    return "\n".join(result)
