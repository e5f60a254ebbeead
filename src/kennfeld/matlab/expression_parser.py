r"""Turns the words of an expression into its tree.

Precedence, from the loosest: `||`, `&&`, `|`, `&`, comparisons, `:`, `+ -`, `* / \`, signs and `~`, powers and
transposes; all of them from left to right.
"""

from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.lexer import Lines, MatlabToken, TokenKind
from kennfeld.matlab.syntax import (
    AnonymousFunction,
    Binary,
    Call,
    CellArray,
    CellIndex,
    Colon,
    DynamicField,
    End,
    Expression,
    Field,
    FunctionHandle,
    Matrix,
    Name,
    Number,
    Range,
    SourcePosition,
    Text,
    Transpose,
    Unary,
    children,
)

__all__ = ["ExpressionParser"]

DEEPEST = 150  # levels of a tree
_BRACKETS = 30  # within each other
_LEVELS = (("||",), ("&&",), ("|",), ("&",), ("==", "~=", "!=", "<", "<=", ">", ">="))
_SUMS = (("+", "-"), ("*", "/", "\\", ".*", "./", ".\\"))
_SIGNS = ("+", "-", "~", "!")
_POWERS = ("^", ".^")
_BASES = ("0x", "0X", "0b", "0B")
_OPENS_OPERAND = frozenset("([{@")
_OPERANDS = (TokenKind.NUMBER, TokenKind.NAME, TokenKind.TEXT, TokenKind.STRING)


