"""Floating-point types of signals."""

from enum import IntEnum

from kennfeld.importers.simulink.variables.data_types import (
    BusElement,
    BusType,
    DataType,
    PlainType,
    UndefinedType,
    data_type,
)
from kennfeld.importers.simulink.variables.mask_scope import Scope


class FloatType(IntEnum):
    """Floating-point type of a signal; a result of several signals has the largest type among theirs.

    `OTHER` are integers and conditions, which leave the type to the other operands. A result with an operand of type
    double is double, and one with an operand of an unknown type may be so.
    """

    OTHER = 0
    SINGLE = 1
    UNKNOWN = 2
    DOUBLE = 3


def float_type_of(kind: DataType | None, scope: Scope) -> FloatType | None:
    """Return the floating-point type of a data type, None for one that is inherited or a bus."""
    if isinstance(kind, BusElement):  # a value type
        kind = data_type(kind.type, scope)
    match kind:
        case None | BusType():
            return None
        case PlainType(name):
            return {"single": FloatType.SINGLE, "double": FloatType.DOUBLE}.get(name, FloatType.OTHER)
        case UndefinedType():
            return FloatType.UNKNOWN
    return FloatType.OTHER
