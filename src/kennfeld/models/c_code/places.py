"""Places in memory that expressions name: variables, elements of arrays, members of structs, and addresses of them."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TypeAlias

from pycparser import c_ast

from kennfeld.lazy_dataclass import dataclass
from kennfeld.matlab import syntax as m
from kennfeld.models.c_code.declarations import CFile, CVariable, line_of
from kennfeld.models.c_code.number_types import CType, UnsupportedCError
from kennfeld.models.c_code.struct_types import CStructType, Leaf, ObjectType, OpaqueType, Sizes, leaves_of


@dataclass(frozen=True)
class CPlace:
    """An object in memory.

    Attributes:
        variable: the variable that it is a part of.
        path: the members that lead to it, such as `.filter.state`.
        type: type of its elements.
        sizes: sizes of the array that it is; empty for a number or a struct.
        indices: the indices that lead to it, counted from 1.
        is_constant: True if it cannot be assigned.
        is_pointer: True if it is an address that leads to the object.
    """

    variable: CVariable
    path: str
    type: ObjectType
    sizes: Sizes = ()
    indices: tuple[m.Expression, ...] = ()
    is_constant: bool = False
    is_pointer: bool = False

    @property
    def name(self) -> str:
        """The name of its numbers in the shared syntax tree."""
        return f"{self.variable.name}{self.path}"

    @property
    def label(self) -> str:
        """Its name in messages."""
        return self.name.removeprefix(".")

    @property
    def tree(self) -> m.Expression:
        """The tree of its numbers; all of them if it is an array."""
        return m.Call(m.Name(self.name), self.indices) if self.indices else m.Name(self.name)

    @property
    def leaves(self) -> Iterator[Leaf]:
        """The numbers that it consists of, with paths from here on."""
        return leaves_of(self.type, self.sizes)

    def leaf(self, leaf: Leaf) -> "CPlace":
        """Return the place of some of its numbers."""
        return replace(self, path=f"{self.path}{leaf.path}", type=leaf.type, sizes=leaf.sizes)


Scope: TypeAlias = dict[str, "CVariable | CPlace | int"]  # a place stands for a pointer that always has this address


class PlaceTranslation:
    """Finds the places that expressions name."""

    def __init__(self, file: CFile, scopes: list[Scope]) -> None:
        self.file, self.scopes = file, scopes
        self.statics_used: dict[str, None] = {}

    def index(self, tree: c_ast.Node) -> m.Expression:
        """Translate an index to one that counts from 1."""
        raise NotImplementedError

    def lookup(self, name: str, tree: c_ast.Node) -> CVariable | CPlace | int:
        """Return the variable, the address, or the constant of an enumeration, of a name."""
        for scope in reversed(self.scopes):
            if name in scope:
                return scope[name]
        if name in self.file.types.constants:
            return self.file.types.constants[name]
        raise UnsupportedCError(f"unknown name {name}", line_of(tree), wrong=True)

    def used(self, place: CPlace) -> m.Expression:
        """Return the tree of numbers, which a function uses from then on."""
        if place.variable.is_static:
            self.statics_used[place.name] = None
        return place.tree

    def number(self, tree: c_ast.Node) -> CPlace:
        """Return the place of a number."""
        place = self.place(tree)
        if place.sizes or place.is_pointer or not isinstance(place.type, CType):
            kind = "an address" if place.sizes or place.is_pointer else "a struct"
            raise UnsupportedCError(f"{place.label} is {kind}, which is not supported here", line_of(tree))
        return place

    def place(self, tree: c_ast.Node) -> CPlace:
        """Return the place that an expression names."""
        match tree:
            case c_ast.ID(name=name):
                return self._named(name, tree)
            case c_ast.StructRef(name=of, type=operator, field=c_ast.ID(name=member)):
                return self._member(self.place(of), operator, str(member), tree)
            case c_ast.ArrayRef(name=of, subscript=subscript):
                return self._element(self.place(of), subscript, tree)
            case c_ast.UnaryOp(op="*", expr=c_ast.BinaryOp(op="+", left=left, right=right)):
                return self._element(self.place(left), right, tree)
            case c_ast.UnaryOp(op="*", expr=c_ast.UnaryOp(op="&", expr=of)):
                return self.place(of)
            case c_ast.UnaryOp(op="*", expr=of):
                return self._pointed(self.place(of), tree)
        raise UnsupportedCError(f"{kind_of(tree)} is not supported here", line_of(tree))

    def address(self, tree: c_ast.Node) -> CPlace:
        """Return the place that an address leads to; an array for `a` and `&a[0]`."""
        match tree:
            case c_ast.UnaryOp(op="&", expr=c_ast.ArrayRef(name=of, subscript=c_ast.Constant(value="0" | "0U" | "0u"))):
                array = self.place(of)
                return self._pointed(array, tree) if array.is_pointer else array
            case c_ast.UnaryOp(op="&", expr=of):
                place = self.place(of)
                return self._pointed(place, tree) if place.is_pointer else place
            case c_ast.Cast(expr=of):
                return self.address(of)
            case c_ast.ID() | c_ast.StructRef():
                place = self.place(tree)
                if place.is_pointer:
                    return self._pointed(place, tree)
                if place.sizes:
                    return place
        raise UnsupportedCError("only addresses of variables and arrays are supported", line_of(tree))

    def _named(self, name: str, tree: c_ast.Node) -> CPlace:
        variable = self.lookup(name, tree)
        if isinstance(variable, int):
            raise UnsupportedCError(f"{name} is a constant", line_of(tree), wrong=True)
        if isinstance(variable, CPlace):
            return replace(variable, is_pointer=not variable.sizes)
        is_pointer = variable.is_pointer and not variable.sizes
        return CPlace(
            variable, "", variable.type, variable.sizes, is_constant=variable.is_constant, is_pointer=is_pointer
        )

    def _pointed(self, place: CPlace, tree: c_ast.Node) -> CPlace:
        if place.is_pointer:
            return replace(place, is_pointer=False)
        if place.sizes:
            return replace(place, sizes=place.sizes[1:], indices=(*place.indices, m.Number(1.0)))
        raise UnsupportedCError(f"{place.label} is not an array or address", line_of(tree), wrong=True)

    def _element(self, place: CPlace, subscript: c_ast.Node, tree: c_ast.Node) -> CPlace:
        if place.sizes:
            index = self._bounded(self.index(subscript), place, tree)
            return replace(place, sizes=place.sizes[1:], indices=(*place.indices, index))
        if place.is_pointer and isinstance(subscript, c_ast.Constant) and subscript.value.rstrip("uU") == "0":
            return self._pointed(place, tree)
        raise UnsupportedCError(f"{place.label} is a number, not an array", line_of(tree), wrong=True)

    def _bounded(self, index: m.Expression, place: CPlace, tree: c_ast.Node) -> m.Expression:
        """Return an index that is checked, unless the size of its array is not known."""
        size = place.sizes[0]
        if not size:
            return index
        if isinstance(index, m.Number):
            if not 1 <= index.value <= size:
                message = f"index {index.value - 1:g} of {place.label}, which has {size} elements"
                raise UnsupportedCError(message, line_of(tree), wrong=True)
            return index
        return m.Call(m.Name("c:index"), (index, m.Number(float(size))))

    def _member(self, place: CPlace, operator: str, name: str, tree: c_ast.Node) -> CPlace:
        if operator == "->":
            place = self._pointed(place, tree)
        if place.is_pointer or place.sizes or not isinstance(place.type, CStructType):
            kind = place.type.reason if isinstance(place.type, OpaqueType) else "not a struct"
            raise UnsupportedCError(
                f"{place.label} is {kind}, so that it has no member {name}", line_of(tree), wrong=True
            )
        try:
            declared = place.type.member(name).declared
        except UnsupportedCError as error:
            raise UnsupportedCError(error.message, line_of(tree), wrong=error.wrong) from None
        return replace(
            place,
            path=f"{place.path}.{name}",
            type=declared.type,
            sizes=declared.sizes,
            is_constant=place.is_constant or declared.is_constant,
            is_pointer=declared.is_pointer,
        )


def assigned_leaves(target: CPlace, source: CPlace) -> list[tuple[CPlace, CPlace]]:
    """Return the places of the numbers that an assignment of a struct or an array copies."""
    if target.type != source.type or target.sizes != source.sizes:
        raise UnsupportedCError(f"{target.label} and {source.label} have different types", wrong=True)
    pairs = [(target.leaf(leaf), source.leaf(leaf)) for leaf in target.leaves]
    if any(part.sizes and part.indices for pair in pairs for part in pair):
        raise UnsupportedCError("copies of arrays within arrays are not supported")
    return pairs


def kind_of(tree: c_ast.Node) -> str:
    """Return the kind of an expression for a message."""
    names: Mapping[str, str] = {"UnaryOp": "this address", "InitList": "a list of values", "FuncCall": "a result"}
    return names.get(type(tree).__name__, f"{type(tree).__name__}")
