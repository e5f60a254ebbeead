"""Choice of candidates by coverage weighted by use.

The information I of a value is the diagonal entry of the Gauss-Newton matrix, its use u the mean information of a
sample over the operation that matters. A fit whose values are independent has there the mean variance of prediction

    sum over the values of u / (I + information of the chosen candidates)

in units of the noise. Candidates are chosen to minimise it, averaged over several sets of values around the fit.
Unlike a determinant or the variance at candidates, it does not reward extreme operation that the use never meets, where
a function is most wrong.
"""

from collections.abc import Callable

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.design.subsets import BEST_TIMES, best_subset

Stop = Callable[[list[int]], bool]  # is given what is chosen so far; True ends the search with it
ROUNDS = 10  # of exchanges, of which the first two find nearly all that is to be found
STARTS = 20  # at most, of exchanges from random candidates
MOST_STEPS = 2_000_000  # candidates times values times draws times exchanges, up to which there are several starts
LEAST_GAIN = 1e-9  # relative


def never(progress: object) -> bool:
    """Return False: the search goes on to its end."""
    return False


class WeightedCoverage:
    """The mean variance of prediction as a function of the candidates that are measured.

    Args:
        known: information before, > 0; shape (draws, values).
        candidates: information of each candidate, shape (draws, candidates, values).
        use: mean information over the operation that matters, shape (draws, values).

    >>> candidates = np.array([[[9.0, 0.0], [0.0, 9.0], [4.0, 4.0]]])
    >>> cover = WeightedCoverage(np.ones((1, 2)), candidates, np.array([[1.0, 2.0]]))
    >>> cover.of([]), cover.of([1]), cover.choose(1)
    (3.0, 1.2, [2])
    """

    def __init__(self, known: Float, candidates: Float, use: Float) -> None:
        self._known, self._candidates, self._use = known, candidates, use

    def of(self, chosen: list[int]) -> float:
        """Return the mean variance of prediction with some candidates, in units of the noise."""
        return float((self._use / self._information(chosen)).sum(axis=1).mean())

    def _information(self, chosen: list[int]) -> Float:
        return np.asarray(self._known + self._candidates[:, chosen].sum(axis=1))

    def _with_each(self, information: Float, sign: float = 1.0) -> Float:
        """Return the variance with each of the candidates added to others, or removed, Float[candidates]."""
        total = np.zeros(self._candidates.shape[1])
        # draw by draw, so that memory does not grow with their number
        for known, candidates, use in zip(information, self._candidates, self._use, strict=True):
            total += (use / np.maximum(known + sign * candidates, 1e-300)).sum(axis=1)
        return total / len(self._use)

    def choose(self, count: int, used: Int | None = None, stop: Stop = never) -> list[int]:
        """Choose candidates one by one, then exchange each for a better one, until none is.

        Args:
            count: number of candidates, at most as many as there are.
            used: numbers of candidates that are no longer to be had.
            stop: is asked after each of them, and before each exchange.

        Returns:
            Their numbers; the first adds most.
        """
        blocked = np.zeros(self._candidates.shape[1], dtype=bool)
        blocked[[] if used is None else used] = True
        chosen: list[int] = []
        for _ in range(min(count, int(np.count_nonzero(~blocked)))):
            variances = self._with_each(self._information(chosen))
            variances[blocked] = np.inf
            chosen.append(int(variances.argmin()))
            blocked[chosen[-1]] = True
            if stop(chosen):
                return chosen
        return self._ordered(self._improved(chosen, blocked, stop))

    def _improved(
        self, chosen: list[int], blocked: "np.ndarray[tuple[int], np.dtype[np.bool_]]", stop: Stop
    ) -> list[int]:
        """Return the best of all choices of as many candidates, or, of many, what exchanges from some starts find."""
        if not chosen or stop(chosen):
            return chosen
        free = np.flatnonzero(~blocked | np.isin(np.arange(blocked.size), chosen)).tolist()
        best = best_subset(free, len(chosen), self._of_each, len(chosen) * self._known.size)
        if best is not None:
            return best[1] if best[0] < self.of(chosen) * (1 - LEAST_GAIN) else chosen
        self._exchange(chosen, blocked, stop)
        if self._candidates.size * len(chosen) > MOST_STEPS:
            return chosen
        return self._restarted(chosen, free, stop)

    def _restarted(self, chosen: list[int], free: list[int], stop: Stop) -> list[int]:
        """Return the best of exchanges from random candidates and from these, once three of them end at the best."""
        random, best, times = np.random.default_rng(0), self.of(chosen), 1
        for _ in range(STARTS):
            if times == BEST_TIMES or stop(chosen):
                break
            other: list[int] = random.choice(free, len(chosen), replace=False).tolist()
            blocked = np.ones(self._candidates.shape[1], dtype=bool)
            blocked[free] = np.isin(free, other)
            self._exchange(other, blocked, lambda _, own=chosen: stop(own))  # type: ignore[misc]
            value = self.of(other)
            if value < best * (1 - LEAST_GAIN):
                chosen, best, times = other, value, 1
            elif value <= best * (1 + LEAST_GAIN):
                times += 1
        return chosen

    def _of_each(self, chosen: Int) -> Float:
        """Return the variance with each of several choices, Float[choices], of candidates, Int[choices, count]."""
        total = np.zeros(len(chosen))
        for known, candidates, use in zip(self._known, self._candidates, self._use, strict=True):
            total += (use / (known + candidates[chosen].sum(axis=1))).sum(axis=1)
        return total / len(self._use)

    def _exchange(
        self, chosen: list[int], blocked: "np.ndarray[tuple[int], np.dtype[np.bool_]]", stop: Stop = never
    ) -> None:
        best = self.of(chosen)
        for _ in range(ROUNDS):
            before = best
            for at, own in enumerate(chosen):
                if stop(chosen):
                    return
                variances = self._with_each(self._information(chosen[:at] + chosen[at + 1 :]))
                variances[blocked] = np.inf
                other = int(variances.argmin())
                if variances[other] < best * (1 - LEAST_GAIN):
                    chosen[at], best = other, float(variances[other])
                    blocked[[own, other]] = False, True
            if best == before:
                return

    def _ordered(self, chosen: list[int]) -> list[int]:
        """Sort chosen candidates, each the best of those that remain."""
        rest, ordered = list(chosen), list[int]()
        while rest:
            variances = self._with_each(self._information(ordered))[rest]
            ordered.append(rest.pop(int(variances.argmin())))
        return ordered

    def drop(self, keep: int, *, exchange: bool = False, stop: Stop = never) -> list[tuple[int, float]]:
        """Drop candidates one by one, each the one that is missed least.

        Args:
            keep: number of candidates that remain.
            exchange: exchange those that remain for dropped ones, until none of them is better.
            stop: is asked after each that is dropped, and before each exchange; those so far remain dropped.

        Returns:
            The dropped ones, the first missed least, each with the variance without it and those before it.
        """
        everything = list(range(self._candidates.shape[1]))
        count = len(everything) - max(keep, 0)
        dropped = self._eliminate(everything, everything, count, stop)
        if not exchange or len(dropped) < count:
            return dropped
        gone = [number for number, _ in dropped]
        kept = [number for number in everything if number not in gone]
        blocked = np.isin(everything, kept)
        kept = self._improved(kept, blocked, lambda _: stop(gone))
        return self._eliminate(everything, [number for number in everything if number not in kept], len(dropped))

    def _eliminate(
        self, everything: list[int], droppable: list[int], count: int, stop: Stop = never
    ) -> list[tuple[int, float]]:
        kept, rest = list(everything), list(droppable)
        dropped: list[tuple[int, float]] = []
        for _ in range(count):
            variances = self._with_each(self._information(kept), -1.0)[rest]
            least = int(variances.argmin())
            kept.remove(rest[least])
            dropped.append((rest.pop(least), float(variances[least])))
            if stop([number for number, _ in dropped]):
                break
        return dropped

    def gains(self, chosen: list[int]) -> Float:
        """Return how much of the variance of each value a chosen candidate removes as the last, [chosen, values]."""
        information = self._information(chosen)
        parts = []
        for own in chosen:
            without = information - self._candidates[:, own]
            parts.append((self._use / without - self._use / information).mean(axis=0))
        return np.array(parts).reshape(len(chosen), self._use.shape[1])
