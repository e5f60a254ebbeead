r"""The parser of expressions.

Precedence, from the lowest: `||`, `&&`, `|`, `&`, comparisons, `:`, `+ -`, `* / \`, signs and `~`, powers and
transposes; all of them associate to the left.
"""

from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.lexer import MatlabToken, TokenKind
from kennfeld.program import tree as m
from kennfeld.program.operator_parser import OperatorParser, operator_levels
from kennfeld.program.positions import TextLines
from kennfeld.program.traversal import children

MAX_HEIGHT = 150  # levels of a tree
_MAX_BRACKETS = 30  # nested
_LEVELS = operator_levels(
    ("||",), ("&&",), ("|",), ("&",), ("==", "~=", "!=", "<", "<=", ">", ">="), (":",), ("+", "-"),
    ("*", "/", "\\", ".*", "./", ".\\"),
)  # fmt: skip
_RANGE = _LEVELS[":"]
_SIGNS = ("+", "-", "~", "!")
_POWERS = ("^", ".^")
_BASES = ("0x", "0X", "0b", "0B")
_OPENS_OPERAND = frozenset("([{@")
_OPERANDS = (TokenKind.NUMBER, TokenKind.NAME, TokenKind.TEXT, TokenKind.STRING)


class ExpressionParser(OperatorParser[MatlabToken, m.Expression]):
    """Parses expressions from tokens, beginning at `at`; raises `MatlabError` at the first unexpected one."""

    levels = _LEVELS

    def __init__(self, text: str, tokens: list[MatlabToken], name: str) -> None:
        super().__init__(tokens)
        self.lines = TextLines(text)
        self.name = name
        self.steps = 0  # upper bound of the growth in height of the tree
        self.indices = 0  # depth of indices, in which `end` is valid
        self.spaced = False  # within [] or {}, where blanks separate elements
        self.range_end = 0  # behind the last range, where a colon cannot follow

    def place(self, token: MatlabToken | None = None) -> m.TextPosition:
        return self.lines.position((token or self.token).at)

    def fail(self, message: str, remedy: str = "", token: MatlabToken | None = None) -> MatlabError:
        """Return the error at a token, by default the next one."""
        token = token or self.token
        message, remedy = (token.text, "") if token.kind == TokenKind.BAD else (message, remedy)
        return MatlabError.at(self.name, self.place(token), message, remedy, self.lines.line(token.at).strip()[:200])

    def missing(self, text: str) -> MatlabError:
        """Return the error that another token than `text` follows."""
        return self.fail(f"{text} is missing before {self.describe_token()}")

    def describe_token(self) -> str:
        """Describe the next token for a message."""
        token = self.token
        ends = {
            TokenKind.STOP: "the end of the statement",
            TokenKind.END: "the end",
            TokenKind.ROW: "the end of the row",
        }
        return ends.get(token.kind, repr(token.text[:40]))

    def expression(self) -> m.Expression:
        """Parse an expression other than a bare colon."""
        self.depth += 1
        if self.depth > _MAX_BRACKETS:
            raise self.fail(f"brackets are nested more than {_MAX_BRACKETS} deep", "Split the expression.")
        begin, self.steps = self.token, 0 if self.depth == 1 else self.steps
        tree = self.operations()
        self.depth -= 1
        if not self.depth and self.steps > MAX_HEIGHT and _height(tree) > MAX_HEIGHT:
            raise self.fail(f"more than {MAX_HEIGHT} operators in a row", "Split the expression.", begin)
        return tree

    def level(self) -> int:
        """Return the level of the next operator; -1 for the sign of an element, [1 -2], and behind a whole range."""
        level = super().level()
        ends = level >= 0 and ((self.spaced and self._is_sign()) or (self.at == self.range_end and level == _RANGE))
        return -1 if ends else level

    def _is_sign(self) -> bool:
        """Return True if the next operator is the sign of an element, with a blank before it only."""
        token = self.token
        return token.blank and token.text in _SIGNS and not self.tokens[self.at + 1].blank

    def operand(self, lowest: int) -> m.Expression:
        """Parse an operand with its signs and powers."""
        return self._apply_signs(self._signs(), self._power())

    def joined(self, left: m.Expression, level: int) -> m.Expression:
        """Parse an operator with its right operand, or the rest of a range."""
        word = self.take().text
        right = self.operations(level + 1)
        if word == ":":
            step, last = (right, self.operations(level + 1)) if self.accept(":") else (None, right)
            self.range_end = self.at
            return m.Range(left, step, last, place=left.place)
        self.steps += 1
        return m.Binary("~=" if word == "!=" else word, left, right, place=left.place)

    def _signs(self) -> list[MatlabToken]:
        signs = []
        while self.is_at(*_SIGNS):
            signs.append(self.take())
        self.steps += len(signs)
        return signs

    def _apply_signs(self, signs: list[MatlabToken], operand: m.Expression) -> m.Expression:
        for sign in reversed(signs):
            word = "~" if sign.text == "!" else sign.text
            operand = m.Unary(word, operand, place=self.place(sign))
        return operand

    def _power(self) -> m.Expression:
        tree = self._indexed()
        while True:
            self.steps += 1
            if self.is_at("'", ".'"):
                tree = m.Transpose(tree, self.take().text == "'", place=tree.place)
            elif self.is_at(*_POWERS):
                word = self.take().text
                signs = self._signs()
                tree = m.Binary(word, tree, self._apply_signs(signs, self._indexed()), place=tree.place)
            else:
                self.steps -= 1
                return tree

    def _indexed(self) -> m.Expression:
        """Parse an operand with its fields and indices."""
        tree = self._atom()
        while not (self.spaced and self.token.blank):
            if self.is_at("("):
                tree = m.Call(tree, self.arguments("(", ")"), place=tree.place)
            elif self.is_at("{"):
                tree = m.CellIndex(tree, self.arguments("{", "}"), place=tree.place)
            elif self.is_at("."):
                tree = self._field(tree)
            else:
                break
            self.steps += 1
        return tree

    def _field(self, of: m.Expression) -> m.Expression:
        self.at += 1
        if self.accept("("):
            return m.DynamicField(of, self._parse_enclosed(), place=of.place)
        if self.token.kind != TokenKind.NAME:
            raise self.fail(f"a field name is missing before {self.describe_token()}")
        return m.Field(of, self.take().text, place=of.place)

    def _parse_enclosed(self) -> m.Expression:
        spaced, self.spaced = self.spaced, False
        tree = self.expression()
        self.expect(")")
        self.spaced = spaced
        return tree

    def arguments(self, opening: str, closing: str) -> m.Expressions:
        """Parse the arguments between brackets behind an operand."""
        self.expect(opening)
        spaced, self.spaced = self.spaced, False
        self.indices += 1
        arguments = []
        while not self.is_at(closing):
            arguments.append(self._argument(closing))
            if self.accept(","):
                if self.is_at(closing):
                    raise self.fail(f"an argument is missing before {self.describe_token()}")
            elif not self.is_at(closing):
                raise self.fail(f"{closing} or a comma is missing before {self.describe_token()}")
        self.at += 1
        self.indices -= 1
        self.spaced = spaced
        return tuple(arguments)

    def _argument(self, closing: str) -> m.Expression:
        after = self.tokens[self.at + 1] if self.is_at(":") else None
        if after is not None and after.kind == TokenKind.OPERATOR and after.text in (",", closing):
            return m.Colon(place=self.place(self.take()))
        return self.expression()

    def _atom(self) -> m.Expression:
        token = self.token
        place = self.place()
        if token.kind == TokenKind.NUMBER:
            return self._number(self.take(), place)
        if token.kind == TokenKind.NAME:
            return m.Name(self.take().text, place=place)
        if token.kind == TokenKind.TEXT:
            return m.Text(self.take().text[1:-1].replace("''", "'"), place=place)
        if token.kind == TokenKind.STRING:
            return m.Text(self.take().text[1:-1].replace('""', '"'), True, place=place)
        if token.kind == TokenKind.KEYWORD and token.text == "end" and self.indices:
            self.at += 1
            return m.End(place=place)
        if self.accept("("):
            return self._parse_enclosed()
        if self.is_at("["):
            return m.Matrix(self._rows("]"), place=place)
        if self.is_at("{"):
            return m.CellArray(self._rows("}"), place=place)
        if self.is_at("@"):
            return self._function()
        raise self.fail(f"a value is missing before {self.describe_token()}")

    def _number(self, token: MatlabToken, place: m.TextPosition) -> m.Expression:
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
            return m.Number(float(value), f"{sign}{fitting}", place=place)
        if text[-1] in "ij":
            return m.Number(float(text[:-1].lower().replace("d", "e")), "i", place=place)
        return m.Number(float(text.lower().replace("d", "e")), place=place)

    def _rows(self, closing: str) -> tuple[m.Expressions, ...]:
        self.at += 1
        spaced, self.spaced = self.spaced, True
        indices, rows, row = self.indices, [], list[m.Expression]()
        while not self.is_at(closing):
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
                self._pass_separator(closing)
        self.at += 1
        self.indices = indices
        self.spaced = spaced
        return tuple(elements for elements in (*rows, tuple(row)) if elements)

    def _literal(self) -> m.Expression | None:
        """Parse a number that is an element by itself, with its comma: large tables consist of them."""
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
        return m.Number(float(token.text.lower().replace("d", "e")), place=place)

    def _pass_separator(self, closing: str) -> None:
        """Pass the separator between two elements."""
        if self.accept(","):
            if self.is_at(","):
                raise self.fail("an element is missing before ','")
            return
        token = self.token
        begins = token.kind in (*_OPERANDS, TokenKind.KEYWORD) or (
            token.kind == TokenKind.OPERATOR and (token.text in _OPENS_OPERAND or token.text in _SIGNS)
        )
        ends = token.kind in (TokenKind.ROW, TokenKind.COMMENT) or self.is_at(closing)
        if not ends and not (begins and token.blank):
            raise self.fail(f"{closing} is missing before {self.describe_token()}")

    def _function(self) -> m.Expression:
        place = self.place(self.take())
        if self.token.kind == TokenKind.NAME:
            name = self.take().text
            while self.is_at(".") and self.tokens[self.at + 1].kind == TokenKind.NAME:
                name += "." + self.tokens[self.at + 1].text
                self.at += 2
            return m.FunctionHandle(name, place=place)
        parameters = self.parameters()
        indices, self.indices = self.indices, 0
        body = self.expression()
        self.indices = indices
        return m.AnonymousFunction(parameters, body, place=place)

    def parameters(self) -> tuple[str, ...]:
        """Parse the parameter names of a function definition."""
        self.expect("(")
        names = []
        while not self.is_at(")"):
            if self.token.kind != TokenKind.NAME and not self.is_at("~"):
                raise self.fail(f"the name of a parameter is missing before {self.describe_token()}")
            names.append(self.take().text)
            if not self.accept(",") and not self.is_at(")"):
                raise self.fail(f") or a comma is missing before {self.describe_token()}")
        self.at += 1
        return tuple(names)


def _height(tree: m.Expression) -> int:
    """Return the number of levels of a tree, counted up to `MAX_HEIGHT + 1`."""
    height, level = 0, [tree]
    while level and height <= MAX_HEIGHT:
        level = [child for node in level for child in children(node)]
        height += 1
    return height
