"""Declarations of a C file: types, variables, and functions with their arguments."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from typing import Final, Literal

from pycparser import c_ast
from pycparser.c_generator import CGenerator

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.number_types import KNOWN_TYPES, CType, UnsupportedCError
from kennfeld.importers.c.sizes import size_of
from kennfeld.importers.c.struct_types import (
    MAX_SIZE,
    CStructType,
    DeclaredType,
    Leaf,
    ObjectType,
    OpaqueType,
    Sizes,
    TypeTable,
    integer_literal,
    leaves_of,
)
from kennfeld.program import tree as m

_MAX_DIMENSIONS: Final = 4
RESULT: Final = "return"  # name of the returned value, which precedes the paths of its members


def line_of(tree: c_ast.Node) -> int:
    """Return the line of a tree; 0 if it has none."""
    return int(tree.coord.line) if tree.coord is not None else 0


@dataclass(frozen=True)
class CVariable:
    """A variable: a number, a struct, or an array of them.

    Attributes:
        name: its name in the shared syntax tree, which precedes the paths of members.
        type: type of its elements.
        sizes: sizes of an array; the first one is 0 behind a pointer to an array of unknown size.
        is_pointer: True if it is an address that a function was called with.
        is_static: True if it keeps its value between calls.
        is_constant: True if it cannot be assigned.
        is_volatile: True if it may change between calls, as calibration values do.
    """

    name: str
    type: ObjectType
    sizes: Sizes = ()
    is_pointer: bool = False
    is_static: bool = False
    is_constant: bool = False
    is_volatile: bool = False

    @property
    def leaves(self) -> Iterator[Leaf]:
        """The numbers that it consists of."""
        return leaves_of(self.type, self.sizes)


@dataclass(frozen=True)
class StaticVariable:
    """The numbers of a variable that keep their values, with the tree of the first values.

    `root` is the variable that they belong to, and `label` its name for the user.
    """

    name: str
    leaf: Leaf
    first: m.Expression
    root: CVariable
    label: str
    is_initialized: bool = False
    line: int = 0


@dataclass(frozen=True)
class CArgument:
    """An argument of a function.

    Attributes:
        variable: the variable.
        mode: a number or struct, the address of results, or of constants.
        text: its declaration.
    """

    variable: CVariable
    mode: Literal["value", "output", "input"]
    text: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the numbers that it passes."""
        return tuple(f"{self.variable.name}{leaf.path}" for leaf in self.variable.leaves)


@dataclass(frozen=True)
class CFunctionDeclaration:
    """A function of the file.

    Attributes:
        name: its name.
        tree: its definition.
        arguments: its arguments.
        result: type of the value that it returns; None if it returns none.
        passed_back: the argument that it returns, if that is an address and always the same.
    """

    name: str
    tree: c_ast.FuncDef
    arguments: tuple[CArgument, ...]
    result: CType | CStructType | None
    passed_back: str = ""

    @property
    def returned(self) -> "CVariable | None":
        """The value that it returns, as a variable."""
        return None if self.result is None else CVariable(RESULT, self.result)

    @property
    def result_names(self) -> tuple[str, ...]:
        """The names of the numbers that it returns."""
        return () if self.returned is None else tuple(f"{RESULT}{leaf.path}" for leaf in self.returned.leaves)

    @property
    def outputs(self) -> tuple[CArgument, ...]:
        """The arguments through which it returns results."""
        return tuple(argument for argument in self.arguments if argument.mode == "output")

    @property
    def line(self) -> int:
        """The line of its name."""
        return line_of(self.tree.decl)


@dataclass(eq=False)
class CFile:
    """The declarations of a file; `variables` are the first declarations of those outside of functions."""

    functions: dict[str, CFunctionDeclaration] = field(default_factory=dict)
    unsupported: dict[str, UnsupportedCError] = field(default_factory=dict)
    variables: dict[str, c_ast.Decl] = field(default_factory=dict)
    types: TypeTable = field(default_factory=TypeTable)


def read_declarations(
    tree: c_ast.FileAST, first: int = len(KNOWN_TYPES), types: Mapping[str, CType] | None = None
) -> CFile:
    """Read what a file declares; functions whose arguments are not supported are in `unsupported`.

    Args:
        tree: the syntax tree.
        first: number of declarations that precede those of the file.
        types: the number types that need no definition; by default those of LP64.
    """
    file = CFile()
    if types is not None:
        file.types = TypeTable({name: DeclaredType(kind) for name, kind in types.items()})
    file.types.sizeof = lambda tree: _size_of_object(tree, file)
    for item in tree.ext[:first]:
        if isinstance(item, c_ast.Typedef) and item.name not in KNOWN_TYPES:
            file.types.typedef(item)
    for item in tree.ext[first:]:
        _declare(item, file)
    return file


