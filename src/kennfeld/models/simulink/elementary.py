"""The operators and functions of MATLAB expressions that the graph can say, by their names."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.arrays import each, fold, towards_zero
from kennfeld.models.simulink.signals import Nodes

__all__ = ["BINARY", "KNOWN", "applied"]

BINARY: Final = {
    "+": "add", "-": "sub", ".*": "mul", "./": "div", ".^": "pow", "==": "eq", "~=": "ne", "!=": "ne", "<": "lt",
    "<=": "le", ">": "gt", ">=": "ge", "&": "and", "|": "or", "&&": "and", "||": "or",
}  # fmt: skip
_PLAIN: Final = [
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "log",
    "log10",
    "sqrt",
    "abs",
    "floor",
    "ceil",
    "round",
    "sign",
    "atan2",
    "mod",
]
_CASTS: Final = [
    "double",
    "single",
    "boolean",
    "logical",
    "int8",
    "int16",
    "int32",
    "int64",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
]  # physical values are kept


def applied(loom: Loom, name: str, args: list[Nodes]) -> Nodes | None:
    """A function of node arrays; None for one that is not known."""
    count = 2 if name in ("atan2", "mod") else 1
    if name in _PLAIN and len(args) == count:
        return each(loom, name, *args)
    if name in _MORE and len(args) == _MORE[name][0]:
        return _MORE[name][1](loom, *args)
    if name in ("min", "max") and len(args) == 2:
        return each(loom, name, *args)
    if name in ("min", "max", "sum", "prod") and len(args) == 1 and 1 in args[0].shape:
        op = {"sum": "add", "prod": "mul"}.get(name, name)
        return np.array([[fold(loom, op, [int(n) for n in args[0].ravel(order="F")])]], dtype=np.int64)
    return args[0] if name in _CASTS and len(args) == 1 else None


def _power(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "pow", a, b)


def _remainder(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """What is left of a after whole steps of b towards 0."""
    whole = towards_zero(loom, each(loom, "div", a, b))
    return each(loom, "sub", a, each(loom, "mul", whole, b))


def _hypotenuse(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "sqrt", each(loom, "add", each(loom, "mul", a, a), each(loom, "mul", b, b)))


_MORE: Final[Mapping[str, tuple[int, Callable[..., Nodes]]]] = {
    "power": (2, _power),
    "pow": (2, _power),
    "rem": (2, _remainder),
    "fmod": (2, _remainder),
    "hypot": (2, _hypotenuse),
    "fix": (1, towards_zero),
    "ln": (1, lambda loom, x: each(loom, "log", x)),
    "sgn": (1, lambda loom, x: each(loom, "sign", x)),
    "fabs": (1, lambda loom, x: each(loom, "abs", x)),
    "rdivide": (2, lambda loom, a, b: each(loom, "div", a, b)),
    "times": (2, lambda loom, a, b: each(loom, "mul", a, b)),
    "plus": (2, lambda loom, a, b: each(loom, "add", a, b)),
    "minus": (2, lambda loom, a, b: each(loom, "sub", a, b)),
    "uminus": (1, lambda loom, x: each(loom, "neg", x)),
    "not": (1, lambda loom, x: each(loom, "not", x)),
    "square": (1, lambda loom, x: each(loom, "mul", x, x)),
    "reciprocal": (1, lambda loom, x: each(loom, "div", np.array([[loom.const(1.0)]]), x)),
}

KNOWN: Final = frozenset({*_PLAIN, *_MORE, *_CASTS, "min", "max", "sum", "prod"})
