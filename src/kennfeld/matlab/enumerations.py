"""Enumeration classes of MATLAB: the members of a class file, each a fixed integer."""

import re
from collections.abc import Mapping

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab.evaluator import evaluate
from kennfeld.matlab.simulink_objects import with_default

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_LISTS = re.compile(r"(?:^|[;,])\s*enumeration\b\s*(?:\([^)\n]*\))?(.*?)\bend\b", re.MULTILINE | re.DOTALL)
# `First`, `First(1)` or `First(uint8(min(1, 2)))`: brackets in up to three levels
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(((?:[^()]|\((?:[^()]|\([^()]*\))*\))*)\))?")
_DEFAULT = re.compile(r"\bfunction\s+(\w+)\s*=\s*getDefaultValue\b.*?\b\1\s*=\s*(?:\w+\s*\.\s*)?(\w+)", re.DOTALL)
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_INTEGER = re.compile(r"u?int\d+\Z")
MAX_CHARACTERS = 1_000_000  # in a class file


@dataclass(frozen=True)
class Enumeration:
    """An enumeration class: its name, and its members with their numbers.

    The first member is the default, as which data without an initial value start. `counted` is True if the class gives
    no numbers, so that its members are counted from 0.
    """

    name: str
    members: Mapping[str, float]
    counted: bool = False


def is_class(text: str) -> bool:
    """Return True if MATLAB code defines a class."""
    return bool(_HEAD.match(_plain_class(text)))


def enumeration_of(text: str) -> Enumeration | None:
    r"""Parse an enumeration class, None for other classes and members that are no integers.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    Enumeration(name='Gear', members={'First': 1.0, 'Second': 2.0}, counted=False)
    """
    plain = _plain_class(text)
    head = _HEAD.match(plain)
    if head is None or not (head[2] in _BASES or _INTEGER.match(head[2] or "")):
        return None
    body = plain[head.end() :]
    written = list(_MEMBER.finditer("\n".join(section[1] for section in _LISTS.finditer(body))))
    # some with numbers and some without have no meaning that two readers would agree on
    counted = all(match[2] is None for match in written)
    numbers = [float(at) if counted else number_of(match[2]) for at, match in enumerate(written)]
    members = {match[1]: number for match, number in zip(written, numbers, strict=True) if number is not None}
    if not members or None in numbers:
        return None
    default = _DEFAULT.search(body)
    return Enumeration(head[1], with_default(members, default[2] if default else ""), counted)


def _plain_class(text: str) -> str:
    """Return a text without comments and line continuations."""
    return "\n".join(_REST.sub("", line) for line in text[:MAX_CHARACTERS].splitlines()).lstrip("\ufeff \t\r\n")


def number_of(written: str | None) -> float | None:
    """Return the number of a member, which may be a cast or an expression of literals."""
    try:
        value = np.asarray(evaluate(written or ""), dtype=np.float64)
    except (InputError, TypeError, ValueError):
        return None
    return float(value.item()) if value.size == 1 else None
