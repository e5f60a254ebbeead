"""Machine code that sets and gets variables of all numeric types of an FMU as doubles."""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import NamedTuple

from kennfeld.base.machine_code.ir import HALF, ONE, ZERO, FunctionWriter, literal
from kennfeld.importers.fmu.description import FmuVariable
from kennfeld.importers.fmu.number_types import FmuType, number_type


class NumberGroup(NamedTuple):
    """Variables of one type that follow each other: how many, and their values among those of all groups.

    Attributes:
        name: name of the memory that holds their value references.
        type: their type.
        references: number of variables.
        start: place of their first value.
        size: number of values.
    """

    name: str
    type: FmuType
    references: int
    start: int
    size: int


def group_numbers(name: str, version: str, variables: Sequence[FmuVariable]) -> tuple[NumberGroup, ...]:
    """Group variables, which are sorted by type."""
    groups: list[NumberGroup] = []
    start = 0
    for kind, members in groupby(variables, key=lambda v: number_type(version, v.type)):
        assert kind is not None  # the description selects variables that are numbers
        sizes = [variable.size for variable in members]
        groups.append(NumberGroup(f"{name}_{len(groups)}", kind, len(sizes), start, sum(sizes)))
        start += sum(sizes)
    return tuple(groups)


def real_count(groups: Sequence[NumberGroup]) -> int:
    """Count the values that are doubles, which come first."""
    return sum(group.size for group in groups if group.type.is_real)


def set_numbers(
    f: FunctionWriter, groups: Sequence[NumberGroup], values: str, access: Callable[[NumberGroup, str], None]
) -> str:
    """Set variables to doubles, rounded and limited for integers.

    Args:
        f: the function under construction.
        groups: the variables.
        values: address of the doubles, one per value of the variables.
        access: writes the call for a group, given the address of its values.

    Returns:
        An i1 that is true if an integer or boolean would be set to NaN.
    """
    undefined = "false"
    for group in groups:
        source = f.at(values, group.start)
        if group.type.is_real:
            access(group, source)
            continue
        buffer = f.slot(group.type.kind, group.size)
        missing = f.variable("i32", "0")
        with f.loop(0, group.size) as k:
            x = f.load(source, k)
            with f.when(f.new(f"fcmp uno double {x}, {ZERO}")):
                missing.set("1")
            f.store(_from_double(f, group.type, x), buffer, k, group.type.kind)
        access(group, buffer)
        # single precision has a NaN of its own
        if group.type.kind != "float":
            undefined = f.new(f"or i1 {undefined}, {f.new(f'icmp ne i32 {missing.get()}, 0')}")
    return undefined


def get_numbers(
    f: FunctionWriter, groups: Sequence[NumberGroup], values: str, access: Callable[[NumberGroup, str], None]
) -> None:
    """Read variables into doubles; the arguments are those of `set_numbers`."""
    for group in groups:
        target = f.at(values, group.start)
        if group.type.is_real:
            access(group, target)
            continue
        buffer = f.slot(group.type.kind, group.size)
        access(group, buffer)
        with f.loop(0, group.size) as k:
            f.store(_to_double(f, group.type, f.load(buffer, k, group.type.kind)), target, k)


def _from_double(f: FunctionWriter, kind: FmuType, x: str) -> str:
    if kind.kind == "float":
        return f.new(f"fptrunc double {x} to float")
    # nearest integer, halves away from zero: trunc(x + copysign(0.5, x))
    half = f.new(f"call double @llvm.copysign.f64(double {HALF}, double {x})")
    x = f.new(f"call double @llvm.trunc.f64(double {f.new(f'fadd double {x}, {half}')})")
    if kind.is_boolean:
        return f.new(f"zext i1 {f.new(f'fcmp une double {x}, {ZERO}')} to {kind.kind}")
    # a conversion beyond the range of the integer would be undefined in LLVM
    least, most = literal(kind.least), literal(kind.most)
    x = f.select(f.new(f"fcmp ogt double {x}, {least}"), x, least)  # NaN becomes the least value
    x = f.select(f.new(f"fcmp olt double {x}, {most}"), x, most)
    return f.new(f"fpto{'s' if kind.least < 0 else 'u'}i double {x} to {kind.kind}")


def _to_double(f: FunctionWriter, kind: FmuType, x: str) -> str:
    if kind.kind == "float":
        return f.new(f"fpext float {x} to double")
    if kind.is_boolean:
        return f.select(f.new(f"icmp ne {kind.kind} {x}, 0"), ONE, ZERO)
    return f.new(f"{'s' if kind.least < 0 else 'u'}itofp {kind.kind} {x} to double")
