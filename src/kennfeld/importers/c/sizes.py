"""Sizes of objects in bytes, as `sizeof` tells them, with the gaps that the alignment of members leaves."""

import math

from kennfeld.importers.c.number_types import CType, UnsupportedCError
from kennfeld.importers.c.struct_types import TAG, CStructType, ObjectType, Sizes, TypeTable


def size_of(types: TypeTable, kind: ObjectType, sizes: Sizes = (), *, is_pointer: bool = False) -> int:
    """Return the size of an object, or of the pointer to one; pointers have the size of `size_t` of the target.

    Raises:
        UnsupportedCError: it has parts whose sizes are not known, such as bit fields.
    """
    if 0 in sizes:
        raise UnsupportedCError("sizeof of an array of unknown size")
    pointer = types.number("size_t").bytes
    return pointer if is_pointer and not sizes else _size(kind, pointer)[0] * math.prod(sizes)


def _size(kind: ObjectType, pointer: int) -> tuple[int, int]:
    """Return size and alignment of a type."""
    if isinstance(kind, CType):
        return kind.bytes, kind.bytes
    if not isinstance(kind, CStructType):
        raise UnsupportedCError(f"sizeof of {kind.reason} is not supported")
    end, alignment, largest = 0, 1, 0
    for member in kind.members:
        if member.name.startswith(TAG):
            continue
        declared = member.declared
        own, step = (pointer, pointer) if declared.is_pointer else _size(declared.type, pointer)
        own *= 1 if declared.is_pointer else math.prod(declared.sizes)
        # each member begins at a multiple of its alignment, the members of a union all at 0
        begin = 0 if kind.is_union else -(-end // step) * step
        end, alignment, largest = begin + own, max(alignment, step), max(largest, begin + own)
    return -(-largest // alignment) * alignment, alignment
