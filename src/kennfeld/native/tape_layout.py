"""Layout of the slopes between states on a tape of linearised steps."""

from collections.abc import Collection
from functools import cached_property
from itertools import count

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.derivative import Linearization

MANY = 8  # states beyond which loops are faster than code for each, in which LLVM no longer sees the vectors


@dataclass(frozen=True)
class TapeLayout:
    """Sizes of a tape, and the structural non-zeros of its matrices.

    `copies` are pairs of states of which the first takes over the previous value of the second: their rows of `a` need
    no tape. Up to `MANY` states there are no copies, and `a` is stored in full; beyond, only its structural non-zeros
    are stored, in the order of their flat indices.
    """

    outputs: int
    latencies: tuple[int, ...]  # of the carried states
    c: frozenset[int]  # flat indices into c[outputs][carried]
    a: frozenset[int]  # flat indices into a[carried][carried]
    copies: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, line: Linearization) -> "TapeLayout":
        """Return the layout for a step."""
        m, n = len(line.outputs), len(line.seeds)
        number = {seed: i for i, seed in enumerate(line.seeds)}
        # a next value that is itself a state: one place of a shift register
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
        """Number of states that carry the influence of a free value."""
        return len(self.latencies)

    @property
    def accumulates(self) -> bool:
        """True if the backward and forward sweeps exist: a long delay has too much memory for Q."""
        return 0 < self.carried <= MANY and set(self.latencies) == {1}

    @cached_property
    def kept(self) -> tuple[int, ...]:
        """The states whose slopes the tape holds."""
        copied = {row for row, _ in self.copies}
        return tuple(i for i in range(self.carried) if i not in copied)

    @property
    def rows(self) -> int:
        """Number of rows of slopes on the tape: of the outputs, then of the kept states."""
        return self.outputs + len(self.kept)

    @cached_property
    def seen(self) -> tuple[tuple[int, ...], ...]:
        """The states on which each output depends."""
        return _columns(self.c, range(self.outputs), self.carried)

    @cached_property
    def sources(self) -> tuple[tuple[int, ...], ...]:
        """The states on which the next value of each kept state depends."""
        return _columns(self.a, self.kept, self.carried)

    @property
    def cells(self) -> int:
        """Number of doubles of a sample's `a` on the tape."""
        return self.carried**2 if self.carried <= MANY else sum(map(len, self.sources))

    @cached_property
    def places(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """For each row of the tape its states, and the index of their slopes in a sample's `c` or `a`."""
        n = self.carried
        seen = (tuple((i, row * n + i) for i in columns) for row, columns in enumerate(self.seen))
        if n <= MANY:
            kept = [tuple((i, row * n + i) for i in columns) for row, columns in enumerate(self.sources)]
        else:
            places = count()  # one after the other
            kept = [tuple(zip(columns, places, strict=False)) for columns in self.sources]
        return (*seen, *kept)


def _columns(flat: Collection[int], rows: Collection[int], count: int) -> tuple[tuple[int, ...], ...]:
    """Return the columns of flat indices in some rows of `count`, increasing."""
    result: dict[int, list[int]] = {row: [] for row in rows}
    for index in sorted(flat):
        if index // count in result:
            result[index // count].append(index % count)
    return tuple(map(tuple, result.values()))
