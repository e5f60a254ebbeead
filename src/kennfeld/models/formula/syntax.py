"""The syntax tree of formula text: immutable, every part with the token where it stands.

`key` is the same number for equal expressions of one text, wherever they stand; memory calls that are written
alike become one state through it.
"""

from typing import NamedTuple, TypeAlias

__all__ = [
    "Call",
    "Chain",
    "Declaration",
    "Definition",
    "Expr",
    "FunctionDefinition",
    "Name",
    "Number",
    "Prefix",
    "Statement",
    "StepDeclaration",
    "Token",
]


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
        """The name that the token spells; a quoted name writes a percent sign twice."""
        return self.text[1:-1].replace("%%", "%") if self.kind == "quoted" else self.text

    @property
    def quoted(self) -> bool:
        """A quoted name is never a reserved word, a built-in function or auxiliary."""
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
    """A built-in function, a function of the text, or a table at its coordinates."""

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
    """`name[unit] = value`; no value where the line is wrong, so that its name stays known."""

    at: Token
    unit: str
    value: Expr | None

    @property
    def auxiliary(self) -> bool:
        """Whether the node stays out of the graph's names."""
        return self.at.text.startswith("_")


class Declaration(NamedTuple):
    """`input`, `output`, `scalar`, `curve`, `map` or `cube`, and a name."""

    kind: str
    at: Token
    unit: str


class FunctionDefinition(NamedTuple):
    """`def at(arguments) = value`."""

    at: Token
    arguments: tuple[Token, ...]
    value: Expr | None


class StepDeclaration(NamedTuple):
    """`step 0.01`."""

    at: Token
    seconds: float


Statement: TypeAlias = Definition | Declaration | FunctionDefinition | StepDeclaration
