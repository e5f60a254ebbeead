"""First values of variables: lists in braces, with designators, of arrays, structs and unions."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from pycparser import c_ast

from kennfeld.importers.c.number_types import CType, UnsupportedCError
from kennfeld.importers.c.struct_types import (
    HIDDEN,
    CStructType,
    DeclaredType,
    ObjectType,
    Sizes,
    constant_integer,
    member_path,
)

Slots = npt.NDArray[np.int64]
StructNames: TypeAlias = Callable[[c_ast.Node], c_ast.Node | None]


class _Part(NamedTuple):
    """A part of a variable, with the place of its first number among all numbers."""

    type: ObjectType
    sizes: Sizes
    place: int


def initial_trees(
    tree: c_ast.Node | None,
    kind: ObjectType,
    sizes: Sizes,
    constants: Mapping[str, int],
    named_struct: StructNames = lambda _: None,
) -> dict[str, list[c_ast.Node | None]]:
    """Return the trees of the first values of each path of members, in the order of memory; None stands for 0.

    Args:
        tree: the list of first values.
        kind: type of the elements of the variable.
        sizes: its sizes.
        constants: constants of enumerations.
        named_struct: returns an expression that names the struct of another one; None if that one is a number.
    """
    values: dict[int, c_ast.Node] = {}
    whole = _Part(kind, sizes, 0)
    if tree is not None:
        _InitialValues(values, constants, named_struct).fill(whole, tree)
    return {path: [values.get(int(slot)) for slot in slots.ravel()] for path, slots in _slots(whole)}


def count_elements(tree: c_ast.Node | None, constants: Mapping[str, int]) -> int | None:
    """Return the number of elements that a list gives an array without a size."""
    if not isinstance(tree, c_ast.InitList):
        return None
    at = most = 0
    for item in tree.exprs or ():
        if isinstance(item, c_ast.NamedInitializer):
            name = item.name[0]
            if isinstance(name, c_ast.ID) and name.name not in constants:
                return None  # a member of a struct
            at = constant_integer(name, constants)
        at += 1
        most = max(most, at)
    return most


def _count(kind: ObjectType, sizes: Sizes) -> int:
    """Return how many numbers a part has; a pointer counts as one."""
    count = 1
    if isinstance(kind, CStructType):
        members = kind.members if kind.storage is None else (kind.storage,)
        count = sum(_member_count(member.declared) for member in members)
    for size in sizes:
        count *= size
    return count


def _member_count(declared: DeclaredType) -> int:
    return 1 if declared.is_pointer else _count(declared.type, declared.sizes)


def _slots(part: _Part) -> Iterator[tuple[str, Slots]]:
    yield from _slots_at(part.type, part.sizes, np.array(part.place, dtype=np.int64), "")


def _slots_at(kind: ObjectType, sizes: Sizes, places: Slots, path: str) -> Iterator[tuple[str, Slots]]:
    for at, size in enumerate(sizes):
        # row by row: an index steps over all numbers of the dimensions behind it
        step = _count(kind, sizes[at + 1 :])
        places = places[..., None] + step * np.arange(size, dtype=np.int64)
    if isinstance(kind, CType):
        yield path, places
    elif isinstance(kind, CStructType):
        offset = 0
        for name, declared in kind.members if kind.storage is None else (kind.storage,):
            inner = member_path(path, name)
            if declared.is_pointer:  # which points to numbers without first values
                yield from _slots_at(declared.type, declared.sizes, np.full_like(places, -(2**40)), inner)
            else:
                yield from _slots_at(declared.type, declared.sizes, places + offset, inner)
            offset += _member_count(declared)


def _parts(part: _Part) -> int:
    """Return the number of elements or members that values in braces are for; a union has one."""
    if part.sizes:
        return part.sizes[0]
    assert isinstance(part.type, CStructType)
    return 1 if part.type.is_union else len(part.type.members)


class _InitialValues:
    def __init__(self, values: dict[int, c_ast.Node], constants: Mapping[str, int], named_struct: StructNames) -> None:
        self.values, self.constants, self.named_struct = values, constants, named_struct

    def fill(self, part: _Part, tree: c_ast.Node) -> None:
        """Note the values of a part."""
        if not part.sizes and not isinstance(part.type, CStructType):
            # {{1}} is 1
            while isinstance(tree, c_ast.InitList):
                if len(tree.exprs) != 1:
                    raise UnsupportedCError("a number has several first values", wrong=True)
                tree = tree.exprs[0]
            self.values[part.place] = tree
        elif isinstance(tree, c_ast.CompoundLiteral):
            self.fill(part, tree.init)
        elif isinstance(tree, c_ast.InitList):
            waiting = deque(tree.exprs or ())
            self._items(part, waiting, in_braces=True)
            if waiting:
                raise UnsupportedCError(f"there are {len(waiting)} more first values than elements", wrong=True)
        elif (name := self.named_struct(tree)) is not None:
            self._copy(part, name)
        else:
            raise UnsupportedCError("the first values of an array or struct must be a list in braces")

    def _items(self, part: _Part, waiting: "deque[c_ast.Node]", *, in_braces: bool) -> None:
        """Take the values of the parts of a part, one after the other."""
        at, count = 0, _parts(part)
        while waiting:
            item = waiting[0]
            if isinstance(item, c_ast.NamedInitializer):
                # it names a part of the list in braces around
                if not in_braces:
                    return
                waiting.popleft()
                # C11, 6.7.9: the values that follow belong to the parts behind the named one
                at = self._designated(part, item.name, item.expr) + 1
                continue
            if at >= count:
                return
            child = self._child(part, at)
            self._mark(part, at)
            is_whole = isinstance(item, c_ast.InitList | c_ast.CompoundLiteral)
            if is_whole or not (child.sizes or isinstance(child.type, CStructType)):
                self.fill(child, waiting.popleft())
            elif not child.sizes and (name := self.named_struct(item)) is not None:
                waiting.popleft()
                self._copy(child, name)
            else:
                # braces around an inner array or struct may be left out: it takes as many values as it has parts
                self._items(child, waiting, in_braces=False)
            at += 1

    def _copy(self, part: _Part, tree: c_ast.Node) -> None:
        """Note the numbers of a struct that an expression names as the values of a part."""
        if part.sizes:
            for at in range(part.sizes[0]):
                index = c_ast.Constant("int", str(at))
                self._copy(self._child(part, at), c_ast.ArrayRef(tree, index, tree.coord))
        elif isinstance(part.type, CStructType):
            if part.type.tag or any(member.declared.is_pointer for member in part.type.members):
                raise UnsupportedCError(f"{part.type.name} as a first value is not supported, assign it")
            members = part.type.members if part.type.storage is None else (part.type.storage,)
            for at, member in enumerate(members):
                inner = tree
                if not member.name.startswith(HIDDEN):
                    inner = c_ast.StructRef(tree, ".", c_ast.ID(member.name), tree.coord)
                at = at if part.type.storage is None else part.type.members.index(member)
                self._copy(self._child(part, at), inner)
        else:
            self.values[part.place] = tree

    def _mark(self, part: _Part, at: int) -> None:
        """Note that a member of a union is the one written last."""
        if isinstance(part.type, CStructType) and not part.sizes and part.type.tag:
            place = self._child(part, len(part.type.members) - 1).place
            self.values[place] = c_ast.Constant("int", str(at + 1))

    def _designated(self, part: _Part, names: list[c_ast.Node], tree: c_ast.Node) -> int:
        """Note the value of a part that is named, as in `.x[2] = 1`; return its number."""
        at = self._number(part, names[0])
        child = self._child(part, at)
        self._mark(part, at)
        if not part.sizes and isinstance(part.type, CStructType) and part.type.members[at].name.startswith(HIDDEN):
            self._designated(child, names, tree)
        elif len(names) > 1:
            self._designated(child, names[1:], tree)
        else:
            self.fill(child, tree)
        is_union = not part.sizes and isinstance(part.type, CStructType) and part.type.is_union
        # a union takes one value: none may follow
        return _parts(part) if is_union else at

    def _number(self, part: _Part, name: c_ast.Node) -> int:
        if part.sizes:
            at = constant_integer(name, self.constants)
            if not 0 <= at < part.sizes[0]:
                raise UnsupportedCError(f"index {at} of an array of {part.sizes[0]} elements", wrong=True)
            return at
        chain = part.type.chain(name.name) if isinstance(part.type, CStructType) and isinstance(name, c_ast.ID) else ()
        if not isinstance(part.type, CStructType) or not chain:
            raise UnsupportedCError("a first value of an unknown member", wrong=True)
        return part.type.members.index(chain[0])

    def _child(self, part: _Part, at: int) -> _Part:
        if part.sizes:
            inner = part.sizes[1:]
            return _Part(part.type, inner, part.place + at * _count(part.type, inner))
        assert isinstance(part.type, CStructType)
        is_shared = part.type.storage is not None
        before = 0 if is_shared else sum(_member_count(member.declared) for member in part.type.members[:at])
        declared = part.type.members[at].declared
        if declared.is_pointer:
            return _Part(CType("pointer"), (), part.place + before)
        return _Part(declared.type, declared.sizes, part.place + before)
