"""Parser of ESDL expressions, with the token reader that all parsers of ESDL share.

Precedence, from lowest to highest:

    ||  <  &&  <  |  <  ^  <  &  <  == !=  <  < <= > >= between  <  << >>  <  + -  <  * / %  <  unary - + ! ~
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, TypeVar

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import Token

MAX_DEPTH: Final = 40  # nested brackets, conditions or statements
_MAX_TERMS = 300  # operands of one chain, which makes a tree of that depth

_LEVELS: Final = (
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("==", "!="), ("<", "<=", ">", ">="), ("<<", ">>"), ("+", "-"),
    ("*", "/", "%"),
)  # fmt: skip
_POWERS: Final = {operator: level for level, operators in enumerate(_LEVELS) for operator in operators}
_COMPARISON: Final = _POWERS["<"]
_UNARY: Final = ("-", "+", "!", "~")

Result = TypeVar("Result")


class EsdlSyntaxError(Exception):
    """A token that does not fit; `token` is where."""

    def __init__(self, token: Token, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.token, self.message, self.remedy = token, message, remedy


class TokenReader:
    """The tokens of a text, read one after the other; methods raise `EsdlSyntaxError`."""

    def __init__(self, tokens: Sequence[Token]) -> None:
        self.tokens, self.at, self.depth = tokens, 0, 0

    @property
    def token(self) -> Token:
        """The next token."""
        return self.tokens[self.at]

    def ahead(self, count: int) -> Token:
        """Return a later token; the last one behind the end."""
        return self.tokens[min(self.at + count, len(self.tokens) - 1)]

    def take(self) -> Token:
        """Return the next token and step over it."""
        token = self.token
        self.at += token.kind != "end"
        return token

    def is_at(self, *texts: str) -> bool:
        """Return True if the next token is one of these words or operators."""
        return self.token.text in texts and self.token.kind in ("name", "operator")

    def accept(self, *texts: str) -> bool:
        """Step over the next token if it is one of these words or operators."""
        result = self.is_at(*texts)
        self.at += result
        return result

    def expect(self, text: str) -> Token:
        """Step over a word or operator that must follow."""
        if not self.is_at(text):
            raise self.fault(f"expected {text!r}, got {self._shown()}")
        return self.take()

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
            names.append(self.take().text if self.is_at("*") else self.name())
        return ".".join(names)

    def nested(self, read: Callable[[], Result]) -> Result:
        """Call `read` one level deeper; raises `EsdlSyntaxError` if the text is nested too deeply."""
        self.depth += 1
        try:
            if self.depth > MAX_DEPTH:
                raise self.fault(f"nested more than {MAX_DEPTH} deep", "Split the expression or the method.")
            return read()
        finally:
            self.depth -= 1


class EsdlExpressionParser(TokenReader):
    """Parser of expressions."""

    def expression(self) -> e.Expression:
        """Read an expression."""
        return self.nested(lambda: self._binary(0))

    def range(self) -> e.Expression:
        """Read an expression, or `first .. last`."""
        place = self.token.place
        first = None if self.is_at("..") else self.expression()
        if not self.accept(".."):
            assert first is not None
            return first
        ends_open = self.is_at(";", ",", ")", "]", "{", "delta", "using", "[") or self.token.kind == "end"
        return e.Range(first, None if ends_open else self.expression(), place=place)

    def _binary(self, lowest: int) -> e.Expression:
        left = self._unary()
        for _ in range(_MAX_TERMS):
            place, operator = self.token.place, self.token.text
            if self.is_at("between") and lowest <= _COMPARISON:
                left = self._between(left, place)
                continue
            level = _POWERS.get(operator, -1) if self.token.kind == "operator" else -1
            if level < lowest:
                return left
            self.at += 1
            right = self.nested(partial(self._binary, level + 1))
            left = e.Binary(operator, left, right, place=place)
        raise self.fault(f"more than {_MAX_TERMS} terms in an expression", "Split it by a variable.")

    def _between(self, operand: e.Expression, place: e.TextPosition) -> e.Expression:
        self.at += 1
        low = self._binary(_COMPARISON + 1)
        self.expect("and")
        return e.Between(operand, low, self._binary(_COMPARISON + 1), place=place)

    def _unary(self) -> e.Expression:
        if self.token.kind == "operator" and self.token.text in _UNARY:
            token = self.take()
            return e.Unary(token.text, self.nested(self._unary), place=token.place)
        return self._postfix(self._primary())

    def _postfix(self, tree: e.Expression) -> e.Expression:
        for _ in range(_MAX_TERMS):
            place = self.token.place
            if self.accept("."):
                tree = e.Member(tree, self.name(), place=place)
            elif self.accept("["):
                tree = e.Index(tree, self.expression(), place=place)
                while self.accept(","):
                    tree = e.Index(tree, self.expression(), place=place)
                self.expect("]")
            elif self.is_at("("):
                tree = e.Call(tree, self._arguments(), place=place)
            else:
                return tree
        raise self.fault(f"more than {_MAX_TERMS} accesses in an expression")

    def _arguments(self) -> tuple[e.Expression, ...]:
        self.expect("(")
        result: list[e.Expression] = []
        while not self.accept(")"):
            result.append(self.expression())
            if not self.is_at(")"):
                self.expect(",")
        return tuple(result)

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
        elements: list[e.Expression] = []
        while not self.accept("}"):
            elements.append(self.expression())
            if not self.is_at("}"):
                self.expect(",")
        return e.Braces(tuple(elements), place=place)

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
        keys = [self.range()]
        while self.accept(","):
            keys.append(self.range())
        self.expect(":")
        return tuple(keys)
