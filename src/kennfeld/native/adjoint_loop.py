"""Execution of an `AdjointProgram` in compiled code, several rows at a time, each in one lane of a vector.

For each product of the program, adjoint[onto][row] += adjoint[of][row] * factor. The loop does not depend on the model:
it reads tables of (of, onto, factor) and, for each sample, the values of the factors. It is compiled once per number of
lanes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import accumulate, count

from kennfeld.base.machine_code.engine import shared_function
from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter, Vector, integer_table
from kennfeld.graph.adjoints import AdjointProgram

PARAMETERS = (
    ("i64", "rows"),
    ("ptr", "roots"),  # i32[rows], the node at which the adjoint of a row starts
    ("ptr", "seeds"),  # double[rows], and with what
    ("i64", "pull_count"),
    ("ptr", "pulls"),  # i32[pulls][3]: of, onto, factor
    ("ptr", "factors"),  # double[factors]
    ("i64", "slots"),
    ("ptr", "adjoints"),  # double[slots][lanes]; tables count in doubles from its beginning
    ("i64", "leaf_count"),
    ("ptr", "leaves"),  # i32[leaves], the adjoints that are slopes
    ("i64", "entries"),
    ("ptr", "sources"),  # i32[entries], whose adjoint each is to be multiplied with
    ("ptr", "weights"),  # double[entries], and with what
    ("ptr", "slope"),  # double[entries][rows]
    ("ptr", "ends"),  # i32[rows + 1], 0 and the end of each row's cells
    ("ptr", "cells"),  # i32[cells][2]: the adjoint of a state, and its place in the matrix
    ("i64", "outputs"),
    ("ptr", "c"),  # slopes of the first rows with respect to states
    ("ptr", "a"),  # those of the others
)

FILLED = tuple(("ptr", name) for name in ("factors", "seeds", "weights", "sources"))  # by the code of a sample
CACHE_LINE = 64  # bytes
LANES = (1, 2, 4)  # more would no longer fit the nearest cache


def _pull(lanes: int) -> FunctionWriter:
    """Write `pull(...)`: all rows of one sample, `lanes` at a time; the last block overlaps the previous one.

    A sweep multiplies without care for zeros. If a slope is not finite, a zero may have met infinity: another sweep
    follows, in which a product with zero is zero.
    """
    f = FunctionWriter("pull", PARAMETERS)
    v = Vector(f, lanes)
    blocks = f.new(f"sdiv i64 {f.add('%rows', lanes - 1)}, {lanes}")
    last = f.add("%rows", -lanes)
    with f.loop(0, blocks) as block:
        # the last block begins earlier rather than having fewer lanes; rows that it shares are computed twice
        row = f.extreme("smin", f.mul(block, lanes), last)
        _sweep(f, v, row, v.multiply)
        with f.when(_is_not_finite(f, v)):
            _sweep(f, v, row, partial(_guarded_product, v))
        with f.loop(0, "%entries") as entry:
            # the slope at an entry is the adjoint of its atom times its weight in it
            adjoint = v.load("%adjoints", f.load_index("%sources", entry))
            place = f.add(f.mul(entry, "%rows"), row)
            v.store(_guarded_product(v, adjoint, f.load("%weights", entry)), "%slope", place)
        _fill_matrices(f, v, row)
    return f


def _sweep(f: FunctionWriter, v: Vector, row: str, product: Callable[[str, str], str]) -> None:
    """Write the adjoints of the rows from `row` on: adjoint[onto] += adjoint[of] * factor for each product in turn."""
    f.do(f"call void @llvm.memset.p0.i64(ptr %adjoints, i8 0, i64 {f.mul('%slots', 8 * v.lanes)}, i1 false)")
    for lane in range(v.lanes):
        own = f.add(row, lane)
        f.store(f.load("%seeds", own), "%adjoints", f.add(f.load_index("%roots", own), lane))
    with f.loop(0, "%pull_count") as pull:
        first = f.mul(pull, 3)
        of, onto, factor = (f.load_index("%pulls", f.add(first, i)) for i in range(3))
        passed = product(v.load("%adjoints", of), f.load("%factors", factor))
        v.store(v("fadd", v.load("%adjoints", onto), passed), "%adjoints", onto)


def _guarded_product(v: Vector, vector: str, number: str) -> str:
    """Return the product of a vector with a number; 0 if either factor is 0, whatever the other."""
    f, factors = v.f, (vector, v.splat(number))
    some = [f.new(f"fcmp une {v.kind} {factor}, zeroinitializer") for factor in factors]
    both = f.new(f"and <{v.lanes} x i1> {', '.join(some)}")
    return v.where(both, v("fmul", *factors), "zeroinitializer")


def _is_not_finite(f: FunctionWriter, v: Vector) -> str:
    """Return the condition that a slope is not finite."""
    total = f.variable(v.kind, "zeroinitializer")
    with f.loop(0, "%leaf_count") as leaf:
        adjoint = v.load("%adjoints", f.load_index("%leaves", leaf))
        # 0 for finite slopes, else NaN, which stays in the sum: one comparison for all leaves and lanes
        nothing = f.new(f"fmul {v.kind} {adjoint}, zeroinitializer")
        total.set(v("fadd", total.get(), nothing))
    result = ZERO
    for lane in range(v.lanes):
        result = f.new(f"fadd double {result}, {v.lane(total.get(), lane)}")
    return f.new(f"fcmp uno double {result}, {result}")


def _fill_matrices(f: FunctionWriter, v: Vector, row: str) -> None:
    """Write the slopes with respect to states, of the rows from `row` on."""
    for lane in range(v.lanes):
        own = f.add(row, lane)
        matrix = f.new(f"select i1 {f.new(f'icmp slt i64 {own}, %outputs')}, ptr %c, ptr %a")
        # the adjoints of one lane only: each row has cells of its own
        with f.loop(f.load_index("%ends", own), f.load_index("%ends", f.add(own, 1))) as cell:
            first = f.mul(cell, 2)
            of, place = f.load_index("%cells", first), f.load_index("%cells", f.add(first, 1))
            f.store(f.load("%adjoints", f.add(of, lane)), matrix, place)


class PullProgram:
    """Tables and memory of an adjoint program for a native function `name`.

    `source` maps an atom to the index of its adjoint, `scales` to the factor applied to it; `factors` numbers the nodes
    whose values the code has to provide. `cells` holds for each row the nodes whose slopes go into a matrix, with their
    places there; `entries` is the maximum number of entries per sample.
    """

    def __init__(
        self, name: str, back: AdjointProgram, cells: Sequence[Sequence[tuple[int, int]]], entries: int
    ) -> None:
        self.name = name
        self.rows = len(back.roots)
        self.scales = back.scales
        self.factors = _numbered(pull.factor for pull in back.pulls)
        self._entries = entries
        # no more lanes than rows, since the last block reaches back
        self._lanes = max(lanes for lanes in LANES if lanes <= max(self.rows, 1))
        leaves = sorted({leaf for row in back.reach for leaf in row})
        # nodes with an adjoint; factors have none
        slots = _numbered([*back.roots, *leaves, *(node for pull in back.pulls for node in pull[:2])])
        self._slots = len(slots)
        self.source = {node: self._lanes * slot for node, slot in slots.items()}
        self._tables = {
            "roots": [self.source[root] for root in back.roots],
            "pulls": [i for p in back.pulls for i in (self.source[p.of], self.source[p.onto], self.factors[p.factor])],
            "leaves": [self.source[leaf] for leaf in leaves],
            "ends": [0, *accumulate(map(len, cells))],
            "cells": [i for row in cells for node, place in row for i in (self.source[node], place)],
        }

    def tables(self) -> str:
        """Return the tables as constants of the module."""
        return "".join(integer_table(f"{self.name}_{table}", numbers) for table, numbers in self._tables.items())

    def memory(self, f: FunctionWriter) -> dict[str, str]:
        """Allocate memory for a run of a native function, by the names of the loop's parameters; see `free`."""
        sizes = {
            "adjoints": self._slots * self._lanes,
            "factors": len(self.factors),
            "seeds": self.rows,
            "weights": self._entries,
            # in doubles, of which each holds two i32
            "sources": (self._entries + 1) // 2,
        }
        # all arrays in one block, of which the first begins with a cache line
        room = f.new(f"call ptr {c_pointer(f, 'malloc')}(i64 {8 * sum(sizes.values()) + CACHE_LINE})")
        whole = f.new(f"add i64 {f.new(f'ptrtoint ptr {room} to i64')}, {CACHE_LINE - 1}")
        at = f.new(f"inttoptr i64 {f.new(f'and i64 {whole}, {-CACHE_LINE}')} to ptr")
        places = {"room": room}
        for name, size in sizes.items():
            places[name] = at
            at = f.at(at, size)
        return places

    def run(self, f: FunctionWriter, memory: Mapping[str, str], **places: str | int) -> None:
        """Run all rows for one sample; `places` are the loop's `entries`, `slope`, `outputs`, `c` and `a`."""
        sizes = {
            "rows": self.rows,
            "pull_count": len(self._tables["pulls"]) // 3,
            "slots": self._slots,
            "leaf_count": len(self._tables["leaves"]),
        }
        tables = {table: f"@{self.name}_{table}" for table in self._tables}
        values: dict[str, str | int] = {**sizes, **tables, **memory, **places}
        arguments = ", ".join(f"{kind} {values[name]}" for kind, name in PARAMETERS)
        f.do(f"call void {shared_function(_pull, self._lanes).pointer(f)}({arguments})")

    def free(self, f: FunctionWriter, memory: Mapping[str, str]) -> None:
        f.do(f"call void {c_pointer(f, 'free')}(ptr {memory['room']})")


def _numbered(nodes: Iterable[int]) -> dict[int, int]:
    return dict(zip(dict.fromkeys(nodes), count(), strict=False))
