"""Functions of texts."""

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.matlab.functions.numeric_registry import (
    MANY,
    NUMERIC_FUNCTIONS,
    NumericArguments,
    NumericFunction,
    function,
)
from kennfeld.matlab.values import (
    MatlabCell,
    MatlabValueError,
    Value,
    characters,
    class_name,
    logical,
    numbers,
    object_array,
    row,
    strings,
    text,
)

__all__: list[str] = []

_FORMAT = re.compile(r"%(?:%|([-+ 0#]*)(\*|\d+)?(?:\.(\d+))?l?([diufeEgGxXoscaA]))")
_ESCAPES = {"\\n": "\n", "\\t": "\t", "\\r": "\r", "\\\\": "\\", "\\a": "\a", "\\f": "\f", "\\v": "\v"}
_WIDEST = 500


def _is_text(value: Value) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "UO"


def _over_texts(value: Value, change: Callable[[str], str]) -> Value:
    """Each text of a value changed: of a row of characters, of strings, of a cell array."""
    if isinstance(value, MatlabCell):
        parts = [characters(change(text(one))) for one in value.values.ravel(order="F")]
        return MatlabCell(object_array(parts, value.values.shape))
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return object_array([change(str(one)) for one in value.ravel(order="F")], value.shape)
    return characters(change(text(value)))


def _compared(same: Callable[[str, str, int], bool]) -> Callable[[NumericArguments], Value]:
    def run(given: NumericArguments) -> Value:
        count = given.whole(2, 0)
        sides = [_each_text(given[at]) for at in (0, 1)]
        if all(len(side) == 1 for side in sides) and not any(
            isinstance(value, MatlabCell) for value in given.values[:2]
        ):
            return logical(_both(sides[0][0], sides[1][0], count, same))
        longest = given.data(0 if len(sides[0]) >= len(sides[1]) else 1)
        if len(sides[0]) != len(sides[1]) and 1 not in (len(sides[0]), len(sides[1])):
            raise MatlabValueError("cell arrays of different sizes cannot be compared")
        pairs = [(sides[0][k % len(sides[0])], sides[1][k % len(sides[1])]) for k in range(longest.size)]
        shape = longest.shape if len(pairs) == longest.size else (1, len(pairs))
        return np.array([_both(a, b, count, same) for a, b in pairs], dtype=bool).reshape(shape, order="F")

    return run


def _both(one: str | None, other: str | None, count: int, same: Callable[[str, str, int], bool]) -> bool:
    return one is not None and other is not None and same(one, other, count)


def _each_text(value: Value) -> list[str | None]:
    """The texts of a value; None for what is none."""
    if isinstance(value, MatlabCell):
        return [text(one) if _is_text(one) else None for one in value.values.ravel(order="F")]
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return [str(one) for one in value.ravel(order="F")]
    return [text(value) if _is_text(value) and np.asarray(value).shape[0] < 2 else None]


for _name, _same in {
    "strcmp": lambda a, b, n: a == b,
    "strcmpi": lambda a, b, n: a.casefold() == b.casefold(),
    "strncmp": lambda a, b, n: len(a) >= n and len(b) >= n and a[:n] == b[:n],
    "strncmpi": lambda a, b, n: len(a) >= n and len(b) >= n and a[:n].casefold() == b[:n].casefold(),
}.items():
    _count = 3 if _name.startswith("strn") else 2
    NUMERIC_FUNCTIONS[_name] = NumericFunction(_compared(_same), _count, _count)


def _asked(test: Callable[[str, str], bool]) -> Callable[[NumericArguments], Value]:
    def run(given: NumericArguments) -> Value:
        wanted = [one for one in _each_text(given[1]) if one is not None]
        found = [any(test(one or "", word) for word in wanted) for one in _each_text(given[0])]
        return np.array(found, dtype=bool).reshape(given.data(0).shape if len(found) > 1 else (1, 1))

    return run


for _name, _test in {
    "contains": lambda one, word: word in one,
    "startsWith": lambda one, word: one.startswith(word),
    "endsWith": lambda one, word: one.endswith(word),
}.items():
    NUMERIC_FUNCTIONS[_name] = NumericFunction(_asked(_test), 2, 2)


@function("upper toupper", 1)
def _upper(given: NumericArguments) -> Value:
    return _over_texts(given[0], str.upper)


@function("lower tolower", 1)
def _lower(given: NumericArguments) -> Value:
    return _over_texts(given[0], str.lower)


