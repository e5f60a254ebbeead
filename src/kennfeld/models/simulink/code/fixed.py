"""Functions that only numbers can tell: where all arguments are fixed, the evaluator of MATLAB gives their result."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluation import evaluate
from kennfeld.models.simulink.code.desk import Desk
from kennfeld.models.simulink.code.values import Held, constants

__all__ = ["fixed_result"]


def fixed_result(desk: Desk, name: str, arguments: Sequence[Held]) -> Held | None:
    """What a function gives for numbers and texts; None where an argument is none or the function is not known."""
    given: dict[str, Any] = {}
    for at, held in enumerate(arguments):
        value = held if isinstance(held, str) else desk.numbers(held, name) if isinstance(held, np.ndarray) else None
        if value is None:
            return None
        given[f"argument{at}"] = value
    try:
        found = evaluate(m.Call(m.Name(name), tuple(m.Name(one) for one in given)), given)
    except MatlabError:
        return None
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiub":
        return None
    return constants(desk.loom, found)
