"""The text of C files: comments, includes, and the directives of the preprocessor that need no other file."""

import re
from collections.abc import Iterator
from dataclasses import field
from typing import Final

from kennfeld.errors import Findings, Location
from kennfeld.lazy_dataclass import dataclass
from kennfeld.models.c_code.number_types import KNOWN_TYPES

_MAX_EXPANSIONS: Final = 20  # of a macro within macros
_MAX_LINE: Final = 100_000
_PARTS: Final = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', re.DOTALL)
_NAME: Final = re.compile(r"""\b[A-Za-z_]\w*\b|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'""")
_DIRECTIVE: Final = re.compile(r"\s*#\s*(\w*)\s*(.*)")
_DEFINE: Final = re.compile(r"([A-Za-z_]\w*)(\([^)]*\))?\s*(.*)")
_DEFINED: Final = re.compile(r"(!?)\s*defined\s*\(?\s*(\w+)\s*\)?\Z")
_IGNORED: Final = re.compile(r"\b(__attribute__\s*\(\(.*?\)\)|__inline__|__inline|__restrict|__extension__|register)")

KNOWN_MACROS: Final = {
    "M_PI": "3.14159265358979323846", "M_PI_2": "1.57079632679489661923", "M_PI_4": "0.78539816339744830962",
    "M_E": "2.71828182845904523536", "M_LN2": "0.69314718055994530942", "M_LN10": "2.30258509299404568402",
    "M_SQRT2": "1.41421356237309504880", "M_1_PI": "0.31830988618379067154", "M_2_PI": "0.63661977236758134308",
    "DBL_EPSILON": "2.2204460492503131e-16", "DBL_MAX": "1.7976931348623157e308", "DBL_MIN": "2.2250738585072014e-308",
    "FLT_EPSILON": "1.1920928955078125e-07f", "FLT_MAX": "3.40282346638528860e38f", "FLT_MIN": "1.175494350822288e-38f",
    "HUGE_VAL": "__infinity", "INFINITY": "__infinity", "NAN": "__nan", "true": "1", "false": "0",
    "INT8_MIN": "(-128)", "INT8_MAX": "127", "UINT8_MAX": "255", "INT16_MIN": "(-32768)", "INT16_MAX": "32767",
    "UINT16_MAX": "65535", "INT32_MIN": "(-2147483647-1)", "INT32_MAX": "2147483647", "UINT32_MAX": "4294967295u",
    "INT_MIN": "(-2147483647-1)", "INT_MAX": "2147483647", "UINT_MAX": "4294967295u",
}  # fmt: skip


@dataclass(frozen=True)
class CSource:
    """The text that the parser reads, and the names of the files that it would include in quotes."""

    text: str
    included: tuple[str, ...] = ()


@dataclass(eq=False)
class _Preprocessor:
    findings: Findings
    file: str
    macros: dict[str, str] = field(default_factory=lambda: dict(KNOWN_MACROS))
    included: list[str] = field(default_factory=list)
    # of each open #if: whether its lines count now, and whether one of its parts has counted
    open: list[tuple[bool, bool]] = field(default_factory=list)

    def lines(self, text: str) -> Iterator[str]:
        """Yield each line as the parser sees it; lines of directives are empty, so that numbers stay."""
        for number, line in enumerate(text.split("\n"), 1):
            if line.lstrip().startswith("#"):
                match = _DIRECTIVE.match(line)
                assert match is not None
                self._directive(match[1], match[2].strip(), number)
                yield ""
            else:
                yield self._expand(line, number) if self._counts else ""
        if self.open:
            self._error(0, "#if without #endif", "Add #endif.")

    @property
    def _counts(self) -> bool:
        return all(counts for counts, _ in self.open)

    def _error(self, number: int, message: str, remedy: str) -> None:
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
            return (rest in self.macros) == (word == "ifdef")
        if match := _DEFINED.match(rest):
            return (match[2] in self.macros) != (match[1] == "!")
        value = self._expand(rest, number).strip()
        if re.fullmatch(r"\d{1,18}", value):
            return int(value) != 0
        self._error(number, f"#if {rest[:60]} is not supported", "Use #ifdef, #if 0 or #if 1.")
        return False

    def _active(self, word: str, rest: str, number: int) -> None:
        if word == "include":
            if rest.startswith('"'):
                self.included.append(rest.strip('"'))
        elif word == "define":
            self._define(rest, number)
        elif word == "undef":
            self.macros.pop(rest, None)
        elif word == "error":
            self._error(number, f"#error {rest[:80]}", "Define what it asks for.")
        elif word not in ("pragma", "line", ""):
            self._error(number, f"unknown directive #{word}", "Remove it.")

    def _define(self, rest: str, number: int) -> None:
        match = _DEFINE.match(rest)
        if match is None:
            self._error(number, "#define without a name", "Write #define NAME value.")
        elif match[2] is not None:
            self._error(number, f"the macro {match[1]} has arguments", "Write it as a static inline function.")
        else:
            self.macros[match[1]] = match[3]

    def _expand(self, line: str, number: int) -> str:
        for _ in range(_MAX_EXPANSIONS):
            expanded = _NAME.sub(lambda match: self.macros.get(match[0], match[0]), line)
            if expanded == line:
                return line
            line = expanded
            if len(line) > _MAX_LINE:
                break
        self._error(number, "a macro expands without end", "Macros must not contain themselves.")
        return ""


def preprocess(text: str, file: str, findings: Findings) -> CSource:
    """Return the text without comments and directives, with macros replaced; lines keep their numbers.

    Includes are not executed: the names of `math.h`, `stdint.h`, `stdbool.h` and `float.h` are known.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    text = _joined(text)
    plain = _PARTS.sub(lambda m: m[0] if m[0][0] in "\"'" else " " + "\n" * m[0].count("\n"), text)
    preprocessor = _Preprocessor(findings, file)
    lines = list(preprocessor.lines(plain))
    typedefs = "".join(f"typedef int {name}; " for name in KNOWN_TYPES)
    name = re.sub(r'["\\\n]', "_", file)
    body = _IGNORED.sub("", "\n".join(lines))
    return CSource(f'{typedefs}\n# 1 "{name}"\n{body}\n', tuple(preprocessor.included))


def _joined(text: str) -> str:
    """Join lines that end with a backslash; empty lines keep the numbers of those that follow."""
    result: list[str] = []
    waiting = 0
    for line in text.split("\n"):
        if waiting:
            result[-1] = result[-1][:-1] + " " + line
        else:
            result.append(line)
        if line.endswith("\\"):
            waiting += 1
        else:
            result += [""] * waiting
            waiting = 0
    return "\n".join(result)
