"""Sums over the samples of what scores need: products of the columns of candidates with J, with r and with themselves.

Without memory, the entries of a sample go straight into the sums (`native.hat_products`). With memory, the rows of the
columns are carried through the states, block by block of samples. In both cases memory does not grow with the samples.
"""

from collections.abc import Iterable, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from kennfeld.analysis.missing.families import Family, HatPlaces, with_series
from kennfeld.analysis.missing.probes import is_probe
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.native.column_rows import ColumnRows
from kennfeld.native.hat_products import HatProducts
from kennfeld.native.losses import LOSS_RULES
from kennfeld.native.samples import Chunk
from kennfeld.native.workspace import Workspace
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import NEVER, Divisions, number_samples
from kennfeld.preprocessing.binding import BoundDataset, bind_inputs

ROWS = 512  # samples whose rows of columns are in memory at once


@dataclass
class FamilySums:
    """The sums of a family, whose columns are those of its axes, hat by hat, with all factors for each hat.

    Attributes:
        jb: J'WB, Float[values, columns].
        squares: B'WB of each candidate, by factor and axis, Float[blocks + 1, hats, hats].
        br: B'Wr by block, the last row for samples in none; Float[blocks + 1, columns].
    """

    jb: Float
    squares: list[list[Float]]
    br: Float

    def merge(self, later: "FamilySums") -> None:
        """Add the sums over other samples."""
        self.jb += later.jb
        self.br += later.br
        for own, others in zip(self.squares, later.squares, strict=True):
            for matrix, other in zip(own, others, strict=True):
                matrix += other


@dataclass
class BlockSums:
    """The sums of the function itself by block, the last one of samples in none.

    Attributes:
        jr: J'Wr, Float[blocks + 1, values].
        cost: r'Wr, Float[blocks + 1].
        counts: scored residuals, Float[blocks + 1].
        weights: sum of W / scale^2; robust losses take some away from outliers.
        slopes: sum of the slopes of the influence, over scale^2: what an effect that is added to all residuals has;
            those of the square are the weights.
        influence: sums of w psi^2, w psi / r and w over all samples, with the weights w of the samples.
    """

    jr: Float
    cost: Float
    counts: Float
    weights: float = 0.0
    slopes: float = 0.0
    influence: Float = field(default_factory=lambda: np.zeros(3))

    @property
    def spread(self) -> float:
        """The sum of the squares of independent residuals as they act on a gain: r'Wr for squares.

        Of a robust loss, outliers add what their influence psi is, not what they cost.
        """
        squares, ratios, weights = self.influence
        return float(squares * weights / ratios) if ratios > 0 else 0.0

    @property
    def mean_effect(self) -> float:
        """The root mean square of an effect at the outputs that lowers the cost by 1."""
        return float(np.sqrt(self.weights)) / self.slopes if self.slopes > 0 else float("inf")

    def merge(self, later: "BlockSums") -> None:
        """Add the sums over other samples."""
        self.jr += later.jr
        self.cost += later.cost
        self.counts += later.counts
        self.weights += later.weights
        self.slopes += later.slopes
        self.influence = self.influence + later.influence


def family_sums(
    compiled: CompiledProblem, family: Family, full: Float, divisions: Divisions, blocks: int
) -> FamilySums:
    """Return the sums of a family.

    Args:
        compiled: the problem with probes.
        family: the candidates.
        full: the free and the fixed values, Float[values].
        divisions: of the recordings into blocks.
        blocks: number of blocks.
    """
    total = FamilySums(*_empty(compiled, family, blocks))
    with blas_threads(0):
        for share in _visit(compiled, family, full, divisions, blocks):
            total.merge(share.sums())
    return total


def _empty(compiled: CompiledProblem, family: Family, blocks: int) -> tuple[Float, list[list[Float]], Float]:
    columns = sum(family.hats) * len(family.factors)
    squares = [[np.zeros((blocks + 1, hats, hats)) for hats in family.hats] for _ in family.factors]
    return np.zeros((compiled.values.free, columns)), squares, np.zeros((blocks + 1, columns))


