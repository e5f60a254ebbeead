"""The C action language of charts, as statements and expressions of `kennfeld.matlab.syntax`.

Elements of arrays are counted from 0 in it and from 1 in the tree. `&`, `|`, `^` and `~` are and, or, power and not
unless the chart says that they work on bits, which is not supported.
"""

import re
from typing import NamedTuple

from kennfeld.matlab import syntax as m

__all__ = ["ActionSyntaxError", "c_expression", "c_statements"]

_DEEPEST = 60  # brackets within brackets
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
_BINARY = frozenset({one for level in _LEVELS for one in level} | {"^", "=", "+=", "-=", "*=", "/="})
_WRITTEN = {"|": "||", "&": "&&", "!=": "~=", "<>": "~="}
_BITS = frozenset({"&", "|", "^", "~", "<<", ">>", "&=", "|=", "^="})
_CHANGES = {"+=": "+", "-=": "-", "*=": "*", "/=": "/"}
_FUNCTIONS = {"labs": "abs", "ldexp": "", "ml": "", "rand": "", "mod": "rem"}


class ActionSyntaxError(Exception):
    """Text that is none of what charts may hold; it says why."""


class _Token(NamedTuple):
    kind: str
    text: str


def c_expression(text: str, bits: bool = False) -> m.Expression:
    """The tree of an expression; raises `CError`.

    >>> c_expression("x[0] != 2") == m.Binary("~=", m.Call(m.Name("x"), (m.Number(1.0),)), m.Number(2.0))
    True
    """
    reader = _ActionParser(text, bits)
    reader.pass_lines()
    found = reader.expression()
    reader.pass_lines()
    if reader.token.kind != "over":
        raise ActionSyntaxError(f"{reader.token.text!r} does not belong to the expression {text.strip()[:60]}")
    return found


def c_statements(text: str, bits: bool = False) -> tuple[m.Statement, ...]:
    """The statements of actions, parted by `;`, `,` or line ends; raises `CError`."""
    return _ActionParser(text, bits).statements()


def _joined(tokens: list[_Token]) -> list[_Token]:
    """The words without line ends behind which an expression goes on with an operator."""
    made: list[_Token] = []
    for token in tokens:
        if token.kind == "operator" and token.text in _BINARY:
            while made and made[-1].kind == "line":
                made.pop()
        made.append(token)
    return made


