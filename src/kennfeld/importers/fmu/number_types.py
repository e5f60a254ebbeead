"""Types of variables whose values Kennfeld reads and writes as doubles."""

import math
from typing import NamedTuple


class FmuType(NamedTuple):
    """A type as functions of an FMU access it.

    Attributes:
        access: end of the names of its functions: `Real` of `fmi2SetReal`, `Int32` of `fmi3GetInt32`, ...
        kind: type of a value in LLVM.
        least: least value; doubles are rounded and limited. 0 for booleans.
        most: largest value, the largest double below the limit of 64-bit integers; 1 for booleans.
    """

    access: str
    kind: str
    least: float = 0.0
    most: float = 0.0

    @property
    def is_real(self) -> bool:
        """True if values need no conversion."""
        return self.kind == "double"

    @property
    def dtype(self) -> str:
        """Type of a value in numpy."""
        if self.kind in ("double", "float"):
            return "f8" if self.is_real else "f4"
        return f"{'i' if self.least < 0 or self.is_boolean else 'u'}{int(self.kind[1:]) // 8}"

    @property
    def is_boolean(self) -> bool:
        """True if all values but 0 are true."""
        return self.access == "Boolean"


def _integer(bits: int, signed: bool) -> FmuType:
    end = 2.0 ** (bits - signed)
    # 2^63 - 1 and 2^64 - 1 are not doubles: they round to 2^63 and 2^64, which would overflow
    most = end - 1.0 if bits < 64 else math.nextafter(end, 0.0)
    return FmuType(f"{'' if signed else 'U'}Int{bits}", f"i{bits}", -end if signed else 0.0, most)


_INTEGER_2 = FmuType("Integer", "i32", -(2.0**31), 2.0**31 - 1)
_SIZES = [(bits, signed) for bits in (8, 16, 32, 64) for signed in (True, False)]
_INTEGERS_3 = {kind.access: kind for kind in (_integer(bits, signed) for bits, signed in _SIZES)}
_TYPES = {
    "2.0": {
        "Real": FmuType("Real", "double"),
        "Integer": _INTEGER_2,
        # FMI 2.0 accesses enumerations and booleans as int; FMI 3.0 enumerations as int64, booleans as bool of one byte
        "Enumeration": _INTEGER_2,
        "Boolean": FmuType("Boolean", "i32", 0.0, 1.0),
    },
    "3.0": {
        "Float64": FmuType("Float64", "double"),
        "Float32": FmuType("Float32", "float"),
        **_INTEGERS_3,
        "Enumeration": _INTEGERS_3["Int64"],
        "Boolean": FmuType("Boolean", "i8", 0.0, 1.0),
    },
}


def number_type(version: str, name: str) -> FmuType | None:
    """Look up a type by its name in FMI 2.0 or 3.0; None if it holds no numbers.

    >>> number_type("2.0", "Enumeration").access, number_type("3.0", "UInt16").most, number_type("3.0", "String")
    ('Integer', 65535.0, None)
    """
    return _TYPES[version].get(name)


def type_order(version: str, name: str) -> int:
    """Return a number by which variables are sorted, so that those of one type follow each other, doubles first."""
    kind = number_type(version, name)
    kinds = list(dict.fromkeys(_TYPES[version].values()))
    return len(kinds) if kind is None else kinds.index(kind)
