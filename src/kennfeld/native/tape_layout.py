"""What a tape of linearised steps holds of the slopes between states, and where it stands."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from kennfeld.graph.derivative import Linearization

__all__ = ["MANY", "TapeLayout"]

TERMS = 4  # factors of S that are added at once: more no longer fit the registers
MANY = 8  # states beyond which loops over them are faster than code for each


@dataclass(frozen=True)
class TapeLayout:
    """Sizes of a tape and where its matrices can differ from zero.

    `copies` are pairs of states, of which the first takes over what the second was: their rows of `a` need no tape.
    Up to `MANY` states, there are none, and `a` is held whole; beyond, only those of its cells that can differ from
    zero are held, in the order of their flat indices.
    """

    outputs: int
    latencies: tuple[int, ...]  # of the carried states
    c: frozenset[int]  # flat indices into c[outputs][carried]
    a: frozenset[int]  # flat indices into a[carried][carried]
    copies: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, line: Linearization) -> "TapeLayout":
        """The pattern of a step."""
        m, n = len(line.outputs), len(line.seeds)
        number = {seed: i for i, seed in enumerate(line.seeds)}
        nexts = [number.get(line.states[i].next) for i in line.carried] if n > MANY else []
        copies = tuple((row, source) for row, source in enumerate(nexts) if source is not None)
        present = [[number[leaf] for leaf in row if leaf in number] for row in line.slopes.reach]
        c, a = (
            frozenset(row * n + i for row, columns in enumerate(rows) for i in columns)
            for rows in (present[:m], present[m:])
        )
        return cls(m, tuple(line.states[i].latency for i in line.carried), c, a, copies)

    @property
    def carried(self) -> int:
        """How many states carry the influence of a free value."""
        return len(self.latencies)

    @property
    def batch(self) -> int:
        """Samples in a row with the same columns that are added at once: as many as registers hold the factors of."""
        return max(1, TERMS // max(self.carried, 1))

    @property
    def accumulates(self) -> bool:
        """Whether the backward and forward sweeps exist: a delay's memory is too long for Q."""
        return 0 < self.carried <= MANY and set(self.latencies) == {1}

    @cached_property
    def kept(self) -> tuple[int, ...]:
        """The states whose slopes a tape holds."""
        copied = {row for row, _ in self.copies}
        return tuple(i for i in range(self.carried) if i not in copied)

    @property
    def rows(self) -> int:
        """The rows of slopes that a tape holds: of the outputs, then of the kept states."""
        return self.outputs + len(self.kept)

    @cached_property
    def seen(self) -> tuple[tuple[int, ...], ...]:
        """The states that each output sees."""
        return _columns(self.c, range(self.outputs), self.carried)

    @cached_property
    def sources(self) -> tuple[tuple[int, ...], ...]:
        """The states that the next value of each kept state sees."""
        return _columns(self.a, self.kept, self.carried)

    @property
    def cells(self) -> int:
        """The doubles of a sample's `a` on a tape."""
        return self.carried**2 if self.carried <= MANY else sum(map(len, self.sources))

    @cached_property
    def places(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """For each row of a tape the states that it sees, and where their slopes stand in a sample's `c` or `a`."""
        n = self.carried
        seen = (tuple((i, row * n + i) for i in columns) for row, columns in enumerate(self.seen))
        if n <= MANY:
            return (*seen, *(tuple((i, row * n + i) for i in self.sources[row]) for row in range(n)))
        held, begun = [], 0
        for columns in self.sources:
            held.append(tuple((i, begun + at) for at, i in enumerate(columns)))
            begun += len(columns)
        return (*seen, *held)


def _columns(flat: Collection[int], rows: Collection[int], count: int) -> tuple[tuple[int, ...], ...]:
    """The columns of flat indices in some rows of `count`, rising."""
    found: dict[int, list[int]] = {row: [] for row in rows}
    for index in sorted(flat):
        if index // count in found:
            found[index // count].append(index % count)
    return tuple(map(tuple, found.values()))
