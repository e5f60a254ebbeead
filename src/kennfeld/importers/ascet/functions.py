"""Functions that ESDL programs call: arithmetic of its types, mathematics, bits, and lookups of tables.

Division by zero gives the numerator, unless the divisor is a characteristic, and integers are divided and cut off
towards zero, as in the code that ASCET generates by default.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import GraphBuilder
from kennfeld.importers.rules import (
    Rule,
    RuleFunction,
    elementwise,
    filled_array,
    known_integer,
    shift,
    symbolic_rule,
    wrapped,
)
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import LibraryFunction, SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.graph_operators import ONE, operation
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate
from kennfeld.models.imperative.path_facts import bound_of


@dataclass(frozen=True)
class TableLookup:
    """`esdl:lookup`: the lookup of a table by its label; `names` are the parameters of the labels."""

    names: Mapping[str, str]

    def results(
        self, evaluator: SymbolicEvaluator, values: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]:
        """Look up the table."""
        label, *coordinates = values
        if not isinstance(label, str) or label not in self.names:
            raise ProgramError("the table is not known")
        nodes = [int(s.as_array(s.force(value)).item()) for value in coordinates]
        # the table itself is lowered later, so that its breakpoints and values can be fitted
        return (_single(evaluator.builder.lookup(self.names[label], *nodes)),)


def _single(node: int) -> Nodes:
    return np.array([[node]], dtype=np.int64)


def _divide(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute a / b; a if b is 0, which is not tested for a b that depends on characteristics alone."""
    if _varies(evaluator.builder, int(b.item())):
        return _ratio(evaluator, a, b)
    is_zero = evaluator.builder.value(int(b.item())) == 0
    return a if is_zero else Elementwise(evaluator.builder)("div", a, b)


