"""The parser of the C action language of charts; it produces the syntax tree of `kennfeld.program.tree`.

Array indices count from 0 in C and from 1 in the tree. `&`, `|`, `^` and `~` mean and, or, power and not, unless the
chart enables C-bit operations; then they, like shifts and `&=` in any chart, become calls of the functions of bits.
"""

import re
from collections.abc import Iterable
from typing import ClassVar

from kennfeld.program import tree as m
from kennfeld.program.operator_parser import OperatorParser, operator_levels
from kennfeld.program.tokens import ScannedToken, scan_tokens

_MAX_DEPTH = 60  # nested brackets
_WORD = re.compile(
    r"""(?P<number>0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?:[fFuUlLcr]{0,3})(?![A-Za-z0-9_])
    |(?P<name>[A-Za-z_]\w*)
    |(?P<text>"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*')
    |(?P<operator>\+\+|--|<<|>>|<=|>=|==|!=|~=|<>|&&|\|\||\+=|-=|\*=|/=|\|=|&=|\^=|:=|%%|[-+*/^%()\[\]{}<>=!~&|,;.?:@$])
    |(?P<line>\n)
    |(?P<blank>[ \t\r\f\v]+)
    |(?P<bad>.)""",
    re.VERBOSE,
)
_COMPARED = (("==", "!=", "~=", "<>"), ("<", "<=", ">", ">="), ("<<", ">>"), ("+", "-"), ("*", "/", "%%"))
_LEVELS = operator_levels(("||",), ("&&",), ("|",), ("&",), *_COMPARED)
_BIT_LEVELS = operator_levels(("||",), ("&&",), ("|",), ("^",), ("&",), *_COMPARED)
_CHANGES = {"+=": "+", "-=": "-", "*=": "*", "/=": "/", "&=": "&", "|=": "|", "^=": "^"}
_BINARY = frozenset({*_LEVELS, *_CHANGES, "^", "="})
_WRITTEN = {"|": "||", "&": "&&", "!=": "~=", "<>": "~="}
_BIT_FUNCTIONS = {"&": "bitand", "|": "bitor", "^": "bitxor", "<<": "bitshift", ">>": "bitsra"}
_FUNCTIONS = {"labs": "abs", "ldexp": "", "ml": "", "rand": "", "mod": "rem"}


class ActionSyntaxError(Exception):
    """Code that is not valid or not supported in charts."""


def parse_c_expression(text: str, bits: bool = False) -> m.Expression:
    """Parse an expression; raises `ActionSyntaxError`.

    >>> parse_c_expression("x[0] != 2") == m.Binary("~=", m.Call(m.Name("x"), (m.Number(1.0),)), m.Number(2.0))
    True
    """
    parser = _parser(text, bits)
    parser.pass_lines()
    tree = parser.expression()
    parser.pass_lines()
    if parser.token.kind != "end":
        raise ActionSyntaxError(f"unexpected {parser.token.text!r} after the expression {text.strip()[:60]}")
    return tree


def parse_c_statements(text: str, bits: bool = False) -> m.Statements:
    """Parse the statements of an action, separated by `;`, `,` or line ends; raises `ActionSyntaxError`."""
    return _parser(text, bits).statements()


def _join_lines(tokens: Iterable[ScannedToken]) -> list[ScannedToken]:
    """Remove line ends in front of binary operators, which continue an expression."""
    joined: list[ScannedToken] = []
    for token in tokens:
        if token.kind == "operator" and token.text in _BINARY:
            while joined and joined[-1].kind == "line":
                joined.pop()
        joined.append(token)
    return joined


