"""Sums of the columns of a family over a share of the samples, which one thread goes through.

Without memory, the entries of a sample go straight into the sums. With memory, they come from sweeps over a few samples
at a time (`native.carried_sweeps`), and with many states from rows of all columns, which are carried through them.
"""

import numpy as np
from numpy.typing import NDArray

from kennfeld.analysis.missing.candidate_columns import CandidateColumns, block_runs
from kennfeld.analysis.missing.probes import is_probe
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.carried_products import CarriedProducts, has_carried_sweeps
from kennfeld.native.column_rows import ColumnRows
from kennfeld.native.hat_products import HatProducts
from kennfeld.native.samples import Chunk
from kennfeld.native.workspace import Workspace

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


class SparseShare:
    """The sums of one share without memory."""

    def __init__(self, samples: CandidateColumns) -> None:
        self._samples = samples
        family = samples.family
        # those of the probes themselves are not needed
        wanted = np.ones(samples.compiled.values.free, dtype=bool)
        wanted[[at for name, at in samples.compiled.values.offsets.items() if is_probe(name)]] = False
        sizes = (sum(family.hats), len(family.factors), samples.blocks + 1)
        self._products = HatProducts(wanted, *sizes)
        self._across = HatProducts(np.zeros_like(wanted), *sizes) if family.grid else None

    def add(self, space: Workspace, chunk: Chunk, begins: bool, scales: Float | None) -> None:
        samples = self._samples
        corners = samples.corners(chunk)
        blocks = np.ascontiguousarray(samples.block_of[chunk.first : chunk.last])
        slopes = samples.factors(space, chunk, scales)
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


class CarriedShare:
    """The sums of one share with memory."""

    def __init__(self, samples: CandidateColumns) -> None:
        self._samples = samples
        family, kernel = samples.family, samples.compiled.kernel
        others = [at for name, at in samples.compiled.values.offsets.items() if is_probe(name)]
        self._products = CarriedProducts(
            kernel,
            samples.probes,
            others,
            family.hats,
            samples.blocks + 1,
            corners=2 if family.grid else 1,
            scaled=bool(family.series),
        )

    def add(self, space: Workspace, chunk: Chunk, begins: bool, scales: Float | None) -> None:
        samples = self._samples
        corners = samples.corners(chunk)
        cells, shares, weights = (np.stack(arrays) for arrays in zip(*corners, strict=True))
        if begins:
            space.begin_sensitivities(chunk.first, add_start=False)
            places, sides = _hats_of(corners, samples.family.hats, 1)
            self._products.begin(_first_values(samples, space, chunk, places[0], sides[0]))
        blocks = samples.block_of[chunk.first : chunk.last]
        for first, last in block_runs(blocks):
            own = slice(first, last)
            self._products.add(
                space,
                first,
                last,
                int(blocks[first]),
                np.ascontiguousarray(cells[:, own]),
                np.ascontiguousarray(shares[:, own]),
                np.ascontiguousarray(weights[:, own]) if samples.family.grid else None,
                None if scales is None else scales[own],
            )

    def sums(self) -> FamilySums:
        products = self._products
        squares = [products.squares(at) for at in range(len(self._samples.family.factors))]
        return FamilySums(products.jb, squares, products.br)


def _hats_of(
    corners: list[tuple[NDArray[np.int32], Float, Float]], hats: tuple[int, ...], count: int
) -> tuple[NDArray[np.int32], Float]:
    """Return the hats that are not 0 at the first samples, and their weights; [samples, hats] each."""
    places: list[NDArray[np.int32]] = []
    sides: list[Float] = []
    for cells, shares, weight in corners:
        places.append(cells[:count])
        sides.append((1 - shares[:count]) * weight[:count, None])
        if hats != (1,):
            places.append(cells[:count] + np.int32(1))
            sides.append(shares[:count] * weight[:count, None])
    return np.concatenate(places, axis=1), np.concatenate(sides, axis=1)


def _first_values(
    samples: CandidateColumns, space: Workspace, chunk: Chunk, places: NDArray[np.int32], sides: Float
) -> Float:
    """Return the slopes of the first values of the states, which may depend on nodes; Float[carried, hats, factors]."""
    family, starts = samples.family, space.start_slopes(chunk.first)
    first = np.zeros((space.kernel.pattern.carried, sum(family.hats), len(family.factors)))
    for at, probe in enumerate(samples.probes):
        slope = starts.get(probe)
        # series are 0 there: a lag or a delay starts with the value itself
        if slope is None or family.series:
            continue
        for place, side in zip(places, sides, strict=True):
            first[:, place, at] += side * slope
    return first


class RowShare:
    """The sums of one share with memory, from rows of all columns."""

    def __init__(self, samples: CandidateColumns) -> None:
        self._samples = samples
        family, kernel = samples.family, samples.compiled.kernel
        self._factors, self._hats = len(family.factors), family.hats
        self._columns = sum(self._hats) * self._factors
        self._rows = ColumnRows(kernel, self._columns)
        self._jb = np.zeros((samples.compiled.values.free, self._columns))
        self._br = np.zeros((samples.blocks + 1, self._columns))
        self._squares = [np.zeros((samples.blocks + 1, self._factors, hats, hats)) for hats in self._hats]

    def add(self, space: Workspace, chunk: Chunk, begins: bool, scales: Float | None) -> None:
        samples = self._samples
        places, sides = _hats_of(samples.corners(chunk), self._hats, chunk.length)
        slopes = samples.factors(space, chunk, scales)
        if begins:
            space.begin_sensitivities(chunk.first, add_start=False)
            starts = _first_values(samples, space, chunk, places[0], sides[0])
            self._rows.begin(starts.reshape(len(starts), self._columns))
        residual, jacobian = space.rows(chunk)
        residual, outputs = np.nan_to_num(residual), space.weight.shape[1]
        for first in range(0, chunk.length, ROWS):
            part = slice(first, min(first + ROWS, chunk.length))
            index, slope = self._entries(places[part], sides[part], slopes[part])
            rows = self._rows.over(space, first, index, slope)
            own = slice(part.start * outputs, part.stop * outputs)
            self._jb += jacobian[own].T @ rows
            self._add_products(np.repeat(samples.block_of[chunk.first :][part], outputs), residual[own], rows)

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


CandidateShare = SparseShare | CarriedShare | RowShare


def share_of(samples: CandidateColumns) -> CandidateShare:
    """Return the empty sums of a share."""
    kernel = samples.compiled.kernel
    if not kernel.pattern.carried:
        return SparseShare(samples)
    return CarriedShare(samples) if has_carried_sweeps(kernel) else RowShare(samples)
