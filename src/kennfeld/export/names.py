"""Identifiers of C for the names of a function, which may hold any character."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import join_names

LONGEST = 63  # characters by which C99 tells internal identifiers apart (5.2.4.1)
LONGEST_FUNCTION = LONGEST - len("_parameters")

# of C, and of C++, which may include the header
_KEYWORDS = """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    alignas alignof asm bool catch char8_t char16_t char32_t class concept consteval constexpr constinit const_cast
    co_await co_return co_yield decltype delete dynamic_cast explicit export false friend mutable namespace new
    noexcept nullptr operator private protected public reinterpret_cast requires static_assert static_cast template
    this thread_local throw true try typeid typename typeof using virtual wchar_t and and_eq bitand bitor compl not
    not_eq or or_eq xor xor_eq
"""
# of the headers of C, POSIX, Windows and common compilers
_MACROS = """
    NAN INFINITY HUGE_VAL HUGE_VALF HUGE_VALL NULL EOF errno I complex imaginary linux unix near far interface small
    M_E M_LOG2E M_LOG10E M_LN2 M_LN10 M_PI M_PI_2 M_PI_4 M_1_PI M_2_PI M_2_SQRTPI M_SQRT2 M_SQRT1_2 MAXFLOAT
    DOMAIN SING OVERFLOW UNDERFLOW PLOSS TLOSS X_TLOSS assert offsetof stdin stdout stderr
    FP_NAN FP_INFINITE FP_ZERO FP_SUBNORMAL FP_NORMAL FP_ILOGB0 FP_ILOGBNAN MATH_ERRNO MATH_ERREXCEPT
"""
RESERVED = frozenset((_KEYWORDS + _MACROS).split())


def c_identifier(name: str) -> str:
    """Return the identifier of C for a name: the name itself, if it is one.

    >>> [c_identifier(name) for name in ("Speed", "Air.Mass [kg]", "2nd", "double", "_Bool")]
    ['Speed', 'Air_Mass_kg', 'x_2nd', 'double_', 'x_Bool']
    """
    plain = name if re.fullmatch(r"\w+", name, re.ASCII) else re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    # identifiers that begin with an underscore belong to the compiler
    plain = plain if re.match("[A-Za-z]", plain) else f"x_{plain.lstrip('_')}"
    return f"{plain}_" if plain in RESERVED else plain[:LONGEST]


class NameSpace(NamedTuple):
    """Names that must differ from each other in C, such as the members of a struct."""

    kind: str  # for messages: "parameter", "input", "output"
    names: tuple[str, ...]
    taken: tuple[str, ...] = ()  # identifiers that are in use already
    derived: tuple[str, ...] = ()  # further names, which are not those of the user


def member_names(space: NameSpace, location: Location, findings: Findings) -> Mapping[str, str]:
    """Return the identifiers of names; a remark says which differ, an error which are equal."""
    mapped = {name: c_identifier(name) for name in (*space.names, *space.derived)}
    users: dict[str, list[str]] = {own: ["a name of the struct"] for own in space.taken}
    for name, own in mapped.items():
        users.setdefault(own, []).append(name)
    for own, names in users.items():
        if len(names) > 1:
            message = f"the {space.kind}s {join_names([repr(name) for name in names])} are both {own} in C"
            findings.error(location, message, "Rename one of them in the function.")
    renamed = [f"{name!r} is {own}" for name in space.names if (own := mapped[name]) != name]
    if renamed:
        findings.remark(location, f"names of {space.kind}s that are not identifiers of C: {join_names(renamed)}")
    return mapped


def function_name(name: str, location: Location) -> str:
    """Return the identifier with which all names of the exported code begin.

    Raises:
        InputError: it is too long for C.
    """
    own = c_identifier(name)
    if len(own) > LONGEST_FUNCTION:
        message = f"the name {name!r} is longer than {LONGEST_FUNCTION} characters, which C does not tell apart"
        raise InputError.of(location, message, "Give a shorter one with --name.")
    return own
