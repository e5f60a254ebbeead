"""Functions of character arrays and strings."""

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.matlab import values as v
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, Run, function
from kennfeld.matlab.operators import round_half_away

__all__: list[str] = []

_FORMAT = re.compile(r"%(?:%|([-+ 0#]*)(\*|\d+)?(?:\.(\d+))?l?([diufeEgGxXoscaA]))")
_ESCAPES = {"\\n": "\n", "\\t": "\t", "\\r": "\r", "\\\\": "\\", "\\a": "\a", "\\f": "\f", "\\v": "\v"}
_MAX_WIDTH = 500


def _over_texts(value: v.Value, change: Callable[[str], str]) -> v.Value:
    """Apply a change to each text of a row of characters, a string array or a cell array."""
    if isinstance(value, v.MatlabCell):
        parts = [v.characters(change(v.text(element))) for element in value.values.ravel(order="F")]
        return v.MatlabCell(v.object_array(parts, value.values.shape))
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return v.object_array([change(str(element)) for element in value.ravel(order="F")], value.shape)
    return v.characters(change(v.text(value)))


def _comparison(same: Callable[[str, str, int], bool]) -> Run:
    def run(call: NumericArguments) -> v.Value:
        count = call.integer(2, 0)
        sides = [_each_text(call[at]) for at in (0, 1)]
        if all(len(side) == 1 for side in sides) and not any(
            isinstance(value, v.MatlabCell) for value in call.values[:2]
        ):
            return v.logical(_equal_texts(sides[0][0], sides[1][0], count, same))
        longest = call.data(0 if len(sides[0]) >= len(sides[1]) else 1)
        if len(sides[0]) != len(sides[1]) and 1 not in (len(sides[0]), len(sides[1])):
            raise v.MatlabValueError("cell arrays of different sizes cannot be compared")
        pairs = [(sides[0][k % len(sides[0])], sides[1][k % len(sides[1])]) for k in range(longest.size)]
        shape = longest.shape if len(pairs) == longest.size else (1, len(pairs))
        return np.array([_equal_texts(a, b, count, same) for a, b in pairs], dtype=bool).reshape(shape, order="F")

    return run


def _equal_texts(left: str | None, right: str | None, count: int, same: Callable[[str, str, int], bool]) -> bool:
    return left is not None and right is not None and same(left, right, count)


def _each_text(value: v.Value) -> list[str | None]:
    """Return the texts of a value; None for elements that are not text."""
    if isinstance(value, v.MatlabCell):
        return [v.text(element) if v.is_text(element) else None for element in value.values.ravel(order="F")]
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return [str(element) for element in value.ravel(order="F")]
    return [v.text(value) if v.is_text(value) and np.asarray(value).shape[0] < 2 else None]


for _name, _same in {
    "strcmp": lambda a, b, n: a == b,
    "strcmpi": lambda a, b, n: a.casefold() == b.casefold(),
    "strncmp": lambda a, b, n: len(a) >= n and len(b) >= n and a[:n] == b[:n],
    "strncmpi": lambda a, b, n: len(a) >= n and len(b) >= n and a[:n].casefold() == b[:n].casefold(),
}.items():
    function(_name, 3 if _name.startswith("strn") else 2)(_comparison(_same))


def _pattern_test(test: Callable[[str, str], bool]) -> Run:
    def run(call: NumericArguments) -> v.Value:
        patterns = [item for item in _each_text(call[1]) if item is not None]
        results = [any(test(item or "", word) for word in patterns) for item in _each_text(call[0])]
        return np.array(results, dtype=bool).reshape(call.data(0).shape if len(results) > 1 else (1, 1))

    return run


for _name, _test in {
    "contains": lambda item, word: word in item,
    "startsWith": lambda item, word: item.startswith(word),
    "endsWith": lambda item, word: item.endswith(word),
}.items():
    function(_name, 2)(_pattern_test(_test))


def _register_change(names: str, change: Callable[[str], str]) -> None:
    function(names, 1)(lambda call: _over_texts(call[0], change))


_register_change("upper toupper", str.upper)
_register_change("lower tolower", str.lower)
_register_change("strtrim strip", str.strip)
_register_change("deblank", str.rstrip)


@function("strrep", 3)
def _strrep(call: NumericArguments) -> v.Value:
    old, new = call.text(1), call.text(2)

    def change(word: str) -> str:
        call.budget.allocate(len(word) + (word.count(old) * len(new) if old else 0))
        return word.replace(old, new) if old else word

    return _over_texts(call[0], change)


@function("strfind", 2)
def _strfind(call: NumericArguments) -> v.Value:
    word, pattern = call.text(0), call.text(1)
    positions = [at + 1 for at in range(len(word)) if pattern and word.startswith(pattern, at)]
    return v.row(positions) if positions else np.zeros((0, 0))


