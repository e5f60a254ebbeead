"""The syntax tree of ESDL, made of frozen nodes; positions in the text are not compared.

A file has a package, imports and declarations: classes, data interfaces, types, units and constants.
"""

from dataclasses import field

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program import tree
from kennfeld.program.positions import TextPosition as TextPosition
from kennfeld.program.tree import LanguageExpression, Node

# the nodes that all languages share; a `Field` is a member of a struct, an interface or a class
Expression = tree.Expression
Name = tree.Name
Text = tree.Text
Field = tree.Field
Call = tree.Call
Unary = tree.Unary
Binary = tree.Binary
Conditional = tree.Conditional
Evaluate = tree.Evaluate
Jump = tree.Jump


@dataclass(frozen=True)
class Number(LanguageExpression):
    """A number as written in `text`; `is_real` if it has a point or an exponent, `unit` as in `50.0[kmh]`."""

    value: float
    is_real: bool = True
    unit: str = ""
    text: str = field(default="", compare=False)


@dataclass(frozen=True)
class Truth(LanguageExpression):
    """`true` or `false`."""

    value: bool
    text: str = field(default="", compare=False)


@dataclass(frozen=True)
class Index(LanguageExpression):
    """`of[index]`."""

    of: "Expression"
    index: "Expression"


@dataclass(frozen=True)
class Choice(LanguageExpression):
    """`switch subject case key : value ... default : otherwise` as an expression."""

    subject: "Expression"
    cases: tuple[tuple[tuple["Expression", ...], "Expression"], ...]
    otherwise: "Expression | None"


@dataclass(frozen=True)
class Between(LanguageExpression):
    """`x between low and high`, ends included."""

    operand: "Expression"
    low: "Expression"
    high: "Expression"


@dataclass(frozen=True)
class Braces(LanguageExpression):
    """`{a, b}`: the elements of an array, a table or a struct."""

    elements: tuple["Expression", ...]


@dataclass(frozen=True)
class Range(LanguageExpression):
    """`first .. last`, ends included; None for an open end."""

    first: "Expression | None"
    last: "Expression | None"


@dataclass(frozen=True)
class Unsupported(LanguageExpression):
    """A part of a block diagram or of a text that has no meaning here: why, and the remedy."""

    message: str
    remedy: str = ""


@dataclass(frozen=True)
class TypeName(Node):
    """A reference to a type by name, with its package if it is written, and open or fixed dimensions."""

    name: str


@dataclass(frozen=True)
class Cast(LanguageExpression):
    """`(type) operand` of C."""

    type: "TypeExpression"
    operand: "Expression"


@dataclass(frozen=True)
class ScalarType(Node):
    """`real`, `integer` or `boolean`, or a type derived from a named one; `range` and `delta` as written.

    `is_limited` says whether generated code limits assignments to the range; None if it follows from `delta`.
    """

    base: str
    range: Range | None = None
    delta: Expression | None = None
    using: str = ""
    unit: str = ""
    is_limited: bool | None = None


@dataclass(frozen=True)
class EnumType(Node):
    """`enum {A, B = 3}`: labels with their numbers, None for the next one."""

    labels: tuple[tuple[str, Expression | None], ...]


@dataclass(frozen=True)
class StructType(Node):
    """`struct { ... }`."""

    elements: tuple["Element", ...]


@dataclass(frozen=True)
class ArrayType(Node):
    """`array [size] of element`; a size is None, a number, a range, or the name of a type or constant."""

    sizes: tuple[Expression | None, ...]
    element: "TypeExpression"


@dataclass(frozen=True)
class TableType(Node):
    """`table x, y -> value`; `form` is "", "fixed" or "group"."""

    axes: tuple["TypeExpression", ...]
    value: "TypeExpression"
    form: str = ""


@dataclass(frozen=True)
class AxisType(Node):
    """`axis real`: breakpoints that group tables share."""

    element: "TypeExpression"


@dataclass(frozen=True)
class UnsupportedType(Node):
    """A type that is parsed, but has no meaning here, such as `dataspace`."""

    kind: str


TypeExpression = TypeName | ScalarType | EnumType | StructType | ArrayType | TableType | AxisType | UnsupportedType


@dataclass(frozen=True)
class Annotation(Node):
    """`@name("argument", key = value)`."""

    name: str
    arguments: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Element(Node):
    """An element of a class, an interface, a struct or a package, or a variable of a method.

    Attributes:
        kind: "characteristic", "const", "sysconst" or "" for a variable.
        sizes: dimensions behind the name.
        value: initial value; None if not written.
        formula: text of a dependent parameter, and the elements that its letters stand for.
        description: text of the documentation comment before it.
    """

    name: str
    type: TypeExpression
    kind: str = ""
    sizes: tuple[Expression | None, ...] = ()
    value: Expression | None = None
    formula: "tuple[str, tuple[tuple[str, Expression], ...]] | None" = None
    modifiers: frozenset[str] = frozenset()
    annotations: tuple[Annotation, ...] = ()
    description: str = field(default="", compare=False)

    def has(self, annotation: str) -> bool:
        """Return True if the element has an annotation of this name."""
        return any(item.name == annotation for item in self.annotations)


