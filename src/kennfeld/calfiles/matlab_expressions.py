"""The value of the right side of an assignment in a MATLAB script: numbers, texts and what is made of them.

Nothing is executed: an expression that is not made of numbers, of variables assigned before, and of a few functions
such as `reshape` and `linspace` has no value here.
"""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.matlab_tokens import BadSyntaxError, Token
from kennfeld.calfiles.matlab_values import Struct, Value

__all__ = ["Lookup", "value_of"]

Lookup = Callable[[str], "Value | None"]
_CONSTANTS = {"pi": np.pi, "inf": np.inf, "Inf": np.inf, "nan": np.nan, "NaN": np.nan, "true": 1.0, "false": 0.0}
_CONSTANTS |= {"eps": float(np.finfo(np.float64).eps)}
_INTEGERS = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_TYPES = frozenset({"double", "single", "logical", "boolean", *_INTEGERS})
_OBJECTS = frozenset({"Parameter", "Signal", "LookupTable", "Breakpoint", "struct"})
_MOST = 10_000_000  # values of an array


def value_of(tokens: Sequence[Token], lookup: Lookup) -> Value:
    """The value of an expression; raises `BadSyntaxError` where it has none."""
    parser = _Parser(tokens, lookup)
    with np.errstate(all="ignore"):
        value = parser.range()
    if parser.at < len(tokens):
        raise BadSyntaxError
    return value


def _scalar(number: float) -> Float:
    return np.array([[number]])


class _Parser:
    def __init__(self, tokens: Sequence[Token], lookup: Lookup) -> None:
        self.tokens = tokens
        self.lookup = lookup
        self.at = 0
        self.brackets = False  # within brackets, where blanks part elements

    def _peek(self) -> Token | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def _take(self) -> Token:
        token = self._peek()
        if token is None:
            raise BadSyntaxError
        self.at += 1
        return token

    def _is(self, *words: str) -> bool:
        token = self._peek()
        return token is not None and token.kind == "operator" and token.text in words

    def _expect(self, word: str) -> None:
        if not self._is(word):
            raise BadSyntaxError
        self.at += 1

    def range(self) -> Value:
        """`first:last`, `first:step:last`, or just an expression."""
        first = self._sum()
        if not self._is(":"):
            return first
        parts = [_number(first)]
        while self._is(":") and len(parts) < 3:
            self.at += 1
            parts.append(_number(self._sum()))
        begin, step, end = (parts[0], 1.0, parts[1]) if len(parts) == 2 else parts
        steps = (end - begin) / step if step else -1.0
        if not -1.0 <= steps < _MOST:
            raise BadSyntaxError
        return (begin + step * np.arange(np.floor(steps + 1e-10) + 1)).reshape(1, -1)

    def _sum(self) -> Value:
        left = self._product()
        while self._is("+", "-") and not self._begins_element():
            sign = self._take().text
            right = self._product()
            left = _combined(np.add if sign == "+" else np.subtract, left, right)
        return left

    def _begins_element(self) -> bool:
        """Whether a sign within brackets belongs to the next element: [1 -2]."""
        token, after = self.tokens[self.at], self.tokens[self.at + 1 : self.at + 2]
        return self.brackets and token.blank and bool(after) and not after[0].blank

    def _product(self) -> Value:
        left = self._signed()
        while self._is("*", "/", ".*", "./"):
            sign = self._take().text
            right = self._signed()
            if "." not in sign and not _simple(left, right, division=sign == "/"):
                raise BadSyntaxError  # the product of matrices is none of their elements
            left = _combined(np.multiply if "*" in sign else np.divide, left, right)
        return left

    def _signed(self) -> Value:
        signs = 0
        negative = False
        while self._is("+", "-"):
            negative ^= self._take().text == "-"
            signs += 1
            if signs > 20:
                raise BadSyntaxError
        value = self._power()
        return -_array(value) if negative else value

    def _power(self) -> Value:
        left = self._postfix()
        while self._is("^", ".^"):
            word = self._take().text
            negative = self._is("-")
            self.at += negative
            right = self._postfix()
            if word == "^" and (_array(left).size > 1 or _array(right).size > 1):
                raise BadSyntaxError
            left = _combined(np.power, left, -_array(right) if negative else right)
        return left

    def _postfix(self) -> Value:
        value = self._atom()
        while self._is("'", ".'"):
            array = _array(value)
            if array.ndim > 2:
                raise BadSyntaxError
            value = array.T
            self.at += 1
        return value

    def _atom(self) -> Value:
        token = self._take()
        if token.kind == "number":
            return _scalar(float(token.text.lower().replace("d", "e")))
        if token.kind == "string":
            return token.text
        if token.kind == "matrix" and token.value is not None:
            return token.value
        if token.kind == "name":
            return self._named(token.text)
        if token.text == "(":
            before, self.brackets = self.brackets, False
            value = self.range()
            self._expect(")")
            self.brackets = before
            return value
        if token.text in ("[", "{"):
            rows = self._rows("]" if token.text == "[" else "}")
            return _joined(rows) if token.text == "[" else [value for row in rows for value in row]
        raise BadSyntaxError

    def _rows(self, end: str) -> list[list[Value]]:
        before, self.brackets = self.brackets, True
        rows: list[list[Value]] = [[]]
        while not self._is(end):
            token = self._peek()
            if token is None:
                raise BadSyntaxError
            if token.kind == "newline":
                self.at += 1
                if token.text == ";":
                    rows.append([])
            elif self._is(","):
                self.at += 1
            else:
                rows[-1].append(self.range())
        self._expect(end)
        self.brackets = before
        return [row for row in rows if row]

    def _named(self, name: str) -> Value:
        path = name
        while self._is(".") and self.at + 1 < len(self.tokens) and self.tokens[self.at + 1].kind == "name":
            path += "." + self.tokens[self.at + 1].text
            self.at += 2
        known = self.lookup(path)
        if known is not None and not self._is("("):
            return known
        arguments = self._arguments() if self._is("(") and not (self.brackets and self.tokens[self.at].blank) else None
        if arguments is None and path in _CONSTANTS:
            return _scalar(_CONSTANTS[path])
        if known is not None:
            raise BadSyntaxError  # an element of a variable
        return _called(path, arguments)

    def _arguments(self) -> list[Value]:
        before, self.brackets = self.brackets, False
        self._expect("(")
        found: list[Value] = []
        while not self._is(")"):
            found.append(self.range())
            if self._is(","):
                self.at += 1
            elif not self._is(")"):
                raise BadSyntaxError
        self._expect(")")
        self.brackets = before
        return found


