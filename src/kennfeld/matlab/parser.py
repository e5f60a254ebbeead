"""Turns MATLAB text into its tree: an expression, or a script with its local functions."""

from collections.abc import Callable

from kennfeld.errors import Finding
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.expression_parser import ExpressionParser
from kennfeld.matlab.lexer import MatlabToken, TokenKind, tokenize
from kennfeld.matlab.syntax import (
    Assign,
    Binary,
    Branch,
    Call,
    CellIndex,
    Command,
    Declaration,
    DynamicField,
    Evaluate,
    Expression,
    Field,
    For,
    FunctionDefinition,
    If,
    Jump,
    Name,
    Script,
    SourcePosition,
    Statement,
    Switch,
    Try,
    While,
)

__all__ = ["parse_expression", "parse_leniently", "parse_script"]

_JUMPS = frozenset({"break", "continue", "return"})
_TARGETS = (Name, Field, DynamicField, Call, CellIndex)
_MOST_FINDINGS = 50
_DEEPEST = 25
_CLAUSES = frozenset({"end", "else", "elseif", "case", "otherwise", "catch", "function"})

_END = frozenset({"end"})


def parse_expression(text: str, name: str = "") -> Expression:
    """The tree of one expression; `MatlabError` with line and column where it is none.

    >>> from kennfeld.matlab.syntax import Name, Number
    >>> parse_expression("K*2") == Binary("*", Name("K"), Number(2.0))
    True
    """
    parser = _ScriptParser(text, name, commands=False)
    parser.pass_stops()
    found = parser.expression()
    parser.pass_stops()
    if parser.token.kind != TokenKind.OVER:
        raise parser.fail(f"{parser.said()} does not belong to the expression")
    return found


def parse_script(text: str, name: str = "") -> Script:
    """The tree of a script or of a file of functions; `MatlabError` with every finding.

    >>> parse_script("K = 2; close all").statements[1].name
    'close'
    """
    script, findings = parse_leniently(text, name)
    if findings:
        raise MatlabError(findings)
    return script


def parse_leniently(text: str, name: str = "") -> tuple[Script, tuple[Finding, ...]]:
    """What can be read of a script, and a finding for each statement that cannot."""
    parser = _ScriptParser(text, name)
    return parser.script(), tuple(parser.findings)


def _clean(text: str) -> str:
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