def block_sums(compiled: CompiledProblem, full: Float, divisions: Divisions, blocks: int) -> BlockSums:
    """Return the sums of the function itself; see `family_sums`."""
    numbers = _block_numbers(compiled, divisions, blocks)
    free, scales = compiled.values.free, np.array([output.scale for output in compiled.kernel.outputs])
    parts: dict[int, BlockSums] = {}

    def visit(share: int, space: Workspace, chunk: Chunk, begins: bool) -> None:
        part = parts.setdefault(
            share, BlockSums(np.zeros((blocks + 1, free)), np.zeros(blocks + 1), np.zeros(blocks + 1))
        )
        own = numbers[chunk.first : chunk.last]
        weight = space.weight[: chunk.length]
        residual = np.where(weight != 0, space.residual[: chunk.length], 0.0)
        part.cost += np.bincount(own, (weight * residual**2).sum(axis=1), minlength=blocks + 1)
        ratios, slopes = _influences(compiled, residual)
        plain = np.where(ratios > 0, weight / np.where(ratios > 0, ratios, 1.0), 0.0)
        part.weights += float((weight / scales**2).sum())
        part.slopes += float((plain * slopes / scales**2).sum())
        part.influence += np.array([(weight * ratios * residual**2).sum(), weight.sum(), plain.sum()])
        part.counts += np.bincount(own, (weight != 0).sum(axis=1), minlength=blocks + 1)
        if compiled.stateful and space.kernel.pattern.carried:
            if begins:
                space.begin_sensitivities(chunk.first, add_start=False)
            rooted, rows = space.rows(chunk)
            pulled = np.nan_to_num(rooted)[:, None] * rows
            places = np.repeat(own, weight.shape[1])
            for block in np.unique(places):
                part.jr[block] += pulled[places == block].sum(axis=0)
            return
        pull = np.einsum("ko,keo->ke", weight * residual, space.slope[: chunk.length, :, : weight.shape[1]])
        used = np.arange(space.index.shape[1]) < space.count[: chunk.length, None]
        flat = own[:, None] * free + space.index[: chunk.length]
        part.jr += np.bincount(flat[used], pull[used], minlength=(blocks + 1) * free).reshape(blocks + 1, free)

    compiled.sums.each_tape(full, visit)
    total = BlockSums(np.zeros((blocks + 1, free)), np.zeros(blocks + 1), np.zeros(blocks + 1))
    for share in sorted(parts):
        total.merge(parts[share])
    return total


def _influences(compiled: CompiledProblem, residual: Float) -> tuple[Float, Float]:
    """Return psi / r and psi' of scaled residuals, Float[samples, outputs] each; both are 1 for the square."""
    ratios, slopes = np.ones(residual.shape), np.ones(residual.shape)
    for at, output in enumerate(compiled.kernel.outputs):
        if output.loss != "square":
            ratios[:, at], slopes[:, at] = LOSS_RULES[output.loss].influence(residual[:, at], output.delta)
    return ratios, slopes


def _block_numbers(compiled: CompiledProblem, divisions: Divisions, blocks: int) -> NDArray[np.int32]:
    """Return the block of each visit; `blocks` for those in none."""
    if not divisions:
        return np.full(compiled.samples.count, blocks, dtype=np.int32)
    numbers = number_samples(compiled, divisions)[compiled.sample_numbers()]
    return np.where(numbers == NEVER, blocks, numbers).astype(np.int32)


def _visit(
    compiled: CompiledProblem, family: Family, full: Float, divisions: Divisions, blocks: int
) -> list["_SparseShare | _CarriedShare"]:
    samples = _Samples.of(compiled, family, full, divisions, blocks)
    shares: dict[int, _SparseShare | _CarriedShare] = {}
    make = _CarriedShare if compiled.kernel.pattern.carried else _SparseShare

    def visit(share: int, space: Workspace, chunk: Chunk, begins: bool) -> None:
        if share not in shares:
            shares[share] = make(samples)
        shares[share].add(space, chunk, begins)

    compiled.sums.each_tape(full, visit)
    # added in the order of the shares, whichever thread came first
    return [shares[share] for share in sorted(shares)]


