"""Choice of points that determine named values, or one direction: exact, by the full information matrix.

With the curvature H and the rows J of a candidate, weighted so that the noise is 1, measuring it lowers the variance
f'H^-1 f of a linear function f of the values by

    f'H^-1 J' (1 + J H^-1 J')^-1 J H^-1 f

Points are chosen greedily and exchanged. All that a step needs is J H^-1 F and J H^-1 J' of every candidate, which one
product updates.
"""

from collections.abc import Callable

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.subsets import best_subset

ROUNDS = 2  # passes of exchanges, of which the first finds nearly all that is to be found
LEAST_GAIN = 1e-9


@dataclass(frozen=True, eq=False)
class PointChoice:
    """Chosen candidates, in the order of their gain, and the predicted variance.

    Attributes:
        chosen: numbers of the candidates.
        factors: standard deviation with the first k of them, relative to that without any, as the root of the mean over
            all functions, Float[chosen + 1].
    """

    chosen: tuple[int, ...]
    factors: Float

    @property
    def factor(self) -> float:
        """Predicted standard deviation with all of them, relative to that without."""
        return float(self.factors[-1])


Stop = Callable[[PointChoice], bool]  # is given the choice so far; True ends the search with it


class PointSearch:
    """Searches candidates for the points that determine linear functions of the values best.

    Args:
        curvature: H, Float[values, values], positive definite.
        rows: slopes of the outputs at each candidate, Float[candidates, outputs, values].
        functions: the functions as rows, Float[functions, values].
        repeats: allow a candidate several times.
    """

    def __init__(self, curvature: Float, rows: Float, functions: Float, *, repeats: bool = False) -> None:
        scale = np.sqrt(np.diagonal(curvature))
        # in units of the diagonal, in which the inverse keeps its digits
        self._inverse = np.linalg.inv(curvature / np.outer(scale, scale))
        self._rows, self._functions = rows / scale, functions / scale
        self._repeats = repeats
        self.before = np.einsum("ij,jk,ik->i", self._functions, self._inverse, self._functions)

    def choose(self, count: int, rounds: int = ROUNDS, stop: Stop = lambda choice: False) -> PointChoice:
        """Choose at most `count` points, and exchange them in `rounds` passes.

        `stop` is asked after each point and before each exchange; True ends the search with the choice it is given.
        """
        candidates = len(self._rows)
        count = count if self._repeats else min(count, candidates)
        state = _CandidateState(self._inverse, self._rows, self._functions, self.before)
        chosen, factors = list[int](), [1.0]
        for _ in range(count):
            chosen.append(self._best(state, chosen))
            state.add(chosen[-1])
            factors.append(float(np.sqrt(max(state.mean, 0.0))))
            if stop(PointChoice(tuple(chosen), np.array(factors))):
                return PointChoice(tuple(chosen), np.array(factors))
        if rounds and count <= candidates and not self._repeats:
            chosen = self._improved(state, chosen, rounds, stop)
        return self._ordered(chosen) if rounds else PointChoice(tuple(chosen), np.array(factors))

    def _improved(self, state: "_CandidateState", chosen: list[int], rounds: int, stop: Stop) -> list[int]:
        """Return the best of all choices of as many points, or, of many, what exchanges find."""
        candidates, values = len(self._rows), len(self._inverse)
        width = (len(chosen) * self._rows.shape[1]) ** 2 + values * len(chosen) * self._rows.shape[1]
        best = best_subset(range(candidates), len(chosen), self._means, width) if chosen else None
        if best is not None:
            return best[1] if best[0] < state.mean * (1 - LEAST_GAIN) else chosen
        for _ in range(rounds):
            if not self._exchange(state, chosen, stop):
                break
        return chosen

    def _means(self, chosen: Int) -> Float:
        """Return the mean of the variances relative to those before, Float[choices], of Int[choices, points]."""
        rows = self._rows[chosen].reshape(len(chosen), -1, len(self._inverse))
        reach = rows @ self._inverse  # J H^-1 of all points together
        effects = reach @ self._functions.T
        gains = np.linalg.solve(reach @ rows.transpose(0, 2, 1) + np.eye(rows.shape[1]), effects)
        relative = np.einsum("kof,kof->kf", effects, gains) / np.maximum(self.before, 1e-300)
        return np.asarray(1 - relative.mean(axis=1))

    def _best(self, state: "_CandidateState", chosen: list[int]) -> int:
        gains = state.gains()
        if not self._repeats:
            gains[chosen] = -np.inf
        return int(gains.argmax())

    def _exchange(self, state: "_CandidateState", chosen: list[int], stop: Stop) -> bool:
        """Exchange points for better ones; return False if none is, or if the search is stopped."""
        improved = False
        for at, own in enumerate(chosen):
            before = state.mean
            if stop(PointChoice(tuple(chosen), np.sqrt(np.maximum([1.0, before], 0.0)))):
                return False
            state.add(own, -1.0)
            other = self._best(state, chosen[:at] + chosen[at + 1 :])
            state.add(other)
            if other != own and state.mean < before * (1 - LEAST_GAIN):
                chosen[at], improved = other, True
            elif other != own:
                state.add(other, -1.0)
                state.add(own)
        return improved

    def _ordered(self, chosen: list[int]) -> PointChoice:
        state = _CandidateState(self._inverse, self._rows, self._functions, self.before)
        rest, ordered, factors = list(chosen), list[int](), [1.0]
        while rest:
            gains = state.gains()[rest]
            ordered.append(rest.pop(int(gains.argmax())))
            state.add(ordered[-1])
            factors.append(float(np.sqrt(max(state.mean, 0.0))))
        return PointChoice(tuple(ordered), np.array(factors))


class _CandidateState:
    """J H^-1 F, J H^-1 J' and the variances, as points are added and removed."""

    def __init__(self, inverse: Float, rows: Float, functions: Float, before: Float) -> None:
        self._inverse, self._rows, self._functions = inverse.copy(), rows, functions
        # each function counts relative to its variance before
        self._weights = np.divide(1.0, before, out=np.zeros_like(before), where=before > 0) / max(before.size, 1)
        self._refresh()

    def _refresh(self) -> None:
        reach = self._rows @ self._inverse  # J H^-1, Float[candidates, outputs, values]
        self._effects = reach @ self._functions.T
        self._own = reach @ self._rows.transpose(0, 2, 1)
        self._variances = np.einsum("ij,jk,ik->i", self._functions, self._inverse, self._functions)

    @property
    def mean(self) -> float:
        """Mean of the variances, relative to those before."""
        return float(self._variances @ self._weights)

    def gains(self) -> Float:
        """Return by how much each candidate lowers the mean, Float[candidates]."""
        outputs = self._rows.shape[1]
        solved = np.linalg.solve(self._own + np.eye(outputs), self._effects)
        return np.asarray(np.einsum("kot,kot,t->k", self._effects, solved, self._weights))

    def add(self, candidate: int, sign: float = 1.0) -> None:
        """Add a candidate, or remove it with the sign -1."""
        rows = self._rows[candidate]
        reach = rows @ self._inverse
        middle = np.linalg.inv(np.eye(len(rows)) + sign * reach @ rows.T)
        change = sign * reach.T @ middle  # H^-1 J' (1 + J H^-1 J')^-1, Float[values, outputs]
        across = self._rows @ change
        effects = self._effects[candidate].copy()
        self._own -= across @ (self._rows @ reach.T).transpose(0, 2, 1)
        self._effects -= across @ effects
        self._variances = self._variances - np.einsum("os,op,ps->s", effects, sign * middle, effects)
        self._inverse -= change @ reach
