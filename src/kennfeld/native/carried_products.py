"""Products of the rows of a tape with hat functions of channels times factors, for models with memory.

The candidate columns are those of `hat_products`, but act on later samples through the states; see `carried_sweeps`.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, aligned_zeros
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import LANES
from kennfeld.native.addresses import INT32, INT64, address
from kennfeld.native.carried_sweeps import IGNORED, OWN, TILE, pitch, products_function, pulls_function, scratch_size
from kennfeld.native.kernel import Kernel
from kennfeld.native.tape_layout import MANY, TapeLayout
from kennfeld.native.workspace import Workspace

DEEP = 64  # rows of sensitivities, beyond which what they add at the start of each part takes longer than rows of J


def has_carried_sweeps(kernel: Kernel) -> bool:
    """Return True if sweeps are faster than rows of all columns: with few states and without a long delay."""
    return 0 < kernel.pattern.carried <= MANY and sum(kernel.pattern.latencies) <= DEEP


class CarriedProducts:
    """The sums over samples by block.

    Args:
        kernel: of the tape.
        probes: the column of the kernel whose slopes are those by each factor, Sequence[factors].
        ignored: columns without a row in J'WB.
        hats: number of hats of each axis.
        blocks: number of blocks.
        corners: pairs of neighbouring hats that a sample has on an axis: 1, of a map 2.
        scaled: True if the slopes of a sample are multiplied by numbers of its own.
    """

    def __init__(
        self,
        kernel: Kernel,
        probes: Sequence[int],
        ignored: Sequence[int],
        hats: Sequence[int],
        blocks: int,
        *,
        corners: int = 1,
        scaled: bool = False,
    ) -> None:
        self._pattern, self._hats, self._factors = kernel.pattern, tuple(hats), len(probes)
        self._free, self._depth = kernel.values.free, sum(kernel.pattern.latencies)
        self._width = -(-len(probes) // TILE) * TILE
        self._products = _products(kernel.pattern, self._width, corners, scaled)
        numbers = {column: number for number, column in enumerate(dict.fromkeys(probes))}
        self._roles = np.full(self._free, OWN, dtype=np.int32)
        self._roles[[*ignored]] = IGNORED
        self._roles[[*numbers]] = [*numbers.values()]
        self._probe_of = np.array([numbers[column] for column in probes], dtype=np.int32)
        self._probes = len(numbers)
        self._counts = np.array(hats, dtype=np.int32)
        rows = [pitch(count, self._width) for count in hats]
        # the hat after a single one has the weight 0, and is written to
        room = max(rows) + LANES
        self._columns, self._ends = sum(rows), [0, *np.cumsum(rows).tolist()]
        self._own = aligned_zeros(self._depth * self._columns + room)
        self._jb = aligned_zeros(self._free * self._columns + room)
        self._br = aligned_zeros(blocks * self._columns + room)[: blocks * self._columns].reshape(blocks, -1)
        self._square_ends = [0, *np.cumsum([a * b for a, b in zip(hats, rows, strict=True)]).tolist()]
        size = self._square_ends[-1]
        self._squares = aligned_zeros(blocks * size + room)[: blocks * size].reshape(blocks, size)
        self._scratch = aligned_zeros(
            scratch_size(kernel.pattern, self._width, self._probes, kernel.entries.room, hats) + room
        )

    def begin(self, first: Float) -> None:
        """Start a piece; `first` are the slopes of the first values of the states, Float[carried, hats, factors]."""
        self._own[:] = 0.0
        repeated = np.repeat(first, self._pattern.latencies, axis=0)
        hat = 0
        for (begin, end), count in zip(pairwise(self._ends), self._hats, strict=True):
            rows = self._own[self._depth * begin : self._depth * end].reshape(self._depth, -1)
            self._by_factor(rows, count)[:] = repeated[:, hat : hat + count]
            hat += count

    def _by_factor(self, rows: Float, hats: int) -> Float:
        """Return a view of the rows of an axis, Float[..., hats, factors]."""
        whole = rows[..., : hats * self._width]
        return whole.reshape(*rows.shape[:-1], hats, self._width)[..., : self._factors]

    def add(
        self,
        space: Workspace,
        first: int,
        last: int,
        block: int,
        cells: NDArray[np.int32],
        shares: Float,
        sides: Float | None = None,
        scales: Float | None = None,
    ) -> None:
        """Add samples of a tape, which follow each other in one block.

        Args:
            space: holds the tape, and the sensitivities at its first sample.
            first: the first sample on the tape.
            last: the sample after the last one.
            block: number of the block.
            cells: number of the first hat of each pair, counted over all axes, Int[corners, samples, axes].
            shares: weight of the hat after it, Float[corners, samples, axes].
            sides: weight of each pair, Float[corners, samples].
            scales: by which the slopes of the samples are multiplied, Float[samples, factors].
        """
        roles = address(self._roles, kind=INT32)
        factors = (address(self._probe_of, kind=INT32), self._factors, self._probes)
        whole = shares if sides is None else sides
        places = (address(cells, kind=INT32), address(shares), address(whole), len(self._hats))
        sums = (self._own, self._jb, self._squares[block], self._br[block], self._scratch)
        self._products(
            last - first,
            *_tape(space, first, last),
            *_carried(space, roles),
            *factors,
            address(shares if scales is None else scales),
            *places,
            address(self._counts, kind=INT32),
            *(address(array) for array in sums),
        )

    @property
    def jb(self) -> Float:
        """J'WB, Float[values, hats * factors]; 0 for values without a row."""
        parts = []
        for begin, end in pairwise(self._ends):
            vectors = self._jb[self._free * begin : self._free * end].reshape(-1, self._free, LANES)
            rows = np.ascontiguousarray(vectors.transpose(1, 0, 2)).reshape(self._free, -1)
            # what samples before a part contribute is added to all rows
            rows[self._roles != OWN] = 0.0
            parts.append(rows)
        return self._joined(parts)

    @property
    def br(self) -> Float:
        """B'Wr by block, Float[blocks, hats * factors]."""
        return self._joined([self._br[:, begin:end] for begin, end in pairwise(self._ends)])

    def _joined(self, parts: Sequence[Float]) -> Float:
        whole = [self._by_factor(part, hats) for part, hats in zip(parts, self._hats, strict=True)]
        return np.concatenate([part.reshape(len(part), -1) for part in whole], axis=1)

    def squares(self, factor: int) -> list[Float]:
        """Return B'WB of the columns of a factor by axis, Float[blocks, hats, hats] each."""
        matrices = []
        for (begin, end), hats in zip(pairwise(self._square_ends), self._hats, strict=True):
            rows = self._squares[:, begin:end].reshape(len(self._squares), hats, -1)
            matrix = self._by_factor(rows, hats)[..., factor]
            # summed in different orders below and above the diagonal
            matrices.append(0.5 * (matrix + matrix.transpose(0, 2, 1)))
        return matrices


