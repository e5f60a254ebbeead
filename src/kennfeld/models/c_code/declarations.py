"""Declarations of a C file: types, enumerations, variables, and functions with their arguments."""

from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Final, Literal, TypeAlias

from pycparser import c_ast

from kennfeld.lazy_dataclass import dataclass
from kennfeld.matlab import syntax as m
from kennfeld.models.c_code.number_types import (
    KNOWN_TYPES,
    CType,
    UnsupportedCError,
    number_type,
)

Sizes: TypeAlias = tuple[int, ...]
_MAX_SIZE: Final = 100_000


def line_of(tree: c_ast.Node) -> int:
    """Return the line of a tree; 0 if it has none."""
    return int(tree.coord.line) if tree.coord is not None else 0


@dataclass(frozen=True)
class Variable:
    """A variable.

    Attributes:
        name: its name in the shared syntax tree.
        type: type of its elements.
        sizes: sizes of an array; empty for a number and for pointers to one.
        is_pointer: True if it is the address of a number, or of an array of unknown size if `is_array` as well.
        is_static: True if it keeps its value between calls.
        is_constant: True if it cannot be assigned.
    """

    name: str
    type: CType
    sizes: Sizes = ()
    is_pointer: bool = False
    is_array: bool = False
    is_static: bool = False
    is_constant: bool = False


@dataclass(frozen=True)
class StaticVariable:
    """A variable that keeps its value: its declaration, and the tree of its first value."""

    variable: Variable
    first: m.Expression
    line: int


@dataclass(frozen=True)
class Argument:
    """An argument of a function; `mode` says if it is a number, the address of a result, or that of constants."""

    variable: Variable
    mode: Literal["value", "output", "input"]


@dataclass(frozen=True)
class CFunctionDeclaration:
    """A function of the file."""

    name: str
    tree: c_ast.FuncDef
    arguments: tuple[Argument, ...]
    result: CType | None

    @property
    def outputs(self) -> tuple[Argument, ...]:
        """The arguments through which it returns results."""
        return tuple(argument for argument in self.arguments if argument.mode == "output")

    @property
    def line(self) -> int:
        """The line of its name."""
        return line_of(self.tree.decl)


@dataclass(eq=False)
class CFile:
    """The declarations of a file."""

    functions: dict[str, CFunctionDeclaration] = field(default_factory=dict)
    unsupported: dict[str, UnsupportedCError] = field(default_factory=dict)
    variables: dict[str, c_ast.Decl] = field(default_factory=dict)
    typedefs: dict[str, CType] = field(default_factory=lambda: dict(KNOWN_TYPES))
    constants: dict[str, int] = field(default_factory=dict)


def read_declarations(tree: c_ast.FileAST) -> CFile:
    """Return what a file declares; functions whose arguments are not supported are in `unsupported`."""
    file = CFile()
    for item in tree.ext:
        for enumeration in enumerations(item):
            file.constants |= enumeration_constants(enumeration, file.constants)
        if isinstance(item, c_ast.Typedef) and item.name not in KNOWN_TYPES:
            try:
                file.typedefs[item.name] = number_type(item.type, file.typedefs, line_of(item))
            except UnsupportedCError:
                continue  # an error where it is used
        elif isinstance(item, c_ast.FuncDef):
            name = str(item.decl.name)
            try:
                file.functions[name] = _function(item, file)
            except UnsupportedCError as error:
                file.unsupported[name] = error
        elif isinstance(item, c_ast.Decl) and not isinstance(item.type, c_ast.FuncDecl) and item.name:
            file.variables[item.name] = item
    return file


def enumerations(tree: c_ast.Node) -> Iterator[c_ast.Enum]:
    """Yield the enumerations that a declaration defines."""
    if isinstance(tree, c_ast.Enum):
        yield tree
    elif isinstance(tree, c_ast.Decl | c_ast.Typedef | c_ast.TypeDecl | c_ast.ArrayDecl | c_ast.PtrDecl):
        yield from enumerations(tree.type)


def enumeration_constants(tree: c_ast.Enum, known: Mapping[str, int]) -> dict[str, int]:
    """Return the constants of an enumeration."""
    result: dict[str, int] = {}
    number = 0
    for item in tree.values.enumerators if tree.values is not None else ():
        if item.value is not None:
            number = constant_integer(item.value, {**known, **result})
        result[item.name] = number
        number += 1
    return result