class _ScriptParser(ExpressionParser):
    """Reads statements; one that is wrong is told and passed over."""

    def __init__(self, text: str, name: str, commands: bool = True) -> None:
        text = _clean(text)
        tokens = tokenize(text, commands)
        self.comments = {}
        kept: list[MatlabToken] = []
        for token in tokens:
            if token.kind == TokenKind.COMMENT:
                self.comments[len(kept)] = token
            else:
                kept.append(token)
        super().__init__(text, kept, name)
        self.findings: list[Finding] = []
        self.blocks = 0
        self.unclosed: list[
            tuple[str, MatlabToken]
        ] = []  # functions without end so far, with the one that begins in them

    def pass_stops(self) -> None:
        while self.token.kind == TokenKind.STOP:
            self.at += 1

    def script(self) -> Script:
        statements: list[Statement] = []
        functions: list[FunctionDefinition] = []
        while self.token.kind != TokenKind.OVER:
            statements += self.body(frozenset({"function"}))
            if self.token.kind == TokenKind.KEYWORD and self.token.text == "function":
                self._guarded(lambda: functions.append(self._definition()))
        return Script(self.name, tuple(statements), tuple(functions))

    def body(self, ends: frozenset[str]) -> tuple[Statement, ...]:
        """Statements up to one of these keywords, which stays unread, or to the end of the text."""
        found: list[Statement] = []
        while True:
            self.pass_stops()
            token = self.token
            if token.kind == TokenKind.OVER or (token.kind == TokenKind.KEYWORD and token.text in ends):
                return tuple(found)
            if len(self.findings) >= _MOST_FINDINGS:
                self.at = len(self.tokens) - 1
                return tuple(found)
            self._guarded(lambda: found.append(self._statement()))

    def _guarded(self, read: Callable[[], None]) -> None:
        depth, blocks = self.depth, self.blocks
        try:
            read()
        except MatlabError as error:
            self.findings += error.findings
            self._recover(depth, blocks)

    def _recover(self, depth: int, blocks: int) -> None:
        self.depth, self.blocks, self.indices, self.spaced = depth, blocks, 0, False
        while self.token.kind not in (TokenKind.STOP, TokenKind.OVER):
            if self.token.text.endswith("is never closed"):  # it has taken the rest of the text with it
                self.findings += self.fail("").findings
            self.at += 1

    def _statement(self) -> Statement:
        token = self.token
        place = self.place()
        if token.kind == TokenKind.COMMAND:
            self.at += 1
            self._finished()
            return Command(token.text, token.words, place=place)
        if token.kind == TokenKind.KEYWORD:
            return self._keyword(place)
        return self._simple(place)

    def _finished(self) -> None:
        if self.token.kind not in (TokenKind.STOP, TokenKind.OVER):
            raise self.fail(f"{self.said()} does not belong to the statement")

    def _keyword(self, place: SourcePosition) -> Statement:
        word = self.token.text
        blocks: dict[str, Callable[[SourcePosition], Statement]] = {
            "if": self._if,
            "while": self._while,
            "for": self._for,
            "parfor": self._for,
        }
        blocks |= {"switch": self._switch, "try": self._try}
        if word in blocks:
            return self._block(blocks[word], place)
        if word in _JUMPS:
            self.at += 1
            self._finished()
            return Jump(word, place=place)
        if word in ("global", "persistent"):
            return self._declaration(place)
        if word == "end" and self.unclosed:
            raise self._nested(*self.unclosed.pop())
        message = f"{word} opens no block" if word in _CLAUSES else f"{word} is not read"
        raise self.fail(message, "Remove it." if word == "end" else "")

    def _nested(self, outer: str, inner: MatlabToken) -> MatlabError:
        """The end of a function behind that of another one, which therefore stands within it."""
        message = f"a function stands within the function {outer}; nested functions are not supported"
        return self.fail(message, f"Move it behind the end of {outer}, and give it what it needs as arguments.", inner)

    def _block(self, read: Callable[[SourcePosition], Statement], place: SourcePosition) -> Statement:
        opening = self.take()
        self.blocks += 1
        if self.blocks > _DEEPEST:
            self.at = len(self.tokens) - 1
            raise self.fail(f"blocks are nested more than {_DEEPEST} deep", token=opening)
        found = read(place)
        if self.token.kind != TokenKind.KEYWORD or self.token.text != "end":
            raise self.fail(f"{opening.text} is never closed", "Write end.", opening)
        self.at += 1
        self.blocks -= 1
        return found

    def _head(self) -> Expression:
        """The expression behind a keyword; the body of a block is read even where it is wrong."""
        place = self.place()
        try:
            return self.expression()
        except MatlabError as error:
            self.findings += error.findings
            self._recover(0, self.blocks)
            return Name("?", place=place)

    def _branch(self, ends: frozenset[str]) -> Branch:
        place = self.place()
        return Branch(self._head(), self.body(ends), place=place)

    def _is_keyword(self, word: str) -> bool:
        if self.token.kind == TokenKind.KEYWORD and self.token.text == word:
            self.at += 1
            return True
        return False

    def _if(self, place: SourcePosition) -> If:
        ends = frozenset({"elseif", "else", "end"})
        branches = [self._branch(ends)]
        while self._is_keyword("elseif"):
            branches.append(self._branch(ends))
        return If(tuple(branches), self.body(_END) if self._is_keyword("else") else (), place=place)

    def _while(self, place: SourcePosition) -> While:
        return While(self._head(), self.body(_END), place=place)

    def _for(self, place: SourcePosition) -> For:
        enclosed = self.is_operator("(")
        self.at += enclosed
        target = self._indexed()
        self._check(target)
        self.expect("=")
        values = self._head()
        if enclosed and self.is_operator(","):  # the most workers of a parfor
            self.at += 1
            self._head()
        if enclosed:
            self.expect(")")
        return For(target, values, self.body(_END), place=place)

    def _switch(self, place: SourcePosition) -> Switch:
        subject, cases = self._head(), []
        ends = frozenset({"case", "otherwise", "end"})
        self.pass_stops()
        while self._is_keyword("case"):
            cases.append(self._branch(ends))
        return Switch(subject, tuple(cases), self.body(_END) if self._is_keyword("otherwise") else (), place=place)

    def _try(self, place: SourcePosition) -> Try:
        body = self.body(frozenset({"catch", "end"}))
        if not self._is_keyword("catch"):
            return Try(body, place=place)
        name = ""
        if self.token.kind == TokenKind.NAME and self.tokens[self.at + 1].kind == TokenKind.STOP:
            name = self.take().text
        return Try(body, name, self.body(_END), place=place)

    def _declaration(self, place: SourcePosition) -> Declaration:
        kind, names = self.take().text, []
        while self.token.kind == TokenKind.NAME:
            names.append(self.take().text)
        self._finished()
        return Declaration(kind, tuple(names), place=place)

    def _simple(self, place: SourcePosition) -> Statement:
        """An assignment or an expression."""
        targets = self._targets() if self.is_operator("[") and self._is_several() else None
        if targets is None:
            first = self.expression()
            if not self.is_operator("="):
                self._finished()
                return Evaluate(first, place=place)
            self._check(first)
            targets = (first,)
        self.expect("=")
        value = self.expression()
        self._finished()
        return Assign(targets, value, self._remark(), place=place)

    def _check(self, target: Expression) -> None:
        of = target
        while isinstance(of, Field | DynamicField | Call | CellIndex):
            of = of.of
        if not isinstance(target, _TARGETS) or not isinstance(of, Name):
            message = "nothing can be assigned to this"
            remedy = "To compare, write ==." if isinstance(target, Binary) else ""
            raise MatlabError.at(self.name, target.place, message, remedy, self.lines.line(self.token.at).strip()[:200])

    def _is_several(self) -> bool:
        """Whether the bracket here closes before a single `=`."""
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

    def _targets(self) -> tuple[Expression | None, ...]:
        self.at += 1
        found: list[Expression | None] = []
        self.spaced = True
        while not self.is_operator("]"):
            if self.is_operator("~", "!"):
                self.at += 1
                found.append(None)
            else:
                target = self._indexed()
                self._check(target)
                found.append(target)
            if self.is_operator(","):
                self.at += 1
        self.spaced = False
        self.at += 1
        if not found:
            raise self.fail("nothing stands between the brackets to assign to")
        return tuple(found)

    def _remark(self) -> str:
        """The comment that ends the line of the statement just read, unless another statement follows on it."""
        at = self.at
        while self.tokens[at].kind == TokenKind.STOP and self.tokens[at].text != "\n":
            at += 1
        comment = self.comments.get(at)
        return comment.text.strip() if comment else ""

    def _definition(self) -> FunctionDefinition:
        place = self.place(self.take())
        results: tuple[str, ...] = ()
        if self.is_operator("["):
            results = self._results()
            self.expect("=")
        elif self.tokens[self.at + 1].text == "=":
            results = (self._plain_name(),)
            self.expect("=")
        name = self._plain_name()
        parameters = self.parameters() if self.is_operator("(") else ()
        self._finished()
        body = self.body(frozenset({"function", "end"}))
        if not self._is_keyword("end") and self.token.kind == TokenKind.KEYWORD:
            self.unclosed.append((name, self.token))
        return FunctionDefinition(name, parameters, results, body, place=place)

    def _results(self) -> tuple[str, ...]:
        self.at += 1
        found = []
        while not self.is_operator("]"):
            found.append(self._plain_name())
            if self.is_operator(","):
                self.at += 1
        self.at += 1
        return tuple(found)

    def _plain_name(self) -> str:
        if self.token.kind == TokenKind.COMMAND and not self.token.words:
            return self.take().text
        if self.token.kind != TokenKind.NAME:
            raise self.fail(f"a name is missing before {self.said()}")
        return self.take().text
