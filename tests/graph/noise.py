"""An interpreter that rounds at random: how far the order of rounding can move a result.

Native code may contract a product and a sum into one rounding. Where a comparison or a search then falls on the other
side, the results differ by more than rounding, and rightly so. `spread` measures it, and so tells which samples can
be compared and how closely.
"""

from collections.abc import Callable

import numpy as np

from kennfeld.graph.interpreter import Interpreter

NOISE = 1e-14  # relative; some 50 units in the last place
RUNS = 3


class Noisy(Interpreter):
    """Every value changes a little each time that a node reads it; whole numbers count as exact."""

    random: np.random.Generator
    ahead: list[list[np.ndarray]]

    def run(self, nodes, states, columns, starts=(0,), firsts=None):
        """One of `RUNS` runs over the same data, which are computed side by side as pieces of longer data."""
        if not self.ahead:
            samples = next(iter(columns.values())).size
            repeated = {name: np.tile(column, RUNS) for name, column in columns.items()}
            pieces = [number * samples + start for number in range(RUNS) for start in starts]
            values = super().run(nodes, states, repeated, pieces, firsts)
            self.ahead = [[v[n * samples : (n + 1) * samples] for v in values] for n in range(RUNS)]
        return self.ahead.pop()

    def _node(self, node, args, columns, memory):
        samples = next(iter(columns.values())).size
        return super()._node(node, [self._shake(a, samples) for a in args], columns, memory)

    def _shake(self, value, samples):
        shaken = value * (1.0 + NOISE * self.random.uniform(-1, 1, samples))
        return np.where(value == np.round(value), value, shaken)


def spread(
    interpreter: Interpreter, evaluate: Callable[[Interpreter], np.ndarray], exact: np.ndarray | None = None
) -> np.ndarray:
    """The largest change from `exact` of what `evaluate` gives under noise; NaN where only one of the two is finite."""
    noisy = Noisy.__new__(Noisy)
    noisy.__dict__.update(interpreter.__dict__)
    noisy.random, noisy.ahead = np.random.default_rng(1), []
    exact = evaluate(interpreter) if exact is None else exact
    with np.errstate(all="ignore"):
        changes = [difference(evaluate(noisy), exact) for _ in range(RUNS)]
    return np.max(changes, axis=0)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance, 0 between values that are not finite in the same way, infinite where one alone is not."""
    with np.errstate(all="ignore"):
        same = (a == b) | (np.isnan(a) & np.isnan(b))
        gap = np.where(same, 0.0, np.abs(a - b))
    return np.where(np.isnan(gap), np.inf, gap)


def steady(exact: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the elements that rounding of the inputs moves by no more than rounding of the result."""
    with np.errstate(all="ignore"):
        return change <= 1e-6 * (1.0 + np.where(np.isfinite(exact), np.abs(exact), 0.0))


def assert_close(got: np.ndarray, exact: np.ndarray, change: np.ndarray, where: np.ndarray, message: str = "") -> None:
    """Equal up to what rounding explains, at the entries `where`."""
    with np.errstate(all="ignore"):
        size = np.where(np.isfinite(exact), np.abs(exact), 0.0)
        wrong = where & ~(difference(got, exact) <= 1e-11 * size + 300 * change + 1e-12)
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise AssertionError(f"{message} differs at {at}: {got[at]!r} instead of {exact[at]!r}, noise {change[at]:.2g}")
