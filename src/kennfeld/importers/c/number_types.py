"""Number types of C, their common types, and the errors of code that a graph cannot express."""

from collections.abc import Mapping
from typing import Final

from pycparser import c_ast

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.imperative.integer_types import IntegerType


class UnsupportedCError(Exception):
    """Code in C that the graph cannot express.

    Attributes:
        message: the reason.
        line: its line, 0 if it is not known yet.
        wrong: True if it is not valid C.
        name: the variable outside of functions that cannot be read, if it is that.
        column: its column, 0 if it is not known.
        remedy: what to do, if that is known.
    """

    def __init__(
        self, message: str, line: int = 0, *, wrong: bool = False, name: str = "", column: int = 0, remedy: str = ""
    ) -> None:
        super().__init__(message)
        self.message, self.line, self.wrong, self.name = message, line, wrong, name
        self.column, self.remedy = column, remedy


@dataclass(frozen=True)
class CType:
    """A number type: real without `word`; `truth` marks `_Bool`, `single` a `float` that is rounded as one."""

    name: str
    word: IntegerType | None = None
    truth: bool = False
    single: bool = False

    @property
    def bytes(self) -> int:
        """Its size."""
        if self.word is None:
            return {"float": 4, "long double": 16}.get(self.name, 8)
        return self.word.bits // 8


DOUBLE: Final = CType("double")
FLOAT: Final = CType("float")
SINGLE: Final = CType("float", single=True)
LONG_DOUBLE: Final = CType("long double")
BOOL: Final = CType("_Bool", IntegerType(8, False), truth=True)
INT: Final = CType("int", IntegerType(32, True))
ENUMERATION: Final = CType("enum", IntegerType(32, True))
UNSIGNED: Final = CType("unsigned int", IntegerType(32, False))
LONG: Final = CType("long", IntegerType(64, True))
LONG_LONG: Final = CType("long long", IntegerType(64, True))
SIZE: Final = CType("size_t", IntegerType(64, False))
# the data model LP64: int has 32 bits, long 64; `known_types` returns those of others
_BITS: Final = {"char": 8, "short": 16, "long": 64}

# names of stdint.h, stdbool.h and of code that Simulink generates
_SIZED: Final = {f"{'u' * unsigned}int{bits}": (bits, unsigned) for bits in (8, 16, 32, 64) for unsigned in (0, 1)}
KNOWN_TYPES: Final[Mapping[str, CType]] = {
    **{f"{name}{end}": CType(f"{name}_t", IntegerType(bits, not unsigned))
       for name, (bits, unsigned) in _SIZED.items() for end in ("_t", "_T", "_least_t")},
    **{f"{name.replace('int', 'int_fast')}_t": CType(f"{name}_t", IntegerType(bits, not unsigned))
       for name, (bits, unsigned) in _SIZED.items() if bits in (8, 64)},
    **dict.fromkeys(("double_t", "float64_t", "real_T", "real64_T", "float64", "time_T"), DOUBLE),
    **dict.fromkeys(("float_t", "float32_t", "real32_T", "float32"), FLOAT),
    **dict.fromkeys(("bool", "boolean_T", "boolean"), BOOL),
    **dict.fromkeys(("char_T", "byte_T"), CType("char", IntegerType(8, True))),
    "uchar_T": CType("unsigned char", IntegerType(8, False)),
    **dict.fromkeys(("int_T",), INT), **dict.fromkeys(("uint_T",), UNSIGNED),
    "size_t": SIZE, "ptrdiff_t": LONG, "intptr_t": LONG,
}  # fmt: skip


def known_types(target: str = "", *, float32: bool = False) -> dict[str, CType]:
    """Return the types that need no definition, by name, for a data model and for floats that are rounded.

    >>> known_types("ilp32")["size_t"].bytes, known_types(float32=True)["float32_t"].single
    (4, True)
    """
    result = dict(KNOWN_TYPES) | {"float": FLOAT, "long": LONG}
    if target == "ilp32":
        result |= {name: CType(name, IntegerType(32, True)) for name in ("long", "ptrdiff_t", "intptr_t")}
        result["size_t"] = CType("size_t", IntegerType(32, False))
    if float32:
        result = {name: SINGLE if kind is FLOAT else kind for name, kind in result.items()}
    return result


def type_of_names(names: list[str], typedefs: Mapping[str, CType], line: int) -> CType:
    """Return the type of the words of a declaration, such as `unsigned char`."""
    if len(names) == 1 and names[0] in typedefs:
        return typedefs[names[0]]
    words = sorted(names)
    if "double" in words:
        return LONG_DOUBLE if "long" in words else DOUBLE
    if words == ["_Bool"]:
        return BOOL
    bits = next((_BITS[word] for word in ("char", "short", "long") if word in words), 32)
    long = typedefs["long"].word
    if words.count("long") == 1 and long is not None:
        bits = long.bits
    if set(words) <= {"int", "char", "short", "long", "signed", "unsigned"}:
        return CType(" ".join(names), IntegerType(bits, "unsigned" not in words))
    raise UnsupportedCError(f"the type {' '.join(names)} is not supported", line)


def number_type(tree: c_ast.Node, typedefs: Mapping[str, CType], line: int = 0) -> CType:
    """Return the number type of a declaration without pointers and arrays."""
    if isinstance(tree, c_ast.TypeDecl | c_ast.Typename):
        return number_type(tree.type, typedefs, line)
    if isinstance(tree, c_ast.IdentifierType):
        return type_of_names(list(tree.names), typedefs, line)
    if isinstance(tree, c_ast.Enum):
        return ENUMERATION
    kinds = {"Struct": "a struct", "Union": "a union", "PtrDecl": "a pointer", "FuncDecl": "a function"}
    kind = kinds.get(type(tree).__name__, type(tree).__name__)
    raise UnsupportedCError(f"{kind} is not supported here", line)


def promoted(kind: CType) -> CType:
    """Return the type in which arithmetic with a type is done."""
    # C11, 6.3.1.1: int has all numbers of the narrower types, signed or not
    return INT if kind.word is not None and kind.word.bits < 32 else kind


def common_type(left: CType, right: CType) -> CType:
    """Return the type of an operation.

    >>> common_type(CType("char", IntegerType(8, True)), INT).name, common_type(INT, DOUBLE).name
    ('int', 'double')
    """
    if left.word is None or right.word is None:
        reals = [kind for kind in (left, right) if kind.word is None]
        if LONG_DOUBLE in reals:
            return LONG_DOUBLE
        return reals[0] if all(kind.name == "float" for kind in reals) else DOUBLE
    # C11, 6.3.1.8: the wider type; of equally wide ones the unsigned one
    left, right = promoted(left), promoted(right)
    assert left.word is not None
    assert right.word is not None
    if left.word.bits != right.word.bits:
        return left if left.word.bits > right.word.bits else right
    return right if left.word.signed else left


def same_type(left: object, right: object) -> bool:
    """Return True for types of the same objects: of integers, names do not matter, as `int` is `int32_t`."""
    if isinstance(left, CType) and isinstance(right, CType) and left.word is not None:
        return left.word == right.word and left.truth == right.truth
    return left == right


def holds(target: IntegerType, source: IntegerType) -> bool:
    """Return True if an integer type has all numbers of another one."""
    return target.least <= source.least and source.most <= target.most