def _size_of_object(tree: c_ast.Node, file: CFile) -> int:
    """Return the size of a type, of a variable outside of functions, or of an element of one."""
    if isinstance(tree, c_ast.Typename):
        declared = file.types.declared(tree)
        return size_of(file.types, declared.type, declared.sizes, is_pointer=declared.is_pointer)
    depth = 0
    # indices do not matter: all elements have one size, and sizeof evaluates nothing
    while isinstance(tree, c_ast.ArrayRef):
        tree, depth = tree.name, depth + 1
    if not isinstance(tree, c_ast.ID) or tree.name not in file.variables:
        raise UnsupportedCError("sizeof is supported of types and variables of the file here", line_of(tree))
    variable = file.variables[tree.name]
    declared = file.types.declared(variable)
    sizes = declared.sizes
    if sizes[:1] == (0,):
        sizes = (len(variable.init.exprs) if isinstance(variable.init, c_ast.InitList) else 0, *sizes[1:])
    return size_of(file.types, declared.type, sizes[depth:], is_pointer=declared.is_pointer)


def _declare(item: c_ast.Node, file: CFile) -> None:
    try:
        file.types.enumerate(item)
    except UnsupportedCError:
        return  # its constants are unknown names
    if isinstance(item, c_ast.Typedef):
        file.types.typedef(item)
    elif isinstance(item, c_ast.FuncDef):
        name = str(item.decl.name)
        try:
            file.functions[name] = _function(item, file)
        except UnsupportedCError as error:
            file.unsupported[name] = error
    elif isinstance(item, c_ast.Decl) and not isinstance(item.type, c_ast.FuncDecl):
        _declare_variable(item, file)


def _declare_variable(item: c_ast.Decl, file: CFile) -> None:
    with suppress(UnsupportedCError):  # an error where it is used
        file.types.declared(item)  # which notes the tags of structs
    # `extern` and tentative declarations may precede or follow the one with first values
    if item.name and (item.name not in file.variables or item.init is not None):
        file.variables[item.name] = item


def variable_of(tree: c_ast.Decl, name: str, file: CFile, elements: int | None = None) -> CVariable:
    """Return a declared variable; `elements` is the number of initial values, if no size is written."""
    declared = file.types.declared(tree)
    if declared.is_pointer:
        raise UnsupportedCError(f"{tree.name} is a pointer, which is not supported here", line_of(tree))
    if isinstance(declared.type, OpaqueType):
        raise UnsupportedCError(f"{tree.name} is {declared.type.reason}: not supported", line_of(tree))
    sizes = declared.sizes
    if sizes[:1] == (0,) and elements is not None:
        sizes = (elements, *sizes[1:])
    _check_sizes(tree, declared.type, sizes)
    return CVariable(
        name, declared.type, sizes, is_static="static" in tree.storage, is_constant=declared.is_constant,
        is_volatile=declared.is_volatile,
    )  # fmt: skip


def _check_sizes(tree: c_ast.Decl, kind: ObjectType, sizes: Sizes) -> None:
    for leaf in leaves_of(kind, sizes):
        total = 1
        for size in leaf.sizes:
            total *= size
            if not 0 < size <= MAX_SIZE or total > MAX_SIZE:
                raise UnsupportedCError(f"{tree.name} has {size} elements", line_of(tree))
        if len(leaf.sizes) > _MAX_DIMENSIONS:
            raise UnsupportedCError(f"{tree.name} has more than {_MAX_DIMENSIONS} dimensions", line_of(tree))


def _function(tree: c_ast.FuncDef, file: CFile) -> CFunctionDeclaration:
    declared = tree.decl.type
    parameters = declared.args.params if declared.args is not None else []
    arguments = []
    for parameter in parameters:
        # `f(void)` has no arguments
        if isinstance(parameter, c_ast.Typename) and _is_void(parameter.type):
            continue
        if not isinstance(parameter, c_ast.Decl):
            raise UnsupportedCError(f"{tree.decl.name} has arguments that are not supported", line_of(tree.decl))
        arguments.append(_argument(parameter, tree, file))
    # a function that returns the address it was given is a procedure: what counts is what it wrote there
    passed_back = _passed_back(tree) if isinstance(declared.type, c_ast.PtrDecl) else ""
    if passed_back not in {each.variable.name for each in arguments}:
        passed_back = ""
    is_void = _is_void(declared.type) or passed_back
    result = None if is_void else _result(tree, file.types.declared(declared.type))
    return CFunctionDeclaration(str(tree.decl.name), tree, tuple(arguments), result, passed_back)


def _passed_back(tree: c_ast.FuncDef) -> str:
    """Return the name that all return statements of a function return; empty if they return something else."""
    names, waiting = set[str](), [tree.body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, c_ast.Return):
            names.add(str(node.expr.name) if isinstance(node.expr, c_ast.ID) else "")
        waiting += [child for _, child in node.children()]
    return names.pop() if len(names) == 1 else ""


