"""The parser of the C action language of charts; it produces the syntax tree of `kennfeld.matlab.syntax`.

Array indices count from 0 in C and from 1 in the tree. `&`, `|`, `^` and `~` mean and, or, power and not, unless the
chart enables bitwise operations, which are not supported.
"""

import re
from typing import NamedTuple

from kennfeld.matlab import syntax as m

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
_LEVELS = (
    ("||",),
    ("&&",),
    ("|",),
    ("&",),
    ("==", "!=", "~=", "<>"),
    ("<", "<=", ">", ">="),
    ("+", "-"),
    ("*", "/", "%%"),
)
_BINARY = frozenset({item for level in _LEVELS for item in level} | {"^", "=", "+=", "-=", "*=", "/="})
_WRITTEN = {"|": "||", "&": "&&", "!=": "~=", "<>": "~="}
_BITS = frozenset({"&", "|", "^", "~", "<<", ">>", "&=", "|=", "^="})
_CHANGES = {"+=": "+", "-=": "-", "*=": "*", "/=": "/"}
_FUNCTIONS = {"labs": "abs", "ldexp": "", "ml": "", "rand": "", "mod": "rem"}


class ActionSyntaxError(Exception):
    """Code that is not valid or not supported in charts."""


class _Token(NamedTuple):
    kind: str
    text: str


def parse_c_expression(text: str, bits: bool = False) -> m.Expression:
    """Parse an expression; raises `ActionSyntaxError`.

    >>> parse_c_expression("x[0] != 2") == m.Binary("~=", m.Call(m.Name("x"), (m.Number(1.0),)), m.Number(2.0))
    True
    """
    reader = _ActionParser(text, bits)
    reader.pass_lines()
    tree = reader.expression()
    reader.pass_lines()
    if reader.token.kind != "over":
        raise ActionSyntaxError(f"unexpected {reader.token.text!r} after the expression {text.strip()[:60]}")
    return tree


def parse_c_statements(text: str, bits: bool = False) -> m.Statements:
    """Parse the statements of an action, separated by `;`, `,` or line ends; raises `ActionSyntaxError`."""
    return _ActionParser(text, bits).statements()


def _join_lines(tokens: list[_Token]) -> list[_Token]:
    """Remove line ends in front of binary operators, which continue an expression."""
    joined: list[_Token] = []
    for token in tokens:
        if token.kind == "operator" and token.text in _BINARY:
            while joined and joined[-1].kind == "line":
                joined.pop()
        joined.append(token)
    return joined


