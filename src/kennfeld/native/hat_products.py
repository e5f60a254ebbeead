"""Products of the rows of a tape with hat functions of channels times factors, for models without memory.

A candidate column b is a hat function h of a channel c times a factor f, such as the slope of the output by a node. At
a sample only two hats of a channel are not 0, 1 - a and a, so that with the entries j of the sample

    jb += W j b,    bb += W b b,    br += W r b

touch few numbers, all factors at once in vectors. The products of the two hats are the only ones of different columns.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, aligned_zeros
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import LANES, ONE, ZERO, FunctionWriter, Vector
from kennfeld.native.addresses import INT32, address
from kennfeld.native.samples import Chunk
from kennfeld.native.workspace import Workspace

MAX_FACTORS = 4 * LANES  # whose vectors fit into registers beside the sums
SAMPLE = tuple(("ptr", name) for name in ("weight", "residual", "factors", "cells", "shares", "blocks"))
SUMS = (("ptr", "wanted"), ("ptr", "jb"), ("ptr", "squares"), ("ptr", "neighbours"), ("ptr", "br"))


class HatProducts:
    """The sums of one output over samples.

    Attributes:
        jb: Float[values, hats, factors]; 0 for values that are not wanted.
        squares: b with itself, Float[blocks, hats, factors].
        neighbours: b with that of the next hat, Float[blocks, hats, factors].
        br: Float[blocks, hats, factors].
    """

    def __init__(self, wanted: Bool, hats: int, factors: int, blocks: int) -> None:
        self._wanted, values = wanted.astype(np.int32), wanted.size
        # one hat more, as the second hat of a channel with a single one has the weight 0
        self._hats, self._factors, self._width = hats, factors, -(-factors // LANES) * LANES
        sizes = (values, blocks, blocks, blocks)
        self._arrays = [aligned_zeros(size * (hats + 1) * self._width) for size in sizes]
        shapes = [(size, hats + 1, self._width) for size in sizes]
        views = [array.reshape(shape) for array, shape in zip(self._arrays, shapes, strict=True)]
        jb, squares, neighbours, br = (view[:, :hats, :factors] for view in views)
        self.jb, self.squares, self.neighbours, self.br = jb, squares, neighbours, br

    def add(
        self,
        space: Workspace,
        chunk: Chunk,
        output: int,
        factors: Float,
        cells: NDArray[np.int32],
        shares: Float,
        blocks: NDArray[np.int32],
    ) -> None:
        """Add the samples of a tape.

        Args:
            space: holds the tape of the chunk.
            chunk: the samples.
            output: number of the output.
            factors: Float[samples, factors].
            cells: number of the first hat of each channel, Int[samples, channels].
            shares: weight of the hat after it, Float[samples, channels].
            blocks: number of the block of each sample, Int[samples].
        """
        length = chunk.length
        padded = np.zeros((length, self._width))
        padded[:, : self._factors] = factors
        weight = np.ascontiguousarray(space.weight[:length, output])
        residual = np.ascontiguousarray(space.residual[:length, output])
        outputs, room = space.slope.shape[2], space.index.shape[1]
        entries = (address(space.index, kind=INT32), address(space.slope), address(space.count, kind=INT32), room)
        sample = (address(weight), address(residual), address(padded), address(cells, kind=INT32), address(shares))
        sums = (address(self._wanted, kind=INT32), *(address(array) for array in self._arrays))
        _products(self._width // LANES)(
            length,
            *entries,
            outputs,
            output,
            *sample,
            address(blocks, kind=INT32),
            cells.shape[1],
            *sums,
            self._hats + 1,
        )

    def merge(self, other: "HatProducts") -> None:
        """Add the sums over other samples."""
        for own, later in zip(self._arrays, other._arrays, strict=True):
            own += later


@cache
def _products(vectors: int) -> NativeFunction:
    entries = (("ptr", "index"), ("ptr", "slope"), ("ptr", "count"), ("i64", "room"))
    sizes = (("i64", "rows"), ("i64", "output"))
    head = [("i64", "length"), *entries, *sizes, *SAMPLE, ("i64", "channels"), *SUMS, ("i64", "hats")]
    f = FunctionWriter("hat_products", head)
    with f.loop(0, "%length") as k:
        weight = f.load("%weight", k)
        scored = f.new(f"fcmp one double {weight}, {ZERO}")
        with f.when(scored):
            _add_sample(f, k, weight, vectors)
    return compile_functions(f, loops=True)["hat_products"]


def _add_sample(f: FunctionWriter, k: str, weight: str, vectors: int) -> None:
    v = Vector(f)
    width = vectors * LANES
    start = f.mul(k, width)
    factors = [v.load("%factors", f.add(start, i * LANES)) for i in range(vectors)]
    places = f.mul(k, "%channels")
    pull = f.fmul(weight, f.load("%residual", k))
    block = f.mul(f.load_index("%blocks", k), "%hats")
    with f.loop(0, "%channels") as c:
        cell, first, second = _hats(f, f.add(places, c))
        _accumulate(f, v, "%br", f.add(block, cell), width, factors, (f.fmul(pull, first), f.fmul(pull, second)))
        both = f.fmul(weight, f.fmul(first, second))
        ones, twos = f.fmul(weight, f.fmul(first, first)), f.fmul(weight, f.fmul(second, second))
        squares = [v("fmul", factor, factor) for factor in factors]
        _accumulate(f, v, "%squares", f.add(block, cell), width, squares, (ones, twos))
        _accumulate(f, v, "%neighbours", f.add(block, cell), width, squares, (both,))
    row = f.mul(k, "%room")
    with f.loop(0, f.load_index("%count", k)) as e:
        place = f.add(row, e)
        value = f.load_index("%index", place)
        wanted = f.new(f"icmp ne i32 {f.load('%wanted', value, 'i32')}, 0")
        slope = f.load("%slope", f.add(f.mul(place, "%rows"), "%output"))
        scaled = f.fmul(weight, slope)
        column = f.mul(value, "%hats")
        with f.when(wanted), f.loop(0, "%channels") as c:
            cell, first, second = _hats(f, f.add(places, c))
            sides = (f.fmul(scaled, first), f.fmul(scaled, second))
            _accumulate(f, v, "%jb", f.add(column, cell), width, factors, sides)


def _hats(f: FunctionWriter, place: str) -> tuple[str, str, str]:
    """Return the number of the first hat, its weight and that of the next one."""
    share = f.load("%shares", place)
    return f.load_index("%cells", place), f.new(f"fsub double {ONE}, {share}"), share


def _accumulate(
    f: FunctionWriter, v: Vector, array: str, row: str, width: int, vectors: list[str], sides: tuple[str, ...]
) -> None:
    """Add multiples of the vectors to a row and to those that follow."""
    base = f.at(array, f.mul(row, width))
    for number, side in enumerate(sides):
        splat = v.splat(side)
        for i, vector in enumerate(vectors):
            at = number * width + i * LANES
            v.store(v("fadd", v.load(base, at), v("fmul", splat, vector)), base, at)
