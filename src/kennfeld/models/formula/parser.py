"""Pratt parser of formula text: tokens to the syntax tree, one method per kind of statement.

Precedence, from lowest to highest:

    or  <  and  <  not  <  == != < <= > >=  <  + -  <  * /  <  unary -  <  ^ (right-associative)
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Final, TypeVar

from kennfeld.graph.integration import SOLVERS
from kennfeld.models.formula.lexer import DECLARATIONS, FOREIGN, RESERVED, Source, statements, tokens
from kennfeld.models.formula.syntax import (
    Call,
    Chain,
    Declaration,
    Definition,
    Expr,
    FunctionDefinition,
    Name,
    Number,
    Prefix,
    SolverDeclaration,
    Statement,
    StepDeclaration,
    Token,
)
from kennfeld.program.operator_parser import OperatorParser

LEVELS: Final = {
    "or": 1,
    "and": 2,
    "not": 3,
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), 4),
    **dict.fromkeys("+-", 5),
    **dict.fromkeys("*/", 6),
    "^": 8,
}
_NOT, _COMPARISON, _POWER = LEVELS["not"], LEVELS["<"], LEVELS["^"]

# keeps the parser far from Python's own limit of 1000 calls
MAX_DEPTH = 100

Keys = dict[tuple[Any, ...], int]
Result = TypeVar("Result")


class SyntaxFault(Exception):  # noqa: N818
    def __init__(self, at: Token, message: str, remedy: str = "") -> None:
        self.finding = (at, message, remedy)


def parse(source: Source) -> list[Statement]:
    """Parse the statements of a text; errors go to `source.report`, one finding per statement."""
    keys: Keys = {}
    result = (_StatementParser(line, keys, source).statement() for line in statements(source.lines))
    return [statement for statement in result if statement is not None]


def parse_expression(source: Source, lines: range, keys: Keys) -> Expr | None:
    """Parse the expression in these lines (counted from 1); return None if it is wrong."""
    expression_tokens = [token for number in lines for token in tokens(source.lines[number - 1], number)]
    last = expression_tokens[-1] if expression_tokens else Token("end", "", lines[0], 1)
    end = Token("end", "", last.line, last.column + len(last.text))
    return _StatementParser([*expression_tokens, end], keys, source).whole()


class _StatementParser(OperatorParser[Token, Expr]):
    """Parser of the tokens of one statement."""

    levels: ClassVar = {operator: level for operator, level in LEVELS.items() if operator != "not"}
    word_kinds = ("op",)
    max_depth = MAX_DEPTH

    def __init__(self, line_tokens: Sequence[Token], keys: Keys, source: Source) -> None:
        super().__init__(line_tokens)
        self.keys = keys
        self.source = source

    def statement(self) -> Statement | None:
        number, *others = self.tokens[:2]
        if number.kind == "number" and number.text.isdigit() and others[0].kind in ("name", "quoted"):
            self.at = 1  # a line number
        first, second = self.token, self.ahead(1)
        # `step = 3` and `map[Nm] = 3` define nodes
        declares = first.kind == "name" and first.text in DECLARATIONS
        if not declares or second.text == "=" or second.kind == "unit":
            return self._definition()
        self.at += 1
        if first.text == "def":
            return self._function()
        if first.text == "solver":
            return self._solver(first)
        return self._step(first) if first.text == "step" else self._declaration(first)

    def whole(self) -> Expr | None:
        """Parse the expression up to the end; return None if it is wrong."""

        def parse_all() -> Expr:
            result = self.operations()
            self._finish()
            return result

        return self._attempt(parse_all)

    def _attempt(self, parse: Callable[[], Result]) -> Result | None:
        """Return a parsed part, None with a finding reported if it is wrong."""
        try:
            return parse()
        except SyntaxFault as wrong:
            self.source.report(*wrong.finding)
            return None

    def _definition(self) -> Definition | None:
        head = self._attempt(lambda: (self._name("a statement must start with a name"), self._unit()))
        if head is None:
            return None
        equals = self._attempt(lambda: self._equals(head[0]))
        return Definition(*head, self.whole() if equals else None)

    def _declaration(self, kind: Token) -> Declaration | None:
        name = self._attempt(lambda: self._name(f"{kind.text} requires a name"))
        if name is None:
            return None
        unit = self._unit()
        self._attempt(lambda: self._finish_declaration(kind))
        return Declaration(kind.text, name, unit)

    def _finish_declaration(self, kind: Token) -> None:
        if self.token.text == ",":
            raise SyntaxFault(self.token, "only one name per declaration", f"Write one {kind.text} line per name.")
        self._finish()

    def _step(self, word: Token) -> StepDeclaration | None:
        number = self.take()
        if number.kind != "number" or self.token.kind != "end" or not 0 < float(number.text) < float("inf"):
            self.source.report(number, "step must be a positive number of seconds", "Write step 0.01, for example.")
            return None
        return StepDeclaration(word, float(number.text))

    def _solver(self, word: Token) -> SolverDeclaration | None:
        name = self.take()
        if name.kind != "name" or name.text not in SOLVERS or self.token.kind != "end":
            self.source.report(name, f"solver must be one of {', '.join(SOLVERS)}", "Write solver ode4, for example.")
            return None
        return SolverDeclaration(word, name.text)

    def _function(self) -> FunctionDefinition | None:
        name = self._attempt(lambda: self._name("def requires the name of the function"))
        if name is None:
            return None
        # filled while parsing, so that calls can be checked even if the rest of the line is wrong
        arguments: list[Token] = []
        equals = self._attempt(lambda: self._arguments(arguments))
        return FunctionDefinition(name, tuple(arguments), self.whole() if equals else None)

    def _arguments(self, arguments: list[Token]) -> Token:
        """Append the arguments of a function; return the equals sign after them."""
        self.expect("(")
        while self.token.text != ")" if not arguments else self.accept(","):
            arguments.append(self._name("the name of an argument is missing"))
        self.expect(")")
        return self.expect("=")

    def _name(self, message: str) -> Token:
        token = self.take()
        if token.kind == "bad":
            raise self._bad(token)
        if token.kind not in ("name", "quoted"):
            raise SyntaxFault(token, message)
        if token.kind == "name" and token.text in RESERVED:
            raise SyntaxFault(token, f"{token.text} is a reserved word", f"Write %{token.text}% to use it as a name.")
        return token

    def _unit(self) -> str:
        return self.take().text[1:-1].strip() if self.token.kind == "unit" else ""

    def _equals(self, name: Token) -> Token:
        token = self.take()
        if token.text == "=":
            return token
        if token.kind == "bad" and token.text != ".":
            raise self._bad(token)
        remedy = "Write name[unit] = expression; names with other characters as %any[3].name%."
        raise SyntaxFault(token, f"missing = after {name.name}", remedy)

    def _finish(self) -> None:
        token = self.token
        if token.kind == "end":
            return
        if token.kind == "bad":
            raise self._bad(token)
        if token.text == ")":
            raise SyntaxFault(token, "unmatched closing parenthesis", "Remove it, or open one before it.")
        if token.kind == "unit":
            raise self._misplaced_unit(token)
        if token.text == "=":
            raise SyntaxFault(token, "= inside an expression", "Write == to compare.")
        if token.text == ",":
            raise SyntaxFault(token, "comma outside parentheses", "Use a point as decimal separator.")
        raise SyntaxFault(token, f"missing operator before {token.text}")

    def joined(self, left: Expr, level: int) -> Expr:
        """Parse all operators of a level that follow, as one chain."""
        at, start = self.token, self.at
        rest: list[tuple[str, Expr]] = []
        while self.level() == level:
            operator = self.take()
            if rest and level == _COMPARISON:
                raise self._chained(left, start)
            # a ^ b ^ c is a ^ (b ^ c), all others bind to the left
            rest.append((operator.text, self._nested(_POWER) if level == _POWER else self.operations(level + 1)))
        key = self._key("chain", left.key, *(part for op, operand in rest for part in (op, operand.key)))
        return Chain(left, tuple(rest), at, key)

    def _nested(self, level: int) -> Expr:
        self.enter()
        operand = self.operations(level)
        self.depth -= 1
        return operand

    def _chained(self, left: Expr, start: int) -> SyntaxFault:
        """Return the error of a chained comparison; `start` is the index of the first, the second was read last."""
        first, second, third = self.tokens[start], self.tokens[self.at - 1], self.token
        middle = self.source.text(self.tokens[start + 1], self.tokens[self.at - 2])
        follows = self.ahead(1)
        short = isinstance(left, Name | Number) and (follows.kind == "end" or follows.text in (")", ","))
        a, b, c = (left.at.text, middle, third.text) if short and middle and third.text else ("a", "b", "c")
        remedy = f"Write {a} {first.text} {b} and {b} {second.text} {c}."
        return SyntaxFault(second, "comparisons cannot be chained", remedy)

    def operand(self, lowest: int) -> Expr:
        """Parse an operand with its signs and brackets."""
        token = self.take()
        match token.kind, token.text:
            case "number", _:
                return self._number(token)
            case (("name" | "quoted"), _):
                return self._call(token) if self.token.text == "(" else self._bare(token)
            case "op", "(":
                self.enter()
                inner = self.operations()
                self._close(token)
                return inner
            case "op", ("-" | "+" | "not"):
                return self._prefix(token, lowest)
        raise self._no_operand(token)

    def _number(self, token: Token) -> Number:
        value = float(token.text)
        if value == float("inf"):
            raise SyntaxFault(token, f"{token.text} exceeds the range of numbers", "Write inf for infinity.")
        return Number(value, token, self._key("number", value))

    def _bare(self, token: Token) -> Name:
        if self.token.kind == "unit":
            raise self._misplaced_unit(self.token, token)
        return Name(token.name, token, self._key("name", token.name, token.quoted))

    def _call(self, name: Token) -> Call:
        opening = self.take()
        self.enter()
        args: list[Expr] = []
        while self.token.text != ")" if not args else self.accept(","):
            args.append(self.operations())
        self._close(opening)
        key = self._key("call", name.name, name.quoted, *(arg.key for arg in args))
        return Call(name.name, tuple(args), name, key)

    def _prefix(self, token: Token, level: int) -> Expr:
        if token.text == "not" and level > _NOT:
            message = "`not` has lower precedence than the operator before it"
            raise SyntaxFault(token, message, "Put it in parentheses: (not a).")
        # -a ^ b is -(a ^ b)
        operand = self._nested(_NOT if token.text == "not" else _POWER)
        if token.text == "+":
            return operand
        return Prefix(token.text, operand, token, self._key(token.text, operand.key))

    def _close(self, opening: Token) -> None:
        token = self.token
        if token.text != ")":
            if token.kind == "end":
                raise SyntaxFault(opening, "unclosed parenthesis")
            self._finish()
        self.at += 1
        self.depth -= 1

    def too_deep(self) -> SyntaxFault:
        """Return the error that the expression is nested too deeply."""
        message = f"the expression is nested more than {MAX_DEPTH} levels deep"
        return SyntaxFault(self.tokens[self.at - 1], message, "Assign its inner parts to named nodes.")

    def missing(self, text: str) -> SyntaxFault:
        """Return the error that another token than `text` follows."""
        return SyntaxFault(self.token, f"missing {text}", "Write def f(a, b) = expression.")

    def _key(self, *parts: Any) -> int:
        # equal syntax has equal numbers, by which the lowering shares nodes and states
        return self.keys.setdefault(parts, len(self.keys))

    def _no_operand(self, token: Token) -> SyntaxFault:
        if token.kind == "bad":
            return self._bad(token)
        if token.kind == "unit":
            return self._misplaced_unit(token)
        if token.kind == "end":
            return SyntaxFault(token, "incomplete expression")
        return SyntaxFault(token, f"missing operand before {token.text}")

    def _bad(self, token: Token) -> SyntaxFault:
        if len(token.text) > 1 and token.text not in FOREIGN:
            remedy = f"Write * between a number and a name, or %{token.text}% for a name."
            return SyntaxFault(token, f"{token.text} is neither a number nor a name", remedy)
        return SyntaxFault(token, f"unexpected {token.text!r}", FOREIGN.get(token.text, ""))

    def _misplaced_unit(self, unit: Token, name: Token | None = None) -> SyntaxFault:
        remedy = f"Write %{name.text if name else 'name'}{unit.text}% for a name that contains brackets."
        return SyntaxFault(unit, "a unit is only allowed after the name being defined", remedy)
