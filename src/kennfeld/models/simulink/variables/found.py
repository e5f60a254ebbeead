"""The variables found so far, while one source after the other is read."""

from collections.abc import Mapping

import numpy as np

from kennfeld.errors import Finding
from kennfeld.models.simulink.files.tree import Solver
from kennfeld.models.simulink.variables.scopes import Value, Variable
from kennfeld.parameters import ParameterSet

__all__ = ["GIVEN", "Variables", "same"]

GIVEN = "given"  # the source of values that are given by name


class Variables(dict[str, Variable]):
    """Variables by name, with what was noticed while they were read.

    `undefined` says by name why scripts could give a variable no value, `solvers` are configurations by name,
    `strangers` parameters of calibration files that the model itself does not know.
    """

    def __init__(self) -> None:
        super().__init__()
        self.findings: list[Finding] = []
        self.undefined: dict[str, str] = {}
        self.solvers: dict[str, Solver] = {}
        self.strangers = ParameterSet()


def same(one: Value, other: Value) -> bool:
    """Whether two values are equal."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)):
            return False
        return np.array_equal(np.atleast_2d(one), np.atleast_2d(other), equal_nan=True)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and one == other