@function("strcat", 1, MANY)
def _strcat(call: NumericArguments) -> v.Value:
    if any(isinstance(value, v.MatlabCell) for value in call.values):
        each = [_each_text(value) for value in call.values]
        longest = max(map(len, each))
        words = ["".join(texts[k % len(texts)] or "" for texts in each) for k in range(longest)]
        return v.MatlabCell(v.object_array([v.characters(texts) for texts in words], (1, longest)))
    if any(v.class_name(value) == "string" for value in call.values):
        return v.strings(["".join(v.text(value) for value in call.values)])
    return v.characters("".join(v.text(value).rstrip(" \t\n\v\f\r") for value in call.values))


@function("strsplit split", 1, 2)
def _strsplit(call: NumericArguments) -> v.Value:
    delimiter = call.text(1) if len(call) > 1 else " "
    if not delimiter:
        raise v.MatlabValueError("the delimiter must not be empty")
    words = call.text(0).split(_unescape(delimiter))
    return v.MatlabCell(v.object_array([v.characters(word) for word in words], (1, len(words))))


@function("strjoin join", 1, 2)
def _strjoin(call: NumericArguments) -> v.Value:
    delimiter = _unescape(call.text(1)) if len(call) > 1 else " "
    return v.characters(delimiter.join(word or "" for word in _each_text(call[0])))


@function("fullfile", 1, MANY)
def _fullfile(call: NumericArguments) -> v.Value:
    parts = [call.text(at).replace("\\", "/") for at in range(len(call))]
    joined = "/".join(part for part in parts if part)
    return v.characters(re.sub(r"(?<!^)/+", "/", joined))


@function("filesep", 0)
def _filesep(call: NumericArguments) -> v.Value:
    return v.characters("/")


@function("fileparts", 1)
def _fileparts(call: NumericArguments) -> tuple[v.Value, ...]:
    folder, _, file = call.text(0).replace("\\", "/").rpartition("/")
    name, dot, ending = file.rpartition(".")
    parts = (folder, name, dot + ending) if dot else (folder, file, "")
    return tuple(map(v.characters, parts))


@function("mfilename", 1)
def _mfilename(call: NumericArguments) -> v.Value:
    if call.text(0) != "fullpath":
        raise v.MatlabValueError("mfilename is supported with 'fullpath' only")
    # paths are relative to the folder of the script
    return v.characters("./mfilename")


@function("blanks", 1)
def _blanks(call: NumericArguments) -> v.Value:
    call.budget.allocate(call.integer(0))
    return v.characters(" " * call.integer(0))


@function("num2str", 1, 2)
def _num2str(call: NumericArguments) -> v.Value:
    if call.is_text(0):
        return call[0]
    values = call.numbers(0)
    if call.is_text(1):
        return v.characters(_format_values(call.text(1), [call[0]], call).rstrip())
    digits = call.integer(1) if len(call) > 1 else None
    rows = values.tolist() if values.ndim == 2 else []
    lines = ["  ".join(_format_number(number, digits) for number in line) for line in rows]
    widest = max(map(len, lines), default=0)
    return np.array([list(line.rjust(widest)) for line in lines], dtype="U1").reshape(len(lines), widest)


def _format_number(value: float, digits: int | None) -> str:
    if math.isnan(value) or math.isinf(value):
        return "NaN" if math.isnan(value) else "Inf" if value > 0 else "-Inf"
    if digits is None and value == math.floor(value) and abs(value) < 1e15:
        return f"{value:.0f}"
    if digits is None:
        digits = max(math.floor(math.log10(abs(value))) + 5, 5) if value else 5
    return f"{value:.{min(max(digits, 1), 16)}g}"


@function("int2str", 1)
def _int2str(call: NumericArguments) -> v.Value:
    rounded = round_half_away(call.numbers(0)).ravel(order="F")
    return v.characters("  ".join(f"{number:.0f}" for number in rounded))


@function("mat2str", 1, 2)
def _mat2str(call: NumericArguments) -> v.Value:
    digits = min(max(call.integer(1, 15), 1), 17)
    array = call.array(0)
    if array.dtype.kind == "U":
        return v.characters("'" + call.text(0).replace("'", "''") + "'")
    if array.ndim > 2:
        raise v.MatlabValueError("mat2str requires a two-dimensional array")
    is_logical = array.dtype == np.bool_
    if not array.size:
        return v.characters("zeros({},{})".format(*array.shape))
    words = [[str(bool(x)).lower() if is_logical else _format_number(float(x), digits) for x in line] for line in array]
    result = ";".join(" ".join(line) for line in words)
    return v.characters(result if array.size == 1 else f"[{result}]")


@function("sprintf", 1, MANY)
def _sprintf(call: NumericArguments) -> v.Value:
    result = _format_values(call.text(0), call.values[1:], call)
    return v.strings([result]) if v.class_name(call[0]) == "string" else v.characters(result)


