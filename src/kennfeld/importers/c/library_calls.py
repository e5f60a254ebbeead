"""Translation of calls of functions of the C library: `math.h`, and `abs` of `stdlib.h`."""

import math
from collections.abc import Sequence
from typing import Final

from pycparser import c_ast

from kennfeld.importers.c.declarations import line_of
from kennfeld.importers.c.expression_translation import (
    CExpressionTranslation,
    COperand,
    call_of,
    converted,
    rounded,
)
from kennfeld.importers.c.functions import MATHEMATICS, TESTS
from kennfeld.importers.c.number_types import DOUBLE, INT, LONG, LONG_DOUBLE, LONG_LONG, CType, UnsupportedCError
from kennfeld.program import tree as m

# functions that Simulink writes to a file of its own
_ALIASES: Final = {"rtIsNaN": "isnan", "rtIsNaNF": "isnan", "rtIsInf": "isinf", "rtIsInfF": "isinf"}
_TO_INTEGER: Final = ("lround", "lrint", "llround", "llrint")
_SCALING: Final = ("ldexp", "scalbn", "scalbln")
# functions that write a part of a number through an address: its type, and the rules of what they return and write
_PARTS: Final = {"frexp": (INT, "mantissa", "exponent"), "modf": (DOUBLE, "fraction", "truncate")}
_CLASSES: Final = {"isnormal": "normal", "fpclassify": "classified"}
_NEXT: Final = ("nextafter", "nexttoward")
_LEAST_NORMAL: Final = {"float": 2.0**-126}
_COUNTS: Final = {
    **MATHEMATICS,
    **TESTS,
    **dict.fromkeys(_TO_INTEGER, 1),
    **dict.fromkeys((*_SCALING, *_PARTS), 2),
    **{"isnormal": 1, "fpclassify": 1, "remquo": 3, "ilogb": 1, "nan": 1, "sincos": 3},
}
_GENERIC: Final = frozenset(
    {*TESTS, "isnormal", "fpclassify"}
)  # macros for all types, which have no names with suffixes


