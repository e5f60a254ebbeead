"""Places in memory that expressions name: variables, elements of arrays, members of structs, and addresses of them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, TypeAlias

from pycparser import c_ast

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.declarations import CFile, CVariable, line_of
from kennfeld.importers.c.number_types import CType, UnsupportedCError
from kennfeld.importers.c.struct_types import (
    CStructType,
    Leaf,
    Member,
    ObjectType,
    OpaqueType,
    Sizes,
    leaves_of,
    member_path,
    number_count,
)
from kennfeld.program import tree as m

_MOST_COPIED: Final = 1000  # numbers of a part of an array, which are copied one by one


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
        offset: if it shares numbers with other members of a union, the number of its first one in their array, from 0.
        unions: the members of unions that it is a part of, from outside in.
        start: of an address within an array, the number of the element that it leads to, from 0.
        rows: sizes of the matrix whose numbers it has one by one.
    """

    variable: CVariable
    path: str
    type: ObjectType
    sizes: Sizes = ()
    indices: tuple[m.Expression, ...] = ()
    is_constant: bool = False
    is_pointer: bool = False
    offset: m.Expression | None = None
    unions: "tuple[UnionMember, ...]" = ()
    start: m.Expression | None = None
    rows: Sizes = ()

    @property
    def name(self) -> str:
        """The name of its numbers in the shared syntax tree."""
        return f"{self.variable.name}{self.path}"

    @property
    def label(self) -> str:
        """Its name in messages."""
        return self.name.removeprefix(".").replace("().", ".")  # static variables of a function have it in front

    @property
    def tree(self) -> m.Expression:
        """The tree of its numbers; all of them if it is an array."""
        shared = () if self.offset is None else (sum_of(self.offset, m.Number(1.0)),)
        indices = (*self.indices, *shared)
        return m.Call(m.Name(self.name), indices) if indices else m.Name(self.name)

    @property
    def array(self) -> "CPlace":
        """The array that it is, or into which it leads as an address, whether that may change it or not."""
        return replace(self, start=None, is_constant=False, is_pointer=False)

    @property
    def first(self) -> int:
        """The number of the element that it leads to, if that is a constant.

        Raises:
            UnsupportedCError: it depends on signals or on the pass of a loop.
        """
        if self.start is None:
            return 0
        if isinstance(self.start, m.Number):
            return int(self.start.value)
        raise UnsupportedCError(f"an address within {self.label} that is not constant is not supported here")

    @property
    def leaves(self) -> Iterator[Leaf]:
        """The numbers that it consists of, with paths from here on."""
        return leaves_of(self.type, self.sizes)

    def leaf(self, leaf: Leaf) -> "CPlace":
        """Return the place of some of its numbers."""
        return replace(self, path=f"{self.path}{leaf.path}", type=leaf.type, sizes=leaf.sizes)

    def member(self, member: Member) -> "CPlace":
        """Return the place of a member of a struct or union."""
        struct, declared = self.type, member.declared
        assert isinstance(struct, CStructType)
        place = replace(
            self,
            path=member_path(self.path, member.name),
            type=declared.type,
            sizes=declared.sizes,
            is_constant=self.is_constant or declared.is_constant,
            is_pointer=declared.is_pointer,
        )
        if self.offset is not None:
            # numbers of a struct follow one another in the shared array; members of a union begin at the same one
            before = struct.members[: struct.members.index(member)] if not struct.is_union else ()
            count = sum(number_count(each.declared.type, each.declared.sizes) for each in before)
            return replace(place, path=self.path, offset=sum_of(self.offset, m.Number(float(count))))
        if struct.storage is not None and member != struct.storage:
            return replace(place, path=member_path(self.path, struct.storage.name), offset=m.Number(0.0))
        if struct.tag and member.name != struct.tag:
            return replace(place, unions=(*self.unions, UnionMember(self, place, struct.members.index(member) + 1)))
        return place

    def element(self, index: m.Expression) -> "CPlace":
        """Return the place of an element of an array, counted from 1, or from the address within it."""
        if (start := self.start) is not None:
            return replace(self, start=None).element(sum_of(index, start))
        if self.rows:
            indices = (*self.indices, *_matrix_indices(sum_of(index, m.Number(-1.0)), self.rows))
            return replace(self, sizes=(), indices=indices, rows=())
        if self.offset is None:
            return replace(self, sizes=self.sizes[1:], indices=(*self.indices, index))
        step = m.Number(float(number_count(self.type, self.sizes[1:])))
        # offset + (index - 1) * numbers of an element
        from_zero = sum_of(index, m.Number(-1.0))
        return replace(self, sizes=self.sizes[1:], offset=sum_of(self.offset, _product(from_zero, step)))

    def flat(self, row: m.Expression) -> "CPlace":
        """Return the numbers of a matrix one by one, from those of a row on, counted from 0."""
        count = _product(row, m.Number(float(math.prod(self.sizes[1:]))))
        rows = self.sizes if self.offset is None else ()
        start = sum_of(self.start or m.Number(0.0), count)
        return replace(self, sizes=(math.prod(self.sizes),), start=start, rows=rows)

    def numbers(self) -> "Iterator[CPlace]":
        """Yield the place of each of its numbers."""
        if self.sizes:
            for at in range(self.sizes[0] - self.first):
                yield from self.element(m.Number(at + 1.0)).numbers()
        elif isinstance(self.type, CStructType):
            for member in self.type.members if self.type.storage is None else (self.type.storage,):
                yield from replace(self.member(member), unions=self.unions, is_pointer=False).numbers()
        else:
            yield self