def _unescape(word: str) -> str:
    return re.sub(r"\\[ntrafv\\]", lambda match: _ESCAPES[match[0]], word)


def _flatten(values: Sequence[v.Value]) -> list[Any]:
    """Return texts and numbers as one list."""
    items: list[Any] = []
    for value in values:
        if isinstance(value, v.MatlabCell):
            raise v.MatlabValueError("a cell array cannot be printed")
        if v.is_text(value):
            items.append(v.text(value))
        else:
            items += v.numbers(value).ravel(order="F").tolist()
    return items


def _format_values(pattern: str, values: Sequence[v.Value], call: NumericArguments) -> str:
    """Fill a format pattern, repeatedly while values remain."""
    waiting, pattern = _flatten(values), _unescape(pattern)
    slots = [match for match in _FORMAT.finditer(pattern) if match[4]]
    result = ""
    while True:
        before = len(waiting)
        part = _format_once(pattern, waiting, bool(values))
        result += part
        call.budget.allocate(len(part) + 10)
        if not waiting or not slots or len(waiting) == before:
            return result


def _format_once(pattern: str, waiting: list[Any], has_values: bool) -> str:
    result, at = "", 0
    for match in _FORMAT.finditer(pattern):
        result += pattern[at : match.start()]
        at = match.end()
        if not match[4]:
            result += "%"
        elif match[2] == "*" or int(match[2] or 0) > _MAX_WIDTH or int(match[3] or 0) > _MAX_WIDTH:
            raise v.MatlabValueError(f"the width of {match[0]} is not supported")
        elif not waiting and has_values:
            return result
        else:
            result += _conversion(match, waiting.pop(0) if waiting else "")
    return result + pattern[at:]


def _conversion(match: re.Match[str], value: Any) -> str:
    flags, width, digits, kind = match[1], match[2] or "", match[3], match[4]
    if isinstance(value, str):
        value = value[: int(digits)] if digits and kind == "s" else value
        return f"{value:{'<' if '-' in flags else '>'}{width}}" if width else value
    if kind == "c" and value == math.floor(value) and 0 <= value < 0x110000:
        return chr(int(value))
    if math.isnan(value) or math.isinf(value):
        return f"{_format_number(value, None):{'<' if '-' in flags else '>'}{width or 0}}"
    if kind in "diuxXo" and value == math.floor(value):
        return str(f"%{flags}{width}{'d' if kind in 'iu' else kind}" % int(value))
    if kind in "diuxXosc":
        kind = "f" if kind not in "sc" and digits else "g" if kind in "sc" else "e"
    return str(f"%{flags}{width}{'.' + digits if digits else ''}{kind}" % value)


@function("char", 1)
def _char(call: NumericArguments) -> v.Value:
    value = call[0]
    if isinstance(value, v.MatlabCell):
        words = [v.text(cell) for cell in value.values.ravel(order="F")]
        widest = max(map(len, words), default=0)
        call.budget.allocate(widest * len(words))
        return np.array([list(word.ljust(widest)) for word in words], dtype="U1").reshape(len(words), widest)
    if v.is_text(value):
        return value if v.class_name(value) == "char" else v.characters(v.text(value))
    codes = v.numbers(value)
    if not ((codes >= 0) & (codes < 0x110000) & (codes == np.floor(codes))).all():
        raise v.MatlabValueError("a number is not a character code")
    letters = np.array([chr(int(code)) for code in codes.ravel(order="F")], dtype="U1")
    return letters.reshape(codes.shape, order="F")


@function("cellstr", 1)
def _cellstr(call: NumericArguments) -> v.Value:
    if isinstance(call[0], v.MatlabCell):
        return call[0]
    lines = ["".join(line).rstrip() for line in call.array(0).tolist()]
    return v.MatlabCell(v.object_array([v.characters(line) for line in lines], (len(lines), 1)))


@function("string", 1)
def _string(call: NumericArguments) -> v.Value:
    value = call[0]
    if isinstance(value, v.MatlabCell):
        return v.object_array([v.text(element) for element in value.values.ravel(order="F")], value.values.shape)
    if v.is_text(value):
        return v.strings([v.text(value)]) if v.class_name(value) == "char" else value
    words = [_format_number(element, None) for element in v.numbers(value).ravel(order="F").tolist()]
    return v.object_array(words, call.array(0).shape)


@function("isspace", 1)
def _isspace(call: NumericArguments) -> v.Value:
    array = call.array(0)
    blank = [str(letter).isspace() for letter in array.ravel(order="F")]
    return np.array(blank, dtype=bool).reshape(array.shape, order="F")


function("strlength", 1)(lambda call: np.array([[float(len(call.text(0)))]]))
function("newline", 0)(lambda call: v.characters("\n"))