class ExpressionParser:
    """Reads expressions from tokens, beginning at `at`; raises `MatlabError` at the first that does not fit."""

    def __init__(self, text: str, tokens: list[MatlabToken], name: str) -> None:
        self.lines = Lines(text)
        self.tokens = tokens
        self.name = name
        self.at = 0
        self.depth = 0
        self.steps = 0  # that may have made the tree higher
        self.indices = 0  # within which `end` has a meaning
        self.spaced = False  # within [] or {}, where blanks part elements

    @property
    def token(self) -> MatlabToken:
        return self.tokens[self.at]

    def place(self, token: MatlabToken | None = None) -> SourcePosition:
        return self.lines.place((token or self.token).at)

    def fail(self, message: str, remedy: str = "", token: MatlabToken | None = None) -> MatlabError:
        """The error at a token; by default the next one."""
        token = token or self.token
        message, remedy = (token.text, "") if token.kind == TokenKind.BAD else (message, remedy)
        return MatlabError.at(self.name, self.place(token), message, remedy, self.lines.line(token.at).strip()[:200])

    def take(self) -> MatlabToken:
        token = self.token
        self.at += token.kind != TokenKind.OVER
        return token

    def is_operator(self, *words: str) -> bool:
        return self.token.kind == TokenKind.OPERATOR and self.token.text in words

    def expect(self, word: str) -> None:
        if not self.is_operator(word):
            raise self.fail(f"{word} is missing before {self.said()}")
        self.at += 1

    def said(self) -> str:
        """The next token, for a message."""
        token = self.token
        ends = {
            TokenKind.STOP: "the end of the statement",
            TokenKind.OVER: "the end",
            TokenKind.ROW: "the end of the row",
        }
        return ends.get(token.kind, repr(token.text[:40]))

    def expression(self) -> Expression:
        """An expression of any kind but a bare colon."""
        self.depth += 1
        if self.depth > _BRACKETS:
            raise self.fail(f"brackets are nested more than {_BRACKETS} deep", "Break the expression up.")
        begin, self.steps = self.token, 0 if self.depth == 1 else self.steps
        found = self._binary(0)
        self.depth -= 1
        if not self.depth and self.steps > DEEPEST and _height(found) > DEEPEST:
            raise self._too_long(begin)
        return found

    def _binary(self, level: int) -> Expression:
        if level == len(_LEVELS):
            return self._range()
        left = self._binary(level + 1)
        while self._continues(_LEVELS[level]):
            left = self._joined(left, self.take(), self._binary(level + 1))
        return left

    def _too_long(self, token: MatlabToken) -> MatlabError:
        return self.fail(f"more than {DEEPEST} operators follow each other", "Break the expression up.", token)

    def _joined(self, left: Expression, token: MatlabToken, right: Expression) -> Expression:
        self.steps += 1
        return Binary("~=" if token.text == "!=" else token.text, left, right, place=left.place)

    def _continues(self, words: tuple[str, ...]) -> bool:
        """Whether the next token is one of these operators, not a sign that begins the next element: [1 -2]."""
        if not self.is_operator(*words):
            return False
        if not self.spaced or not self.token.blank or self.token.text not in _SIGNS:
            return True
        return self.tokens[self.at + 1].blank

    def _range(self) -> Expression:
        first = self._sum(0)
        if not self.is_operator(":"):
            return first
        self.at += 1
        second = self._sum(0)
        if not self.is_operator(":"):
            return Range(first, None, second, place=first.place)
        self.at += 1
        return Range(first, second, self._sum(0), place=first.place)

    def _sum(self, level: int) -> Expression:
        if level == len(_SUMS):
            return self._signed()
        left = self._sum(level + 1)
        while self._continues(_SUMS[level]):
            left = self._joined(left, self.take(), self._sum(level + 1))
        return left

    def _signed(self) -> Expression:
        signs = self._signs()
        return self._under(signs, self._power())

    def _signs(self) -> list[MatlabToken]:
        signs = []
        while self.is_operator(*_SIGNS):
            signs.append(self.take())
        self.steps += len(signs)
        return signs

    def _under(self, signs: list[MatlabToken], operand: Expression) -> Expression:
        for sign in reversed(signs):
            word = "~" if sign.text == "!" else sign.text
            operand = Unary(word, operand, place=self.place(sign))
        return operand

    def _power(self) -> Expression:
        found = self._indexed()
        while True:
            self.steps += 1
            if self.is_operator("'", ".'"):
                found = Transpose(found, self.take().text == "'", place=found.place)
            elif self._continues(_POWERS):
                word = self.take().text
                signs = self._signs()
                found = Binary(word, found, self._under(signs, self._indexed()), place=found.place)
            else:
                self.steps -= 1
                return found

    def _indexed(self) -> Expression:
        """An operand with its fields and indices."""
        found = self._atom()
        while not (self.spaced and self.token.blank):
            if self.is_operator("("):
                found = Call(found, self.arguments("(", ")"), place=found.place)
            elif self.is_operator("{"):
                found = CellIndex(found, self.arguments("{", "}"), place=found.place)
            elif self.is_operator("."):
                found = self._field(found)
            else:
                break
            self.steps += 1
        return found

    def _field(self, of: Expression) -> Expression:
        self.at += 1
        if self.is_operator("("):
            self.at += 1
            name = self._enclosed(")")
            return DynamicField(of, name, place=of.place)
        if self.token.kind != TokenKind.NAME:
            raise self.fail(f"a field name is missing before {self.said()}")
        return Field(of, self.take().text, place=of.place)

    def _enclosed(self, closing: str) -> Expression:
        spaced, self.spaced = self.spaced, False
        found = self.expression()
        self.expect(closing)
        self.spaced = spaced
        return found

    def arguments(self, opening: str, closing: str) -> tuple[Expression, ...]:
        """What stands between brackets behind an operand."""
        self.expect(opening)
        spaced, self.spaced = self.spaced, False
        self.indices += 1
        found = []
        while not self.is_operator(closing):
            found.append(self._argument(closing))
            if self.is_operator(","):
                self.at += 1
                if self.is_operator(closing):
                    raise self.fail(f"an argument is missing before {self.said()}")
            elif not self.is_operator(closing):
                raise self.fail(f"{closing} or a comma is missing before {self.said()}")
        self.at += 1
        self.indices -= 1
        self.spaced = spaced
        return tuple(found)

    def _argument(self, closing: str) -> Expression:
        after = self.tokens[self.at + 1] if self.is_operator(":") else None
        if after is not None and after.kind == TokenKind.OPERATOR and after.text in (",", closing):
            return Colon(place=self.place(self.take()))
        return self.expression()

    def _atom(self) -> Expression:
        token = self.token
        place = self.place()
        if token.kind == TokenKind.NUMBER:
            return self._number(self.take(), place)
        if token.kind == TokenKind.NAME:
            return Name(self.take().text, place=place)
        if token.kind == TokenKind.TEXT:
            return Text(self.take().text[1:-1].replace("''", "'"), place=place)
        if token.kind == TokenKind.STRING:
            return Text(self.take().text[1:-1].replace('""', '"'), True, place=place)
        if token.kind == TokenKind.KEYWORD and token.text == "end" and self.indices:
            self.at += 1
            return End(place=place)
        if self.is_operator("("):
            self.at += 1
            return self._enclosed(")")
        if self.is_operator("["):
            return Matrix(self._rows("]"), place=place)
        if self.is_operator("{"):
            return CellArray(self._rows("}"), place=place)
        if self.is_operator("@"):
            return self._function()
        raise self.fail(f"a value is missing before {self.said()}")

    def _number(self, token: MatlabToken, place: SourcePosition) -> Expression:
        text = token.text
        if text[:2] in _BASES:
            base = 16 if text[1] in "xX" else 2
            digits, sign, bits = text[2:], "u", ""
            for mark in "us":
                if mark in digits:
                    digits, sign, bits = *digits.split(mark)[:1], mark, digits.split(mark)[1]
            value = int(digits, base)
            fitting = bits or str(next((size for size in (8, 16, 32) if value < 2**size), 64))
            if value >= 2 ** int(fitting):
                raise self.fail(f"{text[:40]} has more than {fitting} bits", token=token)
            return Number(float(value), f"{sign}{fitting}", place=place)
        if text[-1] in "ij":
            return Number(float(text[:-1].lower().replace("d", "e")), "i", place=place)
        return Number(float(text.lower().replace("d", "e")), place=place)

    def _rows(self, closing: str) -> tuple[tuple[Expression, ...], ...]:
        self.at += 1
        spaced, self.spaced = self.spaced, True
        indices, rows, row = self.indices, [], list[Expression]()
        while not self.is_operator(closing):
            if self.token.kind == TokenKind.ROW:
                self.at += 1
                rows.append(tuple(row))
                row = []
            elif self.token.kind == TokenKind.COMMENT:
                self.at += 1
            elif (literal := self._literal()) is not None:
                row.append(literal)
            else:
                row.append(self.expression())
                self._separated(closing)
        self.at += 1
        self.indices = indices
        self.spaced = spaced
        return tuple(one for one in (*rows, tuple(row)) if one)

    def _literal(self) -> Expression | None:
        """A number that is an element by itself, passed with its comma: tables of thousands hold little else."""
        token, after = self.token, self.tokens[self.at + 1] if self.at + 1 < len(self.tokens) else self.token
        if token.kind != TokenKind.NUMBER or not token.text[-1].isdigit() or token.text[:2] in _BASES:
            return None
        is_comma = after.kind == TokenKind.OPERATOR and after.text == ","
        if not (is_comma or after.kind == TokenKind.ROW or (after.kind == TokenKind.NUMBER and after.blank)):
            return None
        follows = self.tokens[self.at + 2] if is_comma else after
        if is_comma and follows.kind == TokenKind.OPERATOR and follows.text == ",":
            return None
        place = self.place()
        self.at += 1 + is_comma
        return Number(float(token.text.lower().replace("d", "e")), place=place)

    def _separated(self, closing: str) -> None:
        """Pass what parts an element from the next one."""
        if self.is_operator(","):
            self.at += 1
            if self.is_operator(","):
                raise self.fail("an element is missing before ','")
            return
        token = self.token
        begins = token.kind in (*_OPERANDS, TokenKind.KEYWORD) or (
            token.kind == TokenKind.OPERATOR and (token.text in _OPENS_OPERAND or token.text in _SIGNS)
        )
        ends = token.kind in (TokenKind.ROW, TokenKind.COMMENT) or self.is_operator(closing)
        if not ends and not (begins and token.blank):
            raise self.fail(f"{closing} is missing before {self.said()}")

    def _function(self) -> Expression:
        place = self.place(self.take())
        if self.token.kind == TokenKind.NAME:
            name = self.take().text
            while self.is_operator(".") and self.tokens[self.at + 1].kind == TokenKind.NAME:
                name += "." + self.tokens[self.at + 1].text
                self.at += 2
            return FunctionHandle(name, place=place)
        parameters = self.parameters()
        indices, self.indices = self.indices, 0
        body = self.expression()
        self.indices = indices
        return AnonymousFunction(parameters, body, place=place)

    def parameters(self) -> tuple[str, ...]:
        """The names between the round brackets of a function that is defined."""
        self.expect("(")
        found = []
        while not self.is_operator(")"):
            if self.token.kind != TokenKind.NAME and not self.is_operator("~"):
                raise self.fail(f"the name of a parameter is missing before {self.said()}")
            found.append(self.take().text)
            if self.is_operator(","):
                self.at += 1
            elif not self.is_operator(")"):
                raise self.fail(f") or a comma is missing before {self.said()}")
        self.at += 1
        return tuple(found)


def _height(tree: Expression) -> int:
    """How many levels a tree has; of those that are too high, no more than is needed to see it."""
    height, level = 0, [tree]
    while level and height <= DEEPEST:
        level = [child for node in level for child in children(node)]
        height += 1
    return height
