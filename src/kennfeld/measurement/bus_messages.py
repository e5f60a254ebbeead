"""Messages of a bus and their signals, as a database describes them."""

from typing import NamedTuple

from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass


class MultiplexCondition(NamedTuple):
    """The condition of a multiplexed signal: another signal has one of these raw values, both ends included."""

    signal: str
    spans: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class BusSignal:
    """A signal of a message.

    Attributes:
        name: its name, unique in the message.
        start: first bit as the file counts: the least significant one, of big-endian signals the most significant one.
        length: bits.
        big_endian: byte order of Motorola.
        kind: `u` unsigned, `i` signed, `f` floating-point.
        factor: physical value = raw * factor + offset.
        offset: in the unit.
        unit: physical unit.
        comment: description.
        texts: raw values with a name.
        switches: all of them have to be true if the signal is present.
        short_name: another name by which it may be requested, if the file has a longer one, too.
    """

    name: str
    start: int
    length: int
    big_endian: bool = False
    kind: str = "u"
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    comment: str = ""
    texts: tuple[tuple[int, str], ...] = ()
    switches: tuple[MultiplexCondition, ...] = ()
    short_name: str = ""

    @property
    def first(self) -> int:
        """First bit in the order of its bytes; for big-endian signals, bit 0 is the highest one of byte 0."""
        # files number the bits of a byte from its lowest, here they count from its highest
        return self.start ^ 7 if self.big_endian else self.start

    @property
    def bytes(self) -> int:
        """Number of bytes that a frame needs to contain the signal."""
        return (self.first + self.length + 7) // 8

    @property
    def is_scaled(self) -> bool:
        """True if physical and raw values differ."""
        return (self.factor, self.offset) != (1.0, 0.0)


@dataclass(frozen=True)
class BusMessage:
    """A message with its signals; `line` is that of its statement."""

    name: str
    identifier: int
    extended: bool
    size: int
    is_j1939: bool = False
    line: int = 0
    signals: tuple[BusSignal, ...] = ()


@dataclass(frozen=True, eq=False)
class BusDatabase:
    """The messages of a file, each identifier once."""

    file: str
    messages: tuple[BusMessage, ...]
    findings: tuple[Finding, ...] = ()


def bits_of(signal: BusSignal) -> int:
    """Return the bits of a signal in its message as a mask, from the highest bit of the first byte on."""
    if signal.big_endian:
        places = range(signal.first, signal.first + signal.length)
        return sum(1 << place for place in places)
    return sum(1 << (place ^ 7) for place in range(signal.start, signal.start + signal.length))
