"""Functions of each element alone."""

import math
from typing import Final

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function, matlab_word
from kennfeld.models.simulink.code.values import Held, Truths, constants, integers, of_class, truths
from kennfeld.models.simulink.expressions.arrays import each, towards_zero
from kennfeld.models.simulink.expressions.elementary import INVERSE_HYPERBOLIC, ONE, PLAIN, TWO, Rule
from kennfeld.models.simulink.expressions.signals import Nodes

_CASTS: Final = (
    "double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "fi", "half",
)  # fmt: skip
_DEGREES: Final = math.pi / 180


@function(*PLAIN)
def plain(given: Given) -> Held:
    """An operation of the graph."""
    return each(given.calls.loom, given.name, given.array(0))


@function(*_CASTS, most=5)
def cast(given: Given) -> Held:
    """The value as it is: values are physical, in double precision. Functions of bits see the integer type."""
    return integers(given.array(0), matlab_word(given.name))


@function("cast", least=2, most=3)
def cast_to(given: Given) -> Held:
    """The value as it is, as with the casts by name."""
    x = given.array(0)
    if given.held[1] == "like":
        return of_class(given.array(2), x)
    if given.text(1) not in (*_CASTS, "logical"):
        raise given.refuse(f"{given.text(1)!r} is not a class of numbers")
    if given.text(1) != "logical":
        return integers(x, matlab_word(given.text(1)))
    return truths(each(given.calls.loom, "ne", x, constants(given.calls.loom, 0.0)))


@function("real", "conj")
def same(given: Given) -> Held:
    """The value as a number: all numbers are real."""
    return np.asarray(given.array(0))


@function("full")
def full(given: Given) -> Held:
    """The value as it is: all arrays are full."""
    return given.array(0)


@function("logical", "boolean")
def logical(given: Given) -> Held:
    """Whether elements are not 0."""
    x = given.array(0)
    return x if isinstance(x, Truths) else truths(each(given.calls.loom, "ne", x, constants(given.calls.loom, 0.0)))


def _minus(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "sub", a, b)


def _times(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "mul", a, b)


def _over(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "div", a, b)


def _log1p(loom: Loom, x: Nodes) -> Nodes:
    return each(loom, "log", each(loom, "add", x, constants(loom, 1.0)))


def _expm1(loom: Loom, x: Nodes) -> Nodes:
    """By the hyperbolic tangent, which is exact near 0: 2 t / (1 - t), t = tanh(x/2)."""
    t = each(loom, "tanh", _times(loom, x, constants(loom, 0.5)))
    near = _over(loom, _times(loom, constants(loom, 2.0), t), _minus(loom, constants(loom, 1.0), t))
    far = _minus(loom, each(loom, "exp", x), constants(loom, 1.0))
    return each(loom, "select", each(loom, "lt", each(loom, "abs", x), constants(loom, 1.0)), near, far)


def _turned(loom: Loom, x: Nodes, turn: float) -> Nodes:
    """An angle from 0 to a whole turn; positive multiples of a turn stay one."""
    made = each(loom, "mod", x, constants(loom, turn))
    zero = constants(loom, 0.0)
    whole = each(loom, "and", each(loom, "eq", made, zero), each(loom, "gt", x, zero))
    return each(loom, "select", whole, constants(loom, turn), made)


def _wrapped(loom: Loom, x: Nodes, half: float) -> Nodes:
    """An angle within half a turn to both sides; those that are stay as they are."""
    made = _minus(loom, _turned(loom, each(loom, "add", x, constants(loom, half)), 2 * half), constants(loom, half))
    return each(loom, "select", each(loom, "gt", each(loom, "abs", x), constants(loom, half)), made, x)