class UnionMember(NamedTuple):
    """The union that a place is a part of, the place of its member, and the number of the member, from 1 on."""

    union: CPlace
    member: CPlace
    number: int

    def tag(self, indices: Sequence[m.Expression]) -> CPlace:
        """Return the place of the number of the member written last, at the indices of a part of the member."""
        assert isinstance(self.union.type, CStructType)
        # each union of an array has a number of its own: the first indices lead to it
        place = self.union.member(self.union.type.members[-1])
        return replace(place, indices=tuple(indices[: len(place.indices)]), unions=())


def sum_of(left: m.Expression, right: m.Expression) -> m.Expression:
    """Return the tree of a sum, computed if both sides are numbers."""
    if isinstance(left, m.Number) and isinstance(right, m.Number):
        return m.Number(left.value + right.value)
    if m.Number(0.0) in (left, right):
        return left if right == m.Number(0.0) else right
    return m.Binary("+", left, right)


def _matrix_indices(at: m.Expression, sizes: Sizes) -> list[m.Expression]:
    """Return the indices, from 1, of an element of a matrix by its number in memory, from 0."""
    result = []
    for depth in range(len(sizes)):
        step = math.prod(sizes[depth + 1 :])
        part = at if step == 1 else _of_integers("quotient", at, step)
        result.append(sum_of(part if depth == 0 else _of_integers("rest", part, sizes[depth]), m.Number(1.0)))
    return result


