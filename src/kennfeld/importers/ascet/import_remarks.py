"""Remarks on an import: where the model calculates differently than generated code, and what it leaves out."""

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from kennfeld.base.formatting import count_noun, join_names
from kennfeld.importers.ascet.instances import Program, ProgramVariable
from kennfeld.importers.ascet.program_code import ProgramCode

_MAX_NAMES: Final = 8  # in a sentence
_EXACT: Final = 2.0**53  # integers up to which double precision is exact
_REALS: Final = "real numbers are calculated in double precision: their representations and resolutions are ignored"
_INTEGERS: Final = (
    "intermediate results of integers do not overflow; integers are limited to the range of their type when they are "
    "assigned, passed or returned"
)


def import_remarks(program: Program, code: ProgramCode, frozen: Iterable[str]) -> Iterator[str]:
    """Yield the remarks on translated methods; `frozen` are texts that use characteristics as constants."""
    yield _REALS
    if code.has_integer_arithmetic:
        yield _INTEGERS
    used = [program.variables[label] for label in sorted(code.assigned | code.read) if label in program.variables]
    # above 2^53 every second integer is missing, so that a counter would stop
    wide = [item.label for item in used if item.type.is_whole and max(-item.type.low, item.type.high) > _EXACT]
    if wide:
        yield f"integers of 64 bits are exact up to 2^53: {join_names(wide, _MAX_NAMES)}"
    yield from _limit_notes([item for item in used if item.label in code.assigned])
    yield from (f"{text} depends on characteristics, which are constant there" for text in frozen)
    yield from (f"{label} is in C and returns nothing: its calls are skipped" for label in code.skipped)


def _limit_notes(assigned: Iterable[ProgramVariable]) -> Iterator[str]:
    """Yield how many variables of reals with a range are limited to it, and how many are not."""
    reals = [
        item for item in assigned if item.type.kind == "real" and np.isfinite((item.type.low, item.type.high)).any()
    ]
    for is_limited, word, effect in ((True, "limited", "false does not limit"), (False, "not limited", "true limits")):
        labels = [item.label for item in reals if item.type.is_limited is is_limited]
        if labels:
            count, verb = count_noun(len(labels), "real variable"), "is" if len(labels) == 1 else "are"
            names = join_names(labels, _MAX_NAMES)
            text = f"{count} {verb} {word} to the range of the type when assigned: {names}"
            yield f"{text}; limit_assignments = {effect} them"
