"""Addresses within arrays: sums with integers, differences, comparisons, and pointers that move.

The tree has no addresses. One that leads into an array is the array and an index. Of a pointer that moves, the index is
a variable of its own, while the array is known where the code is translated:

    const float *p = a;       p@ = 0
    while (n--) y += *p++;    y += a[p@]; p@ += 1
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple, TypeVar

from pycparser import c_ast

from kennfeld.importers.c.declarations import CFile, CVariable, line_of
from kennfeld.importers.c.number_types import UnsupportedCError, same_type
from kennfeld.importers.c.places import CPlace, PlaceTranslation, sum_of
from kennfeld.importers.c.struct_types import DeclaredType, ObjectType, OpaqueType
from kennfeld.program import tree as m

_Value = TypeVar("_Value")
_STEPS: Final = {"++": 1.0, "p++": 1.0, "--": -1.0, "p--": -1.0}
_COMPARISONS: Final = {"==": "==", "!=": "~=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
NULL: Final = m.Number(-(2.0**40))  # the index of a pointer that leads nowhere
_MARK: Final = "@"  # behind the name of a pointer: the variable of its index


class DeclaredPointer(NamedTuple):
    """A pointer: the type of what it leads to, and the variable of its index, if it moves."""

    type: ObjectType
    variable: str

    @property
    def place(self) -> m.Name:
        """The index of the element that it leads to."""
        return m.Name(self.variable)


class AddressTranslation(PlaceTranslation):
    """Translates addresses; `pending` are statements that must run before the expression that is translated."""

    def __init__(self, file: CFile) -> None:
        super().__init__(file, [{}])
        self.pending: list[m.Statement] = []
        self._temporaries = 0

    def temporary(self) -> str:
        """Return the name of a new local variable."""
        self._temporaries += 1
        return f"%{self._temporaries}"

    def apart(self, translate: Callable[[], _Value]) -> tuple[_Value, list[m.Statement]]:
        """Translate an expression that is evaluated only under a condition; return it with its statements."""
        outer, self.pending = self.pending, []
        try:
            return translate(), self.pending
        finally:
            self.pending = outer

    # addresses

    def is_address(self, tree: c_ast.Node) -> bool:
        match tree:
            case c_ast.UnaryOp(op="&"):
                return True
            case c_ast.UnaryOp(op="++" | "--" | "p++" | "p--", expr=of) | c_ast.Assignment(op="+=" | "-=", lvalue=of):
                return self.is_address(of)
            case c_ast.BinaryOp(op="+", left=left, right=right):
                return self.is_address(left) or self.is_address(right)
            case c_ast.BinaryOp(op="-", left=left, right=right):
                return self.is_address(left) and not self.is_address(right)
            case c_ast.Cast(to_type=c_ast.Typename(type=c_ast.PtrDecl()), expr=of):
                return self.is_address(of)
            case c_ast.ID() | c_ast.ArrayRef():
                return self._dimensions(tree) > 0
            case c_ast.StructRef():
                member, _ = self.apart(lambda: self.place(tree))
                return member.is_pointer or bool(member.sizes)
        return False

    def _dimensions(self, tree: c_ast.Node) -> int:
        """Return how many indices lead from a variable, or an element of one, to a number or a struct."""
        match tree:
            case c_ast.ArrayRef(name=of, subscript=index):
                return max(self._dimensions(of), self._dimensions(index)) - 1
            case c_ast.ID(name=name) if any(name in scope for scope in self.scopes):
                place = self.lookup(name, tree)
                if isinstance(place, int):
                    return 0
                return max(len(place.sizes), int(place.is_pointer or isinstance(place, CPlace)))
            case c_ast.StructRef():
                member, _ = self.apart(lambda: self.place(tree))
                return max(len(member.sizes), int(member.is_pointer))
        return 0

    def address(self, tree: c_ast.Node, *, is_flat: bool = False) -> CPlace:
        """Return the place that an address leads to; the numbers of a matrix one by one, if `is_flat`."""
        match tree:
            case c_ast.UnaryOp(op="&", expr=c_ast.ArrayRef(name=left, subscript=right)):
                of, index = (right, left) if self.is_address(right) else (left, right)
                return self._moved(self.address(of, is_flat=is_flat), self._from_zero(index), tree)
            case c_ast.UnaryOp(op="&", expr=c_ast.UnaryOp(op="*", expr=of)):
                return self.address(of, is_flat=is_flat)
            case c_ast.UnaryOp(op="&", expr=of):
                place = self.place(of)
                return self.pointed(place, tree) if place.is_pointer else place
            case c_ast.UnaryOp(op=("++" | "--" | "p++" | "p--") as op, expr=of):
                return self._stepped_address(of, m.Number(_STEPS[op]), tree, is_before=op.startswith("p"))
            case c_ast.Assignment(op=("+=" | "-=") as op, lvalue=of, rvalue=count):
                return self._stepped_address(of, self.signed(op[0], count), tree)
            case c_ast.BinaryOp(op=("+" | "-") as op, left=left, right=right):
                of, count = (right, left) if op == "+" and self.is_address(right) else (left, right)
                return self._moved(self.address(of, is_flat=is_flat), self.signed(op, count), tree)
            case c_ast.Cast(to_type=kind, expr=of):
                place = self.address(of, is_flat=is_flat)
                self.check_type(place, self.file.types.declared(kind), line_of(tree))
                return place
            case c_ast.ArrayRef(name=of, subscript=index) if is_flat:
                rows = self.address(of, is_flat=True)
                if len(rows.sizes) > 1:
                    return rows.flat(self._from_zero(index))
        return self._named_address(tree)

    def _named_address(self, tree: c_ast.Node) -> CPlace:
        if isinstance(tree, c_ast.FuncCall):
            return self.returned_address(tree)
        if isinstance(tree, c_ast.ID | c_ast.StructRef | c_ast.CompoundLiteral | c_ast.ArrayRef):
            place = self.place(tree)
            if place.is_pointer:
                return self.pointed(place, tree)
            if place.sizes:
                return place
        raise UnsupportedCError("only addresses of variables and arrays are supported", line_of(tree))

    def check_type(self, place: CPlace, declared: DeclaredType, line: int) -> None:
        """Raise `UnsupportedCError` if an address is used as that of another type, which reads its bytes."""
        kind = declared.type
        if isinstance(kind, OpaqueType) or isinstance(place.type, OpaqueType) or same_type(place.type, kind):
            return
        message = f"{place.label} consists of {place.type.name}, and its address is used as one of {kind.name}"
        raise UnsupportedCError(f"{message}: reading bytes as another type is not supported", line)

    def _from_zero(self, tree: c_ast.Node) -> m.Expression:
        return sum_of(self.index(tree), m.Number(-1.0))

    def signed(self, op: str, tree: c_ast.Node) -> m.Expression:
        """Return the number of elements by which `p + n` or `p - n` is apart from p."""
        count = self._from_zero(tree)
        if op == "+":
            return count
        return m.Number(-count.value) if isinstance(count, m.Number) else m.Unary("-", count)

    def _moved(self, place: CPlace, count: m.Expression, tree: c_ast.Node) -> CPlace:
        """Return the address some elements behind another one."""
        if count == m.Number(0.0):
            return place
        if not place.sizes:
            message = f"{place.label} is a single object: an address in front of or behind it is not supported"
            raise UnsupportedCError(message, line_of(tree))
        return replace(place, start=sum_of(place.start or m.Number(0.0), count))

    def _stepped_address(
        self, of: c_ast.Node, count: m.Expression, tree: c_ast.Node, *, is_before: bool = False
    ) -> CPlace:
        """Move a pointer; return where it leads to then, or led before."""
        before = self.frozen(self.address(of), line_of(tree)) if is_before else None
        self.step_pointer(of, count, tree)
        return before or self.frozen(self.address(of), line_of(tree))

    def step_pointer(self, of: c_ast.Node, count: m.Expression, tree: c_ast.Node) -> None:
        """Add the statement that moves a pointer by some elements."""
        pointer = self.moving_pointer(of.name) if isinstance(of, c_ast.ID) else None
        if pointer is None:
            raise UnsupportedCError("only pointers that are local variables or arguments may move", line_of(tree))
        place = self._moved(self.address(of), count, tree)
        assert place.start is not None
        self.pending.append(m.Assign((pointer.place,), place.start, place=m.TextPosition(line_of(tree))))

    def declared_pointer(self, name: str) -> DeclaredPointer | None:
        """Return the pointer that a name stands for; None for other names."""
        for scope in reversed(self.scopes):
            if name in scope:
                declared = scope.get(f"{name}{_MARK}")
                return DeclaredPointer(declared.type, declared.name) if isinstance(declared, CVariable) else None
        return None

    def moving_pointer(self, name: str) -> DeclaredPointer | None:
        """Return the pointer with an index that a name stands for; None for other names."""
        pointer = self.declared_pointer(name)
        return pointer if pointer is not None and pointer.variable else None

    def add_pointer(self, name: str, kind: ObjectType, *, moves: bool) -> DeclaredPointer:
        """Note the type of a pointer that is declared in the innermost scope; give it an index if it moves."""
        variable = self.temporary() if moves else ""
        self.scopes[-1][f"{name}{_MARK}"] = CVariable(variable, kind)
        return DeclaredPointer(kind, variable)

    # what addresses tell

    def is_set(self, tree: c_ast.Node) -> m.Expression:
        """Return the condition that an address leads somewhere; none that a function gets is assumed to be null."""
        if isinstance(tree, c_ast.ID) and (pointer := self.moving_pointer(tree.name)) is not None:
            self.lookup(tree.name, tree)
            return m.Binary("~=", pointer.place, NULL)
        return m.Number(1.0)

    def between(self, op: str, left: c_ast.Node, right: c_ast.Node) -> m.Expression | None:
        """Return the tree of the difference of two addresses, or of their comparison; None for numbers."""
        if op not in (*_COMPARISONS, "-") or not (self.is_address(left) and self.is_address(right)):
            return None
        first, second = self.address(left, is_flat=True), self.address(right, is_flat=True)
        if first.array != second.array:
            message = f"addresses of {first.label} and {second.label} are compared, which are different objects"
            raise UnsupportedCError(message, line_of(left))
        starts = [place.start or m.Number(0.0) for place in (first, second)]
        return m.Binary(_COMPARISONS.get(op, op), *starts)

    def frozen(self, place: CPlace, line: int) -> CPlace:
        """Return a place whose indices keep the values that they have now."""
        indices = tuple(self._frozen(index, line) for index in place.indices)
        offset = None if place.offset is None else self._frozen(place.offset, line)
        start = None if place.start is None else self._frozen(place.start, line)
        return replace(place, indices=indices, offset=offset, start=start)

    def _frozen(self, index: m.Expression, line: int) -> m.Expression:
        if isinstance(index, m.Number):
            return index
        name = m.Name(self.temporary())
        self.pending.append(m.Assign((name,), index, place=m.TextPosition(line)))
        return name
