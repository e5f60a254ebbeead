"""Parser of the bodies of methods in C, which ASCET keeps in files of their own beside the ESDL of a class.

C and ESDL share their operators with their precedence, and most statements. What C writes otherwise is read here; what
it means otherwise, such as a case that falls through into the next one, is an error.
"""

from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.expression_parser import EsdlSyntaxError
from kennfeld.ascet.lexer import Token, tokens_of
from kennfeld.ascet.statement_parser import EsdlStatementParser
from kennfeld.base.errors import Finding, Location

_INTEGERS: Final = {
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in "us" for bits in (8, 16, 32)},
    **{f"{short}{bits}": f"{sign}int{bits}" for short, sign in ("Uu", "Ss") for bits in (8, 16, 32)},
    **{f"{sign}int{bits}_t": f"{own}int{bits}" for sign, own in (("u", "u"), ("", "s")) for bits in (8, 16, 32)},
}  # fmt: skip
_REALS: Final = ("real32", "real64", "float32", "float64", "float", "double")
_TRUTHS: Final = ("boolean", "bool", "_Bool")
_SUFFIXES: Final = frozenset({"u", "l", "ul", "lu", "ll", "ull", "llu", "f"})


class CBodyParser(EsdlStatementParser):
    """Parser of the statements of a method in C; its trees are those of ESDL."""

    def statements(self) -> e.Statements:
        """Read all statements of a file."""
        result: list[e.Statement] = []
        while self.token.kind != "end":
            result += self.statement()
        return tuple(result)

    def expression(self) -> e.Expression:
        """Read an expression, or `condition ? yes : no`."""
        place = self.token.place
        condition = super().expression()
        if not self.accept("?"):
            return condition
        yes = self.expression()
        self.expect(":")
        return e.Conditional(condition, yes, self.expression(), place=place)

    def operand(self, lowest: int) -> e.Expression:
        """Read an operand, perhaps with a conversion `(uint16)` before it, which binds like a sign."""
        if not (self.is_at("(") and self.ahead(2).text == ")" and (kind := _type_of(self.ahead(1))) is not None):
            return super().operand(lowest)
        place = self.token.place
        self.at += 3
        return e.Cast(kind, self.nested(lambda: self.operand(lowest)), place=place)

    def _primary(self) -> e.Expression:
        if self.token.text in ("TRUE", "FALSE"):
            token = self.take()
            return e.Truth(token.text == "TRUE", token.text, place=token.place)
        return super()._primary()

    def _number(self) -> e.Number:
        written, begin = self.token.text, self.token
        if written[:1] == "0" and written[1:].isdecimal():
            raise self.fault(f"the octal number {written} is not supported")
        number = super()._number()
        # 1u and 2.0f: a name right behind the number
        if self.token.kind == "name" and self.token.place.offset == begin.end:
            if self.token.text.lower() not in _SUFFIXES:
                raise self.fault(f"invalid number {written}{self.token.text[:20]}")
            self.at += 1
        return number

    def _declares(self) -> bool:
        if self.is_at("static"):
            raise self.fault("a static variable of C is not supported", "Declare it as a variable of the class.")
        return super()._declares()

    def type_of_variable(self) -> e.TypeExpression:
        """Read the type of a local variable: one of C, or one that the class knows."""
        token = self.token
        kind = _type_of(token)
        if kind is None:
            return super().type_of_variable()
        self.at += 1
        return kind

    def _switch(self) -> e.Switch:
        switch = super()._switch()
        bodies = [body for _, body in switch.cases] + [switch.otherwise]
        # the last one, wherever `default` stands, has none to fall into
        if any(not body or not _leaves(body[-1]) for body in bodies[:-1]):
            message = "a case of C that falls through into the next one is not supported"
            raise EsdlSyntaxError(Token("name", "switch", switch.place), message, "End each case by break.")
        return switch


def _type_of(token: Token) -> e.TypeExpression | None:
    """Return the type of C that a token names; None for another name."""
    if token.text in _INTEGERS:
        return e.ScalarType("integer", using=_INTEGERS[token.text], place=token.place)
    if token.text in _REALS:
        return e.TypeName("real", place=token.place)
    return e.TypeName("boolean", place=token.place) if token.text in _TRUTHS else None


def _leaves(statement: e.Statement) -> bool:
    """Return True for the last statement of a case that does not fall through."""
    if isinstance(statement, e.Block) and statement.statements:
        return _leaves(statement.statements[-1])
    return isinstance(statement, e.Return) or (isinstance(statement, e.Jump) and statement.kind == "break")


def parse_c_body(text: str, name: str) -> e.Statements | Finding:
    """Parse the body of a method in C; return its statements, or the finding on what is not supported.

    >>> parse_c_body("return (uint16) x & 0x0Fu;", "low.c")[0].value.right.value
    15.0
    """
    tokens = [token._replace(place=token.place._replace(file=name)) for token in tokens_of(text)]
    try:
        return CBodyParser(tokens).statements()
    except EsdlSyntaxError as error:
        place = error.token.place
        return Finding(Location(name, place.line, column=place.column), error.message, error.remedy)