@function("strtrim strip", 1)
def _strtrim(given: NumericArguments) -> Value:
    return _over_texts(given[0], str.strip)


@function("deblank", 1)
def _deblank(given: NumericArguments) -> Value:
    return _over_texts(given[0], str.rstrip)


@function("strrep", 3)
def _strrep(given: NumericArguments) -> Value:
    old, new = given.text(1), given.text(2)

    def change(word: str) -> str:
        given.budget.make(len(word) + (word.count(old) * len(new) if old else 0))
        return word.replace(old, new) if old else word

    return _over_texts(given[0], change)


@function("strfind", 2)
def _strfind(given: NumericArguments) -> Value:
    word, wanted = given.text(0), given.text(1)
    found = [at + 1 for at in range(len(word)) if wanted and word.startswith(wanted, at)]
    return row(found) if found else np.zeros((0, 0))


@function("strcat", 1, MANY)
def _strcat(given: NumericArguments) -> Value:
    if any(isinstance(value, MatlabCell) for value in given.values):
        each = [_each_text(value) for value in given.values]
        most = max(map(len, each))
        made = ["".join(one[k % len(one)] or "" for one in each) for k in range(most)]
        return MatlabCell(object_array([characters(one) for one in made], (1, most)))
    if any(class_name(value) == "string" for value in given.values):
        return strings(["".join(text(value) for value in given.values)])
    return characters("".join(text(value).rstrip(" \t\n\v\f\r") for value in given.values))


@function("strsplit split", 1, 2)
def _strsplit(given: NumericArguments) -> Value:
    by = given.text(1) if len(given) > 1 else " "
    if not by:
        raise MatlabValueError("there is nothing to split by")
    found = given.text(0).split(_escaped(by))
    return MatlabCell(object_array([characters(one) for one in found], (1, len(found))))


@function("strjoin join", 1, 2)
def _strjoin(given: NumericArguments) -> Value:
    by = _escaped(given.text(1)) if len(given) > 1 else " "
    return characters(by.join(one or "" for one in _each_text(given[0])))


@function("blanks", 1)
def _blanks(given: NumericArguments) -> Value:
    given.budget.make(given.whole(0))
    return characters(" " * given.whole(0))


@function("num2str", 1, 2)
def _num2str(given: NumericArguments) -> Value:
    if given.is_text(0):
        return given[0]
    values = given.numbers(0)
    if given.is_text(1):
        return characters(_printed(given.text(1), [given[0]], given).rstrip())
    digits = given.whole(1) if len(given) > 1 else None
    lines = ["  ".join(_short(one, digits) for one in line) for line in values.tolist()] if values.ndim == 2 else []
    widest = max(map(len, lines), default=0)
    return np.array([list(line.rjust(widest)) for line in lines], dtype="U1").reshape(len(lines), widest)


def _short(value: float, digits: int | None) -> str:
    if math.isnan(value) or math.isinf(value):
        return "NaN" if math.isnan(value) else "Inf" if value > 0 else "-Inf"
    if digits is None and value == math.floor(value) and abs(value) < 1e15:
        return f"{value:.0f}"
    if digits is None:
        digits = max(math.floor(math.log10(abs(value))) + 5, 5) if value else 5
    return f"{value:.{min(max(digits, 1), 16)}g}"


@function("int2str", 1)
def _int2str(given: NumericArguments) -> Value:
    rounded = np.trunc(given.numbers(0) + np.copysign(0.5, given.numbers(0)))
    return characters("  ".join(f"{one:.0f}" for one in rounded.ravel(order="F")))


@function("mat2str", 1, 2)
def _mat2str(given: NumericArguments) -> Value:
    digits = min(max(given.whole(1, 15), 1), 17)
    array = given.array(0)
    if array.dtype.kind == "U":
        return characters("'" + given.text(0).replace("'", "''") + "'")
    if array.ndim > 2:
        raise MatlabValueError("mat2str is for arrays of two dimensions")
    is_logical = array.dtype == np.bool_
    words = [
        [("true" if one else "false") if is_logical else _short(float(one), digits) for one in line] for line in array
    ]
    made = ";".join(" ".join(line) for line in words)
    return characters(made if array.size == 1 else f"[{made}]" if array.size else "zeros({},{})".format(*array.shape))


@function("sprintf", 1, MANY)
def _sprintf(given: NumericArguments) -> Value:
    made = _printed(given.text(0), given.values[1:], given)
    return strings([made]) if class_name(given[0]) == "string" else characters(made)


