"""Check whether an instance of an FMU is as new after a reset; otherwise each start of a trajectory needs a new one.

The standards demand that a reset restores the state after the instantiation. FMUs that keep values nevertheless, or
lose those at which variables start, return no error: trajectories after the first one would be wrong without a word. So
the results after a reset are compared with those of a new instance, and so are all variables that state a start value,
because results need not depend on each of them at once.
"""

import ctypes
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable
from kennfeld.importers.fmu.instance_calls import WARNING
from kennfeld.importers.fmu.library import READING, FmuLibrary
from kennfeld.importers.fmu.number_types import FmuType, number_type

_REPEATED = 1e-9  # relative difference of values that are repeated


def is_repeated(new: Float, *others: Float) -> bool:
    """Return True if the values of other trials are those of a new instance.

    Args:
        new: Float[values] or Float[samples, values], which may be NaN.
        others: the same of other trials.
    """
    samples = tuple(range(new.ndim - 1))
    with np.errstate(invalid="ignore"):
        scale = np.max(np.abs(new), axis=samples, initial=0.0, where=np.isfinite(new))
        # equal infinities and NaN are repeated as well, though their differences are NaN
        same = [(np.abs(again - new) <= _REPEATED * scale) | (again == new) for again in others]
    return all(np.all(near | (np.isnan(again) & np.isnan(new))) for near, again in zip(same, others, strict=True))


def other_starts(variables: Sequence[FmuVariable]) -> Float:
    """Return values of inputs that differ from their start values, within their limits, [values].

    Results may rest at the start values whether the reset works or not.
    """
    return np.array([_other_start(v, k) for v in variables for k in range(v.size)], dtype=float)


def _other_start(variable: FmuVariable, position: int) -> float:
    start = variable.start_of(position)
    moved = start + (variable.nominal or abs(start) or 1.0)
    return min(max(moved, variable.minimum), variable.maximum) if variable.is_real else start


class StartedValues:
    """The values of all variables that state a start value and are not set from outside.

    Args:
        description: the FMU.
        library: its library in this process.
    """

    def __init__(self, description: FmuDescription, library: FmuLibrary) -> None:
        # inputs and parameters are set again after a reset
        known = {v.name for v in (*description.parameters, *description.number_inputs)}
        started = [v for v in description.variables if v.start and v.name not in known]
        self._library, self._version = library, description.version
        self._groups = [
            (kind, tuple(members))
            for kind, members in groupby(description.sorted_by_type(started), key=self._type_of)
            if kind is not None
        ]

    def read(self, instance: int, slot: int = 0) -> Float:
        """Read them from an instance, [values]; NaN where it refuses.

        Args:
            instance: address of an instance that has been initialized; 0 for none.
            slot: the slot of the record of calls.
        """
        parts = [np.empty(0)]
        for kind, variables in self._groups:
            values = self._get(instance, kind, variables, slot)
            if values is None:
                # an FMU that refuses one of them refuses all: those that it returns are compared nevertheless
                single = [(v, self._get(instance, kind, [v], slot)) for v in variables]
                values = np.concatenate([np.full(v.size, np.nan) if x is None else x for v, x in single])
            parts.append(values)
        return np.concatenate(parts)

    def _type_of(self, variable: FmuVariable) -> FmuType | None:
        return number_type(self._version, variable.type)

    def _get(self, instance: int, kind: FmuType, variables: Sequence[FmuVariable], slot: int) -> Float | None:
        """Return the values of variables of one type; None if the FMU refuses."""
        address = self._library.address(f"fmi{self._version[0]}Get{kind.access}")
        if not address or not instance:
            return None
        references = np.array([v.reference for v in variables], dtype=np.uint32)
        size, pointer, count = sum(v.size for v in variables), ctypes.c_void_p, ctypes.c_size_t
        values = np.zeros(size, dtype=kind.dtype)
        # FMI 3.0 takes the number of values as well
        lengths = (size,) if self._version == "3.0" else ()
        get = ctypes.CFUNCTYPE(ctypes.c_int, pointer, pointer, count, pointer, *[count] * len(lengths))(address)
        with self._library.record.during(READING, slot):
            status = get(instance, references.ctypes.data, len(references), values.ctypes.data, *lengths)
        return None if status > WARNING else values.astype(float)