@dataclass(frozen=True)
class Assign(Node):
    """`target = value`, or with an `operator` such as `+` for `+=`."""

    target: Expression
    value: Expression
    operator: str = ""


@dataclass(frozen=True)
class Declare(Node):
    """A variable of a method."""

    element: Element


@dataclass(frozen=True)
class If(Node):
    """`if (condition) ... else ...`."""

    condition: Expression
    body: tuple["Statement", ...]
    otherwise: tuple["Statement", ...] = ()


@dataclass(frozen=True)
class While(Node):
    """`while (condition) ...`; `tests_last` for `do ... while (condition);`."""

    condition: Expression
    body: tuple["Statement", ...]
    tests_last: bool = False


@dataclass(frozen=True)
class For(Node):
    """`for (name in values) ...`, over a range, a type or the indices of an array."""

    name: str
    values: Expression
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class Switch(Node):
    """`switch (subject) { case a, b : ... default : ... }`; only one case runs."""

    subject: Expression
    cases: tuple[tuple[tuple[Expression, ...], tuple["Statement", ...]], ...]
    otherwise: tuple["Statement", ...] = ()


@dataclass(frozen=True)
class Return(Node):
    """`return value;`."""

    value: Expression | None = None


@dataclass(frozen=True)
class Block(Node):
    """`{ ... }`: variables declared within are not known outside."""

    statements: tuple["Statement", ...]


Statement = Assign | Declare | Evaluate | If | While | For | Switch | Return | Jump | Block
Statements = tuple[Statement, ...]


@dataclass(frozen=True)
class Argument(Node):
    """An argument of a method; `direction` is "in", "out" or "inout"."""

    name: str
    type: TypeExpression
    direction: str = "in"


@dataclass(frozen=True)
class Method(Node):
    """A method; the body is None if it is external, `triggers` names the state machine that it runs."""

    name: str
    result: TypeExpression | None
    arguments: tuple[Argument, ...]
    body: Statements | None
    triggers: str = ""
    modifiers: frozenset[str] = frozenset()
    annotations: tuple[Annotation, ...] = ()

    @property
    def is_in_c(self) -> bool:
        """True for a method that is implemented in C."""
        return self.body is None and not self.triggers

    def annotation(self, name: str) -> Annotation | None:
        """Return the annotation of a name, or None."""
        return next((item for item in self.annotations if item.name == name), None)


@dataclass(frozen=True)
class Initializer(Node):
    """Named initial values of a class: assignments to its elements."""

    name: str
    body: Statements


@dataclass(frozen=True)
class Transition(Node):
    """`transition condition to target { action }`; `trigger` is the method that may take it, "" for any."""

    condition: Expression
    target: str
    action: Statements = ()
    trigger: str = ""


@dataclass(frozen=True)
class State(Node):
    """A state, or a junction; `start` names the inner state that is entered first."""

    name: str
    entry: Statements = ()
    static: Statements = ()
    exit: Statements = ()
    transitions: tuple[Transition, ...] = ()
    states: tuple["State", ...] = ()
    start: str = ""
    is_junction: bool = False
    keeps_history: bool = False


@dataclass(frozen=True)
class StateMachine(Node):
    """A state machine; `labels` names the enumeration of its states."""

    name: str
    labels: str
    states: tuple[State, ...]
    start: str
    default_trigger: str = ""


@dataclass(frozen=True)
class ClassDeclaration(Node):
    """A class with its members.

    `reads` and `writes` are the messages that it names, and `implementation` the representation that it uses.
    """

    name: str
    elements: tuple[Element, ...] = ()
    methods: tuple[Method, ...] = ()
    machines: tuple[StateMachine, ...] = ()
    initializers: tuple[Initializer, ...] = ()
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    modifiers: frozenset[str] = frozenset()
    annotations: tuple[Annotation, ...] = ()
    implementation: str = ""


@dataclass(frozen=True)
class Interface(Node):
    """A data interface: its elements are messages."""

    name: str
    elements: tuple[Element, ...] = ()


@dataclass(frozen=True)
class TypeDeclaration(Node):
    """`type name is type;`."""

    name: str
    type: TypeExpression


@dataclass(frozen=True)
class UnitDeclaration(Node):
    """`unit name = expression;`: a unit of real numbers, also used as a type."""

    name: str
    expression: Expression | None = None


@dataclass(frozen=True)
class Constant(Node):
    """A constant or system constant of a package."""

    element: Element

    @property
    def name(self) -> str:
        """The name of the constant."""
        return self.element.name


Declaration = ClassDeclaration | Interface | TypeDeclaration | UnitDeclaration | Constant


@dataclass(frozen=True)
class EsdlFile:
    """The content of a file."""

    name: str = field(compare=False)
    package: str = ""
    imports: tuple[str, ...] = ()
    declarations: tuple[Declaration, ...] = ()
