"""Sums over all samples: cost, gradient and Gauss-Newton matrix, or residuals and Jacobian.

With residuals r[k] [outputs], weights W[k] [outputs] and the Jacobian J[k] [outputs, free] of sample k, the sums are
J'Wr [free] and J'WJ [free, free]. Without states, J[k] is sparse and goes straight into them. With carried states, J[k]
= C[k] S[k] + D[k] and S[k+1] = A[k] S[k] + B[k] for the sensitivities S [states, free]; the sums come either from a
backward and a forward sweep, or from blocks of rows of J (see `sweeps`).

The samples are cut into chunks, so that the tape of a chunk fits the cache and a call takes milliseconds, and dealt
into shares for threads. Shares and their order depend only on the problem, so results do not depend on the number of
threads.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby, pairwise

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import available_cores
from kennfeld.native.kernel import Kernel
from kennfeld.native.samples import Chunk, Samples, shares
from kennfeld.native.symmetric import SymmetricMatrix
from kennfeld.native.workspace import Workspace, stores_blocks

TAPE_BYTES = 512 * 1024  # of a chunk; of half of it, the calls take a tenth of the time
SHARES = 4
MIN_LENGTH = 64  # samples of a chunk
FEW = 512  # visits that one chunk has, as calls take longer than their work


@dataclass(frozen=True)
class Normal:
    """Half the gradient, J'Wr [free], and the Gauss-Newton matrix J'WJ [free, free] of the sum of losses.

    The arrays belong to the accumulator and are valid until its next call.
    """

    gradient: Float  # Float[free]
    matrix: SymmetricMatrix  # [free, free]


Run = list[Chunk]  # chunks that follow each other: a whole piece with states, any single chunk without


class Accumulator:
    """Cost and derivatives of a compiled kernel, summed over samples.

    Args:
        kernel: compiled functions of the model, the outputs and the free values.
        samples: inputs and targets.
        widths: standard deviations of the smoothing, one per axis of the lowered graph, in the unit of the axis.
        sparse: with states, True forces backward and forward sweeps, False rows in blocks; None selects the cheaper.

    Raises:
        ArgumentError: the samples do not match the kernel.
    """

    def __init__(
        self, kernel: Kernel, samples: Samples, widths: Float | None = None, *, sparse: bool | None = None
    ) -> None:
        needs = (("inputs", samples.inputs, kernel.layout.inputs), ("targets", samples.wanted, kernel.outputs))
        for name, table, needed in needs:  # the kernel would read beyond the rows of the samples
            if len(table.parts) != len(needed):
                raise ArgumentError(f"the kernel reads {len(needed)} rows of {name}, got {len(table.parts)}")
        self.kernel, self.samples = kernel, samples
        unsmoothed = np.zeros(max(len(kernel.layout.axes), 1))
        self.widths = unsmoothed if widths is None else np.array(widths, dtype=np.float64)
        self.stateful = bool(kernel.line.states)
        self.sparse = (kernel.accumulates or not kernel.pattern.carried) if sparse is None else sparse
        self.length = _chunk_length(kernel, self.sparse)
        if not self.stateful:  # a chunk for each share
            visits = sum(piece.last - piece.first for piece in samples.pieces)
            share = visits if visits <= FEW else -(-visits // SHARES)
            self.length = max(MIN_LENGTH, min(self.length, share))
        self.chunks = samples.chunks(self.length)
        weights = [samples.pieces[chunk.piece].scores for chunk in self.chunks]
        self._weights = np.array(weights).reshape(len(self.chunks), len(kernel.outputs))
        self._off = self._weights == 0
        self._shares = self._deal()
        self._workspaces = [Workspace(kernel, samples, self.widths, self.length) for _ in self._shares]
        self._memory = np.zeros((len(self.chunks), kernel.layout.memory))
        self._rings = np.zeros((len(self.chunks), len(kernel.layout.latencies)), dtype=np.int64)
        self._last: tuple[Float, Float] | None = None  # values and widths of the states kept at the chunks' starts
        threads = min(available_cores(), len(self._shares))
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def prepare(self) -> None:
        """Compile what `normal` calls, so that the first iteration does not wait for it."""
        with_states = ("backward", "forward") if self.sparse else ("rows",)
        without = ("block_normal",) if stores_blocks(self.kernel) else ("normal", "fold")
        for name in (*with_states, "fold") if self.kernel.pattern.carried else without:
            getattr(self.kernel.sweeps, name)

    def _deal(self) -> list[list[Run]]:
        runs: list[Run] = [[c] for c in self.chunks]
        if self.stateful:
            runs = [list(chunks) for _, chunks in groupby(self.chunks, key=lambda chunk: chunk.piece)]
        entries, columns = self.kernel.entries.room, self.kernel.values.free
        stored = columns if stores_blocks(self.kernel) else columns * columns
        # work of all samples over 20 times that of a matrix: each share clears, adds and keeps a matrix of its own
        useful = self.samples.count * (entries * entries + 100) // (20 * (stored + 1000))
        dealt = shares([sum(c.length for c in run) for run in runs], max(1, min(SHARES, useful)))
        return [[runs[i] for i in share] for share in dealt]

    def _each_share(self, work: Callable[[Workspace, list[Run]], None]) -> None:
        run = map if self._pool is None else self._pool.map
        list(run(work, self._workspaces, self._shares))

    def cost(self, values: Float) -> float:
        """Compute the sum of weighted losses at the values p [values]; not finite if the model output is not."""
        return float(sum(self.costs(values)))

    def costs(self, values: Float) -> Float:
        """Compute the sum of weighted losses of each output, shape (outputs,)."""
        values = np.ascontiguousarray(values, dtype=np.float64)
        sums = np.zeros((len(self.chunks), len(self.kernel.outputs)))

        def work(space: Workspace, runs: list[Run]) -> None:
            space.use(values)
            for run in runs:
                # the states at the start of each chunk are kept: derivatives resume from them
                space.start(run[0].first)
                for chunk in run:
                    self._memory[chunk.number] = space.memory
                    self._rings[chunk.number] = space.hints[: self._rings.shape[1]]
                    space.cost(chunk, sums[chunk.number])

        self._each_share(work)
        if self.stateful:
            self._last = values.copy(), self.widths.copy()
        # a weight of 0 switches an output off even where its sum is infinite or NaN
        total: Float = np.where(self._off, 0.0, self._weights * np.where(self._off, 0.0, sums)).sum(axis=0)
        return total

    def _visit_states(self, values: Float) -> tuple[Float, Workspace]:
        """Ensure that the states at the start of each chunk are those of these values; let a workspace use them."""
        values = np.ascontiguousarray(values, dtype=np.float64)
        if self.stateful and not self._knows_states(values):
            self.costs(values)
        space = self._workspaces[0]
        space.use(values)
        return values, space

    def _knows_states(self, values: Float) -> bool:
        last = self._last
        return last is not None and np.array_equal(values, last[0]) and np.array_equal(self.widths, last[1])

    def normal(self, values: Float) -> Normal:
        """Compute gradient and Gauss-Newton matrix at the values p [values]."""
        values, first = self._visit_states(values)

        def work(space: Workspace, runs: list[Run]) -> None:
            space.use(values)
            space.clear()
            for run in runs:
                self._sum_run(space, run)

        self._each_share(work)
        for space in self._workspaces[1:]:
            first.add(space)
        if first.storage is not None and first.storage.mostly_used:
            for space in self._workspaces:
                space.fill()
        return Normal(first.gradient, first.fold())

    def _sum_run(self, space: Workspace, run: Run) -> None:
        if not self.kernel.pattern.carried:
            for chunk in run:
                self._linearise(space, chunk)
                space.normal(chunk)
        elif self.sparse:
            self._sum_sweeps(space, run)
        else:
            for residual, jacobian in self._row_blocks(space, run):
                # half, as `fold` adds the transpose
                space.matrix += 0.5 * (jacobian.T @ jacobian)
                space.gradient += jacobian.T @ residual

    def _sum_sweeps(self, space: Workspace, run: Run) -> None:
        """Sweep backward over the chunks, keeping Q and L after each, then forward; see `sweeps`."""
        # Q and L of all samples would fill the memory: those between chunks are kept, each chunk is swept back twice
        kept: list[tuple[Float, Float]] = []
        space.q[:], space.l[:] = 0.0, 0.0
        for chunk in reversed(run):
            kept.append((space.q.copy(), space.l.copy()))
            self._linearise(space, chunk)
            space.backward(chunk)
        self._resume(space, run[0])
        space.begin_sensitivities(run[0].first, add_start=True)
        for chunk, (q, l) in zip(run, reversed(kept), strict=True):  # noqa: E741
            # of a single chunk, the tape and the sweep are still there
            if len(run) > 1:
                space.q[:], space.l[:] = q, l
                self._linearise(space, chunk)
                space.backward(chunk)
            space.forward(chunk)

    def _resume(self, space: Workspace, chunk: Chunk) -> None:
        space.memory[:] = self._memory[chunk.number]
        space.hints[: self._rings.shape[1]] = self._rings[chunk.number]

    def _linearise(self, space: Workspace, chunk: Chunk) -> None:
        self._resume(space, chunk)
        space.tape(chunk)

    def _row_blocks(self, space: Workspace, run: Run) -> Iterator[tuple[Float, Float]]:
        if not run:
            return
        space.begin_sensitivities(run[0].first, add_start=False)
        for chunk in run:
            self._linearise(space, chunk)
            yield space.rows(chunk)

    def each_tape(self, values: Float, work: Callable[[int, Workspace, Chunk, bool], None]) -> None:
        """Linearise all samples and call `work(share, workspace, chunk, begins)` for each chunk.

        The workspace holds the tape of the chunk. Shares run on threads, the chunks of a share in their order, with
        states those of a piece after each other; `begins` is true for the first of them, at which the states start.
        """
        values, _ = self._visit_states(values)

        def visit(item: tuple[int, Workspace, list[Run]]) -> None:
            share, space, runs = item
            space.use(values)
            for run in runs:
                for chunk in run:
                    self._linearise(space, chunk)
                    work(share, space, chunk, chunk is run[0])

        items = zip(range(len(self._shares)), self._workspaces, self._shares, strict=True)
        run = map if self._pool is None else self._pool.map
        list(run(visit, items))

    def residual(self, values: Float) -> Float:
        """Compute the residuals of `rows`, Float[samples * outputs], without their derivatives."""
        _, space = self._visit_states(values)
        m = len(self.kernel.outputs)
        residual = np.zeros(self.samples.count * m)
        for chunk in (chunk for share in self._shares for run in share for chunk in run):
            self._linearise(space, chunk)
            residual[chunk.first * m : chunk.last * m] = space.residuals(chunk)
        return residual

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, both multiplied by the square root of the weight, for all samples.

        Returns:
            Shapes (samples * outputs,) and (samples * outputs, free), in the order of the samples, with zeros for
            samples that are not scored.
        """
        _, space = self._visit_states(values)
        m = len(self.kernel.outputs)
        residual = np.zeros(self.samples.count * m)
        jacobian = np.zeros((self.samples.count * m, self.kernel.values.free))
        for run in (run for share in self._shares for run in share):
            for chunk, (r, j) in zip(run, self._row_blocks(space, run), strict=True):
                residual[chunk.first * m : chunk.last * m] = r
                jacobian[chunk.first * m : chunk.last * m] = j
        return residual, jacobian

    def rows_at(self, values: Float, visits: Int) -> Float:
        """Compute the rows of the Jacobian at increasing `visits` as in `rows`, shape (visits, outputs, free)."""
        _, space = self._visit_states(values)
        m = len(self.kernel.outputs)
        counts = np.zeros((visits.size, m, self.kernel.values.free))
        for run in (run for share in self._shares for run in share):
            first, last = np.searchsorted(visits, [run[0].first, run[-1].last])
            # S is carried from the start of the run, up to the last visit that is asked for
            needed = [chunk for chunk in run if last > first and chunk.first <= visits[last - 1]]
            for chunk, (_, jacobian) in zip(needed, self._row_blocks(space, needed), strict=True):
                at = np.arange(*np.searchsorted(visits, [chunk.first, chunk.last]))
                counts[at] = jacobian.reshape(chunk.length, m, -1)[visits[at] - chunk.first]
        return counts

    def squares(self, values: Float, groups: Int, count: int) -> Float:
        """Sum the squares of the rows of the Jacobian as in `rows` over groups of visits, shape (count, free).

        `groups` assigns each visit to a group from 0 to `count` - 1, or to none by -1.
        """
        values, _ = self._visit_states(values)
        totals = [np.zeros((count, self.kernel.values.free)) for _ in self._shares]
        own = {id(space): total for space, total in zip(self._workspaces, totals, strict=True)}

        def work(space: Workspace, runs: list[Run]) -> None:
            space.use(values)
            for run in runs:
                for chunk, (_, jacobian) in zip(run, self._row_blocks(space, run), strict=True):
                    _add_squares(jacobian, groups[chunk.first : chunk.last], own[id(space)])

        self._each_share(work)
        # in the order of the shares, so that the sum does not depend on the number of threads
        return np.asarray(np.sum(totals, axis=0))

    def touched(self, values: Float, owners: Int | None = None) -> Int:
        """Count for each free value the scored samples whose step depends on it, shape (free,).

        Without states only values on which a scored output depends count. `owners` assigns samples to scored samples,
        by non-decreasing numbers, -1 for none: a scored sample then counts once for all samples assigned to it.
        """
        values, space = self._visit_states(values)
        if owners is None:
            return self._count_touching(values)
        columns = self.kernel.values.free
        counts = np.zeros(columns, dtype=np.int64)
        before = np.zeros(0, dtype=np.int64)
        for chunk in self.chunks:
            self._linearise(space, chunk)
            met = space.met(chunk, owners[chunk.first : chunk.last])
            counts += np.bincount(np.setdiff1d(met, before, assume_unique=True) % columns, minlength=columns)
            both = np.union1d(before, met)
            # owners do not decrease: only the last one may go on in the next chunk, and its columns count once
            before = both[both // columns == both[-1] // columns] if met.size else before
        return counts

    def _count_touching(self, values: Float) -> Int:
        counts: list[Int] = []  # of each share, in any order

        def work(space: Workspace, runs: list[Run]) -> None:
            space.use(values)
            own = np.zeros(self.kernel.values.free, dtype=np.int64)
            latest = np.full_like(own, -1)
            for chunk in (chunk for run in runs for chunk in run):
                self._linearise(space, chunk)
                space.touched(chunk, latest, own)
            counts.append(own)

        self._each_share(work)
        return np.asarray(np.sum(counts, axis=0))


def _add_squares(jacobian: Float, groups: Int, total: Float) -> None:
    """Add the squares of rows, Float[visits * outputs, free], to the sums of their groups, Float[groups, free]."""
    if not groups.size:
        return
    outputs = len(jacobian) // groups.size
    if np.any(groups[1:] < groups[:-1]):
        order = np.argsort(groups, kind="stable")
        jacobian = jacobian.reshape(groups.size, outputs, -1)[order].reshape(jacobian.shape)
        groups = groups[order]
    edges = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), groups.size]
    for first, last in pairwise(edges):
        if groups[first] >= 0:
            block = jacobian[first * outputs : last * outputs]
            total[groups[first]] += np.einsum("ij,ij->j", block, block)


def _chunk_length(kernel: Kernel, sparse: bool) -> int:
    pattern, e = kernel.pattern, kernel.entries.room
    m, n, swept = pattern.outputs, pattern.carried, pattern.carried if pattern.accumulates else 0
    # bytes of a sample: residual and weight, C, A, Q and L, slopes; then columns and count as i32
    record = 8 * (2 * m + m * n + pattern.cells + swept * (swept + 1) + e * pattern.rows) + 4 * (e + 1)
    if not sparse:
        record += 8 * m * kernel.values.free
    return max(MIN_LENGTH, min(8192, TAPE_BYTES // record))
