"""Parser of ESDL expressions, with the token reader that all parsers of ESDL share.

Precedence, from lowest to highest:

    ||  <  &&  <  |  <  ^  <  &  <  == !=  <  < <= > >= between  <  << >>  <  + -  <  * / %  <  unary - + ! ~
"""

import math
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import Token
from kennfeld.program.operator_parser import OperatorParser, operator_levels
from kennfeld.program.token_reader import TokenReader

_MAX_TERMS = 300  # operands of one chain, which makes a tree of that depth
_LEVELS: Final = operator_levels(
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("==", "!="), ("<", "<=", ">", ">=", "between"), ("<<", ">>"), ("+", "-"),
    ("*", "/", "%"),
)  # fmt: skip
_UNARY: Final = ("-", "+", "!", "~")


class EsdlSyntaxError(Exception):
    """A token that does not fit; `token` is where."""

    def __init__(self, token: Token, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.token, self.message, self.remedy = token, message, remedy


class EsdlReader(TokenReader[Token]):
    """Reader of tokens of ESDL; methods raise `EsdlSyntaxError`."""

    word_kinds = ("name", "operator")
    max_depth = 40  # nested brackets, conditions or statements

    def missing(self, text: str) -> EsdlSyntaxError:
        """Return the error that another token than `text` follows."""
        return self.fault(f"expected {text!r}, got {self._shown()}")

    def too_deep(self) -> EsdlSyntaxError:
        """Return the error that the text is nested too deeply."""
        return self.fault(f"nested more than {self.max_depth} deep", "Split the expression or the method.")

    def fault(self, message: str, remedy: str = "") -> EsdlSyntaxError:
        """Return an error at the next token."""
        if self.token.kind == "open":
            closing = "*/" if self.token.text.startswith("/*") else '"'
            return EsdlSyntaxError(self.token, f"{closing} is missing behind {self.token.text[:2]}")
        return EsdlSyntaxError(self.token, message, remedy)

    def _shown(self) -> str:
        return repr(self.token.text[:40]) if self.token.kind != "end" else "the end of the file"

    def name(self) -> str:
        """Read a name; `^` before it allows a word of the language."""
        self.accept("^")
        if self.token.kind != "name":
            raise self.fault(f"expected a name, got {self._shown()}")
        return self.take().text

    def qualified_name(self) -> str:
        """Read names joined by points."""
        names = [self.name()]
        while self.is_at(".") and (self.ahead(1).kind == "name" or self.ahead(1).text in ("^", "*")):
            self.at += 1
            # import a.*
            names.append(self.take().text if self.is_at("*") else self.name())
        return ".".join(names)


class EsdlExpressionParser(EsdlReader, OperatorParser[Token, e.Expression]):
    """Parser of expressions."""

    levels = _LEVELS
    max_terms = _MAX_TERMS

    def expression(self) -> e.Expression:
        """Read an expression."""
        return self.nested(self.operations)

    def range(self) -> e.Expression:
        """Read an expression, or `first .. last`."""
        place = self.token.place
        first = None if self.is_at("..") else self.expression()
        if not self.accept(".."):
            assert first is not None
            return first
        ends_open = self.is_at(";", ",", ")", "]", "{", "delta", "using", "[") or self.token.kind == "end"
        return e.Range(first, None if ends_open else self.expression(), place=place)

    def joined(self, left: e.Expression, level: int) -> e.Expression:
        """Read an operator with its right operand."""
        token = self.take()
        if token.text == "between":
            low = self.operations(level + 1)
            self.expect("and")
            return e.Between(left, low, self.operations(level + 1), place=token.place)
        right = self.nested(lambda: self.operations(level + 1))
        return e.Binary(token.text, left, right, place=token.place)

    def too_many_terms(self) -> EsdlSyntaxError:
        """Return the error that an expression has too many terms."""
        return self.fault(f"more than {_MAX_TERMS} terms in an expression", "Split it by a variable.")

    def operand(self, lowest: int) -> e.Expression:
        """Read an operand with its signs."""
        if self.is_at(*_UNARY):
            token = self.take()
            # nested, as a chain of signs is a tree of its depth
            return e.Unary(token.text, self.nested(lambda: self.operand(lowest)), place=token.place)
        return self._postfix(self._primary())

    def _postfix(self, tree: e.Expression) -> e.Expression:
        for _ in range(_MAX_TERMS):
            place = self.token.place
            if self.accept("."):
                tree = e.Field(tree, self.name(), place=place)
            elif self.accept("["):
                for index in self.series(self.expression):
                    tree = e.Index(tree, index, place=place)
                self.expect("]")
            elif self.is_at("("):
                tree = e.Call(tree, self._arguments(), place=place)
            else:
                return tree
        raise self.fault(f"more than {_MAX_TERMS} accesses in an expression")

    def _arguments(self) -> tuple[e.Expression, ...]:
        self.expect("(")
        return self.listed(")", self.expression)

    def _primary(self) -> e.Expression:
        token = self.token
        match token.kind, token.text:
            case "number", _:
                return self._number()
            case "text", text:
                self.at += 1
                return e.Text(text[1:-1], place=token.place)
            case "operator", "(":
                self.at += 1
                tree = self.expression()
                self.expect(")")
                return tree
            case "operator", "{":
                return self._braces()
            case "name", "if":
                return self._conditional()
            case "name", "switch":
                return self._choice()
            case "name", "true" | "false":
                self.at += 1
                return e.Truth(token.text == "true", token.text, place=token.place)
        if token.kind == "name" or token.text == "^":
            return e.Name(self.name(), place=token.place)
        raise self.fault(f"expected an expression, got {self._shown()}")

    def _number(self) -> e.Number:
        token = self.take()
        plain = token.text.replace("_", "")
        is_hexadecimal = plain[:2] in ("0x", "0X")
        is_real = not is_hexadecimal and any(sign in plain for sign in ".eE")
        try:
            value = float(int(plain, 16)) if is_hexadecimal else float(plain)
        except (ValueError, OverflowError):
            value = math.inf
        if not math.isfinite(value):
            raise EsdlSyntaxError(token, f"invalid number {token.text[:40]}") from None
        unit = self._unit() if self.is_at("[") else ""
        return e.Number(value, is_real, unit, token.text, place=token.place)

    def _unit(self) -> str:
        self.expect("[")
        parts: list[str] = []
        while not self.is_at("]"):
            if self.token.kind == "end" or self.is_at(";", "{", "}"):
                raise self.fault("] is missing behind a unit")
            parts.append(self.take().text)
        self.at += 1
        return "".join(parts)

    def _braces(self) -> e.Braces:
        place = self.expect("{").place
        return e.Braces(self.listed("}", self.expression), place=place)

    def _conditional(self) -> e.Conditional:
        place = self.expect("if").place
        condition = self.expression()
        self.expect("then")
        yes = self.expression()
        self.expect("else")
        return e.Conditional(condition, yes, self.expression(), place=place)

    def _choice(self) -> e.Choice:
        place = self.expect("switch").place
        subject = self.expression()
        in_braces = self.accept("{")
        cases: list[tuple[tuple[e.Expression, ...], e.Expression]] = []
        otherwise: e.Expression | None = None
        while self.is_at("case", "default"):
            keys = self.case_keys()
            value = self.expression()
            self.accept(";") if in_braces else None
            if keys:
                cases.append((keys, value))
            else:
                otherwise = value
        if in_braces:
            self.expect("}")
        return e.Choice(subject, tuple(cases), otherwise, place=place)

    def case_keys(self) -> tuple[e.Expression, ...]:
        """Read `case key, key :`, or `default :` as no keys."""
        if self.accept("default"):
            self.expect(":")
            return ()
        self.expect("case")
        keys = self.series(self.range)
        self.expect(":")
        return keys