def _result(tree: c_ast.FuncDef, declared: DeclaredType) -> CType | CStructType:
    reason = ""
    if declared.is_pointer:
        reason = "a pointer"
    elif isinstance(declared.type, OpaqueType):
        reason = declared.type.reason
    elif any(leaf.owner[0] for leaf in leaves_of(declared.type)):
        reason = "a struct with pointers"
    if reason or isinstance(declared.type, OpaqueType):
        raise UnsupportedCError(f"{tree.decl.name} returns {reason}, which is not supported", line_of(tree.decl))
    return declared.type


def _is_void(tree: c_ast.Node) -> bool:
    return isinstance(tree, c_ast.TypeDecl) and getattr(tree.type, "names", None) == ["void"]


def _argument(tree: c_ast.Decl, function: c_ast.FuncDef, file: CFile) -> CArgument:
    declared = file.types.declared(tree)
    name, text = str(tree.name), CGenerator().visit(tree)
    if isinstance(declared.type, OpaqueType):
        raise UnsupportedCError(f"the argument {name} is {declared.type.reason}: not supported", line_of(tree))
    if not declared.is_pointer and not declared.sizes:
        return CArgument(CVariable(name, declared.type), "value", text)
    sizes = declared.sizes
    if declared.is_pointer and (sizes or is_indexed(function.body, name, file.functions)):
        # an array of unknown size
        sizes = (0, *sizes)
    if sizes[:1] == (0,):
        sizes = (_constant_size(function.body, name), *sizes[1:])
    variable = CVariable(name, declared.type, sizes, True, is_constant=declared.is_constant)
    return CArgument(variable, "input" if declared.is_constant else "output", text)


def _constant_size(tree: c_ast.Node, name: str) -> int:
    """Return the size of an array behind a pointer of which a function names elements only by constants; else 0."""
    largest, waiting = 0, [tree]
    while waiting:
        match waiting.pop():
            case c_ast.ArrayRef(name=c_ast.ID(name=indexed), subscript=c_ast.Constant(type="int", value=text)) if (
                indexed == name
            ):
                largest = max(largest, integer_literal(text) + 1)
            # used otherwise than by a constant index
            case c_ast.ID(name=used) if used == name:
                return 0
            case c_ast.StructRef(name=of):  # whose member may have the same name
                waiting.append(of)
            case node:
                waiting += [child for _, child in node.children()]
    return largest if largest <= MAX_SIZE else 0


def is_indexed(
    tree: c_ast.Node, name: str, functions: "Mapping[str, CFunctionDeclaration]", seen: tuple[str, ...] = ()
) -> bool:
    """Return True if a pointer leads into an array: it moves, is a part of a sum, or has an index other than 0.

    So does one that another pointer of that kind is set to, or that a function gets as an array.
    """
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if _indexes(node, name, functions):
            return True
        other = _pointer_set_to(node, name)
        if other and other not in seen and is_indexed(tree, other, functions, (*seen, name)):
            return True
        waiting += [child for _, child in node.children()]
    return False


def _indexes(node: c_ast.Node, name: str, functions: "Mapping[str, CFunctionDeclaration]") -> bool:
    match node:
        case c_ast.ArrayRef(name=of, subscript=index):
            # p[0] is another way to write *p
            return _is_name(of, name) and not (isinstance(index, c_ast.Constant) and index.value in ("0", "0U", "0u"))
        case c_ast.UnaryOp(op="++" | "--" | "p++" | "p--", expr=of) | c_ast.Assignment(op="+=" | "-=", lvalue=of):
            return _is_name(of, name)
        case c_ast.BinaryOp(op="+" | "-", left=left, right=right):
            return _is_name(left, name) or _is_name(right, name)
        case c_ast.FuncCall(name=c_ast.ID(name=called), args=c_ast.ExprList(exprs=arguments)) if called in functions:
            pairs = zip(functions[called].arguments, arguments, strict=False)
            return any(_is_name(tree, name) and argument.variable.sizes for argument, tree in pairs)
    return False


def _is_name(tree: c_ast.Node, name: str) -> bool:
    while isinstance(tree, c_ast.Cast):
        tree = tree.expr
    return isinstance(tree, c_ast.ID) and bool(tree.name == name)


def _pointer_set_to(node: c_ast.Node, name: str) -> str:
    """Return the name of a pointer that is declared or set as another one; empty for other statements."""
    if isinstance(node, c_ast.Decl) and isinstance(node.type, c_ast.PtrDecl) and node.init is not None:
        return str(node.name) if _is_name(node.init, name) and node.name != name else ""
    if isinstance(node, c_ast.Assignment) and node.op == "=" and isinstance(node.lvalue, c_ast.ID):
        return str(node.lvalue.name) if _is_name(node.rvalue, name) and node.lvalue.name != name else ""
    return ""