@dataclass
class _Samples:
    """The columns of a family at the samples, by visit."""

    compiled: CompiledProblem
    family: Family
    blocks: int
    block_of: NDArray[np.int32]
    numbers: Int  # of the sample at each visit
    places: HatPlaces
    channels: dict[str, Float]  # by sample
    series: Float | None  # Float[factors, samples]
    probes: list[int]  # columns of the kernel

    @classmethod
    def of(
        cls, compiled: CompiledProblem, family: Family, full: Float, divisions: Divisions, blocks: int
    ) -> "_Samples":
        places = HatPlaces(family.axes)
        channels = {name: _channel(compiled, name) for name in places.channels}
        series = _series(compiled, family, full) if family.series else None
        probes = [compiled.values.offsets[name] for name in family.factors]
        numbers = compiled.sample_numbers()
        block_of = _block_numbers(compiled, divisions, blocks)
        return cls(compiled, family, blocks, block_of, numbers, places, channels, series, probes)

    def factors(self, space: Workspace, chunk: Chunk) -> Float:
        """Return the slopes of outputs, then of states, Float[samples, rows, factors]."""
        slopes = np.zeros((chunk.length, space.slope.shape[2], len(self.probes)))
        fixed = self.compiled.kernel.entries.fixed
        for at, column in enumerate(self.probes):
            if fixed:
                for place in np.flatnonzero(space.index[0] == column).tolist():
                    slopes[:, :, at] += space.slope[: chunk.length, place]
                continue
            used = np.arange(space.index.shape[1]) < space.count[: chunk.length, None]
            sample, entry = np.nonzero((space.index[: chunk.length] == column) & used)
            np.add.at(slopes[:, :, at], sample, space.slope[sample, entry])
        if self.series is not None:
            slopes *= self.series[:, self.numbers[chunk.first : chunk.last]].T[:, None, :]
        return slopes

    def corners(self, chunk: Chunk) -> list[tuple[NDArray[np.int32], Float, Float]]:
        """Return cells and shares of hats, and the weight of each sample; of maps for both rows of a cell."""
        family = self.family
        cells, shares = self.places.locate(self.channels, self.numbers[chunk.first : chunk.last])
        if not family.grid:
            return [(cells, shares, np.ones(chunk.length))]
        rows, width = (len(axis.points) for axis in family.axes)
        first = np.ascontiguousarray(cells[:, :1] * width + cells[:, 1:] - rows)
        across, along = shares[:, 0], np.ascontiguousarray(shares[:, 1:])
        second = first + np.int32(width)
        return [(first, along, 1 - across), (second, along, across)]


def _channel(compiled: CompiledProblem, name: str) -> Float:
    """Return a channel at all samples, the last known value of the recording in its gaps, Float[samples]."""
    return np.concatenate([bound.at_kept(_without_gaps(bound.dataset, name)) for bound in compiled.problem.gathered])


def _without_gaps(dataset: Dataset, name: str) -> Float:
    """Return a channel with the last known value of each piece in its gaps, at its start the first one."""
    values = dataset[name].values
    if np.isfinite(values).all():
        return values
    values = values.copy()
    for piece in dataset.pieces:
        own = values[piece]
        known = np.isfinite(own)
        latest = np.maximum.accumulate(np.where(known, np.arange(own.size), -1))
        values[piece] = own[np.maximum(latest, int(np.argmax(known)) if own.size else 0)]
    return values


def _series(compiled: CompiledProblem, family: Family, full: Float) -> Float:
    """Return the series of a family at all samples, Float[series, samples]."""
    problem = compiled.problem
    parameters = compiled.values.unpack(full, problem.parameters)
    # the probes are 0 and 1 there, so that the nodes are those of the function
    graph = with_series(problem.graph, family.series)
    simulator = NodeSimulator(graph, parameters, [each.name for each in family.series])
    parts = [_simulated(simulator, problem, bound, graph, parameters) for bound in problem.gathered]
    return np.concatenate(parts, axis=1)


def _simulated(
    simulator: NodeSimulator, problem: Problem, bound: BoundDataset, graph: Graph, parameters: ParameterSet
) -> Float:
    """Return series at the samples of a bound dataset, 0 where the function has no inputs; Float[series, samples]."""
    # bound again, as the function itself may have read no steps
    timed = bind_inputs(bound.dataset, graph, problem.channels, problem.model.step)
    values = simulator.values(timed, parameters)
    whole = np.zeros((len(values), bound.dataset.samples))
    whole[:, timed.kept] = np.nan_to_num(values)
    return whole if bound.picked is None else whole[:, bound.kept]


