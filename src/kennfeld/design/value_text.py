"""Names of values for sentences: the grid points that a measurement determines."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import join_names
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.optimize.trust.direction_text import Describer

MOST_NAMED = 3  # values of one measurement
LEAST_SHARE = 0.05  # of the total gain that a value needs to be named


class ValueNames:
    """Names single values of a fitted function by their grid points."""

    def __init__(self, fitted: FittedFunction) -> None:
        self._blocks = fitted.blocks
        parameters, problem = fitted.problem.parameters, fitted.problem
        tables = {name: samples for name, samples in fitted.trust.samples.items() if name in parameters}
        self._shapes = {name: parameters[name].values.shape for name in tables}
        self._words = Describer(problem.model.graph, parameters, parameters, tables, {})

    def name(self, value: int) -> str:
        """Return the name of a free value by its number."""
        for block, (first, size) in self._blocks.items():
            if first <= value < first + size:
                if block not in self._shapes:
                    return f"breakpoint {value - first + 1} of {block}"
                at = np.unravel_index(value - first, self._shapes[block]) if self._shapes[block] else ()
                place = self._words.place(block, at)
                return f"{block} at {place}" if place else block
        return f"value {value}"

    def strongest(self, gains: Float) -> str:
        """Name the values of the largest gains, Float[values]; empty if there is no gain."""
        total = float(gains.sum())
        order = np.argsort(-gains, kind="stable")[:MOST_NAMED].tolist()
        return join_names([self.name(at) for at in order if total > 0 and gains[at] >= LEAST_SHARE * total])


def matching(names: Sequence[str], fitted: FittedFunction) -> list[int]:
    """Return the numbers of all free values of parameters that match patterns, without those that are held."""
    from fnmatch import fnmatchcase

    located: list[int] = []
    for block, (first, size) in fitted.blocks.items():
        if any(fnmatchcase(block, pattern) for pattern in names):
            located += [at for at in range(first, first + size) if not fitted.fixed[at]]
    return located