def _escaped(word: str) -> str:
    return re.sub(r"\\[ntrafv\\]", lambda found: _ESCAPES[found[0]], word)


def _flat(values: Sequence[Value]) -> list[Any]:
    """Texts and numbers one after the other."""
    found: list[Any] = []
    for value in values:
        if isinstance(value, MatlabCell):
            raise MatlabValueError("a cell array cannot be printed")
        if _is_text(value):
            found.append(text(value))
        else:
            found += numbers(value).ravel(order="F").tolist()
    return found


def _printed(pattern: str, values: Sequence[Value], given: NumericArguments) -> str:
    """The pattern filled in, over again while values are left."""
    waiting, pattern = _flat(values), _escaped(pattern)
    slots = [found for found in _FORMAT.finditer(pattern) if found[4]]
    made = ""
    while True:
        before = len(waiting)
        part = _once(pattern, waiting, bool(values))
        made += part
        given.budget.make(len(part) + 10)
        if not waiting or not slots or len(waiting) == before:
            return made


def _once(pattern: str, waiting: list[Any], has_values: bool) -> str:
    made, at = "", 0
    for found in _FORMAT.finditer(pattern):
        made += pattern[at : found.start()]
        at = found.end()
        if not found[4]:
            made += "%"
        elif found[2] == "*" or int(found[2] or 0) > _WIDEST or int(found[3] or 0) > _WIDEST:
            raise MatlabValueError(f"the width of {found[0]} is not known")
        elif not waiting and has_values:
            return made
        else:
            made += _conversion(found, waiting.pop(0) if waiting else "")
    return made + pattern[at:]


def _conversion(found: re.Match[str], value: Any) -> str:
    flags, width, digits, kind = found[1], found[2] or "", found[3], found[4]
    if isinstance(value, str):
        value = value[: int(digits)] if digits and kind == "s" else value
        return f"{value:{'<' if '-' in flags else '>'}{width}}" if width else value
    if kind == "c" and value == math.floor(value) and 0 <= value < 0x110000:
        return chr(int(value))
    if math.isnan(value) or math.isinf(value):
        return f"{_short(value, None):{'<' if '-' in flags else '>'}{width or 0}}"
    if kind in "diuxXo" and value == math.floor(value):
        return str(f"%{flags}{width}{'d' if kind in 'iu' else kind}" % int(value))
    if kind in "diuxXosc":
        kind = "f" if kind not in "sc" and digits else "g" if kind in "sc" else "e"
    return str(f"%{flags}{width}{'.' + digits if digits else ''}{kind}" % value)


@function("char", 1)
def _char(given: NumericArguments) -> Value:
    value = given[0]
    if isinstance(value, MatlabCell):
        words = [text(one) for one in value.values.ravel(order="F")]
        widest = max(map(len, words), default=0)
        given.budget.make(widest * len(words))
        return np.array([list(word.ljust(widest)) for word in words], dtype="U1").reshape(len(words), widest)
    if _is_text(value):
        return value if class_name(value) == "char" else characters(text(value))
    codes = numbers(value)
    if not ((codes >= 0) & (codes < 0x110000) & (codes == np.floor(codes))).all():
        raise MatlabValueError("a number is the code of no character")
    made = np.array([chr(int(code)) for code in codes.ravel(order="F")], dtype="U1")
    return made.reshape(codes.shape, order="F")


@function("cellstr", 1)
def _cellstr(given: NumericArguments) -> Value:
    if isinstance(given[0], MatlabCell):
        return given[0]
    lines = ["".join(line).rstrip() for line in given.array(0).tolist()]
    return MatlabCell(object_array([characters(line) for line in lines], (len(lines), 1)))


@function("string", 1)
def _string(given: NumericArguments) -> Value:
    value = given[0]
    if isinstance(value, MatlabCell):
        return object_array([text(one) for one in value.values.ravel(order="F")], value.values.shape)
    if _is_text(value):
        return strings([text(value)]) if class_name(value) == "char" else value
    words = [_short(one, None) for one in numbers(value).ravel(order="F").tolist()]
    return object_array(words, given.array(0).shape)


@function("isspace", 1)
def _isspace(given: NumericArguments) -> Value:
    array = given.array(0)
    return np.array([str(one).isspace() for one in array.ravel(order="F")], dtype=bool).reshape(array.shape, order="F")


@function("strlength", 1)
def _strlength(given: NumericArguments) -> Value:
    return np.array([[float(len(given.text(0)))]])


@function("newline", 0)
def _newline(given: NumericArguments) -> Value:
    return characters("\n")