class _SparseShare:
    """The sums of one share without memory."""

    def __init__(self, samples: _Samples) -> None:
        self._samples = samples
        family = samples.family
        # those of the probes themselves are not needed
        wanted = np.ones(samples.compiled.values.free, dtype=bool)
        wanted[[at for name, at in samples.compiled.values.offsets.items() if is_probe(name)]] = False
        sizes = (sum(family.hats), len(family.factors), samples.blocks + 1)
        self._products = HatProducts(wanted, *sizes)
        self._across = HatProducts(np.zeros_like(wanted), *sizes) if family.grid else None

    def add(self, space: Workspace, chunk: Chunk, begins: bool) -> None:
        samples = self._samples
        corners = samples.corners(chunk)
        blocks = np.ascontiguousarray(samples.block_of[chunk.first : chunk.last])
        slopes = samples.factors(space, chunk)
        for output in range(space.weight.shape[1]):
            for cells, shares, weight in corners:
                factors = slopes[:, output] * weight[:, None]
                self._products.add(space, chunk, output, factors, cells, shares, blocks)
            if self._across is not None:
                (cells, shares, below), (_, _, above) = corners
                factors = slopes[:, output] * np.sqrt(below * above)[:, None]
                self._across.add(space, chunk, output, factors, cells, shares, blocks)

    def sums(self) -> FamilySums:
        products, family = self._products, self._samples.family
        squares, first = [[] for _ in family.factors], 0  # type: list[list[Float]], int
        for hats in family.hats:
            rows = slice(first, first + hats)
            first += hats
            for at, own in enumerate(squares):
                matrix = np.zeros((len(products.br), hats, hats))
                place = np.arange(hats)
                matrix[:, place, place] = products.squares[:, rows, at]
                between = products.neighbours[:, rows, at][:, :-1]
                matrix[:, place[:-1], place[1:]] = matrix[:, place[1:], place[:-1]] = between
                if self._across is not None:
                    _add_across(matrix, self._across, at, len(family.axes[1].points))
                own.append(matrix)
        free, blocks = len(products.jb), len(products.br)
        return FamilySums(products.jb.reshape(free, -1), squares, products.br.reshape(blocks, -1))


def _add_across(matrix: Float, across: HatProducts, at: int, width: int) -> None:
    """Add the products of the hats of neighbouring rows of a map, with one factor.

    Those of the samples of a cell (i, j) with a between the rows and b along them are a (1 - a) times (1 - b)^2, b^2
    and b (1 - b): the products of the hats j and j + 1 of one row, with a factor that is the root of a (1 - a).

    Args:
        matrix: Float[blocks, hats, hats].
        across: products with that factor, kept in the row i.
        at: number of the factor.
        width: hats of a row.
    """
    place = np.arange(matrix.shape[1] - width)
    squares, between = across.squares[:, place, at], across.neighbours[:, place[:-1], at]
    for below, above, product in (
        (place, place + width, squares),
        (place[:-1], place[:-1] + width + 1, between),
        (place[1:], place[:-1] + width, between),
    ):
        # of rows with two hats, the last pair lies where a row has its own products, and is 0
        matrix[:, below, above] += product
        matrix[:, above, below] += product


