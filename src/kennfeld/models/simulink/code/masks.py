"""Assignments to the elements that a mask chooses where the mask depends on signals: `x(x > 1) = 2*x(x > 1)`.

Where each element of the right side depends on the same element of its arrays alone, all elements may be computed, and
each one takes its new value or keeps its old one.
"""

from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.functions.elementwise import EACH_ALONE
from kennfeld.models.simulink.code.values import Handle, Held, Truths, array_of, truths
from kennfeld.models.simulink.expressions.arrays import each

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.calls import Calls

__all__ = ["chooses", "chosen_elements"]

_OPERATORS = frozenset({"+", "-", ".*", "./", ".^", "==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "*", "/", "^"})


def chooses(calls: "Calls", target: m.Expression, tree: m.Expression) -> bool:
    """Whether elements are assigned that a mask chooses by signals, from what may be so chosen too."""
    if not isinstance(target, m.Call) or len(target.arguments) != 1 or not isinstance(target.of, m.Name):
        return False
    if target.of.name not in calls.body.names or not _selects(tree):
        return False
    found = calls.value(target.arguments[0]) if _says_truth(calls, target.arguments[0]) else None
    return isinstance(found, Truths) and calls.desk.numbers(found, "a mask") is None


def _says_truth(calls: "Calls", tree: m.Expression) -> bool:
    """Whether an index is a mask by its form: a comparison, or a variable that is logical."""
    if isinstance(tree, m.Name):
        return isinstance(calls.body.names.get(tree.name), Truths)
    return isinstance(tree, m.Binary | m.Unary) and not _ranged(tree)


def _ranged(tree: m.Expression) -> bool:
    return isinstance(tree, m.End | m.Range | m.Colon) or any(map(_ranged, m.children(tree)))


def _selects(tree: m.Expression) -> bool:
    return isinstance(tree, m.Call) or any(map(_selects, m.children(tree)))


def chosen_elements(calls: "Calls", target: m.Call, tree: m.Expression) -> Held:
    """The variable after the assignment."""
    assert isinstance(target.of, m.Name)
    old = array_of(calls.body.read(target.of.name))
    mask = array_of(calls.value(target.arguments[0]))
    if mask.shape != old.shape:
        raise CodeError("a mask that depends on signals has another size than what it chooses from")
    if not _alone(calls, tree):
        raise CodeError("elements that a mask chooses by signals are not used one by one", _MEND)
    calls.mask = mask
    try:
        new = array_of(calls.value(tree))
    finally:
        calls.mask = None
    if new.size != 1 and new.shape != old.shape:
        raise CodeError("a mask that depends on signals chooses where several elements are assigned", _MEND)
    made = each(calls.loom, "select", np.asarray(mask), np.broadcast_to(np.asarray(new), old.shape), old)
    return truths(made) if isinstance(old, Truths) and isinstance(new, Truths) else made


def _alone(calls: "Calls", tree: m.Expression) -> bool:
    """Whether each element of an expression depends on the same element of its arrays alone."""
    match tree:
        case m.Number() | m.Name():
            return True
        case m.Unary(_, operand):
            return _alone(calls, operand)
        case m.Binary(operator, left, right):
            return operator in _OPERATORS and _alone(calls, left) and _alone(calls, right)
        case m.Call(m.Name(name), arguments) if name in calls.body.names:
            return not isinstance(calls.body.names[name], Handle)
        case m.Call(m.Name(name), arguments):
            alone = name in EACH_ALONE or (name in ("min", "max") and len(arguments) == 2)
            return alone and all(_alone(calls, one) for one in arguments)
    return False


_MEND = "Write it as a loop over all elements with if."
