"""Enumeration classes of MATLAB: the members of a class file, each a fixed integer."""

import re

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.matlab.evaluator import evaluate

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_LISTS = re.compile(r"(?:^|[;,])\s*enumeration\b\s*(?:\([^)\n]*\))?(.*?)\bend\b", re.MULTILINE | re.DOTALL)
# `First`, `First(1)` or `First(uint8(min(1, 2)))`: brackets in up to three levels
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(((?:[^()]|\((?:[^()]|\([^()]*\))*\))*)\))?")
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_INTEGER = re.compile(r"u?int\d+\Z")
MAX_CHARACTERS = 1_000_000  # in a class file


def is_class(text: str) -> bool:
    """Return True if MATLAB code defines a class."""
    return bool(_HEAD.match(_plain_class(text)))


def enumeration_of(text: str) -> tuple[str, dict[str, float]] | None:
    r"""Parse name and members of an enumeration class, None for other classes and non-numeric members.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    ('Gear', {'First': 1.0, 'Second': 2.0})
    """
    plain = _plain_class(text)
    head = _HEAD.match(plain)
    if head is None or not (head[2] in _BASES or _INTEGER.match(head[2] or "")):
        return None
    members: dict[str, float] = {}
    for match in _MEMBER.finditer("\n".join(section[1] for section in _LISTS.finditer(plain[head.end() :]))):
        value = number_of(match[2])
        if value is None:
            return None
        members[match[1]] = value
    return (head[1], members) if members else None


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