class _CarriedShare:
    """The sums of one share with memory."""

    def __init__(self, samples: _Samples) -> None:
        self._samples = samples
        family, kernel = samples.family, samples.compiled.kernel
        self._factors, self._hats = len(family.factors), family.hats
        self._columns = sum(self._hats) * self._factors
        self._rows = ColumnRows(kernel, self._columns)
        self._jb = np.zeros((samples.compiled.values.free, self._columns))
        self._br = np.zeros((samples.blocks + 1, self._columns))
        self._squares = [np.zeros((samples.blocks + 1, self._factors, hats, hats)) for hats in self._hats]

    def add(self, space: Workspace, chunk: Chunk, begins: bool) -> None:
        samples = self._samples
        places, sides = self._hats_of(samples.corners(chunk))
        slopes = samples.factors(space, chunk)
        if begins:
            self._begin(space, chunk, places[0], sides[0])
        residual, jacobian = space.rows(chunk)
        residual, outputs = np.nan_to_num(residual), space.weight.shape[1]
        for first in range(0, chunk.length, ROWS):
            part = slice(first, min(first + ROWS, chunk.length))
            index, slope = self._entries(places[part], sides[part], slopes[part])
            rows = self._rows.over(space, first, index, slope)
            own = slice(part.start * outputs, part.stop * outputs)
            self._jb += jacobian[own].T @ rows
            self._add_products(np.repeat(samples.block_of[chunk.first :][part], outputs), residual[own], rows)

    def _hats_of(self, corners: list[tuple[NDArray[np.int32], Float, Float]]) -> tuple[NDArray[np.int32], Float]:
        """Return the hats that are not 0 at each sample, and their weights; [samples, hats] each."""
        places: list[NDArray[np.int32]] = []
        sides: list[Float] = []
        for cells, shares, weight in corners:
            places.append(cells)
            sides.append((1 - shares) * weight[:, None])
            if self._hats != (1,):
                places.append(cells + np.int32(1))
                sides.append(shares * weight[:, None])
        return np.concatenate(places, axis=1), np.concatenate(sides, axis=1)

    def _begin(self, space: Workspace, chunk: Chunk, places: NDArray[np.int32], sides: Float) -> None:
        """Set the sensitivities at the start of a piece, whose first values may depend on the nodes."""
        samples = self._samples
        space.begin_sensitivities(chunk.first, add_start=False)
        starts = space.start_slopes(chunk.first)
        first = np.zeros((space.kernel.pattern.carried, self._columns))
        for at, probe in enumerate(samples.probes):
            slope = starts.get(probe)
            # series are 0 there: a lag or a delay starts with the value itself
            if slope is None or samples.series is not None:
                continue
            for place, side in zip(places, sides, strict=True):
                first[:, place * self._factors + at] += side * slope
        self._rows.begin(first)

    def _entries(self, places: NDArray[np.int32], sides: Float, slopes: Float) -> tuple[NDArray[np.int32], Float]:
        """Return columns and slopes of the entries of some samples, [samples, hats * factors] and [..., rows]."""
        index = places[..., None] * self._factors + np.arange(self._factors, dtype=np.int32)
        values = sides[..., None, None] * slopes.transpose(0, 2, 1)[:, None]
        count = len(places)
        shaped = np.ascontiguousarray(index.reshape(count, -1), dtype=np.int32)
        return shaped, np.ascontiguousarray(values.reshape(count, shaped.shape[1], -1))

    def _add_products(self, blocks: NDArray[np.int32], residual: Float, rows: Float) -> None:
        each = np.arange(self._factors)
        # blocks follow each other in time, so that there are few in one part
        for block in np.unique(blocks):
            here = slice(None) if (blocks == block).all() else blocks == block
            own, column = rows[here], 0
            self._br[block] += residual[here] @ own
            for total, hats in zip(self._squares, self._hats, strict=True):
                columns = own[:, column : column + hats * self._factors]
                column += hats * self._factors
                if self._samples.family.grid:
                    # a map has so many hats that the products of different factors would take most of the time
                    by_factor = np.ascontiguousarray(columns.reshape(len(own), hats, self._factors).transpose(2, 0, 1))
                    total[block] += by_factor.transpose(0, 2, 1) @ by_factor
                    continue
                product = (columns.T @ columns).reshape(hats, self._factors, hats, self._factors)
                total[block] += product[:, each, :, each]

    def sums(self) -> FamilySums:
        squares = [[np.ascontiguousarray(total[:, at]) for total in self._squares] for at in range(self._factors)]
        return FamilySums(self._jb, squares, self._br)


def merged(parts: Iterable[FamilySums]) -> FamilySums:
    """Return the sums of all partitions, added in their order."""
    first, *others = parts
    for other in others:
        first.merge(other)
    return first


def merged_blocks(parts: Sequence[BlockSums]) -> BlockSums:
    """Return the sums of all partitions, added in their order."""
    first, *others = parts
    for other in others:
        first.merge(other)
    return first
