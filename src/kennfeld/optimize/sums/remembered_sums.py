"""Sums that remember their last results: a fit asks several times for those at its start and at its end."""

from typing import Any

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.column_table import ColumnTable
from kennfeld.optimize.sums.sums import NormalEquations, Sums, TapeVisitor

MOST_COSTS = 8
MOST_ROWS, MAX_ROW_ENTRIES = 4, 10_000  # of few samples, each end is asked for its rows by several checks
MIN_SAMPLES = 0.125  # per entry of the matrix; for fewer samples the sums take hardly longer than a copy of the matrix


@dataclass(frozen=True)
class _Copy:
    """A copy of normal equations; valid for good."""

    gradient: Float
    matrix: Float

    def again(self) -> "_Copy":
        """Return another copy, which a caller may change."""
        return _Copy(self.gradient.copy(), self.matrix.copy())


class RememberedSums:
    """The given sums, which compute nothing twice; see `sums.Sums`.

    Args:
        sums: sums over samples.
        samples: number of samples.
        targets: their targets if these may change in place.
    """

    def __init__(self, sums: Sums, samples: int, targets: ColumnTable | None = None) -> None:
        self._sums, self._samples, self._targets, self.widths = sums, samples, targets, sums.widths
        self._costs: dict[bytes, float] = {}
        self._last: tuple[bytes, _Copy] | None = None
        self._rows: dict[bytes, tuple[Float, Float]] = {}

    @property
    def stateful(self) -> bool:
        """See `Sums`."""
        return self._sums.stateful

    def prepare(self) -> None:
        """See `Sums`."""
        self._sums.prepare()

    def cost(self, values: Float) -> float:
        """See `Sums`."""
        key = self._key(values)
        if key not in self._costs:
            _make_room(self._costs, MOST_COSTS)
            self._costs[key] = self._sums.cost(values)
        return self._costs[key]

    def normal(self, values: Float) -> NormalEquations:
        """See `Sums`."""
        key = self._key(values)
        if self._last is not None and self._last[0] == key:
            return self._last[1].again()
        # the caller may change the matrix that it gets, so that a copy is kept
        normal, self._last = self._sums.normal(values), None
        matrix = normal.matrix  # in blocks if there are many values
        if isinstance(matrix, np.ndarray) and self._samples >= MIN_SAMPLES * matrix.size:
            self._last = key, _Copy(normal.gradient, matrix).again()
        return normal

    def residual(self, values: Float) -> Float:
        """See `Sums`."""
        return self._sums.residual(values)

    def rows(self, values: Float) -> tuple[Float, Float]:
        """See `Sums`."""
        key = self._key(values)
        known = self._rows.get(key)
        if known is None:
            known = self._sums.rows(values)
            if known[1].size > MAX_ROW_ENTRIES:
                return known
            _make_room(self._rows, MOST_ROWS)
            self._rows[key] = known
        # the caller may change what it gets
        return known[0].copy(), known[1].copy()

    def rows_at(self, values: Float, visits: Int) -> Float:
        """See `Sums`."""
        return self._sums.rows_at(values, visits)

    def squares(self, values: Float, groups: Int, count: int) -> Float:
        """See `Sums`."""
        return self._sums.squares(values, groups, count)

    def touched(self, values: Float, owners: Int | None = None) -> Int:
        """See `Sums`."""
        return self._sums.touched(values, owners)

    def each_tape(self, values: Float, work: TapeVisitor) -> None:
        """See `Sums`."""
        self._sums.each_tape(values, work)

    def _key(self, values: Float) -> bytes:
        """Return a key of all that the sums depend on: values, widths, and targets that may change in place."""
        version = 0 if self._targets is None else self._targets.version
        return values.tobytes() + self.widths.tobytes() + version.to_bytes(8, "little")


def _make_room(remembered: dict[bytes, Any], most: int) -> None:
    if len(remembered) >= most:
        # the oldest one
        del remembered[next(iter(remembered))]
