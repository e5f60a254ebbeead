"""Arrays of one thread, and the native calls on them."""

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, Int, aligned_zeros
from kennfeld.native.addresses import INT32, INT64, POINTER, address, strided
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage
from kennfeld.native.forward_sweep import scratch_size
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_sums import BATCH, batch_width
from kennfeld.native.samples import Chunk, Samples
from kennfeld.native.tape_reader import VECTOR

LARGE = 1000  # values from which the zeros of the Gauss-Newton matrix are worth leaving out


class Workspace:
    """Tape, states and sums of one thread."""

    def __init__(self, kernel: Kernel, samples: Samples, widths: Float, length: int) -> None:
        pattern, entries = kernel.pattern, kernel.entries.room
        m, n = pattern.outputs, pattern.carried
        columns, self.width = kernel.values.free, _round_to_vectors(kernel.values.reach)
        self.kernel, self.samples, self.widths = kernel, samples, widths
        self.memory = np.zeros(kernel.layout.memory)
        self.hints = np.zeros(kernel.layout.hints, dtype=np.int64)
        self.residual, self.weight = np.zeros((2, length, m))
        self.c, self.a = np.zeros((length, m, n)), np.zeros((length, pattern.cells))
        self.index = np.zeros((length, entries), dtype=np.int32)
        self.slope = np.zeros((length, entries, pattern.rows))
        self.count = np.zeros(length, dtype=np.int32)
        first = kernel.start_entries.room
        self._start = (np.zeros(first, dtype=np.int32), np.zeros((first, n)), np.zeros(1, dtype=np.int32))
        swept = n if pattern.accumulates else 0
        self.q, self.l = np.zeros((swept, swept)), np.zeros(swept)
        self.q_next, self.l_next = np.zeros((length, swept, swept)), np.zeros((length, swept))
        self.latencies = pattern.latencies
        self.sensitivities = _aligned_zeros(sum(self.latencies), self.width, self.width)
        self.next, self.scratch = np.zeros((n, self.width)), aligned_zeros(scratch_size(pattern, entries))
        self.turn = np.zeros(max(n, 1), dtype=np.int64)
        self.gradient = np.zeros(columns)
        self.storage = BlockStorage(columns) if stores_blocks(kernel) else None
        dense = columns if self.storage is None else 0
        self.matrix = _aligned_zeros(dense, dense, _round_to_vectors(dense))
        self._jacobian: Float | None = None
        self._rows: tuple[int, ...] = ()  # the arguments of `rows` from the sensitivities on
        self._scores: dict[int, int] = {}  # address of the scores of each piece
        self._entries = (*_entry_addresses(self.index, self.slope, self.count), entries)
        self._sums = (*strided(self.matrix, dense), address(self.gradient))
        # sums with carried states are those of sweeps
        self._batch = BatchMemory(0 if n else entries, columns, m)
        self._steps = tuple(address(array) for array in (self.residual, self.weight, self.c, self.a))
        self._ends = tuple(address(array) for array in (self.q, self.l, self.q_next, self.l_next))
        self._swept = (*self._ends[2:], address(self.sensitivities), self.width, address(self.scratch))
        axes = (address(kernel.axes), address(widths, len(kernel.layout.axes)))
        self._targets = address(samples.targets, kind=POINTER)
        self._settings = (*axes, address(self.memory), address(self.hints, kind=INT64))
        self._model: tuple[int, ...] = ()
        self._used: tuple[Float, NDArray[np.uintp]] | None = None

    def use(self, values: Float) -> None:
        """Set the values p [values] for the calls that follow; the array must live until then."""
        table = self.samples.data
        # taking an address takes as long as the call for a few samples
        if self._used is not None and values is self._used[0] and table is self._used[1]:
            return
        self._used = values, table
        pointers = (address(table, kind=POINTER), table.shape[1], address(values, self.kernel.values.total))
        self._model = (*pointers, *self._settings)

    def start(self, sample: int) -> None:
        """Compute the first values of the states, and the entries of their slopes."""
        if self.kernel.start is not None:
            self.kernel.start(*self._model, *_entry_addresses(*self._start), sample)

    def cost(self, chunk: Chunk, sums: Float) -> None:
        """Add the losses of each output over a chunk, without weights, to Float[outputs]."""
        into = address(sums, len(self.kernel.outputs))
        self.kernel.cost(*self._model, self._targets, into, chunk.first, chunk.last)

    def tape(self, chunk: Chunk) -> None:
        """Write the tape of a chunk, from the current states."""
        if chunk.piece not in self._scores:
            scores = self.samples.pieces[chunk.piece].scores
            self._scores[chunk.piece] = address(scores, len(self.kernel.outputs))
        head = (self._targets, self._scores[chunk.piece], *self._steps, *self._entries[:3])
        self.kernel.tape(*self._model, *head, chunk.first, chunk.last)

    def normal(self, chunk: Chunk) -> None:
        """Add the tape to the sums, for models without states."""
        tape = (chunk.length, *self._steps[:2], *self._entries, self._sums[2])
        storage, batch = self.storage, self._batch
        if storage is None:
            self.kernel.sweeps.normal(*tape, *self._sums[:2], *batch.pointers)
            return
        following = np.zeros(1, dtype=np.int64)
        sweeps = self.kernel.sweeps
        normal = sweeps.full_normal if storage.full else sweeps.block_normal
        # ends early if a batch needs blocks that are not reserved, and goes on at the sample of which it begins
        while following[0] < chunk.length:
            storage.reserve(batch.width**2)
            resumed = (storage.capacity, address(following, kind=INT64))
            normal(*tape, *storage.pointers, *batch.pointers, *resumed)

    def clear(self) -> None:
        """Set the sums to zero."""
        self.gradient[:], self.matrix[:] = 0.0, 0.0
        if self.storage is not None:
            self.storage.clear()

    def add(self, other: "Workspace") -> None:
        """Add the sums of another workspace."""
        self.gradient += other.gradient
        self.matrix += other.matrix
        if self.storage is not None and other.storage is not None:
            self.storage.add(other.storage)

    def fill(self) -> None:
        """Store all blocks of the matrix."""
        if self.storage is not None:
            self.storage.fill()

    def fold(self) -> Float | BlockMatrix:
        """Compute the Gauss-Newton matrix, [free, free], from the sums."""
        columns = self.kernel.values.free
        if self.storage is not None:
            return BlockMatrix(self.storage, np.arange(columns))
        self.kernel.sweeps.fold(*self._sums[:2], columns)
        return self.matrix

    def backward(self, chunk: Chunk) -> None:
        """Compute Q and L after each sample of the tape."""
        self.kernel.sweeps.backward(chunk.length, *self._steps, *self._ends)

    def forward(self, chunk: Chunk) -> None:
        """Add the tape to the sums, and carry S over it."""
        self.kernel.sweeps.forward(chunk.length, *self._steps, *self._swept, *self._entries, *self._sums)

    def rows(self, chunk: Chunk) -> tuple[Float, Float]:
        """Compute residuals and Jacobian of the tape, times the root of the weights; carries S over it.

        Shapes (samples * outputs,) and (samples * outputs, free).
        """
        columns, m = self.kernel.values.free, len(self.kernel.outputs)
        if self._jacobian is None:
            self._jacobian = _aligned_zeros(len(self.count) * m, columns, columns)
            turn = address(self.turn, kind=INT64)
            carried = (address(self.sensitivities), self.width, turn, address(self.next))
            self._rows = (*carried, *self._entries, address(self._jacobian), columns)
        self.kernel.sweeps.rows(chunk.length, *self._steps[1:], *self._rows)
        return self.residuals(chunk), self._jacobian[: chunk.length * m]

    def residuals(self, chunk: Chunk) -> Float:
        """Compute the residuals of the tape, Float[samples * outputs], times the root of the weights."""
        with np.errstate(invalid="ignore"):
            residual: Float = self.residual[: chunk.length] * np.sqrt(self.weight[: chunk.length])
        return residual.ravel()

    def touched(self, chunk: Chunk, latest: Int, counts: Int) -> None:
        """Count for each column, Int[free], the scored samples of the tape that have a slope in it; see `sweeps`."""
        columns = self.kernel.values.free
        numbers = (chunk.first, address(latest, columns, INT64), address(counts, columns, INT64))
        self.kernel.sweeps.touched(chunk.length, self._steps[1], *self._entries, *numbers)

    def met(self, chunk: Chunk, owners: Int) -> Int:
        """Return owner * columns + column for each column in which a sample has a slope, given owners, Int[samples].

        Sorted, without duplicates.
        """
        length = chunk.length
        used = (self.slope[:length] != 0).any(axis=2) & (owners >= 0)[:, None]
        # entries behind the count are those of earlier samples
        used &= np.arange(self.index.shape[1]) < self.count[:length, None]
        numbers = owners[:, None] * self.kernel.values.free + self.index[:length]
        return np.unique(numbers[used])

    def carried(self) -> tuple[Float, Int]:
        """Return S and the places in its ring buffers, for `carry`."""
        return self.sensitivities.copy(), self.turn.copy()

    def carry(self, sensitivities: Float, turn: Int) -> None:
        """Set S to what `carried` returned, to go through the same samples again."""
        self.sensitivities[:], self.turn[:] = sensitivities, turn

    def start_slopes(self, sample: int) -> dict[int, Float]:
        """Return by column the slopes of the first values of the carried states at a sample, Float[carried]."""
        if not self.kernel.line.start_atoms:
            return {}
        self.start(sample)
        index, slope, counted = self._start
        slopes: dict[int, Float] = {}
        # several entries may have one column
        for column, own in zip(index[: counted[0]].tolist(), slope, strict=False):
            slopes[column] = slopes.get(column, 0.0) + own
        return slopes

    def begin_sensitivities(self, sample: int, *, add_start: bool) -> None:
        """Set S at the first sample of a piece; `add_start` adds its share to the sums, from Q and L there."""
        self.sensitivities[:] = 0.0
        self.turn[:] = 0
        if not self.kernel.line.start_atoms:
            return
        self.start(sample)
        index, slope, counted = self._start
        count, n = int(counted[0]), self.kernel.pattern.carried
        columns = index[:count].astype(np.int64)
        first = np.zeros((n, self.width))
        # several entries may have one column
        np.add.at(first.T, columns, slope[:count])
        # all cells of a delay begin with the first value, and so with its slopes
        self.sensitivities[: sum(self.latencies)] = np.repeat(first, self.latencies, axis=0)
        if add_start:
            used = np.unique(columns)
            # G += 1/2 S' Q S and g += S' L at the first sample, over the few columns that reach a first value
            part = first[:, used]
            self.matrix[np.ix_(used, used)] += 0.5 * part.T @ self.q @ part
            self.gradient[used] += part.T @ self.l