class _ActionParser:
    def __init__(self, text: str, bits: bool) -> None:
        matches = (match for match in _WORD.finditer(text) if match.lastgroup != "blank")
        self.tokens = _join_lines([_Token(str(match.lastgroup), match[match.lastgroup or 0]) for match in matches])
        self.tokens.append(_Token("over", "the end"))
        self.bits, self.at, self.depth, self.text = bits, 0, 0, text

    @property
    def token(self) -> _Token:
        return self.tokens[self.at]

    def take(self) -> _Token:
        token = self.token
        self.at += token.kind != "over"
        return token

    def pass_lines(self) -> None:
        while self.token.kind == "line":
            self.at += 1

    def next_is(self, *words: str) -> bool:
        return self.token.kind == "operator" and self.token.text in words

    def expect(self, word: str) -> None:
        self.pass_lines()
        if not self.next_is(word):
            raise ActionSyntaxError(f"{word} is missing before {self.token.text!r} in {self.text.strip()[:60]}")
        self.at += 1

    # statements

    def statements(self) -> m.Statements:
        statements: list[m.Statement] = []
        while True:
            while self.token.kind == "line" or self.next_is(";", ","):
                self.at += 1
            if self.token.kind == "over":
                return tuple(statements)
            statements.append(self._statement())
            if self.token.kind not in ("line", "over") and not self.next_is(";", ","):
                raise ActionSyntaxError(
                    f"unexpected {self.token.text!r} after the statement in {self.text.strip()[:60]}"
                )

    def _statement(self) -> m.Statement:
        if self.next_is("++", "--"):
            sign = self.take().text[0]
            return self._update(self._postfix(), sign, m.Number(1.0))
        if self.next_is("[") and self._is_several():
            return m.Assign(self._targets(), self._value())
        first = self.expression()
        if self.next_is("=", ":="):
            return m.Assign((self._target(first),), self._value())
        if self.next_is("++", "--"):
            return self._update(first, self.take().text[0], m.Number(1.0))
        if self.next_is(*_CHANGES):
            return self._update(first, _CHANGES[self.take().text], self.expression())
        self._reject_bitwise()
        return m.Evaluate(first)

    def _value(self) -> m.Expression:
        self.at += 1
        self.pass_lines()
        value = self.expression()
        if self.next_is("=", ":="):
            raise ActionSyntaxError(f"chained assignment in {self.text.strip()[:60]}")
        return value

    def _update(self, target: m.Expression, operator: str, by: m.Expression) -> m.Assign:
        return m.Assign((self._target(target),), m.Binary(operator, target, by))

    def _target(self, target: m.Expression) -> m.Expression:
        if not isinstance(target, (m.Name, m.Call, m.Field)):
            raise ActionSyntaxError(f"cannot assign to the left side in {self.text.strip()[:60]}")
        return target

    def _is_several(self) -> bool:
        at = self.at
        while self.tokens[at].kind != "over" and self.tokens[at].text != "]":
            at += 1
        return self.tokens[min(at + 1, len(self.tokens) - 1)].text == "="

    def _targets(self) -> m.Expressions:
        self.at += 1
        targets: list[m.Expression] = []
        while not self.next_is("]"):
            targets.append(self._target(self._postfix()))
            if self.next_is(","):
                self.at += 1
        self.at += 1
        return tuple(targets)

    # expressions

    def expression(self) -> m.Expression:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise ActionSyntaxError(f"brackets are nested more than {_MAX_DEPTH} deep")
        tree = self._binary(0)
        self.depth -= 1
        return tree

    def _reject_bitwise(self) -> None:
        if self.next_is(*_BITS) and (self.bits or self.token.text in ("<<", ">>", "&=", "|=", "^=")):
            raise ActionSyntaxError(f"bitwise operator {self.token.text} is not supported")

    def _binary(self, level: int) -> m.Expression:
        if level == len(_LEVELS):
            return self._unary()
        left = self._binary(level + 1)
        while self.next_is(*_LEVELS[level]):
            self._reject_bitwise()
            operator = self.take().text
            self.pass_lines()
            right = self._binary(level + 1)
            left = (
                m.Call(m.Name("rem"), (left, right))
                if operator == "%%"
                else m.Binary(_WRITTEN.get(operator, operator), left, right)
            )
        self._reject_bitwise()
        return left

    def _unary(self) -> m.Expression:
        if self.next_is("-", "+", "!", "~"):
            self._reject_bitwise()
            operator = self.take().text
            return m.Unary("~" if operator == "!" else operator, self._unary())
        left = self._postfix()
        while self.next_is("^"):
            self._reject_bitwise()
            self.at += 1
            left = m.Binary("^", left, self._signed())
        return left

    def _signed(self) -> m.Expression:
        if self.next_is("-", "+"):
            return m.Unary(self.take().text, self._signed())
        return self._postfix()

    def _postfix(self) -> m.Expression:
        tree = self._primary()
        while True:
            if self.next_is("("):
                tree = self._call(tree)
            elif self.next_is("["):
                tree = m.Call(tree, self._indices())
            elif self.next_is(".") and self.tokens[self.at + 1].kind == "name":
                self.at += 1
                tree = m.Field(tree, self.take().text)
            else:
                return tree

    def _call(self, of: m.Expression) -> m.Expression:
        name = of.name if isinstance(of, m.Name) else ""
        arguments = self._arguments()
        if isinstance(of, m.Field) and of.of == m.Name("ml"):
            name = "ml"
        if name in _FUNCTIONS and not _FUNCTIONS[name]:
            raise ActionSyntaxError(f"{name} is not supported")
        return m.Call(m.Name(_FUNCTIONS[name]) if name in _FUNCTIONS else of, arguments)

    def _arguments(self) -> m.Expressions:
        self.at += 1
        arguments: list[m.Expression] = []
        self.pass_lines()
        while not self.next_is(")"):
            arguments.append(self.expression())
            self.pass_lines()
            if self.next_is(","):
                self.at += 1
                self.pass_lines()
            elif not self.next_is(")"):
                self.expect(")")
        self.at += 1
        return tuple(arguments)

    def _indices(self) -> m.Expressions:
        indices: list[m.Expression] = []
        while self.next_is("["):
            self.at += 1
            index = self.expression()
            self.expect("]")
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
                self.expect(")")
                return tree
        raise ActionSyntaxError(f"unexpected {token.text!r} in {self.text.strip()[:60]}")


def _number(text: str) -> float:
    if text[:2] not in ("0x", "0X"):
        return float(text)
    try:
        return float(int(text, 16))
    except OverflowError:
        raise ActionSyntaxError(f"{text[:40]} has more digits than an integer of C") from None