def constant_integer(tree: c_ast.Node | None, known: Mapping[str, int]) -> int:
    """Return a constant integer, such as the size of an array."""
    match tree:
        case c_ast.Constant(type=kind, value=text) if "int" in kind or kind == "char":
            return integer_literal(text)
        case c_ast.ID(name=name) if name in known:
            return known[name]
        case c_ast.UnaryOp(op="-", expr=operand):
            return -constant_integer(operand, known)
        case c_ast.BinaryOp(op=("+" | "-" | "*") as op, left=left, right=right):
            a, b = constant_integer(left, known), constant_integer(right, known)
            return {"+": a + b, "-": a - b, "*": a * b}[op]
    raise UnsupportedCError("a constant integer is required", line_of(tree) if tree is not None else 0)


def integer_literal(text: str) -> int:
    r"""Return the number of an integer or character.

    >>> integer_literal("0x1Fu"), integer_literal("017"), integer_literal("'a'"), integer_literal(r"'\n'")
    (31, 15, 97, 10)
    """
    if text.startswith("'"):
        escapes = {"\\n": 10, "\\t": 9, "\\0": 0, "\\\\": 92, "\\'": 39, "\\r": 13}
        inner = text[1:-1]
        if inner in escapes:
            return escapes[inner]
        if len(inner) != 1:
            raise UnsupportedCError(f"the character {text[:20]} is not supported")
        return ord(inner)
    digits = text.rstrip("uUlL")
    if digits[:2].casefold() in ("0x", "0b"):
        number = int(digits, 0)
    else:
        number = int(digits, 8 if digits.startswith("0") and len(digits) > 1 else 10) if len(digits) < 25 else 2**70
    if number >= 2**64:
        raise UnsupportedCError(f"the number {text[:30]} is too large")
    return number


def variable_of(tree: c_ast.Decl, name: str, file: CFile, elements: int | None = None) -> Variable:
    """Return a declared variable; `elements` is the number of initial values, if no size is written."""
    sizes: list[int] = []
    kind: c_ast.Node = tree.type
    while isinstance(kind, c_ast.ArrayDecl):
        size = elements if kind.dim is None and not sizes else None
        sizes.append(constant_integer(kind.dim, file.constants) if size is None else size)
        kind = kind.type
    total = 1
    for size in sizes:
        total *= size
        if not 0 < size <= _MAX_SIZE or total > _MAX_SIZE:
            raise UnsupportedCError(f"{tree.name} has {size} elements", line_of(tree))
    if len(sizes) > 2:
        raise UnsupportedCError(f"{tree.name} has more than two dimensions", line_of(tree))
    is_constant = "const" in tree.quals or "const" in getattr(kind, "quals", ())
    return Variable(
        name, number_type(kind, file.typedefs, line_of(tree)), tuple(sizes), is_constant=is_constant,
        is_static="static" in tree.storage,
    )  # fmt: skip


def _function(tree: c_ast.FuncDef, file: CFile) -> CFunctionDeclaration:
    declared = tree.decl.type
    parameters = declared.args.params if declared.args is not None else []
    arguments = []
    for parameter in parameters:
        if isinstance(parameter, c_ast.Typename) and _is_void(parameter.type):
            continue
        if not isinstance(parameter, c_ast.Decl):
            raise UnsupportedCError(f"{tree.decl.name} has arguments that are not supported", line_of(tree.decl))
        arguments.append(_argument(parameter, tree, file))
    result = None if _is_void(declared.type) else number_type(declared.type, file.typedefs, line_of(tree.decl))
    return CFunctionDeclaration(str(tree.decl.name), tree, tuple(arguments), result)


def _is_void(tree: c_ast.Node) -> bool:
    return isinstance(tree, c_ast.TypeDecl) and getattr(tree.type, "names", None) == ["void"]


def _argument(tree: c_ast.Decl, function: c_ast.FuncDef, file: CFile) -> Argument:
    line = line_of(tree)
    kind = tree.type
    if not isinstance(kind, c_ast.PtrDecl | c_ast.ArrayDecl):
        return Argument(Variable(tree.name, number_type(kind, file.typedefs, line)), "value")
    inner = kind.type
    sizes: tuple[int, ...] = ()
    if isinstance(inner, c_ast.ArrayDecl) and isinstance(kind, c_ast.ArrayDecl):
        sizes = (0, constant_integer(inner.dim, file.constants))
        inner = inner.type
    is_constant = "const" in getattr(inner, "quals", ())
    is_array = bool(sizes) or _is_indexed(function.body, tree.name)
    variable = Variable(
        tree.name, number_type(inner, file.typedefs, line), sizes, True, is_array, is_constant=is_constant
    )
    return Argument(variable, "input" if is_constant else "output")


def _is_indexed(tree: c_ast.Node, name: str) -> bool:
    """Return True if a pointer is used as an array: with an index other than 0."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, c_ast.ArrayRef) and isinstance(node.name, c_ast.ID) and node.name.name == name:
            index = node.subscript
            if not (isinstance(index, c_ast.Constant) and index.value == "0"):
                return True
        waiting += [child for _, child in node.children()]
    return False