def add_pulls(space: Workspace, first: int, last: int, total: Float) -> None:
    """Add J'Wr of samples of a tape to Float[values], and carry the sensitivities of the workspace over them."""
    kernel = space.kernel
    own = np.full(kernel.values.free, OWN, dtype=np.int32)
    later = np.zeros(sum(kernel.pattern.latencies))
    carried = _carried(space, address(own, kind=INT32))
    _pulls(kernel.pattern)(last - first, *_tape(space, first, last), *carried, address(later), address(total, own.size))


def _tape(space: Workspace, first: int, last: int) -> tuple[int, ...]:
    steps = [address(array[first:last]) for array in (space.weight, space.residual, space.c, space.a)]
    integers = (address(array[first:last], kind=INT32) for array in (space.index, space.count))
    index, count = integers
    return (*steps, index, address(space.slope[first:last]), count, space.index.shape[1])


def _carried(space: Workspace, roles: int) -> tuple[int, ...]:
    free = space.kernel.values.free
    rings = address(space.turn, kind=INT64)
    return (address(space.sensitivities), space.width, rings, roles, free)


@cache
def _products(pattern: TapeLayout, width: int, corners: int, scaled: bool) -> NativeFunction:
    return compile_functions(products_function(pattern, width, corners, scaled=scaled), loops=True)["products"]


@cache
def _pulls(pattern: TapeLayout) -> NativeFunction:
    return compile_functions(pulls_function(pattern), loops=True)["pulls"]