def stores_blocks(kernel: Kernel) -> bool:
    """Return True if the Gauss-Newton matrix is stored in blocks: if it is large, and no state couples all values."""
    return kernel.values.free > LARGE and not kernel.pattern.carried


class BatchMemory:
    """Memory of `sample_sums` for samples with up to `room` entries."""

    def __init__(self, room: int, columns: int, outputs: int) -> None:
        self.width = batch_width(room) if room else 0
        self._number = np.full(columns if room else 0, -1, dtype=np.int32)
        self._columns = np.zeros(self.width, dtype=np.int32)
        self._rows, self._weighted = (aligned_zeros(BATCH * outputs * self.width) for _ in range(2))
        numbers = (address(self._number, kind=INT32), address(self._columns, kind=INT32))
        self.pointers = (*numbers, address(self._rows), address(self._weighted), self.width)


def _round_to_vectors(columns: int) -> int:
    return -(-columns // VECTOR) * VECTOR


def _aligned_zeros(rows: int, columns: int, stride: int) -> Float:
    """Return a matrix of zeros whose rows start on vectors if `stride` does, padded by one vector."""
    # vectors at the end of the last row reach beyond it
    return aligned_zeros(rows * stride + VECTOR)[: rows * stride].reshape(rows, stride)[:, :columns]


def _entry_addresses(index: NDArray[np.int32], slope: Float, count: NDArray[np.int32]) -> tuple[int, int, int]:
    return address(index, kind=INT32), address(slope), address(count, kind=INT32)
