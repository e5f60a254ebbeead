"""Frames of a bus as columns, and those of each identifier."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.bus_bits import words_of
from kennfeld.measurement.bus_databases import Network

# a key: identifier in bits 0 to 28, format (11 or 29 bits) in bit 31, bus from bit 32 on
_EXTENDED = 31  # bit of a key
_BUS = 32  # first bit
# bytes of a frame by its length code (DLC)
_BYTES_OF_CODE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], dtype=np.uint8)


class Sender(NamedTuple):
    """The frames with one identifier on one bus."""

    network: Network
    bus: int  # channel, from 1 on; 0 if the log does not say
    identifier: int
    extended: bool

    @property
    def text(self) -> str:
        """The identifier as tools show it.

        >>> Sender("CAN", 1, 0x0CF00400, True).text, Sender("CAN", 1, 0x1F, False).text
        ('0x0CF00400', '0x01F')
        """
        return f"0x{self.identifier:0{8 if self.extended else 3}X}"

    @property
    def bus_text(self) -> str:
        """The bus in names: `CAN1`."""
        return f"{self.network}{self.bus or ''}"

    @property
    def source_address(self) -> int:
        """Source address of J1939."""
        return self.identifier & 0xFF

    @property
    def group_number(self) -> int:
        """Parameter group number (PGN) of J1939; of frames to one receiver without its address."""
        return group_number(self.identifier)


def group_number(identifier: int) -> int:
    """Return the parameter group number (PGN) of an identifier of J1939.

    >>> hex(group_number(0x0CF00400)), hex(group_number(0x18EAFF00))
    ('0xf004', '0xea00')
    """
    # J1939-21: priority in bits 26 to 28, group in 8 to 25, source in 0 to 7; if the second byte is below 240 (PDU1),
    # the low byte of the group is the address of the receiver
    number = identifier >> 8 & 0x3FFFF
    return number if identifier >> 16 & 0xFF >= 240 else number & 0x3FF00


@dataclass(frozen=True, eq=False)
class Frames:
    """Data frames in the order of the log.

    Attributes:
        network: kind of bus.
        time: Float[frames], s.
        keys: Int[frames], bus, format and identifier in one number.
        lengths: UInt8[frames], bytes of the payload.
        payload: UInt8[frames, bytes], with zeros up to a whole number of 64-bit words.
    """

    network: Network
    time: Float
    keys: NDArray[np.uint64]
    lengths: NDArray[np.uint8]
    payload: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        network: Network,
        time: Float,
        bus: NDArray[np.integer],
        identifier: NDArray[np.integer],
        extended: Bool,
        lengths: NDArray[np.integer],
        payload: NDArray[np.uint8],
    ) -> "Frames":
        """Return frames from their columns, [frames] each, and the payload, UInt8[frames, bytes].

        The time is in s; lengths beyond the payload are those of the payload.
        """
        keys = identifier.astype(np.uint64) & np.uint64((1 << 29) - 1)
        keys |= extended.astype(np.uint64) << np.uint64(_EXTENDED)
        keys |= bus.astype(np.uint64) << np.uint64(_BUS)
        own = np.minimum(lengths, payload.shape[1]).astype(np.uint8)
        return cls(network, time, keys, own, words_of(payload))

    def __len__(self) -> int:
        return len(self.time)

    def select(self, rows: Bool) -> "Frames":
        """Return the frames of a mask, Bool[frames]."""
        if rows.all():
            return self
        return Frames(self.network, self.time[rows], self.keys[rows], self.lengths[rows], self.payload[rows])

    def senders(self) -> Iterator[tuple[Sender, Int]]:
        """Yield each sender with its frames, Int[frames of it], in the order of the identifiers."""
        if not len(self):
            return
        keys = np.unique(self.keys)
        codes = np.searchsorted(keys, self.keys).astype(np.uint16 if len(keys) < 1 << 16 else np.uint32)
        order = np.argsort(codes, kind="stable")  # of 16 bits by counting
        ends = np.cumsum(np.bincount(codes, minlength=len(keys)))
        for key, begin, end in zip(keys.tolist(), [0, *ends[:-1]], ends, strict=True):
            identifier, extended = key & ((1 << 29) - 1), bool(key >> _EXTENDED & 1)
            yield Sender(self.network, key >> _BUS, identifier, extended), order[begin:end]


def bytes_of_codes(codes: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Convert length codes (DLC) of frames, [frames], to bytes, UInt8[frames]: 9 stands for 12, 15 for 64."""
    sizes: NDArray[np.uint8] = _BYTES_OF_CODE[np.clip(codes, 0, 15).astype(np.intp)]
    return sizes


def from_rows(
    network: Network,
    time: Float,
    buses: NDArray[np.integer],
    identifiers: NDArray[np.integer],
    extended: NDArray[np.integer],
    sizes: NDArray[np.uint8],
    content: bytes | bytearray,
) -> Frames:
    """Return frames from their columns, [frames] each, whose payloads follow each other in `content`; time in s."""
    width = int(sizes.max(initial=0))
    payload = np.zeros((sizes.size, max(-(-width // 8) * 8, 8)), dtype=np.uint8)
    # a mask is filled row by row, the order in which the payloads follow each other
    payload[np.arange(payload.shape[1]) < sizes[:, np.newaxis]] = np.frombuffer(content, dtype=np.uint8)
    return Frames.of(network, time, buses, identifiers, extended.astype(bool), sizes, payload)


def joined(parts: Sequence[Frames]) -> Frames:
    """Return the frames of one network from several parts, in the order of their time."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.payload.shape[1] for part in parts)
    payload = np.zeros((sum(map(len, parts)), width), dtype=np.uint8)
    end = 0
    for part in parts:
        payload[end : end + len(part), : part.payload.shape[1]] = part.payload
        end += len(part)
    time = np.concatenate([part.time for part in parts])
    # stable, so that frames of one stamp keep the order of the log
    order = np.argsort(time, kind="stable")
    keys, lengths = (np.concatenate([getattr(part, name) for part in parts]) for name in ("keys", "lengths"))
    return Frames(parts[0].network, time[order], keys[order], lengths[order], payload[order])
