"""Expressions that only numbers can tell, by the evaluator of MATLAB."""

from collections.abc import Callable
from typing import NamedTuple

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.scopes import Value

__all__ = ["Evaluated", "evaluated"]


class Evaluated(NamedTuple):
    """The value of an expression, and the variables that it took."""

    value: Value
    names: tuple[str, ...]


def evaluated(tree: m.Expression, text: str, variable: Callable[[str], Value | None], why: str) -> Evaluated:
    """The value of an expression over the variables that `variable` gives."""
    from kennfeld.models.simulink.expressions import NoValueError

    raise NoValueError(why)
