"""Sums over the partitions of the data, added in their order."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage
from kennfeld.native.kernel import Kernel
from kennfeld.native.samples import Samples
from kennfeld.native.symmetric import SymmetricMatrix
from kennfeld.optimize.sums.sums import NormalEquations, Sums, TapeVisitor


class _Compiled(Protocol):
    """The compiled problem over one partition."""

    kernel: Kernel

    @property
    def samples(self) -> Samples: ...
    @property
    def sums(self) -> Sums: ...


Each = Callable[..., Iterator[Any]]


class NormalSum(NamedTuple):
    """Half the gradient J'Wr and the Gauss-Newton matrix J'WJ; see `NormalEquations`."""

    gradient: Float  # Float[free]
    matrix: SymmetricMatrix  # [free, free]


class PackedBlocks(NamedTuple):
    """The blocks of a large matrix, see `BlockStorage`."""

    places: Int  # Int[blocks]
    blocks: Float  # Float[blocks, entries]


class PackedNormal(NamedTuple):
    """The same of one partition; of a matrix that is an array, the upper triangle alone, row by row."""

    gradient: Float  # Float[free]
    matrix: Float | PackedBlocks  # Float[free * (free + 1) / 2]


def pack(normal: NormalEquations) -> PackedNormal:
    """Return a copy of normal equations as they are sent."""
    matrix = normal.matrix
    if isinstance(matrix, BlockMatrix):
        storage, count = matrix.storage, matrix.storage.count
        blocks = PackedBlocks(storage.places[:count].copy(), storage.blocks[:count].copy())
        return PackedNormal(normal.gradient.copy(), blocks)
    # half of a symmetric matrix is sent
    rows = [row[at:] for at, row in enumerate(matrix)]
    return PackedNormal(normal.gradient.copy(), np.concatenate(rows) if rows else np.zeros(0))


def add_packed(parts: Iterator[PackedNormal]) -> NormalSum:
    """Add the normal equations of partitions in order."""
    total = NormalAddition(next(parts))
    for part in parts:
        total.add(part)
    return total.result()


class NormalAddition:
    """Adds normal equations one after the other, beginning with a first one."""

    def __init__(self, first: PackedNormal) -> None:
        self._gradient = first.gradient.copy()
        in_blocks = isinstance(first.matrix, PackedBlocks)
        self._add, self._matrix = (_add_blocks if in_blocks else _add_triangles)(first)

    def add(self, part: PackedNormal) -> None:
        """Add the normal equations of another partition."""
        self._gradient += part.gradient
        self._add(part)

    def result(self) -> NormalSum:
        """Return the sum."""
        return NormalSum(self._gradient, self._matrix())


Addition = tuple[Callable[[PackedNormal], None], Callable[[], SymmetricMatrix]]  # adds a part; returns the sum


def _add_triangles(first: PackedNormal) -> Addition:
    size, total = first.gradient.size, np.array(first.matrix)

    def add(part: PackedNormal) -> None:
        # in the order of the partitions, so that the sum is the same bit for bit whoever computes it
        np.add(total, part.matrix, out=total)

    def result() -> Float:
        matrix, end = np.empty((size, size)), 0
        for at in range(size):
            begin, end = end, end + size - at
            matrix[at, at:] = matrix[at:, at] = total[begin:end]
        return matrix

    return add, result


def _add_blocks(first: PackedNormal) -> Addition:
    storage = BlockStorage(first.gradient.size)

    def add(part: PackedNormal) -> None:
        assert isinstance(part.matrix, PackedBlocks)
        storage.add_blocks(*part.matrix)

    def result() -> BlockMatrix:
        # as `Accumulator.normal` does
        if storage.mostly_used:
            storage.fill()
        return BlockMatrix(storage, np.arange(first.gradient.size))

    add(first)
    return add, result


class PartitionedSums:
    """The `Sums` of a problem whose data are in partitions.

    Args:
        each: yields the results of a function of the compiled problem of each partition, in order.
        axes: number of axes of the lowered graph.
        stateful: True if the model has states.
    """

    def __init__(self, each: Each, axes: int, *, stateful: bool) -> None:
        self._each, self.stateful = each, stateful
        self.widths = np.zeros(max(axes, 1))

    def prepare(self) -> None:
        """Do nothing: every process compiles what it calls."""

    def cost(self, values: Float) -> float:
        """Compute the sum of weighted losses at all values, Float[values]; not finite if an output is not."""
        return float(sum(self._each(partial_cost, self.widths, values)))

    def normal(self, values: Float) -> NormalSum:
        """Compute half the gradient, Float[free], and the Gauss-Newton matrix [free, free]."""
        return add_packed(self._each(partial_normal, self.widths, values))

    def residual(self, values: Float) -> Float:
        """Compute residuals, Float[visits * outputs], one partition after the other."""
        return np.concatenate([*self._each(partial_residual, self.widths, values)])

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[visits * outputs, free], one partition after the other."""
        residuals, jacobians = zip(*self._each(partial_rows, self.widths, values), strict=True)
        return np.concatenate(residuals), np.concatenate(jacobians)

    def rows_at(self, values: Float, visits: Int) -> Float:
        """Return the rows of the Jacobian at increasing visits as in `rows`, Float[visits, outputs, free]."""
        shapes = [*self._each(partial_shape)]
        outputs, free = shapes[0][1:]
        return self.rows(values)[1].reshape(-1, outputs, free)[visits]

    def squares(self, values: Float, groups: Int, count: int) -> Float:
        """Raise `ArgumentError`: groups of visits must be assigned within each partition."""
        raise ArgumentError("groups of samples must be assigned within each partition")

    def touched(self, values: Float, owners: Int | None = None) -> Int:
        """Count for each free value the scored samples whose step depends on it, Int[free].

        Raises:
            ArgumentError: there are owners, which a partition cannot tell from its own samples.
        """
        if owners is not None:
            raise ArgumentError("owners of samples must be assigned within each partition")
        return np.asarray(sum(self._each(partial_touched, self.widths, values)))

    def each_tape(self, values: Float, work: TapeVisitor) -> None:
        """Raise `ArgumentError`: a tape is read where it is written, within each partition."""
        raise ArgumentError("tapes are read within each partition")


def _at_widths(compiled: _Compiled, widths: Float) -> Sums:
    sums = compiled.sums
    # in place: the array is shared with what reads it
    sums.widths[:] = widths
    return sums


def partial_cost(compiled: _Compiled, widths: Float, values: Float) -> float:
    """Return the cost of one partition."""
    return _at_widths(compiled, widths).cost(values)


def partial_normal(compiled: _Compiled, widths: Float, values: Float) -> PackedNormal:
    """Return the normal equations of one partition."""
    return pack(_at_widths(compiled, widths).normal(values))


def partial_residual(compiled: _Compiled, widths: Float, values: Float) -> Float:
    """Return residuals of one partition."""
    return _at_widths(compiled, widths).residual(values)


def partial_rows(compiled: _Compiled, widths: Float, values: Float) -> tuple[Float, Float]:
    """Return residuals and Jacobian of one partition."""
    return _at_widths(compiled, widths).rows(values)


def partial_shape(compiled: _Compiled) -> tuple[int, int, int]:
    """Return the numbers of visits, outputs and free values of one partition."""
    return compiled.samples.count, len(compiled.kernel.outputs), compiled.kernel.values.free


def partial_touched(compiled: _Compiled, widths: Float, values: Float) -> Int:
    """Count the samples of one partition that depend on each free value."""
    return _at_widths(compiled, widths).touched(values)
