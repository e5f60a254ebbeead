"""The syntax tree of imperative code, made of frozen nodes; positions in the text are not compared.

MATLAB is parsed to it, and ESDL, C, Python and the actions of charts are translated to it, so that one interpreter
evaluates them all. `f(x)` is a `Call` whether f is a function or an array: that depends on the variables in scope.
"""

from dataclasses import field

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program.positions import TextPosition as TextPosition


@dataclass(frozen=True)
class Node:
    """A part of a tree, with its position in the text."""

    place: TextPosition = field(default=TextPosition(), compare=False, repr=False, kw_only=True)


@dataclass(frozen=True)
class Number(Node):
    """A number as written; `suffix` is "i" if it is imaginary, "u8" to "s64" for the class of a 0x or 0b literal."""

    value: float
    suffix: str = ""


@dataclass(frozen=True)
class Text(Node):
    """A character vector `'a'`, or a string `"a"` if `is_string`."""

    value: str
    is_string: bool = False


@dataclass(frozen=True)
class Name(Node):
    """A variable, or a function called without arguments."""

    name: str


@dataclass(frozen=True)
class Colon(Node):
    """A bare `:` as an index: all elements along the dimension."""


@dataclass(frozen=True)
class End(Node):
    """`end` within an index."""


@dataclass(frozen=True)
class Field(Node):
    """`of.name`."""

    of: "Expression"
    name: str


@dataclass(frozen=True)
class DynamicField(Node):
    """`of.(name)`."""

    of: "Expression"
    name: "Expression"


@dataclass(frozen=True)
class Call(Node):
    """`of(arguments)`: a function call or an index into an array."""

    of: "Expression"
    arguments: tuple["Expression", ...]


@dataclass(frozen=True)
class CellIndex(Node):
    """`of{arguments}`."""

    of: "Expression"
    arguments: tuple["Expression", ...]


@dataclass(frozen=True)
class Range(Node):
    """`first:last` or `first:step:last`."""

    first: "Expression"
    step: "Expression | None"
    last: "Expression"


@dataclass(frozen=True)
class Unary(Node):
    """`-x`, `+x` or `~x`."""

    operator: str
    operand: "Expression"


@dataclass(frozen=True)
class Binary(Node):
    """`left operator right`: an arithmetic, relational or logical operation."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class Conditional(Node):
    """`condition ? yes : no`, of which one side is evaluated; MATLAB has none, other languages use it."""

    condition: "Expression"
    yes: "Expression"
    no: "Expression"


@dataclass(frozen=True)
class Transpose(Node):
    """`x'`, or `x.'` if not `conjugate`; both are the same for real numbers."""

    operand: "Expression"
    conjugate: bool = True


@dataclass(frozen=True)
class Matrix(Node):
    """`[a b; c d]`: the elements of each row."""

    rows: tuple[tuple["Expression", ...], ...]


@dataclass(frozen=True)
class CellArray(Node):
    """`{a, b; c, d}`."""

    rows: tuple[tuple["Expression", ...], ...]


@dataclass(frozen=True)
class AnonymousFunction(Node):
    """`@(parameters) body`."""

    parameters: tuple[str, ...]
    body: "Expression"


@dataclass(frozen=True)
class FunctionHandle(Node):
    """`@name`."""

    name: str


@dataclass(frozen=True)
class LanguageExpression(Node):
    """Base of the expressions that one language adds; its translator replaces them, so that no evaluator meets them."""


Expression = (
    Number | Text | Name | Colon | End | Field | DynamicField | Call | CellIndex | Range | Unary | Binary | Transpose
    | Matrix | CellArray | AnonymousFunction | FunctionHandle | Conditional | LanguageExpression
)  # fmt: skip
Expressions = tuple[Expression, ...]


@dataclass(frozen=True)
class Assign(Node):
    """`target = value` or `[a, ~, b] = value`, where None stands for `~`; `comment` ends its last line."""

    targets: tuple[Expression | None, ...]
    value: Expression
    comment: str = field(default="", compare=False, repr=False)


@dataclass(frozen=True)
class Evaluate(Node):
    """An expression statement: a function called for its effect."""

    expression: Expression


@dataclass(frozen=True)
class Command(Node):
    """A call in command syntax, `name word word`, such as `close all`."""

    name: str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Branch(Node):
    """A condition, or the value of a case, with the statements that depend on it."""

    condition: Expression
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class If(Node):
    """`if` and each `elseif`, with the statements of `else`."""

    branches: tuple[Branch, ...]
    otherwise: tuple["Statement", ...] = ()


@dataclass(frozen=True)
class For(Node):
    """`for target = values`: runs the body once per column."""

    target: Expression
    values: Expression
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class While(Node):
    """`while condition`."""

    condition: Expression
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class Switch(Node):
    """`switch subject` with its cases and the statements of `otherwise`."""

    subject: Expression
    cases: tuple[Branch, ...]
    otherwise: tuple["Statement", ...] = ()


@dataclass(frozen=True)
class Try(Node):
    """`try` and `catch`, with the name of the exception if it has one."""

    body: tuple["Statement", ...]
    name: str = ""
    handler: tuple["Statement", ...] = ()


@dataclass(frozen=True)
class Jump(Node):
    """`break`, `continue` or `return`."""

    kind: str


@dataclass(frozen=True)
class Declaration(Node):
    """`global a b` or `persistent a b`."""

    kind: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class FunctionDefinition(Node):
    """`function [results] = name(parameters)`; an ignored parameter is `~`."""

    name: str
    parameters: tuple[str, ...]
    results: tuple[str, ...]
    body: tuple["Statement", ...]


Statement = Assign | Evaluate | Command | If | For | While | Switch | Try | Jump | Declaration
Statements = tuple[Statement, ...]


@dataclass(frozen=True)
class Script:
    """The statements of a text and the functions it defines; a file of functions has no statements."""

    name: str = field(compare=False)
    statements: tuple[Statement, ...] = ()
    functions: tuple[FunctionDefinition, ...] = ()
