"""A pull-back as part of a model's code: its tables, its memory, and the call of the loop that runs it."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate, count

from kennfeld.graph.pullback import PullBack
from kennfeld.native.ir import Function
from kennfeld.native.library import c_function
from kennfeld.native.pullback import PARAMETERS, PULL

__all__ = ["FILLED", "PullProgram"]

FILLED = tuple(("ptr", name) for name in ("factors", "seeds", "weights", "sources"))  # by the code of a sample
CACHE_LINE = 64  # bytes


class PullProgram:
    """The pull-back of a native function `name`.

    `source` tells where the adjoint of an atom lies, `scales` what it is multiplied with, `factors` numbers the nodes
    whose values the code has to provide.
    `cells` are for each row the nodes whose slopes go into a matrix, each with its place there, `entries` is the most
    entries that a sample can have.
    """

    def __init__(self, name: str, back: PullBack, cells: Sequence[Sequence[tuple[int, int]]], entries: int) -> None:
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
        """The tables as constants of the module."""
        return "".join(_table(f"{self.name}_{what}", numbers) for what, numbers in self._tables.items())

    def memory(self, f: Function) -> dict[str, str]:
        """Memory for the run of a native function, by the names of the loop's parameters; `free` gives it back."""
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

    def run(self, f: Function, memory: Mapping[str, str], **places: str | int) -> None:
        """Run all rows for one sample; `places` are the loop's `entries`, `slope`, `outputs`, `c` and `a`."""
        sizes = {
            "rows": self.rows,
            "pull_count": len(self._tables["pulls"]) // 3,
            "slots": self._slots,
            "leaf_count": len(self._tables["leaves"]),
        }
        tables = {what: f"@{self.name}_{what}" for what in self._tables}
        given: dict[str, str | int] = {**sizes, **tables, **memory, **places}
        arguments = ", ".join(f"{kind} {given[name]}" for kind, name in PARAMETERS)
        f.do(f"call void {PULL[self._lanes]}({arguments})")

    def free(self, f: Function, memory: Mapping[str, str]) -> None:
        """Give the memory back."""
        f.do(f"call void {_c('free')}(ptr {memory['room']})")


def _numbered(nodes: Iterable[int]) -> dict[int, int]:
    return dict(zip(dict.fromkeys(nodes), count(), strict=False))


def _table(name: str, numbers: Sequence[int]) -> str:
    held = ", ".join(f"i32 {number}" for number in numbers)
    return f"@{name} = internal constant [{len(numbers)} x i32] [{held}]\n"


def _c(name: str) -> str:
    return f"inttoptr (i64 {c_function(name)} to ptr)"
