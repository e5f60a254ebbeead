"""The parser of MATLAB text: expressions, and scripts with their local functions."""

import re
from collections.abc import Callable
from functools import lru_cache

from kennfeld.base.errors import Finding
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.expression_parser import ExpressionParser
from kennfeld.matlab.lexer import KEYWORDS, MatlabToken, TokenKind, tokenize
from kennfeld.program import tree as m
from kennfeld.program.traversal import assigned_name

_JUMPS = frozenset({"break", "continue", "return"})
_TARGETS = (m.Name, m.Field, m.DynamicField, m.Call, m.CellIndex)
_MAX_FINDINGS = 50
_MAX_DEPTH = 25
_MAX_KEPT = 500  # characters of an expression whose tree is kept
_CLAUSES = frozenset({"end", "else", "elseif", "case", "otherwise", "catch", "function"})

_END = frozenset({"end"})
_NAME = re.compile(r"[A-Za-z]\w*\Z", re.ASCII)
_BEGINNING = m.TextPosition(1, 1)


def parse_expression(text: str, name: str = "") -> m.Expression:
    """Parse an expression.

    Args:
        text: The expression.
        name: Its name in error messages.

    Returns:
        Its syntax tree.

    Raises:
        MatlabError: The text is not an expression; the finding names line and column.

    Example:
        >>> parse_expression("K*2") == m.Binary("*", m.Name("K"), m.Number(2.0))
        True
    """
    # most fields of blocks are the name of a variable
    if _NAME.match(text) and text not in KEYWORDS:
        return m.Name(text, place=_BEGINNING)
    # others repeat: `[0 1 2 3]` stands in hundreds of blocks of a model
    return _parse(text, name) if len(text) > _MAX_KEPT else _parse_once(text, name)


def _parse(text: str, name: str) -> m.Expression:
    parser = _ScriptParser(text, name, commands=False)
    parser.pass_stops()
    tree = parser.expression()
    parser.pass_stops()
    if parser.token.kind != TokenKind.END:
        raise parser.fail(f"unexpected {parser.describe_token()} after the expression")
    return tree


_parse_once = lru_cache(8192)(_parse)  # trees are immutable


def parse_script(text: str, name: str = "") -> m.Script:
    """Parse a script or a file of functions.

    Args:
        text: The script.
        name: Its name in error messages.

    Returns:
        Its syntax tree.

    Raises:
        MatlabError: The text is not valid; there is one finding per invalid statement.

    Example:
        >>> parse_script("K = 2; close all").statements[1].name
        'close'
    """
    script, findings = parse_leniently(text, name)
    if findings:
        raise MatlabError(findings)
    return script


def parse_leniently(text: str, name: str = "") -> tuple[m.Script, tuple[Finding, ...]]:
    """Parse the valid statements of a script; return them with one finding for each invalid statement."""
    parser = _ScriptParser(text, name)
    return parser.script(), tuple(parser.findings)