class LibraryCalls(CExpressionTranslation):
    """Translates calls of the C library."""

    def library_call(self, name: str, trees: Sequence[c_ast.Node], tree: c_ast.Node) -> COperand:
        """Translate a call of a function of the C library."""
        plain, kind = self._named_function(name)
        if not plain:
            raise UnsupportedCError(f"unknown function {name}", line_of(tree), wrong=True)
        if len(trees) != _COUNTS[plain]:
            raise UnsupportedCError(f"{name} takes {_COUNTS[plain]} arguments, got {len(trees)}", wrong=True)
        if plain == "nan":
            return COperand(m.Number(math.nan), kind)
        if plain in _PARTS:
            return self._two_parts(plain, kind, *trees)
        if plain == "sincos":
            return self._both(kind, trees)
        if plain == "remquo":
            return self._remainder(kind, *trees)
        operands = [self.operand(argument) for argument in trees]
        if plain in _GENERIC:
            return self._test(plain, operands)
        self.note_precision(kind)
        if plain in _SCALING:
            return self._of_kind(call_of("scaled", converted(operands[0], kind), converted(operands[1], INT)), kind)
        if plain in _NEXT:
            return self._next(kind, operands)
        values = [converted(operand, kind) for operand in operands]
        if plain in _TO_INTEGER:
            return self._rounded_integer(plain, values[0])
        if plain == "ilogb":
            return COperand(converted(COperand(call_of("logb", *values), DOUBLE), INT), INT)
        return self._of_kind(call_of(plain, *values), kind)

    def _named_function(self, name: str) -> tuple[str, CType]:
        """Return the function of doubles that a name stands for, and the type of its numbers; empty if it is unknown.

        `sinf` is sin of floats, `sinl` that of long doubles.
        """
        name = _ALIASES.get(name, name.removeprefix("__builtin_"))
        if name in _COUNTS:
            return name, DOUBLE
        kind = {"f": self.file.types.number("float"), "l": LONG_DOUBLE}.get(name[-1:])
        if kind is None or name[:-1] not in _COUNTS or name[:-1] in _GENERIC:
            return "", DOUBLE
        return name[:-1], kind

    def _test(self, plain: str, operands: Sequence[COperand]) -> COperand:
        # those of stdlib.h convert their argument to an integer, unlike fabs
        if plain in ("abs", "labs"):
            kind = INT if plain == "abs" else LONG
            return COperand(call_of(plain, *(converted(operand, kind) for operand in operands)), kind)
        if plain in ("isnormal", "fpclassify"):
            least = m.Number(_LEAST_NORMAL.get(operands[0].type.name, 2.0**-1022))
            return COperand(call_of(_CLASSES[plain], operands[0].tree, least), INT)
        return COperand(call_of(plain, *(operand.tree for operand in operands)), INT)

    def _of_kind(self, tree: m.Expression, kind: CType) -> COperand:
        return COperand(rounded(tree) if kind.single else tree, kind)

    def _rounded_integer(self, name: str, value: m.Expression) -> COperand:
        """Translate lround and the like: the number rounded, as an integer."""
        kind = LONG_LONG if name.startswith("ll") else self.file.types.number("long")
        rule = "round" if name.endswith("round") else "rint"
        return COperand(converted(COperand(call_of(rule, value), DOUBLE), kind), kind)

    def _two_parts(self, name: str, kind: CType, of: c_ast.Node, target: c_ast.Node) -> COperand:
        """Translate frexp and modf, which write one part of a number through an address and return the other one."""
        written, *rules = _PARTS[name]
        value = self._kept(converted(self.operand(of), kind), target)
        parts = [call_of(rule, value) for rule in rules]
        self._store(target, COperand(parts[1], kind if written is DOUBLE else written))
        return self._of_kind(parts[0], kind)

    def _both(self, kind: CType, trees: Sequence[c_ast.Node]) -> COperand:
        """Translate sincos of the GNU library."""
        value = self._kept(converted(self.operand(trees[0]), kind), trees[0])
        for name, target in zip(("sin", "cos"), trees[1:], strict=True):
            self._store(target, self._of_kind(call_of(name, value), kind))
        return COperand(m.Number(0.0), kind)

    def _remainder(self, kind: CType, of: c_ast.Node, by: c_ast.Node, target: c_ast.Node) -> COperand:
        """Translate remquo, which writes the last bits of the quotient through an address."""
        values = [self._kept(converted(self.operand(tree), kind), target) for tree in (of, by)]
        self._store(target, COperand(call_of("lastbits", *values), INT))
        return self._of_kind(call_of("remainder", *values), kind)

    def _next(self, kind: CType, operands: Sequence[COperand]) -> COperand:
        """Translate nextafter, whose steps are those of the precision in which numbers are computed."""
        if kind.name == "long double" or (kind.name == "float" and not kind.single):
            remedy = "; with float32 = true it is" if kind.name == "float" else ""
            raise UnsupportedCError(f"the next number of {kind.name} is not known in double precision{remedy}")
        values = [converted(operands[0], kind), operands[1].tree]
        return COperand(call_of("nextafterf" if kind.single else "nextafter", *values), kind)

    def _kept(self, value: m.Expression, tree: c_ast.Node) -> m.Expression:
        """Return a number in a variable of its own, since what is written may be what it is computed from."""
        name = m.Name(self.temporary())
        self.pending.append(m.Assign((name,), value, place=m.TextPosition(line_of(tree))))
        return name

    def _store(self, target: c_ast.Node, operand: COperand) -> None:
        place, line = self.number(c_ast.UnaryOp("*", target, target.coord)), line_of(target)
        self.pending.append(self.stored(self.frozen(place, line), operand, line))