def _ratio(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute the exact ratio of integers; a if b is 0, which quotients of integers often are."""
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    divisor = builder.value(int(b.item()))
    if divisor is not None:
        return a if divisor == 0 else apply("div", a, b)
    return apply("select", apply("eq", b, 0.0), a, apply("div", a, b))


def _varies(builder: GraphBuilder, node: int) -> bool:
    """Return True if a node depends on inputs or states."""
    seen, waiting = {node}, [node]
    while waiting:
        op, args, _ = builder.nodes[waiting.pop()]
        if op in ("input", "state"):
            return True
        waiting += [arg for arg in args if arg not in seen]
        seen.update(args)
    return False


def _quotient(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    return truncate(evaluator.builder, _ratio(evaluator, a, b))


def _remainder(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute the remainder with the sign of a; 0 if b is 0."""
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    divisor = builder.value(int(b.item()))
    if divisor == 0:
        return _single(builder.const(0.0))
    # a - b * (a / b) with the quotient cut off towards 0 has the sign of a, as in C
    rest = apply("sub", a, apply("mul", _quotient(evaluator, a, b), b))
    return rest if divisor is not None else apply("select", apply("eq", b, 0.0), 0.0, rest)


def _between(evaluator: SymbolicEvaluator, x: Nodes, low: Nodes, high: Nodes) -> Nodes:
    apply = Elementwise(evaluator.builder)
    return apply("and", apply("ge", x, low), apply("le", x, high))


def _limit(evaluator: SymbolicEvaluator, x: Nodes, low: Nodes, high: Nodes) -> Nodes:
    """Limit numbers to a range, where their bounds are not known to be within it."""
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    least, most = (float(builder.value(int(bound.item())) or 0.0) for bound in (low, high))
    nodes = [int(node) for node in x.ravel()]
    # a limit that cannot be exceeded would be computed for each sample and change nothing
    if any(bound_of(builder, node, True) > most for node in nodes):
        x = apply("min", x, most)
    if any(bound_of(builder, node, False) < least for node in nodes):
        x = apply("max", x, least)
    return x


def _wrap(evaluator: SymbolicEvaluator, x: Nodes, low: Nodes, size: Nodes) -> Nodes:
    """Return the integers that the lowest bits of numbers stand for: x mod size, from `low` on."""
    return wrapped(evaluator.builder, x, known_integer(evaluator, low), known_integer(evaluator, size))


def _index(evaluator: SymbolicEvaluator, at: Nodes, first: Nodes, size: Nodes) -> Nodes:
    """Return an index counted from 1, that of the nearest element if it is out of range."""
    apply = Elementwise(evaluator.builder)
    last = apply("add", first, apply("sub", size, 1.0))
    return apply("add", apply("sub", _limit(evaluator, at, first, last), first), 1.0)


def _fill(evaluator: SymbolicEvaluator, value: Nodes, *sizes: Nodes) -> Nodes:
    return filled_array(evaluator, value.item(), sizes)


def _bits(name: str) -> Rule:
    """Return the rule of a bit operation on words of 32 bits; the last argument says whether they are signed."""
    apply = symbolic_rule(name)

    def rule(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, signed: Nodes) -> Nodes:
        word = IntegerType(32, bool(known_integer(evaluator, signed)), "Round", True)
        low, size = (_single(evaluator.builder.const(float(bound))) for bound in (word.least, 2**32))
        a = _wrap(evaluator, a, low, size)
        if name == "bitshift":
            return apply(evaluator, s.integers(a, word), b)
        return apply(evaluator, s.integers(a, word), s.integers(_wrap(evaluator, b, low, size), word))

    return rule


def _bit_of(operator: str) -> Rule:
    """Return the rule that combines a number with the bit at a position, counted from 0; `write` takes its value."""

    def rule(evaluator: SymbolicEvaluator, x: Nodes, position: Nodes, *value: Nodes) -> Nodes:
        apply = Elementwise(evaluator.builder)
        # arithmetic instead of words: the position is a signal, and the number may have any size
        weight = apply("pow", 2.0, position)
        # bit = floor(x / 2^position) mod 2; x + 2^position (new - old) replaces it
        old = apply("mod", apply("floor", apply("div", x, weight)), 2.0)
        match operator:
            case "get":
                return old
            case "write":
                new: Nodes | float = value[0]
            case "set":
                new = 1.0
            case "clear":
                new = 0.0
            case _:
                new = apply("sub", 1.0, old)
        return apply("add", x, apply("mul", weight, apply("sub", new, old)))

    return rule


def _shift(direction: float) -> Rule:
    """Return the rule that shifts the bits of an unsigned number of 16 bits."""
    shifted = shift(direction)
    return lambda evaluator, x, count: Elementwise(evaluator.builder)("mod", shifted(evaluator, x, count), 2.0**16)


def _rotate(evaluator: SymbolicEvaluator, x: Nodes, count: Nodes) -> Nodes:
    """Rotate the bits of an unsigned number of 16 bits to the left: those that leave it enter at its right."""
    apply = Elementwise(evaluator.builder)
    return apply("add", _shift(1.0)(evaluator, x, count), _shift(-1.0)(evaluator, x, apply("sub", 16.0, count)))


def _write_byte(evaluator: SymbolicEvaluator, x: Nodes, *bits: Nodes) -> Nodes:
    """Replace the lowest 8 bits of a number, the lowest one first."""
    apply = Elementwise(evaluator.builder)
    result = apply("sub", x, apply("mod", x, 256.0))
    for at, bit in enumerate(bits):
        result = apply("add", result, apply("mul", bit, 2.0**at))
    return result


def _unsigned(name: str) -> Rule:
    rule = _bits(name)
    return lambda evaluator, a, b: rule(evaluator, a, b, _single(evaluator.builder.const(0.0)))


_MATHEMATICS: Final = (
    *(RuleFunction(name, 1, elementwise(ONE[name])) for name in ONE if name != "uminus"),
    *(RuleFunction(name, 2, elementwise(operation(name))) for name in ("min", "max", "atan2", "pow")),
)
_BITS: Final = (
    *(RuleFunction(f"bits_{name}", 2, _bit_of(name)) for name in ("get", "set", "clear", "toggle")),
    *(RuleFunction(f"bits_{name}", 2, _unsigned(f"bit{name}")) for name in ("and", "or", "xor")),
    RuleFunction("bits_write", 3, _bit_of("write")),
    RuleFunction("byte_write", 9, _write_byte),
    RuleFunction("rotate", 2, _rotate),
    RuleFunction("shift_left", 2, _shift(1.0)),
    RuleFunction("shift_right", 2, _shift(-1.0)),
)
_INTERNAL: Final = (
    RuleFunction("divide", 2, _divide),
    RuleFunction("ratio", 2, _ratio),
    RuleFunction("quotient", 2, _quotient),
    RuleFunction("remainder", 2, _remainder),
    RuleFunction("between", 3, _between),
    RuleFunction("limit", 3, _limit),
    RuleFunction("wrap", 3, _wrap),
    RuleFunction("index", 3, _index),
    RuleFunction("fill", 1, _fill),
    RuleFunction("truncate", 1, lambda evaluator, x: truncate(evaluator.builder, x)),
    RuleFunction("and", 3, _bits("bitand")),
    RuleFunction("or", 3, _bits("bitor")),
    RuleFunction("xor", 3, _bits("bitxor")),
    RuleFunction("shift", 3, _bits("bitshift")),
)

# functions that programs call by their names, and those written in C, by their symbols or by the methods of SystemLib
FUNCTIONS: Final[Mapping[str, RuleFunction]] = {function.name: function for function in _MATHEMATICS}
_SYSTEM_LIB: Final = "SystemLib.Bitoperations"
_METHODS: Final = {
    "and.getAnd": "bits_and", "or.getOr": "bits_or", "xor.getXor": "bits_xor", "getBit.getGetBit": "bits_get",
    "setBit.getSetBit": "bits_set", "clearBit.getClearBit": "bits_clear", "toggleBit.getToggleBit": "bits_toggle",
    "shiftLeft.getShiftLeft": "shift_left", "shiftRight.getShiftRight": "shift_right", "rotate.getRotate": "rotate",
    "writeBit.getWriteBit": "bits_write", "writeByte.getWriteByte": "byte_write",
}  # fmt: skip
_BY_NAME: Final = {function.name: function for function in (*_MATHEMATICS, *_BITS, *_INTERNAL)}
EXTERNAL: Final[Mapping[str, RuleFunction]] = {
    # math.h does not have these
    **{name: function for name, function in FUNCTIONS.items() if name not in ("min", "max", "fix", "sign")},
    "fabs": FUNCTIONS["abs"],
    "fmin": FUNCTIONS["min"],
    "fmax": FUNCTIONS["max"],
    **{f"{_SYSTEM_LIB}.{method}": _BY_NAME[name] for method, name in _METHODS.items()},
    # older versions of the class have no symbols
    **{f"SystemLib.Math.MathLib.{name}": function for name, function in FUNCTIONS.items()},
}


def library(names: Mapping[str, str]) -> dict[str, LibraryFunction]:
    """Return the functions by name; `names` are the parameters of the labels of tables."""
    functions: dict[str, LibraryFunction] = {f"esdl:{name}": function for name, function in _BY_NAME.items()}
    return {**functions, "esdl:lookup": TableLookup(names)}