_ONE: Final[dict[str, Rule]] = {
    **ONE,
    **INVERSE_HYPERBOLIC,
    "log2": lambda loom, x: _over(loom, each(loom, "log", x), constants(loom, math.log(2.0))),
    "log1p": _log1p,
    "expm1": _expm1,
    "sec": lambda loom, x: _over(loom, constants(loom, 1.0), each(loom, "cos", x)),
    "csc": lambda loom, x: _over(loom, constants(loom, 1.0), each(loom, "sin", x)),
    "cot": lambda loom, x: _over(loom, constants(loom, 1.0), each(loom, "tan", x)),
    "sind": lambda loom, x: each(loom, "sin", _times(loom, x, constants(loom, _DEGREES))),
    "cosd": lambda loom, x: each(loom, "cos", _times(loom, x, constants(loom, _DEGREES))),
    "tand": lambda loom, x: each(loom, "tan", _times(loom, x, constants(loom, _DEGREES))),
    "asind": lambda loom, x: _over(loom, each(loom, "asin", x), constants(loom, _DEGREES)),
    "acosd": lambda loom, x: _over(loom, each(loom, "acos", x), constants(loom, _DEGREES)),
    "atand": lambda loom, x: _over(loom, each(loom, "atan", x), constants(loom, _DEGREES)),
    "deg2rad": lambda loom, x: _times(loom, x, constants(loom, _DEGREES)),
    "rad2deg": lambda loom, x: _over(loom, x, constants(loom, _DEGREES)),
    "wrapToPi": lambda loom, x: _wrapped(loom, x, math.pi),
    "wrapTo180": lambda loom, x: _wrapped(loom, x, 180.0),
    "wrapTo2Pi": lambda loom, x: _turned(loom, x, 2 * math.pi),
    "wrapTo360": lambda loom, x: _turned(loom, x, 360.0),
    "uplus": lambda loom, x: x,
}


@function(*_ONE)
def composed(given: Given) -> Held:
    """A function of one argument that operations of the graph make up."""
    return _ONE[given.name](given.calls.loom, given.array(0))


def _xor(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    zero = constants(loom, 0.0)
    return each(loom, "ne", each(loom, "ne", a, zero), each(loom, "ne", b, zero))


_TWO: Final[dict[str, Rule]] = {
    **TWO,
    "realpow": TWO["power"],
    "ldivide": lambda loom, a, b: _over(loom, b, a),
}
_LOGIC: Final[dict[str, Rule]] = {
    "xor": _xor,
    "eq": lambda loom, a, b: each(loom, "eq", a, b),
    "ne": lambda loom, a, b: each(loom, "ne", a, b),
    "lt": lambda loom, a, b: each(loom, "lt", a, b),
    "le": lambda loom, a, b: each(loom, "le", a, b),
    "gt": lambda loom, a, b: each(loom, "gt", a, b),
    "ge": lambda loom, a, b: each(loom, "ge", a, b),
}


@function(*_TWO, least=2, most=2)
def of_two(given: Given) -> Held:
    """A function of two arguments, element by element."""
    given.fits(*given.arrays)
    return _TWO[given.name](given.calls.loom, *given.arrays)


@function(*_LOGIC, least=2, most=2)
def comparison(given: Given) -> Held:
    """A comparison, element by element."""
    given.fits(*given.arrays)
    return truths(_LOGIC[given.name](given.calls.loom, *given.arrays))


@function("and", "or", least=2, most=20)
def several(given: Given) -> Held:
    """Logic of several arguments, element by element."""
    made = given.array(0)
    for other in given.arrays[1:]:
        made = each(given.calls.loom, given.name, made, other)
    return truths(made)


@function("not")
def negation(given: Given) -> Held:
    """Whether elements are 0."""
    return truths(each(given.calls.loom, "not", given.array(0)))


EACH_ALONE: Final = frozenset({*PLAIN, *_CASTS, *_ONE, *_TWO, *_LOGIC, "not", "logical"})


@function("idivide", least=2, most=3)
def whole_division(given: Given) -> Held:
    """A quotient made whole: towards zero where nothing else is asked for."""
    loom, how = given.calls.loom, given.text(2) if len(given) > 2 else "fix"
    quotient = _over(loom, given.array(0), given.array(1))
    if how not in ("fix", "floor", "ceil", "round"):
        raise given.refuse(f"{how!r} is no way of rounding")
    return towards_zero(loom, quotient) if how == "fix" else each(loom, how, quotient)


@function("nthroot", least=2, most=2)
def root(given: Given) -> Held:
    """A real root of a whole degree, of negative numbers where the degree is odd."""
    loom, x, degree = given.calls.loom, given.array(0), given.whole(1)
    if not degree:
        raise given.refuse("a root of degree 0")
    share = constants(loom, 1.0 / degree)
    if degree % 2 == 0:
        return each(loom, "pow", x, share)
    return _times(loom, each(loom, "sign", x), each(loom, "pow", each(loom, "abs", x), share))
