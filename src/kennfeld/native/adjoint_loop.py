"""Execution of an `AdjointProgram` in compiled code, several rows at a time, each in one lane of a vector.

For each product of the program, adjoint[onto][row] += adjoint[of][row] * factor. The loop does not depend on the model:
it reads tables of (of, onto, factor) and, for each sample, the values of the factors. It is compiled once per number of
lanes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import accumulate, count

from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.native.elementwise import c_function
from kennfeld.native.engine import SharedFunction
from kennfeld.native.ir import FunctionWriter, literal

ZERO = literal(0.0)

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


def _pull(lanes: int) -> FunctionWriter:
    """Write `pull(...)`: all rows of one sample, `lanes` at a time; the last block overlaps the previous one."""
    f = FunctionWriter("pull", PARAMETERS)
    v = _Vectors(f, lanes)
    blocks = f.new(f"sdiv i64 {f.add('%rows', lanes - 1)}, {lanes}")
    last = f.add("%rows", -lanes)
    with f.loop(0, blocks) as block:
        row = f.new(f"call i64 @llvm.smin.i64(i64 {f.mul(block, lanes)}, i64 {last})")
        _sweep(f, v, row, v.product)
        with f.when(_wild(f, v)):
            _sweep(f, v, row, v.guarded_product)
        _fill_entries(f, v, row)
        _fill_matrices(f, v, row)
    return f


def _sweep(f: FunctionWriter, v: "_Vectors", row: str, product: Callable[[str, str], str]) -> None:
    """Write the adjoints of the rows from `row` on."""
    f.do(f"call void @llvm.memset.p0.i64(ptr %adjoints, i8 0, i64 {f.mul('%slots', 8 * v.lanes)}, i1 false)")
    for lane in range(v.lanes):
        own = f.add(row, lane)
        f.store(f.load("%seeds", own), "%adjoints", f.add(_index(f, "%roots", own), lane))
    with f.loop(0, "%pull_count") as pull:
        first = f.mul(pull, 3)
        of, onto, factor = (_index(f, "%pulls", f.add(first, i)) for i in range(3))
        passed = product(v.load("%adjoints", of), f.load("%factors", factor))
        v.store(v.sum(v.load("%adjoints", onto), passed), "%adjoints", onto)


def _wild(f: FunctionWriter, v: "_Vectors") -> str:
    """Return the condition that a slope is not finite: zeros may then have met infinity, and a guarded sweep
    follows.
    """
    total = f.slot(v.kind)
    f.do(f"store {v.kind} zeroinitializer, ptr {total}")
    with f.loop(0, "%leaf_count") as leaf:
        adjoint = v.load("%adjoints", _index(f, "%leaves", leaf))
        nothing = f.new(f"fmul {v.kind} {adjoint}, zeroinitializer")
        v.store(v.sum(v.load(total, "0"), nothing), total, "0")
    result = ZERO
    for lane in range(v.lanes):
        result = f.new(f"fadd double {result}, {v.lane(v.load(total, '0'), lane)}")
    return f.new(f"fcmp uno double {result}, {result}")


def _index(f: FunctionWriter, table: str, at: str) -> str:
    return f.new(f"sext i32 {f.load(table, at, 'i32')} to i64")


def _fill_entries(f: FunctionWriter, v: "_Vectors", row: str) -> None:
    """Write the slopes of entries."""
    with f.loop(0, "%entries") as entry:
        adjoint = v.load("%adjoints", _index(f, "%sources", entry))
        place = f.add(f.new(f"mul i64 {entry}, %rows"), row)
        v.store(v.guarded_product(adjoint, f.load("%weights", entry)), "%slope", place)


def _fill_matrices(f: FunctionWriter, v: "_Vectors", row: str) -> None:
    """Write the slopes with respect to states, of the rows from `row` on."""
    for lane in range(v.lanes):
        own = f.add(row, lane)
        matrix = f.new(f"select i1 {f.new(f'icmp slt i64 {own}, %outputs')}, ptr %c, ptr %a")
        with f.loop(_index(f, "%ends", own), _index(f, "%ends", f.add(own, 1))) as cell:
            first = f.mul(cell, 2)
            of, place = _index(f, "%cells", first), _index(f, "%cells", f.add(first, 1))
            f.store(f.load("%adjoints", f.add(of, lane)), matrix, place)


class _Vectors:
    """Instructions on vectors of doubles."""

    def __init__(self, f: FunctionWriter, lanes: int) -> None:
        self.f, self.lanes, self.kind = f, lanes, f"<{lanes} x double>"

    def load(self, pointer: str, index: str) -> str:
        return self.f.new(f"load {self.kind}, ptr {self.f.at(pointer, index)}, align 8")

    def store(self, value: str, pointer: str, index: str) -> None:
        self.f.do(f"store {self.kind} {value}, ptr {self.f.at(pointer, index)}, align 8")

    def sum(self, a: str, b: str) -> str:
        return self.f.new(f"fadd contract {self.kind} {a}, {b}")

    def lane(self, vector: str, number: int) -> str:
        return self.f.new(f"extractelement {self.kind} {vector}, i64 {number}")

    def spread(self, number: str) -> str:
        """Return a vector with a number in all lanes."""
        first = self.f.new(f"insertelement {self.kind} poison, double {number}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.f.new(f"shufflevector {self.kind} {first}, {self.kind} poison, {zeros}")

    def product(self, vector: str, number: str) -> str:
        """Return the product with a number."""
        return self.f.new(f"fmul contract {self.kind} {vector}, {self.spread(number)}")

    def guarded_product(self, vector: str, number: str) -> str:
        """Return the product with a number; 0 if either factor is 0, whatever the other."""
        f, factors = self.f, (vector, self.spread(number))
        some = [f.new(f"fcmp une {self.kind} {factor}, zeroinitializer") for factor in factors]
        both = f.new(f"and <{self.lanes} x i1> {', '.join(some)}")
        product = f.new(f"fmul contract {self.kind} {', '.join(factors)}")
        return f.new(f"select <{self.lanes} x i1> {both}, {self.kind} {product}, {self.kind} zeroinitializer")


def _shared(lanes: int) -> SharedFunction:
    return SharedFunction("pull", lambda: _pull(lanes).text())


PULL = {lanes: _shared(lanes) for lanes in (1, 2, 4)}  # by lanes; more would no longer fit the nearest cache


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
        self._lanes = max(lanes for lanes in PULL if lanes <= max(self.rows, 1))
        leaves = sorted({leaf for row in back.reach for leaf in row})
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
        return "".join(_table(f"{self.name}_{message}", numbers) for message, numbers in self._tables.items())

    def memory(self, f: FunctionWriter) -> dict[str, str]:
        """Allocate memory for a run of a native function, by the names of the loop's parameters; release it
        by `free`.
        """
        sizes = {
            "adjoints": self._slots * self._lanes,
            "factors": len(self.factors),
            "seeds": self.rows,
            "weights": self._entries,
            "sources": (self._entries + 1) // 2,
        }
        room = f.new(f"call ptr {_c('malloc')}(i64 {8 * sum(sizes.values()) + CACHE_LINE})")
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
        tables = {message: f"@{self.name}_{message}" for message in self._tables}
        values: dict[str, str | int] = {**sizes, **tables, **memory, **places}
        arguments = ", ".join(f"{kind} {values[name]}" for kind, name in PARAMETERS)
        f.do(f"call void {PULL[self._lanes]}({arguments})")

    def free(self, f: FunctionWriter, memory: Mapping[str, str]) -> None:
        f.do(f"call void {_c('free')}(ptr {memory['room']})")


def _numbered(nodes: Iterable[int]) -> dict[int, int]:
    return dict(zip(dict.fromkeys(nodes), count(), strict=False))


def _table(name: str, numbers: Sequence[int]) -> str:
    held = ", ".join(f"i32 {number}" for number in numbers)
    return f"@{name} = internal constant [{len(numbers)} x i32] [{held}]\n"


def _c(name: str) -> str:
    return f"inttoptr (i64 {c_function(name)} to ptr)"