def _array(value: Value) -> Float:
    if not isinstance(value, np.ndarray):
        raise BadSyntaxError
    return value


def _number(value: Value) -> float:
    array = _array(value)
    if array.size != 1 or not np.isfinite(array).all():
        raise BadSyntaxError
    return float(array.ravel()[0])


def _simple(left: Value, right: Value, division: bool) -> bool:
    """Whether the product of two values is that of their elements."""
    return _array(right).size == 1 or (not division and _array(left).size == 1)


def _combined(operation: Callable[[Float, Float], Float], left: Value, right: Value) -> Float:
    one, other = _array(left), _array(right)
    if one.size != 1 and other.size != 1 and one.shape != other.shape:
        raise BadSyntaxError
    return operation(one, other)


def _joined(rows: list[list[Value]]) -> Value:
    """Arrays or texts side by side and below each other."""
    if rows and all(isinstance(value, str) for row in rows for value in row):
        if len(rows) > 1:
            raise BadSyntaxError
        return "".join(str(value) for value in rows[0])
    if sum(_array(value).size for row in rows for value in row) > _MOST:
        raise BadSyntaxError
    try:
        made = [np.hstack([_array(value) for value in row]) for row in rows]
        filled = [row for row in made if row.size] or made
        return np.vstack(filled) if filled else np.zeros((0, 0))
    except ValueError:
        raise BadSyntaxError from None


def _called(name: str, arguments: list[Value] | None) -> Value:
    given = arguments or []
    if name.rpartition(".")[2] in _OBJECTS and (name == "struct" or "." in name):
        return _object(name, given)
    if name in _TYPES and len(given) == 1:
        return _array(given[0])
    if name == "char" and len(given) == 1:
        return _characters(_array(given[0]))
    if name == "transpose" and len(given) == 1 and _array(given[0]).ndim == 2:
        return _array(given[0]).T
    if name == "reshape" and len(given) > 1:
        return _reshaped(_array(given[0]), given[1:])
    if name in ("zeros", "ones") and given:
        return np.full(_sizes(given), 1.0 if name == "ones" else 0.0)
    if name == "linspace" and len(given) in (2, 3):
        count = _number(given[2]) if len(given) == 3 else 100.0
        if not 1 <= count <= _MOST:
            raise BadSyntaxError
        return np.linspace(_number(given[0]), _number(given[1]), int(count)).reshape(1, -1)
    raise BadSyntaxError


def _object(name: str, arguments: list[Value]) -> Struct:
    """A struct by its constructor, or an object such as Simulink.Parameter(5), which is read like one."""
    if name != "struct":
        if len(arguments) > 1:
            raise BadSyntaxError
        return Struct({"Value": arguments[0]} if arguments else {})
    keys, values = arguments[::2], arguments[1::2]
    if len(keys) != len(values) or not all(isinstance(key, str) for key in keys):
        raise BadSyntaxError
    return Struct({str(key): value for key, value in zip(keys, values, strict=True)})


def _characters(codes: Float) -> str:
    if not all(number == int(number) and 0 <= number < 0x110000 for number in codes.ravel().tolist()):
        raise BadSyntaxError
    return "".join(map(chr, map(int, codes.ravel().tolist())))


def _sizes(given: Sequence[Value]) -> tuple[int, ...]:
    numbers = _array(given[0]).ravel().tolist() if len(given) == 1 else [_number(one) for one in given]
    if len(numbers) == 1 and len(given) == 1:
        numbers *= 2
    if not all(np.isfinite(number) and number == int(number) and number >= 0 for number in numbers):
        raise BadSyntaxError
    if not 2 <= len(numbers) <= 10 or np.prod(np.array(numbers, dtype=np.float64)) > _MOST:
        raise BadSyntaxError
    return tuple(map(int, numbers))


def _reshaped(array: Float, sizes: Sequence[Value]) -> Float:
    try:
        return array.reshape(_sizes(sizes), order="F")
    except ValueError:
        raise BadSyntaxError from None
