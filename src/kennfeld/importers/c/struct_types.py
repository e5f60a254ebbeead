"""Structs and unions of C: their members, and the numbers that they consist of."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from typing import Final, NamedTuple, TypeAlias

from pycparser import c_ast

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.number_types import INT, CType, UnsupportedCError, known_types, number_type

Sizes: TypeAlias = tuple[int, ...]
MAX_SIZE: Final = 100_000  # numbers of a variable
_MAX_NESTING: Final = 20
_MAX_PATHS: Final = 20_000  # of a struct, through the structs in it
HIDDEN: Final = "?"  # how the names of members without names begin
_ESCAPES: Final = {
    r"\n": 10, r"\t": 9, r"\\": 92, r"\'": 39, r'\"': 34, r"\r": 13, r"\a": 7, r"\b": 8, r"\f": 12, r"\v": 11,
    r"\?": 63,
}  # fmt: skip
_CHARACTER_CODE: Final = re.compile(r"\\x([0-9A-Fa-f]{1,2})|\\([0-7]{1,3})")
TAG: Final = "%"  # how the names of members begin that tell which one of a union was written last


@dataclass(frozen=True)
class OpaqueType:
    """A type that code may declare, but not use: a function, a bit field; `tag` is that of a struct not defined yet."""

    reason: str
    tag: str = ""


@dataclass(frozen=True)
class CStructType:
    """A struct or union by its members, in order.

    The members of a union have numbers of their own, behind which a number tells which member was written last. If all
    members consist of the same numbers, they share those of the first array.

    Attributes:
        name: its name, such as `struct Gains`.
        members: the members. A member without a name, whose own members count as those of the struct, has a name that
            begins with `?`.
        count: how many paths lead to numbers in it.
        tag: of a union, the name of the last member, which tells the number of the one written last, from 1 on.
        storage: of a union whose members share their numbers, the member that stands for all.
    """

    name: str
    members: "tuple[Member, ...]"
    count: int = 0
    tag: str = ""
    storage: "Member | None" = None

    @property
    def is_union(self) -> bool:
        """True if the members overlap."""
        return bool(self.tag) or self.storage is not None

    def chain(self, name: str) -> "tuple[Member, ...]":
        """Return a member, behind the members without names that lead to it; empty if there is none of this name."""
        for member in self.members:
            kind = member.declared.type
            if member.name == name:
                return (member,)
            # members of a struct without a name are members of the one around it (C11, 6.7.2.1)
            inner = kind.chain(name) if member.name.startswith(HIDDEN) and isinstance(kind, CStructType) else ()
            if inner:
                return (member, *inner)
        return ()

    def path(self, name: str) -> "tuple[Member, ...]":
        """Return the chain of a member; raises `UnsupportedCError` if there is none, or it cannot be used."""
        chain = self.chain(name)
        if not chain:
            raise UnsupportedCError(f"{self.name} has no member {name}", wrong=True)
        if isinstance(chain[-1].declared.type, OpaqueType):
            raise UnsupportedCError(f"the member {name} is {chain[-1].declared.type.reason}: not supported")
        return chain


ObjectType: TypeAlias = CType | CStructType | OpaqueType


@dataclass(frozen=True)
class DeclaredType:
    """The declaration of a variable: the type of its elements, the sizes of an array, and qualifiers.

    Attributes:
        type: type of the elements.
        sizes: sizes of an array, 0 where none is written.
        is_pointer: True for the address of such an object.
        is_constant: True if the object cannot be assigned; behind a pointer, the object and not the pointer.
        is_volatile: True if the object may change between calls: a calibration value, if it is constant as well.
    """

    type: ObjectType
    sizes: Sizes = ()
    is_pointer: bool = False
    is_constant: bool = False
    is_volatile: bool = False


class Member(NamedTuple):
    """A member of a struct."""

    name: str
    declared: DeclaredType


class Leaf(NamedTuple):
    """The numbers of a struct under one path of members.

    Attributes:
        path: the members, such as `.filter.state`; empty for a number that is not a member.
        type: type of the numbers.
        sizes: sizes of the array that they are, those of arrays of structs first.
        is_constant: True if one of the members is constant.
        owner: the struct that the numbers belong to: path and name of the last one behind a pointer.
        unions: of the members of unions that they belong to, the path of the tag and the number of the member.
    """

    path: str
    type: CType
    sizes: Sizes = ()
    is_constant: bool = False
    owner: tuple[str, str] = ("", "")
    unions: tuple[tuple[str, int], ...] = ()

    @property
    def is_tag(self) -> bool:
        """True if the number tells which member of a union was written last."""
        return self.path.rpartition(".")[2].startswith(TAG)


def member_path(path: str, name: str) -> str:
    """Return the path of a member; those without names are left out."""
    return path if name.startswith(HIDDEN) else f"{path}.{name}"


def leaves_of(kind: ObjectType, sizes: Sizes = ()) -> Iterator[Leaf]:
    """Yield the numbers of a type; those of members that cannot be used are left out."""
    yield from _leaves(kind, Leaf("", CType(""), sizes, owner=("", _name(kind))))


def _leaves(kind: ObjectType, leaf: Leaf) -> Iterator[Leaf]:
    if isinstance(kind, CType):
        yield leaf._replace(type=kind)
    elif isinstance(kind, CStructType):
        # numbered from 1, as a tag of 0 says that no member was written
        for at, (name, declared) in enumerate(kind.members if kind.storage is None else (kind.storage,), start=1):
            path = member_path(leaf.path, name)
            inner = leaf._replace(
                path=path,
                sizes=(*leaf.sizes, *declared.sizes),
                is_constant=leaf.is_constant or declared.is_constant,
                owner=(path, _name(declared.type)) if declared.is_pointer else leaf.owner,
            )
            if kind.tag and name != kind.tag:
                inner = inner._replace(unions=(*leaf.unions, (member_path(leaf.path, kind.tag), at)))
            yield from _leaves(declared.type, inner)


def _name(kind: ObjectType) -> str:
    return "" if isinstance(kind, OpaqueType) else kind.name


@dataclass(eq=False)
class TypeTable:
    """The types that a file names: its typedefs, the tags of its structs, and the constants of its enumerations.

    `float` and `long` are among the typedefs, as they depend on the target.
    """

    typedefs: dict[str, DeclaredType] = field(
        default_factory=lambda: {name: DeclaredType(kind) for name, kind in known_types().items()}
    )
    structs: dict[str, CStructType] = field(default_factory=dict)
    sizeof: "Callable[[c_ast.Node], int] | None" = None  # evaluates `sizeof` in constant integers
    constants: dict[str, int] = field(default_factory=dict)

    @property
    def numbers(self) -> Mapping[str, CType]:
        """The names of number types."""
        return {
            name: declared.type
            for name, declared in self.typedefs.items()
            if isinstance(declared.type, CType) and not declared.sizes and not declared.is_pointer
        }

    def number(self, name: str) -> CType:
        """Return a number type that is always known, such as `long` of the target."""
        kind = self.typedefs[name].type
        assert isinstance(kind, CType)
        return kind

    def declared(self, tree: c_ast.Node, depth: int = 0) -> DeclaredType:
        """Return what a declaration says."""
        if depth > _MAX_NESTING:
            raise UnsupportedCError("types nested too deeply", _line(tree))
        match tree:
            case c_ast.Decl() | c_ast.Typename() | c_ast.Typedef():
                inner = self.declared(tree.type, depth + 1)
                return _qualified(inner, tree.quals or ())
            case c_ast.TypeDecl():
                return _qualified(self.declared(tree.type, depth + 1), tree.quals or ())
            case c_ast.ArrayDecl():
                size = 0 if tree.dim is None else constant_integer(tree.dim, self.constants, self.sizeof)
                inner = self.declared(tree.type, depth + 1)
                if inner.is_pointer:
                    return DeclaredType(OpaqueType("an array of pointers"))
                return _changed(inner, sizes=(size, *inner.sizes))
            case c_ast.PtrDecl():
                inner = self.declared(tree.type, depth + 1)
                if inner.is_pointer:
                    return DeclaredType(OpaqueType("a pointer to a pointer"))
                if isinstance(inner.type, OpaqueType):
                    return DeclaredType(OpaqueType(f"a pointer to {inner.type.reason}"))
                return _changed(inner, is_pointer=True)
            case c_ast.IdentifierType(names=[name]) if name in self.typedefs:
                # `typedef struct S S;` may precede the members of S
                known = self.typedefs[name]
                tag = known.type.tag if isinstance(known.type, OpaqueType) else ""
                return _changed(known, type=self.structs[tag]) if tag in self.structs else known
            case c_ast.IdentifierType(names=["void"]):
                return DeclaredType(OpaqueType("void"))
            case c_ast.Struct() | c_ast.Union():
                return DeclaredType(self._struct(tree, depth))
            case c_ast.FuncDecl():
                return DeclaredType(OpaqueType("a function"))
        return DeclaredType(number_type(tree, self.numbers, _line(tree)))

    def _struct(self, tree: c_ast.Struct | c_ast.Union, depth: int) -> ObjectType:
        kind = "union" if isinstance(tree, c_ast.Union) else "struct"
        # `struct S` alone may be defined elsewhere, later or never: code that uses no members of it works all the same
        if tree.decls is None:
            if tree.name in self.structs:
                return self.structs[tree.name]
            return OpaqueType(f"{kind} {tree.name}, whose members are not known", str(tree.name))
        members = [Member(*member) for item in tree.decls if (member := self._named_member(item, depth)) is not None]
        # structs that contain others twice, over many levels, have exponentially many paths
        count = sum(getattr(member.declared.type, "count", 1) for member in members)
        if count > _MAX_PATHS:
            return OpaqueType(f"a {kind} of more than {_MAX_PATHS} members")
        struct = CStructType(f"{kind} {tree.name}" if tree.name else f"the {kind}", tuple(members), count)
        if kind == "union":
            struct = _union(struct, tree)
        if tree.name:
            self.structs[tree.name] = struct
        return struct

    def _named_member(self, item: c_ast.Node, depth: int) -> tuple[str, DeclaredType] | None:
        """Return name and type of a member; None for what declares none, such as bits without a name."""
        if not isinstance(item, c_ast.Decl):
            return None
        if item.name:
            bits = item.bitsize is not None
            return str(item.name), DeclaredType(OpaqueType("a bit field")) if bits else self._member(item, depth)
        declared = self._member(item, depth) if item.bitsize is None else DeclaredType(OpaqueType("a bit field"))
        # `struct S {...};` within a struct declares S, but no member
        is_part = isinstance(item.type, c_ast.Struct | c_ast.Union) and item.type.decls and not item.type.name
        return (f"{HIDDEN}{_position(item.type)}", declared) if is_part else None

    def _member(self, tree: c_ast.Decl, depth: int) -> DeclaredType:
        try:
            declared = self.declared(tree, depth + 1)
        except UnsupportedCError as error:
            return DeclaredType(OpaqueType(error.message))
        if declared.is_pointer and isinstance(declared.type, CType):
            return DeclaredType(OpaqueType("a pointer"))
        return declared

    def typedef(self, tree: c_ast.Typedef) -> None:
        """Note a type; one that cannot be used is an error where it is used."""
        try:
            declared = self.declared(tree)
        except UnsupportedCError as error:
            declared = DeclaredType(OpaqueType(error.message))
        # a struct without a tag takes the name of its typedef, by which generated code is recognized
        struct = declared.type
        if isinstance(struct, CStructType) and struct.name in ("the struct", "the union"):
            declared = _changed(declared, type=replace(struct, name=str(tree.name)))
        self.typedefs[str(tree.name)] = declared

    def enumerate(self, tree: c_ast.Node) -> None:
        """Note the constants of the enumerations that a declaration defines."""
        for enumeration in enumerations(tree):
            self.constants |= enumeration_constants(enumeration, self.constants)


def _union(members: CStructType, tree: c_ast.Union) -> CStructType:
    """Return a union of these members."""
    storage = _shared_array(members)
    if storage is not None:
        return replace(members, storage=storage, count=1)
    tag = Member(f"{TAG}{_position(tree)}", DeclaredType(INT))
    return replace(members, members=(*members.members, tag), count=members.count + 1, tag=tag.name)


def _shared_array(union: CStructType) -> Member | None:
    """Return the array that all members of a union share, number by number; None if they are of different types."""
    # such as union { double all[3]; struct { double a, b, c; } each; }: `all` stands for both
    sizes = [math.prod((*leaf.sizes, 1)) for leaf in leaves_of(union)]
    types = {leaf.type for leaf in leaves_of(union)}
    if len(types) != 1 or any(leaf.owner[0] for leaf in leaves_of(union)) or _is_incomplete(union) or min(sizes) < 1:
        return None
    counts = {member.name: number_count(member.declared.type, member.declared.sizes) for member in union.members}
    arrays = (member for member in union.members if len(member.declared.sizes) == 1)
    (kind,) = types
    most = max(counts.values())
    return next((each for each in arrays if each.declared.type == kind and counts[each.name] == most), None)


def _is_incomplete(kind: ObjectType) -> bool:
    """Return True if a type has members that cannot be used, or unions whose members do not share their numbers."""
    if isinstance(kind, CStructType):
        return bool(kind.tag) or any(_is_incomplete(member.declared.type) for member in kind.members)
    return isinstance(kind, OpaqueType)


def number_count(kind: ObjectType, sizes: Sizes = ()) -> int:
    """Return how many numbers an object has."""
    return sum(math.prod(leaf.sizes) for leaf in leaves_of(kind, sizes))


def _position(tree: c_ast.Node) -> str:
    """Return where a type without a name is defined, which tells it from others."""
    return f"{tree.coord.line}_{tree.coord.column or 0}" if tree.coord is not None else "0"


def _line(tree: c_ast.Node) -> int:
    return int(tree.coord.line) if tree.coord is not None else 0


def _changed(declared: DeclaredType, **changes: object) -> DeclaredType:
    names = ("type", "sizes", "is_pointer", "is_constant", "is_volatile")
    return DeclaredType(**{**{name: getattr(declared, name) for name in names}, **changes})


def _qualified(declared: DeclaredType, qualifiers: list[str] | tuple[str, ...]) -> DeclaredType:
    if declared.is_pointer:
        return declared  # qualifiers behind the asterisk are of the pointer
    return _changed(
        declared,
        is_constant=declared.is_constant or "const" in qualifiers,
        is_volatile=declared.is_volatile or "volatile" in qualifiers,
    )


def enumerations(tree: c_ast.Node) -> Iterator[c_ast.Enum]:
    """Yield the enumerations that a declaration defines."""
    if isinstance(tree, c_ast.Enum):
        yield tree
    elif isinstance(tree, c_ast.Decl | c_ast.Typedef | c_ast.TypeDecl | c_ast.ArrayDecl | c_ast.PtrDecl):
        yield from enumerations(tree.type)
    elif isinstance(tree, c_ast.Struct | c_ast.Union):
        for item in tree.decls or ():
            yield from enumerations(item)


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


def constant_integer(
    tree: c_ast.Node | None, known: Mapping[str, int], sizeof: "Callable[[c_ast.Node], int] | None" = None
) -> int:
    """Return a constant integer, such as the size of an array; `sizeof` returns the size of a type or a variable."""
    if type(tree).__name__ == "ArrayDesignator":  # which some versions of pycparser put around an index
        return constant_integer(next(child for _, child in tree.children()), known, sizeof)  # type: ignore[union-attr]
    match tree:
        case c_ast.Constant(type=kind, value=text) if "int" in kind or kind == "char":
            return integer_literal(text)
        case c_ast.ID(name=name) if name in known:
            return known[name]
        case c_ast.Cast(expr=operand):
            return constant_integer(operand, known, sizeof)
        case c_ast.UnaryOp(op="sizeof", expr=of) if sizeof is not None:
            return sizeof(of)
        case c_ast.UnaryOp(op="-", expr=operand):
            return -constant_integer(operand, known, sizeof)
        case c_ast.UnaryOp(op="+", expr=operand):
            return constant_integer(operand, known, sizeof)
        case c_ast.BinaryOp(op=("+" | "-" | "*" | "/" | "<<" | ">>") as op, left=left, right=right):
            a, b = constant_integer(left, known, sizeof), constant_integer(right, known, sizeof)
            if op in ("<<", ">>") and not 0 <= b < 63:
                raise UnsupportedCError(f"a shift by {b}", _line(tree))
            # // rounds down, / of C towards 0
            if op == "/" and (b == 0 or a < 0 or b < 0):
                raise UnsupportedCError(f"the division {a} / {b}", _line(tree))
            rules = {"+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: a // b}
            return {**rules, "<<": lambda: a << b, ">>": lambda: a >> b}[op]()
    raise UnsupportedCError("a constant integer is required", _line(tree) if tree is not None else 0)


def integer_literal(text: str) -> int:
    r"""Return the number of an integer or character.

    >>> integer_literal("0x1Fu"), integer_literal("017"), integer_literal("'a'"), integer_literal(r"'\n'")
    (31, 15, 97, 10)
    """
    if text.startswith("'"):
        inner = text[1:-1]
        if inner in _ESCAPES:
            return _ESCAPES[inner]
        if (code := _CHARACTER_CODE.fullmatch(inner)) is not None:
            number = int(code[1], 16) if code[1] else int(code[2], 8)
            # char is signed: '\xff' is -1
            return number - 256 if number > 127 else number
        if len(inner) != 1:
            raise UnsupportedCError(f"the character {text[:20]} is not supported")
        return ord(inner)
    digits = text.rstrip("uUlL")
    try:
        if digits[:2].casefold() in ("0x", "0b"):
            number = int(digits, 0)
        else:
            number = int(digits, 8 if digits.startswith("0") and len(digits) > 1 else 10) if len(digits) < 25 else 2**70
    except ValueError:
        raise UnsupportedCError(f"{text[:30]} is not an integer", wrong=True) from None
    if number >= 2**64:
        raise UnsupportedCError(f"the number {text[:30]} is too large")
    return number