class _ActionParser:
    def __init__(self, text: str, bits: bool) -> None:
        found = (match for match in _WORD.finditer(text) if match.lastgroup != "blank")
        self.tokens = _joined([_Token(str(match.lastgroup), match[match.lastgroup or 0]) for match in found])
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

    def statements(self) -> tuple[m.Statement, ...]:
        found: list[m.Statement] = []
        while True:
            while self.token.kind == "line" or self.next_is(";", ","):
                self.at += 1
            if self.token.kind == "over":
                return tuple(found)
            found.append(self._statement())
            if self.token.kind not in ("line", "over") and not self.next_is(";", ","):
                raise ActionSyntaxError(
                    f"{self.token.text!r} does not belong to the statement in {self.text.strip()[:60]}"
                )

    def _statement(self) -> m.Statement:
        if self.next_is("++", "--"):
            sign = self.take().text[0]
            return self._changed(self._postfix(), sign, m.Number(1.0))
        if self.next_is("[") and self._is_several():
            return m.Assign(self._targets(), self._value())
        first = self.expression()
        if self.next_is("=", ":="):
            return m.Assign((self._target(first),), self._value())
        if self.next_is("++", "--"):
            return self._changed(first, self.take().text[0], m.Number(1.0))
        if self.next_is(*_CHANGES):
            operator = _CHANGES[self.take().text]
            return self._changed(first, operator, self.expression())
        self._no_bits()
        return m.Evaluate(first)

    def _value(self) -> m.Expression:
        self.at += 1
        self.pass_lines()
        found = self.expression()
        if self.next_is("=", ":="):
            raise ActionSyntaxError(f"it assigns several variables at once in {self.text.strip()[:60]}")
        return found

    def _changed(self, target: m.Expression, operator: str, by: m.Expression) -> m.Assign:
        return m.Assign((self._target(target),), m.Binary(operator, target, by))

    def _target(self, target: m.Expression) -> m.Expression:
        if not isinstance(target, (m.Name, m.Call, m.Field)):
            raise ActionSyntaxError(f"nothing can be assigned to what stands left in {self.text.strip()[:60]}")
        return target

    def _is_several(self) -> bool:
        at = self.at
        while self.tokens[at].kind != "over" and self.tokens[at].text != "]":
            at += 1
        return self.tokens[min(at + 1, len(self.tokens) - 1)].text == "="

    def _targets(self) -> tuple[m.Expression, ...]:
        self.at += 1
        found: list[m.Expression] = []
        while not self.next_is("]"):
            found.append(self._target(self._postfix()))
            if self.next_is(","):
                self.at += 1
        self.at += 1
        return tuple(found)

    # expressions

    def expression(self) -> m.Expression:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise ActionSyntaxError(f"brackets are nested more than {_DEEPEST} deep")
        found = self._binary(0)
        self.depth -= 1
        return found

    def _no_bits(self) -> None:
        if self.next_is(*_BITS) and (self.bits or self.token.text in ("<<", ">>", "&=", "|=", "^=")):
            raise ActionSyntaxError(f"the operation {self.token.text} on bits is not supported")

    def _binary(self, level: int) -> m.Expression:
        if level == len(_LEVELS):
            return self._unary()
        left = self._binary(level + 1)
        while self.next_is(*_LEVELS[level]):
            self._no_bits()
            operator = self.take().text
            self.pass_lines()
            right = self._binary(level + 1)
            left = (
                _remainder(left, right) if operator == "%%" else m.Binary(_WRITTEN.get(operator, operator), left, right)
            )
        self._no_bits()
        return left

    def _unary(self) -> m.Expression:
        if self.next_is("-", "+", "!", "~"):
            self._no_bits()
            operator = self.take().text
            return m.Unary("~" if operator == "!" else operator, self._unary())
        left = self._postfix()
        while self.next_is("^"):
            self._no_bits()
            self.at += 1
            left = m.Binary("^", left, self._signed())
        return left

    def _signed(self) -> m.Expression:
        if self.next_is("-", "+"):
            return m.Unary(self.take().text, self._signed())
        return self._postfix()

    def _postfix(self) -> m.Expression:
        found = self._primary()
        while True:
            if self.next_is("("):
                found = self._call(found)
            elif self.next_is("["):
                found = m.Call(found, self._indices())
            elif self.next_is(".") and self.tokens[self.at + 1].kind == "name":
                self.at += 1
                found = m.Field(found, self.take().text)
            else:
                return found

    def _call(self, of: m.Expression) -> m.Expression:
        name = of.name if isinstance(of, m.Name) else ""
        arguments = self._arguments()
        if isinstance(of, m.Field) and of.of == m.Name("ml"):
            name = "ml"
        if name in _FUNCTIONS and not _FUNCTIONS[name]:
            raise ActionSyntaxError(f"it calls {name}, which is not supported")
        return m.Call(m.Name(_FUNCTIONS[name]) if name in _FUNCTIONS else of, arguments)

    def _arguments(self) -> tuple[m.Expression, ...]:
        self.at += 1
        found: list[m.Expression] = []
        self.pass_lines()
        while not self.next_is(")"):
            found.append(self.expression())
            self.pass_lines()
            if self.next_is(","):
                self.at += 1
                self.pass_lines()
            elif not self.next_is(")"):
                self.expect(")")
        self.at += 1
        return tuple(found)

    def _indices(self) -> tuple[m.Expression, ...]:
        found: list[m.Expression] = []
        while self.next_is("["):
            self.at += 1
            index = self.expression()
            self.expect("]")
            found.append(
                m.Number(index.value + 1) if isinstance(index, m.Number) else m.Binary("+", index, m.Number(1.0))
            )
        return tuple(found)

    def _primary(self) -> m.Expression:
        token = self.take()
        match token.kind, token.text:
            case "number", text:
                return m.Number(float(int(text, 16)) if text[:2] in ("0x", "0X") else float(text))
            case "name", text:
                return m.Name(text)
            case "text", text:
                return m.Text(text[1:-1], text[0] == '"')
            case "operator", "(":
                self.pass_lines()
                found = self.expression()
                self.expect(")")
                return found
        raise ActionSyntaxError(f"{token.text!r} cannot be read in {self.text.strip()[:60]}")


def _remainder(left: m.Expression, right: m.Expression) -> m.Expression:
    return m.Call(m.Name("rem"), (left, right))