class _ScriptParser(ExpressionParser):
    """Parses statements; an invalid one is reported and skipped."""

    def __init__(self, text: str, name: str, commands: bool = True) -> None:
        text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
        tokens = tokenize(text, commands)
        self.comments = {}
        significant: list[MatlabToken] = []
        for token in tokens:
            if token.kind == TokenKind.COMMENT:
                # by the number of the token that follows
                self.comments[len(significant)] = token
            else:
                significant.append(token)
        super().__init__(text, significant, name)
        self.findings: list[Finding] = []
        self.blocks = 0
        self.unclosed: list[tuple[str, MatlabToken]] = []  # functions without end, with the next function

    def pass_stops(self) -> None:
        while self.token.kind == TokenKind.STOP:
            self.at += 1

    def script(self) -> m.Script:
        statements: list[m.Statement] = []
        functions: list[m.FunctionDefinition] = []
        while self.token.kind != TokenKind.END:
            statements += self.body(frozenset({"function"}))
            if self.token.kind == TokenKind.KEYWORD and self.token.text == "function":
                self._parse_guarded(lambda: functions.append(self._definition()))
        return m.Script(self.name, tuple(statements), tuple(functions))

    def body(self, ends: frozenset[str]) -> m.Statements:
        """Parse statements up to one of the keywords `ends`, which stays unread, or to the end of the text."""
        statements: list[m.Statement] = []
        while True:
            self.pass_stops()
            token = self.token
            if token.kind == TokenKind.END or (token.kind == TokenKind.KEYWORD and token.text in ends):
                return tuple(statements)
            if len(self.findings) >= _MAX_FINDINGS:
                # the rest is skipped: it would give more of the same findings
                self.at = len(self.tokens) - 1
                return tuple(statements)
            self._parse_guarded(lambda: statements.append(self._statement()))

    def _parse_guarded(self, read: Callable[[], None]) -> None:
        depth, blocks = self.depth, self.blocks
        try:
            read()
        except MatlabError as error:
            self.findings += error.findings
            self._recover(depth, blocks)

    def _recover(self, depth: int, blocks: int) -> None:
        self.depth, self.blocks, self.indices, self.spaced = depth, blocks, 0, False
        while self.token.kind not in (TokenKind.STOP, TokenKind.END):
            if self.token.text.endswith("is never closed"):  # the rest of the text belongs to it
                self.findings += self.fail("").findings
            self.at += 1

    def _statement(self) -> m.Statement:
        token = self.token
        place = self.place()
        if token.kind == TokenKind.COMMAND:
            self.at += 1
            self._expect_end()
            return m.Command(token.text, token.words, place=place)
        if token.kind == TokenKind.KEYWORD:
            return self._keyword(place)
        return self._simple(place)

    def _expect_end(self) -> None:
        if self.token.kind not in (TokenKind.STOP, TokenKind.END):
            raise self.fail(f"unexpected {self.describe_token()} after the statement")

    def _keyword(self, place: m.TextPosition) -> m.Statement:
        word = self.token.text
        blocks: dict[str, Callable[[m.TextPosition], m.Statement]] = {
            "if": self._if, "while": self._while, "for": self._for, "parfor": self._for, "switch": self._switch,
            "try": self._try,
        }  # fmt: skip
        if word in blocks:
            return self._block(blocks[word], place)
        if word in _JUMPS:
            self.at += 1
            self._expect_end()
            return m.Jump(word, place=place)
        if word in ("global", "persistent"):
            return self._declaration(place)
        if word == "end" and self.unclosed:
            raise self._nested(*self.unclosed.pop())
        message = f"{word} without an open block" if word in _CLAUSES else f"{word} is not supported"
        raise self.fail(message, "Remove it." if word == "end" else "")

    def _nested(self, outer: str, inner: MatlabToken) -> MatlabError:
        """Return the error for a function within a function, whose `end` follows that of the inner one."""
        message = f"a function is defined within the function {outer}; nested functions are not supported"
        return self.fail(
            message, f"Move it behind the end of {outer} and pass the variables it uses as arguments.", inner
        )

    def _block(self, read: Callable[[m.TextPosition], m.Statement], place: m.TextPosition) -> m.Statement:
        opening = self.take()
        self.blocks += 1
        if self.blocks > _MAX_DEPTH:
            self.at = len(self.tokens) - 1
            raise self.fail(f"blocks are nested more than {_MAX_DEPTH} deep", token=opening)
        block = read(place)
        if not self._is_keyword("end"):
            raise self.fail(f"{opening.text} is never closed", "Write end.", opening)
        self.blocks -= 1
        return block

    def _head(self) -> m.Expression:
        """Parse the expression behind a keyword; if it is invalid, the body of the block is still parsed."""
        place = self.place()
        try:
            return self.expression()
        except MatlabError as error:
            self.findings += error.findings
            self._recover(0, self.blocks)
            return m.Name("?", place=place)

    def _branch(self, ends: frozenset[str]) -> m.Branch:
        place = self.place()
        return m.Branch(self._head(), self.body(ends), place=place)

    def _is_keyword(self, word: str) -> bool:
        if self.token.kind == TokenKind.KEYWORD and self.token.text == word:
            self.at += 1
            return True
        return False

    def _if(self, place: m.TextPosition) -> m.If:
        ends = frozenset({"elseif", "else", "end"})
        branches = [self._branch(ends)]
        while self._is_keyword("elseif"):
            branches.append(self._branch(ends))
        return m.If(tuple(branches), self.body(_END) if self._is_keyword("else") else (), place=place)

    def _while(self, place: m.TextPosition) -> m.While:
        return m.While(self._head(), self.body(_END), place=place)

    def _for(self, place: m.TextPosition) -> m.For:
        # for (k = 1:3) and parfor (k = 1:3, 4)
        enclosed = self.accept("(")
        target = self._indexed()
        self._check(target)
        self.expect("=")
        values = self._head()
        if enclosed and self.accept(","):  # the maximum number of workers of a parfor
            self._head()
        if enclosed:
            self.expect(")")
        return m.For(target, values, self.body(_END), place=place)

    def _switch(self, place: m.TextPosition) -> m.Switch:
        subject, cases = self._head(), []
        ends = frozenset({"case", "otherwise", "end"})
        self.pass_stops()
        while self._is_keyword("case"):
            cases.append(self._branch(ends))
        return m.Switch(subject, tuple(cases), self.body(_END) if self._is_keyword("otherwise") else (), place=place)

    def _try(self, place: m.TextPosition) -> m.Try:
        body = self.body(frozenset({"catch", "end"}))
        if not self._is_keyword("catch"):
            return m.Try(body, place=place)
        name = ""
        # `catch err` names the error; anything longer is the first statement of the handler
        if self.token.kind == TokenKind.NAME and self.tokens[self.at + 1].kind == TokenKind.STOP:
            name = self.take().text
        return m.Try(body, name, self.body(_END), place=place)

    def _declaration(self, place: m.TextPosition) -> m.Declaration:
        kind, names = self.take().text, []
        while self.token.kind == TokenKind.NAME:
            names.append(self.take().text)
        self._expect_end()
        return m.Declaration(kind, tuple(names), place=place)

    def _simple(self, place: m.TextPosition) -> m.Statement:
        """Parse an assignment or an expression statement."""
        targets = self._targets() if self.is_at("[") and self._is_several() else None
        if targets is None:
            first = self.expression()
            if not self.is_at("="):
                self._expect_end()
                return m.Evaluate(first, place=place)
            self._check(first)
            targets = (first,)
        self.expect("=")
        value = self.expression()
        self._expect_end()
        return m.Assign(targets, value, self._end_comment(), place=place)

    def _check(self, target: m.Expression) -> None:
        if not isinstance(target, _TARGETS) or not assigned_name(target):
            message = "cannot assign to this expression"
            remedy = "Use == to compare." if isinstance(target, m.Binary) else ""
            raise MatlabError.at(self.name, target.place, message, remedy, self.lines.line(self.token.at).strip()[:200])

    def _is_several(self) -> bool:
        """Return True if the bracket here closes before a single `=`."""
        depth = 0
        for at in range(self.at, len(self.tokens) - 1):
            token = self.tokens[at]
            if token.kind in (TokenKind.STOP, TokenKind.BAD):
                return False
            if token.kind == TokenKind.OPERATOR:
                depth += (token.text in "([{") - (token.text in ")]}")
                if not depth:
                    after = self.tokens[at + 1]
                    return after.kind == TokenKind.OPERATOR and after.text == "="
        return False

    def _targets(self) -> tuple[m.Expression | None, ...]:
        self.at += 1
        targets: list[m.Expression | None] = []
        # blanks separate targets, as they separate elements: [a b] = f(x)
        self.spaced = True
        while not self.is_at("]"):
            if self.accept("~", "!"):
                targets.append(None)
            else:
                target = self._indexed()
                self._check(target)
                targets.append(target)
            self.accept(",")
        self.spaced = False
        self.at += 1
        if not targets:
            raise self.fail("the list of targets is empty")
        return tuple(targets)

    def _end_comment(self) -> str:
        """Return the comment at the end of the line, unless another statement follows on the line."""
        at = self.at
        # a semicolon precedes the comment
        while self.tokens[at].kind == TokenKind.STOP and self.tokens[at].text != "\n":
            at += 1
        comment = self.comments.get(at)
        return comment.text.strip() if comment else ""

    def _definition(self) -> m.FunctionDefinition:
        place = self.place(self.take())
        results: tuple[str, ...] = ()
        if self.is_at("["):
            results = self._results()
            self.expect("=")
        elif self.tokens[self.at + 1].text == "=":
            results = (self._plain_name(),)
            self.expect("=")
        name = self._plain_name()
        parameters = self.parameters() if self.is_at("(") else ()
        self._expect_end()
        body = self.body(frozenset({"function", "end"}))
        # `function` follows: either the functions of this file have no `end`, or that one is nested, which an `end`
        # left over shows
        if not self._is_keyword("end") and self.token.kind == TokenKind.KEYWORD:
            self.unclosed.append((name, self.token))
        return m.FunctionDefinition(name, parameters, results, body, place=place)

    def _results(self) -> tuple[str, ...]:
        self.at += 1
        names = []
        while not self.is_at("]"):
            names.append(self._plain_name())
            self.accept(",")
        self.at += 1
        return tuple(names)

    def _plain_name(self) -> str:
        is_command = self.token.kind == TokenKind.COMMAND and not self.token.words
        if self.token.kind != TokenKind.NAME and not is_command:
            raise self.fail(f"a name is missing before {self.describe_token()}")
        return self.take().text