def _of_integers(name: str, left: m.Expression, right: int) -> m.Expression:
    if isinstance(left, m.Number):
        return m.Number(float(left.value // right if name == "quotient" else left.value % right))
    return m.Call(m.Name(f"c:{name}"), (left, m.Number(float(right))))


def _product(left: m.Expression, right: m.Number) -> m.Expression:
    if isinstance(left, m.Number):
        return m.Number(left.value * right.value)
    return left if right.value == 1.0 else m.Binary(".*", left, right)


# a place stands for a pointer that always has this address, an error for a declaration that is not supported
Scope: TypeAlias = dict[str, "CVariable | CPlace | int | UnsupportedCError"]


class PlaceTranslation:
    """Finds the places that expressions name."""

    def __init__(self, file: CFile, scopes: list[Scope]) -> None:
        self.file, self.scopes = file, scopes
        self.statics_used: dict[str, None] = {}

    def index(self, tree: c_ast.Node) -> m.Expression:
        """Translate an index to one that counts from 1."""
        raise NotImplementedError

    def is_address(self, tree: c_ast.Node) -> bool:
        """Return True for an expression that is an address: an array, a pointer, or `&x`."""
        raise NotImplementedError

    def object_place(self, tree: c_ast.Node) -> CPlace:
        """Return the place of an object without a name, such as a result that is a struct."""
        raise NotImplementedError

    def returned_address(self, tree: c_ast.FuncCall) -> CPlace:
        """Return the place whose address a call returns: that of one of its arguments."""
        raise NotImplementedError

    def passes_back(self, tree: c_ast.FuncCall) -> bool:
        """Return True if a call returns the address that one of its arguments is."""
        function = self.file.functions.get(getattr(tree.name, "name", ""))
        return function is not None and bool(function.passed_back)

    def lookup(self, name: str, tree: c_ast.Node) -> CVariable | CPlace | int:
        """Return the variable, the address, or the constant of an enumeration, of a name."""
        for scope in reversed(self.scopes):
            if name in scope:
                named = scope[name]
                if isinstance(named, UnsupportedCError):
                    raise named  # the reason itself, so that it is reported once
                return named
        if name in self.file.types.constants:
            return self.file.types.constants[name]
        raise UnsupportedCError(f"unknown name {name}", line_of(tree), wrong=True)

    def used(self, place: CPlace) -> m.Expression:
        """Return the tree of numbers, which a function uses from then on."""
        if place.start is not None:
            raise UnsupportedCError(f"a part of {place.label} from an address on is not supported here")
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
            # *(a + i) is a[i], and so is i[a]
            case (
                c_ast.ArrayRef(name=left, subscript=right)
                | c_ast.UnaryOp(op="*", expr=c_ast.BinaryOp(op="+", left=left, right=right))
            ):
                of, index = (right, left) if self.is_address(right) else (left, right)
                return self._element(self.address(of) if is_computed(of) else self.place(of), index, tree)
            case c_ast.UnaryOp(op="*", expr=c_ast.UnaryOp(op="&", expr=of)):
                return self.place(of)
            case c_ast.UnaryOp(op="*", expr=of) if is_computed(of):
                place = self.address(of)
                return self.pointed(place, tree) if place.sizes else place
            case c_ast.UnaryOp(op="*", expr=of):
                return self.pointed(self.place(of), tree)
            case c_ast.FuncCall() | c_ast.CompoundLiteral() | c_ast.TernaryOp() | c_ast.Assignment():
                return self.object_place(tree)
        raise UnsupportedCError(f"{kind_of(tree)} is not supported here", line_of(tree))

    def address(self, tree: c_ast.Node, *, is_flat: bool = False) -> CPlace:
        """Return the place that an address leads to: an array for `a` and `&a[0]`, a part of one for `a + 2`."""
        raise NotImplementedError

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

    def pointed(self, place: CPlace, tree: c_ast.Node) -> CPlace:
        """Return the object that an address leads to."""
        if place.is_pointer:
            return replace(place, is_pointer=False)
        if place.sizes:
            # *a is a[0]
            return self._at(place, m.Number(1.0), tree)
        raise UnsupportedCError(f"{place.label} is not an array or address", line_of(tree), wrong=True)

    def _element(self, place: CPlace, subscript: c_ast.Node, tree: c_ast.Node) -> CPlace:
        if place.sizes:
            return self._at(place, self.index(subscript), tree)
        if place.is_pointer and isinstance(subscript, c_ast.Constant) and subscript.value.rstrip("uU") == "0":
            return self.pointed(place, tree)
        raise UnsupportedCError(f"{place.label} is a number, not an array", line_of(tree), wrong=True)

    def _at(self, place: CPlace, index: m.Expression, tree: c_ast.Node) -> CPlace:
        """Return an element of an array, which it must have."""
        if (start := place.start) is not None:
            place, index = replace(place, start=None), sum_of(index, start)
        return place.element(self._bounded(index, place, tree))

    def _bounded(self, index: m.Expression, place: CPlace, tree: c_ast.Node) -> m.Expression:
        """Return an index that is checked."""
        size = place.sizes[0]
        if not size:  # of an array behind a pointer, which the function may be called with
            if place.indices or place.offset is not None:
                return index
            numbers = m.Name(f"{place.name}{next(place.leaves).path}")
            count = m.Call(m.Name("c:size"), (numbers, m.Number(float(math.prod(place.rows[1:])))))
            return m.Call(m.Name("c:index"), (index, count))
        if isinstance(index, m.Number):
            if not 1 <= index.value <= size:
                message = f"index {index.value - 1:g} of {place.label}, which has {size} elements"
                raise UnsupportedCError(message, line_of(tree), wrong=True)
            return index
        # tested when the graph is built, where the index may turn out to be constant
        return m.Call(m.Name("c:index"), (index, m.Number(float(size))))

    def _member(self, place: CPlace, operator: str, name: str, tree: c_ast.Node) -> CPlace:
        if operator == "->":
            place = self.pointed(place, tree)
        if place.is_pointer or place.sizes or not isinstance(place.type, CStructType):
            kind = place.type.reason if isinstance(place.type, OpaqueType) else "not a struct"
            raise UnsupportedCError(
                f"{place.label} is {kind}, so that it has no member {name}", line_of(tree), wrong=True
            )
        try:
            chain = place.type.path(name)
        except UnsupportedCError as error:
            raise UnsupportedCError(error.message, line_of(tree), wrong=error.wrong) from None
        for member in chain:
            place = place.member(member)
        return place


def is_computed(tree: c_ast.Node) -> bool:
    """Return True for an expression that can only be an address if it is one: `a + 1`, `p++`, `(int *)p`, `&a[1]`."""
    is_step = isinstance(tree, c_ast.UnaryOp) and tree.op in ("++", "--", "p++", "p--", "&")
    is_sum = isinstance(tree, c_ast.Assignment) and tree.op != "="
    return is_step or is_sum or isinstance(tree, c_ast.BinaryOp | c_ast.Cast)


def assigned_leaves(target: CPlace, source: CPlace) -> list[tuple[CPlace, CPlace]]:
    """Return the places of the numbers that an assignment of a struct or an array copies."""
    if target.type != source.type or target.sizes != source.sizes:
        raise UnsupportedCError(f"{target.label} and {source.label} have different types", wrong=True)
    if any(leaf.owner[0] for leaf in source.leaves):  # the copy leads to the same numbers
        raise UnsupportedCError(f"{source.label} has pointers, so that it cannot be copied")
    parts = [_whole_parts(place) for place in (target, source)]
    if any(each is None for each in parts):
        parts = [single_numbers(place) for place in (target, source)]
    return list(zip(*(each or [] for each in parts), strict=True))


def parts_of(place: CPlace) -> list[CPlace]:
    """Return the places of the numbers of an object: of each array as a whole, unless it is within another array."""
    parts = _whole_parts(place)
    return single_numbers(place) if parts is None else parts


def _whole_parts(place: CPlace) -> list[CPlace] | None:
    parts = [place.leaf(leaf) for leaf in place.leaves]
    is_within = (
        place.offset is not None or place.start is not None or any(part.sizes and part.indices for part in parts)
    )
    return None if is_within else parts


def single_numbers(place: CPlace) -> list[CPlace]:
    """Return the place of each number of an object that is a part of an array."""
    count = number_count(place.type, place.sizes)
    if count > _MOST_COPIED:
        raise UnsupportedCError(f"a copy of {count} numbers within an array, more than {_MOST_COPIED}")
    return list(place.numbers())


def kind_of(tree: c_ast.Node) -> str:
    """Return the kind of an expression for a message."""
    names: Mapping[str, str] = {"UnaryOp": "this address", "InitList": "a list of values", "FuncCall": "a result"}
    return names.get(type(tree).__name__, f"{type(tree).__name__}")