class _ActionParser(OperatorParser[ScannedToken, m.Expression]):
    levels = _LEVELS
    bits: ClassVar[bool] = False
    max_depth = _MAX_DEPTH

    def __init__(self, text: str) -> None:
        super().__init__([*_join_lines(scan_tokens(_WORD, text)), ScannedToken("end", "the end")])
        self.text = text

    def fault(self, message: str) -> ActionSyntaxError:
        return ActionSyntaxError(f"{message} in {self.text.strip()[:60]}")

    def pass_lines(self) -> None:
        while self.token.kind == "line":
            self.at += 1

    def missing(self, text: str) -> ActionSyntaxError:
        return self.fault(f"{text} is missing before {self.token.text!r}")

    def too_deep(self) -> ActionSyntaxError:
        return ActionSyntaxError(f"brackets are nested more than {_MAX_DEPTH} deep")

    def close(self, bracket: str) -> None:
        self.pass_lines()
        self.expect(bracket)

    # statements

    def statements(self) -> m.Statements:
        statements: list[m.Statement] = []
        while True:
            while self.token.kind == "line" or self.is_at(";", ","):
                self.at += 1
            if self.token.kind == "end":
                return tuple(statements)
            statements.append(self._statement())
            if self.token.kind not in ("line", "end") and not self.is_at(";", ","):
                raise self.fault(f"unexpected {self.token.text!r} after the statement")

    def _statement(self) -> m.Statement:
        if self.is_at("++", "--"):
            sign = self.take().text[0]
            return self._update(self._postfix(), sign, m.Number(1.0))
        if self.is_at("[") and self._is_several():
            return m.Assign(self._targets(), self._value())
        first = self.expression()
        if self.is_at("=", ":="):
            return m.Assign((self._target(first),), self._value())
        if self.is_at("++", "--"):
            return self._update(first, self.take().text[0], m.Number(1.0))
        if self.is_at(*_CHANGES):
            return self._update(first, _CHANGES[self.take().text], self.expression())
        return m.Evaluate(first)

    def _value(self) -> m.Expression:
        self.at += 1
        self.pass_lines()
        value = self.expression()
        if self.is_at("=", ":="):
            raise self.fault("chained assignment")
        return value

    def _update(self, target: m.Expression, operator: str, by: m.Expression) -> m.Assign:
        if operator in _BIT_FUNCTIONS:
            return m.Assign((self._target(target),), _bits(operator, target, by))
        return m.Assign((self._target(target),), m.Binary(operator, target, by))

    def _target(self, target: m.Expression) -> m.Expression:
        if not isinstance(target, (m.Name, m.Call, m.Field)):
            raise self.fault("cannot assign to the left side")
        return target

    def _is_several(self) -> bool:
        # [a, b] = f(x), unlike an expression that begins with a bracket
        at = self.at
        while self.tokens[at].kind != "end" and self.tokens[at].text != "]":
            at += 1
        return self.tokens[min(at + 1, len(self.tokens) - 1)].text == "="

    def _targets(self) -> m.Expressions:
        self.at += 1
        targets: list[m.Expression] = []
        while not self.is_at("]"):
            targets.append(self._target(self._postfix()))
            self.accept(",")
        self.at += 1
        return tuple(targets)

    # expressions

    def expression(self) -> m.Expression:
        return self.nested(self.operations)

    def joined(self, left: m.Expression, level: int) -> m.Expression:
        operator = self.take().text
        self.pass_lines()
        right = self.operations(level + 1)
        if operator == "%%":
            return m.Call(m.Name("rem"), (left, right))
        if operator in _BIT_FUNCTIONS and (self.bits or operator in ("<<", ">>")):
            return _bits(operator, left, right)
        return m.Binary(_WRITTEN.get(operator, operator), left, right)

    def operand(self, lowest: int) -> m.Expression:
        if self.is_at("-", "+", "!", "~"):
            operator = self.take().text
            if operator == "~" and self.bits:
                return m.Call(m.Name("bitcmp"), (self.operand(lowest),))
            # a sign binds less tightly than ^: -x^2 is -(x^2)
            return m.Unary("~" if operator == "!" else operator, self.operand(lowest))
        left = self._postfix()
        while self.is_at("^") and not self.bits:
            self.at += 1
            left = m.Binary("^", left, self._signed())
        return left

    def _signed(self) -> m.Expression:
        if self.is_at("-", "+"):
            return m.Unary(self.take().text, self._signed())
        return self._postfix()

    def _postfix(self) -> m.Expression:
        tree = self._primary()
        while True:
            if self.is_at("("):
                tree = self._call(tree)
            elif self.is_at("["):
                tree = m.Call(tree, self._indices())
            elif self.is_at(".") and self.tokens[self.at + 1].kind == "name":
                self.at += 1
                tree = m.Field(tree, self.take().text)
            else:
                return tree

    def _call(self, of: m.Expression) -> m.Expression:
        name = of.name if isinstance(of, m.Name) else ""
        arguments = self._arguments()
        # ml.f(x) calls a function of MATLAB, as ml('f(x)') does
        if isinstance(of, m.Field) and of.of == m.Name("ml"):
            name = "ml"
        if name in _FUNCTIONS and not _FUNCTIONS[name]:
            raise ActionSyntaxError(f"{name} is not supported")
        return m.Call(m.Name(_FUNCTIONS[name]) if name in _FUNCTIONS else of, arguments)

    def _arguments(self) -> m.Expressions:
        self.at += 1
        arguments: list[m.Expression] = []
        self.pass_lines()
        while not self.is_at(")"):
            arguments.append(self.expression())
            self.pass_lines()
            if self.accept(","):
                self.pass_lines()
            elif not self.is_at(")"):
                self.close(")")
        self.at += 1
        return tuple(arguments)

    def _indices(self) -> m.Expressions:
        # x[0][1] is x(1, 2)
        indices: list[m.Expression] = []
        while self.accept("["):
            index = self.expression()
            self.close("]")
            indices.append(
                m.Number(index.value + 1) if isinstance(index, m.Number) else m.Binary("+", index, m.Number(1.0))
            )
        return tuple(indices)

    def _primary(self) -> m.Expression:
        token = self.take()
        match token.kind, token.text:
            case "number", text:
                return m.Number(_number(text))
            case "name", text:
                return m.Name(text)
            case "text", text:
                return m.Text(text[1:-1], text[0] == '"')
            case "operator", "(":
                self.pass_lines()
                tree = self.expression()
                self.close(")")
                return tree
        raise self.fault(f"unexpected {token.text!r}")


class _BitActionParser(_ActionParser):
    """The parser of a chart that enables C-bit operations."""

    levels = _BIT_LEVELS
    bits = True


def _parser(text: str, bits: bool) -> _ActionParser:
    return _BitActionParser(text) if bits else _ActionParser(text)


def _bits(operator: str, left: m.Expression, right: m.Expression) -> m.Call:
    return m.Call(m.Name(_BIT_FUNCTIONS[operator]), (left, right))


def _number(text: str) -> float:
    if text[:2] not in ("0x", "0X"):
        return float(text)
    try:
        return float(int(text, 16))
    except OverflowError:
        raise ActionSyntaxError(f"{text[:40]} has more digits than an integer of C") from None
