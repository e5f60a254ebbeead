"""Syntax tree of formula text: immutable, with the token of each part.

Equal expressions of one text have the same number `key`, wherever they are; through it, equal memory calls share one
state.
"""

from typing import NamedTuple, TypeAlias


class Token(NamedTuple):
    """A word of the text; `line` and `column` count from 1.

    `kind` is one of number, name, quoted, unit, op, bad, end.

    >>> Token("quoted", "%rad[3].x%", 1, 1).name
    'rad[3].x'
    """

    kind: str
    text: str
    line: int
    column: int

    @property
    def name(self) -> str:
        """The name that the token spells; quoted names write a percent sign twice."""
        return self.text[1:-1].replace("%%", "%") if self.kind == "quoted" else self.text

    @property
    def quoted(self) -> bool:
        """True for a quoted name, which is never a reserved word, a built-in function or auxiliary."""
        return self.kind == "quoted"


class Number(NamedTuple):
    """A number as written, never negative."""

    value: float
    at: Token
    key: int


class Name(NamedTuple):
    """A node, a parameter, an input, a constant or an argument of a `def`."""

    name: str
    at: Token
    key: int


class Call(NamedTuple):
    """A call of a built-in function or a function of the text, or a table at its coordinates."""

    name: str
    args: "tuple[Expr, ...]"
    at: Token
    key: int


class Prefix(NamedTuple):
    """`-x` or `not x`."""

    op: str
    operand: "Expr"
    at: Token
    key: int


class Chain(NamedTuple):
    """Operators of one precedence, applied from the left: `a - b + c`. Flat, because sums may be long."""

    first: "Expr"
    rest: "tuple[tuple[str, Expr], ...]"
    at: Token
    key: int


Expr: TypeAlias = Number | Name | Call | Prefix | Chain


class Definition(NamedTuple):
    """`name[unit] = value`; the value is None if the line is wrong, so that its name stays known."""

    at: Token
    unit: str
    value: Expr | None

    @property
    def auxiliary(self) -> bool:
        """True if the node is not a name of the graph."""
        return self.at.text.startswith("_")


class Declaration(NamedTuple):
    """`input`, `output`, `scalar`, `curve`, `map`, `cube` or `rbf`, and a name."""

    kind: str
    at: Token
    unit: str


class FunctionDefinition(NamedTuple):
    """`def name(arguments) = value`."""

    at: Token
    arguments: tuple[Token, ...]
    value: Expr | None


class StepDeclaration(NamedTuple):
    """`step 0.01`."""

    at: Token
    seconds: float


class SolverDeclaration(NamedTuple):
    """`solver ode4`."""

    at: Token
    solver: str


Statement: TypeAlias = Definition | Declaration | FunctionDefinition | StepDeclaration | SolverDeclaration
