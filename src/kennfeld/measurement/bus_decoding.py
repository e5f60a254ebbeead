"""Decoding of bus frames by databases: one table for the signals of a message that are sent together.

A frame belongs to the message with its identifier; a message of J1939 has all identifiers with its parameter group
number (PGN), and each source address is a sender of its own. A multiplexed signal has the frames in which its
multiplexers have the values that the database states.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Int
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.bus_bits import extract_raw, to_numbers, to_physical
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.measurement.bus_frames import Frames, Sender, group_number
from kennfeld.measurement.bus_messages import BusDatabase, BusMessage, BusSignal, MultiplexCondition
from kennfeld.measurement.bus_texts import missing_texts, without_texts
from kennfeld.measurement.channel_names import TIME, unique_forms
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table

NO_DATABASE = (
    'Name its CAN database: dbc = ["engine.dbc"] in the [[dataset]] of the project, `kennfeld info --dbc engine.dbc`, '
    'or read(..., dbc=["engine.dbc"]) in Python; in the app, drop it on the page.'
)
_ANY_SOURCE = 0xFE  # source address of a message of J1939 that any control unit may send
_CLASSIC = 8  # bytes of a frame that is not CAN FD
_MAX_TEXTS = 12  # of values in a description
_MAX_LISTED = 6  # identifiers in a message


@dataclass(frozen=True, eq=False)
class RecordedMessage:
    """A message of the log: its description, its sender, and its frames by their numbers in `frames`."""

    message: BusMessage
    database: str
    sender: Sender
    frames: Frames
    rows: tuple[Int, ...]

    @property
    def sender_text(self) -> str:
        """The source address of J1939, else the identifier."""
        return f"0x{self.sender.source_address:02X}" if self.message.is_j1939 else self.sender.text

    @property
    def forms(self) -> tuple[str, ...]:
        """The names that may mean it, from short to certain."""
        name = self.message.name
        with_sender, bus = f"{name}@{self.sender_text}", self.sender.bus_text
        certain = f"{Path(self.database).stem}/{bus}/{with_sender}"
        return (name, with_sender, f"{bus}/{name}", f"{bus}/{with_sender}", certain)

    @cached_property
    def numbers(self) -> Int:
        """Int[frames of it], numbers of its frames in the order of the log."""
        return self.rows[0] if len(self.rows) == 1 else np.sort(np.concatenate(self.rows))


@dataclass(frozen=True)
class BusChannel:
    """A signal of a recorded message; see `NamedChannel`."""

    name: str
    forms: tuple[str, ...]
    place: int  # of its message
    signal: BusSignal
    is_array: bool = False

    def named(self, name: str) -> "BusChannel":
        """Return the channel under another name."""
        return replace(self, name=name)


class _Described(NamedTuple):
    """A message that a database describes."""

    database: str
    message: BusMessage


class BusLog:
    """The frames of a log with the databases that describe them.

    Args:
        source: the file, with its databases.
        frames: its frames, each network at most once.
        findings: what was noticed when they were read.
        may_be_empty: whether the databases may describe none of the frames.

    Raises:
        InputError: there is no database, or none of them describes a frame.
    """

    def __init__(
        self,
        source: MeasurementFile,
        frames: Sequence[Frames],
        findings: Iterable[Finding] = (),
        *,
        may_be_empty: bool = False,
    ) -> None:
        self._location, self._all = source.location, frames
        if not source.databases:
            raise InputError.of(source.location, f"this is a bus log: it holds {_content(frames)}", NO_DATABASE)
        self._databases = [(file, file.read()) for file in source.databases]
        self._findings = [*findings, *(finding for _, database in self._databases for finding in database.findings)]
        self._unknown: list[tuple[Sender, int]] = []
        self._segmented: dict[str, Sender] = {}
        self._texts: dict[str, str] = {}  # channels with samples that stand for a text, how many and which
        self.messages = self._match()
        if not self.messages and not may_be_empty:
            names = join_names([_restricted(file, database.file) for file, database in self._databases], 3)
            message = f"none of its identifiers is described by {names}; it holds {_content(frames)}"
            remedy = "Check the database, and its bus if one is stated."
            if self._segmented:
                message = f"{message}; {next(self._segmented_findings()).message}"
            raise InputError.of(source.location, message, remedy)

    def _match(self) -> list[RecordedMessage]:
        """Return the recorded messages; frames of one parameter group and source address are one of them."""
        recorded: dict[tuple[object, ...], RecordedMessage] = {}
        catalog = _Catalog(self._databases)
        for frames in self._all:
            for sender, rows in frames.senders():
                described = catalog.find(sender)
                if described is None:
                    self._unknown.append((sender, rows.size))
                    continue
                name, message = described
                # described with more than 8 bytes, recorded with at most 8: the frames belong to a transport protocol
                if message.size > _CLASSIC and frames.lengths[rows].max() <= _CLASSIC:
                    self._segmented.setdefault(message.name, sender)
                    continue
                # identifiers of J1939 that differ in their priority alone are one sender of one message
                address = sender.source_address if message.is_j1939 else sender.identifier
                key = (sender.network, sender.bus, address, sender.extended, name, message.identifier)
                known = recorded.get(key)
                recorded[key] = (
                    replace(known, rows=(*known.rows, rows))
                    if known
                    else RecordedMessage(message, name, sender, frames, (rows,))
                )
        self._findings += [*catalog.findings(self._location), *self._segmented_findings()]
        return list(recorded.values())

    def channels(self) -> list[BusChannel]:
        """Return the signals of all recorded messages, under their shortest names."""
        return [
            BusChannel(signal.name, _forms(message, signal), place, signal)
            for place, message in enumerate(self.messages)
            for signal in message.message.signals
        ]

    def _segmented_findings(self) -> Iterator[Finding]:
        """Yield a warning on messages that are sent in several frames (ISO-TP, J1939 transport, NMEA fast packets)."""
        if self._segmented:
            listed = [f"{name} ({sender.text})" for name, sender in self._segmented.items()]
            message = f"messages of more than {_CLASSIC} bytes in several frames are not decoded: {join_names(listed)}"
            yield Finding(self._location, message, "Decode them with another tool if needed.", severity="warning")

    def named_channels(self) -> list[BusChannel]:
        """Return the signals of all recorded messages, each with a name of its own."""
        channels = self.channels()
        names = unique_forms([channel.forms for channel in channels])
        return [channel.named(name) for channel, name in zip(channels, names, strict=True)]

    def explain(self, name: str) -> str:
        """Return why a signal that the databases describe is not there; nothing if none does."""
        for _, database in self._databases:
            for message in database.messages:
                if any(name in (signal.name, f"{message.name}.{signal.name}") for signal in message.signals):
                    text = Sender("CAN", 0, message.identifier, message.extended).text
                    return f"Its message {message.name} ({text} in {database.file}) was not recorded."
        return ""

    def tables(self, chosen: Sequence[BusChannel]) -> list[Table]:
        """Return a table for the signals of a message that are sent together; none if they are never sent."""
        tables: list[Table] = []
        for place in dict.fromkeys(channel.place for channel in chosen):
            own = [channel for channel in chosen if channel.place == place]
            tables += self._message_tables(self.messages[place], own)
        if not tables:
            names = [channel.name for channel in chosen]
            message = f"no frame holds {join_names(names)}: their multiplexers never have the values for it"
            raise InputError.of(self._location, message, "Name other signals.")
        return [replace(tables[0], findings=(*self._findings, *self._text_remarks())), *tables[1:]]

    def _text_remarks(self) -> Iterator[Finding]:
        """Yield a remark on samples that are missing because their raw values stand for a text."""
        if self._texts:
            listed = [f"{name} ({text})" for name, text in self._texts.items()]
            message = f"samples that stand for a text are missing values: {join_names(listed, _MAX_LISTED)}"
            yield Finding(self._location, message, severity="remark")

    def descriptions(self, channels: Sequence[BusChannel]) -> Iterator[TableDescription]:
        """Yield the descriptions of all tables, one message after the other; the first one has all remarks."""
        findings = [*self._findings, *self._undescribed()]
        count = Counter(channel.signal.name for channel in channels)
        for place in dict.fromkeys(channel.place for channel in channels):
            own = [channel for channel in channels if channel.place == place]
            for table in self._message_tables(self.messages[place], own):
                signals = [channel.signal.name for channel in own if channel.name in table.names]
                described = describe_table(replace(table, findings=(*findings, *self._text_remarks())))
                yield replace(described, ambiguous=tuple(name for name in signals if count[name] > 1))
                findings = []
                # these texts belong to the table that was just described
                self._texts.clear()

    def _undescribed(self) -> Iterator[Finding]:
        """Yield a remark on the identifiers that no database describes."""
        if not self._unknown:
            return
        frames = sum(count for _, count in self._unknown)
        every, ids = sum(map(len, self._all)), sum(len(m.rows) for m in self.messages) + len(self._unknown)
        most = sorted(self._unknown, key=lambda pair: -pair[1])
        listed = [f"{sender.text} on {sender.bus_text} ({count_noun(count, 'frame')})" for sender, count in most]
        share = f"{len(self._unknown)} of {ids} identifiers ({frames} of {every} frames)"
        verb = "is" if len(self._unknown) == 1 else "are"
        message = f"{share} {verb} not described by the databases: {join_names(listed, _MAX_LISTED)}"
        yield Finding(self._location, message, severity="remark")

    def _message_tables(self, recorded: RecordedMessage, own: Sequence[BusChannel]) -> Iterator[Table]:
        # whole words are gathered, an eighth of the elements that bytes would be
        payload = recorded.frames.payload.view(np.uint64)[recorded.numbers].view(np.uint8)
        lengths = recorded.frames.lengths[recorded.numbers]
        label = self._labels[id(recorded)]
        for switches in dict.fromkeys(channel.signal.switches for channel in own):
            sent = _switched_on(recorded.message, switches, payload, lengths)
            together = [channel for channel in own if channel.signal.switches == switches]
            if sent is None:
                parts = recorded.numbers, payload, lengths
            elif sent.any():
                parts = recorded.numbers[sent], payload[sent], lengths[sent]
            else:
                continue
            yield self._table(recorded, f"{label}{_condition(switches)}", together, *parts)

    def _table(
        self,
        recorded: RecordedMessage,
        label: str,
        own: Sequence[BusChannel],
        numbers: Int,
        payload: NDArray[np.uint8],
        lengths: NDArray[np.uint8],
    ) -> Table:
        clock = Column(TIME, "s", TIME, recorded.frames.time[numbers])
        columns = [_column(channel, payload, lengths, recorded.message.is_j1939, self._texts) for channel in own]
        return Table(
            self._location.within(f"message {label}"),
            (clock, *columns),
            numbers + 1,
            "frame",
            (TIME, *(column.name for column in columns)),
            details=(("group", label),),
            clock_index=0,
        )

    @cached_property
    def _labels(self) -> dict[int, str]:
        """The shortest unique name of each recorded message."""
        names = unique_forms([message.forms for message in self.messages])
        return {id(message): name for message, name in zip(self.messages, names, strict=True)}


class _Catalog:
    """The messages of databases that have signals, found by their senders."""

    def __init__(self, databases: Iterable[tuple[DatabaseFile, BusDatabase]]) -> None:
        self._exact: list[tuple[DatabaseFile, dict[tuple[int, bool], _Described]]] = []
        self._groups: list[tuple[DatabaseFile, dict[int, list[_Described]]]] = []
        self._twice: dict[str, None] = {}
        for file, database in databases:
            exact: dict[tuple[int, bool], _Described] = {}
            groups: dict[int, list[_Described]] = {}
            for message in database.messages:
                if not message.signals:
                    continue
                described = _Described(database.file, message)
                exact[message.identifier, message.extended] = described
                if message.is_j1939:
                    groups.setdefault(group_number(message.identifier), []).append(described)
            self._exact.append((file, exact))
            self._groups.append((file, groups))

    def find(self, sender: Sender) -> _Described | None:
        """Return the description of the frames of a sender: that of the identifier, else of the parameter group."""
        key = sender.identifier, sender.extended
        exact = [messages[key] for file, messages in self._exact if self._applies(file, sender) and key in messages]
        self._compare(sender, exact)
        if exact or not sender.extended or sender.network != "CAN":
            return exact[0] if exact else None
        number = sender.group_number
        similar = [
            described
            for file, groups in self._groups
            if self._applies(file, sender)
            for described in groups.get(number, ())
        ]
        nearest = min((_distance(described.message, sender) for described in similar), default=0)
        similar = [described for described in similar if _distance(described.message, sender) == nearest]
        # of each database the first description, as one database may describe a group for several addresses
        by_database = {described.database: described for described in reversed(similar)}
        self._compare(sender, list(reversed(by_database.values())))
        return similar[0] if similar else None

    def _compare(self, sender: Sender, candidates: Sequence[_Described]) -> None:
        """Keep in mind that databases describe a sender differently; the first one is used."""
        if any(other.message.signals != candidates[0].message.signals for other in candidates[1:]):
            others = join_names([f"{name} ({message.name})" for name, message in candidates], 3)
            self._twice[f"{sender.text} is described differently by {others}; {candidates[0].database} is used"] = None

    @staticmethod
    def _applies(file: DatabaseFile, sender: Sender) -> bool:
        return file.describes(sender.network, sender.bus)

    def findings(self, location: Location) -> list[Finding]:
        """Return a warning for identifiers that databases describe differently."""
        remedy = 'State the bus of each: dbc = [{ file = "engine.dbc", bus = 1 }].'
        if not self._twice:
            return []
        return [Finding(location, join_names(list(self._twice), 3, "; "), remedy, severity="warning")]


def _distance(message: BusMessage, sender: Sender) -> int:
    """Return how well a message of J1939 fits a sender of its group: its own address, any, or another."""
    address = message.identifier & 0xFF
    return 0 if address == sender.source_address else 1 if address == _ANY_SOURCE else 2


def _forms(recorded: RecordedMessage, signal: BusSignal) -> tuple[str, ...]:
    short = (signal.short_name,) if signal.short_name else ()
    return (signal.name, *(f"{form}.{signal.name}" for form in recorded.forms), *short)


def _restricted(file: DatabaseFile, name: str) -> str:
    """Return a database with the bus that it is restricted to: `body.dbc@CAN2`."""
    is_restricted = file.bus is not None or file.network != "CAN"
    return f"{name}@{file.network}{file.bus or ''}" if is_restricted else name


def _content(frames: Sequence[Frames]) -> str:
    """Return what a log holds: `1200 CAN frames of 3 identifiers (0x123, ...), no values of signals`."""
    parts = []
    for each in frames:
        texts = list(dict.fromkeys(sender.text for sender, _ in each.senders()))
        buses = sorted({sender.bus_text for sender, _ in each.senders() if sender.bus})
        place = f" on {join_names(buses, 3)}" if buses else ""
        listed = f"{count_noun(len(texts), 'identifier')}{place} ({join_names(texts, _MAX_LISTED)})"
        parts.append(f"{count_noun(len(each), f'{each.network} frame')} of {listed}")
    return f"{' and '.join(parts) or 'no frames'}, no values of signals"


def _switched_on(
    message: BusMessage, switches: Sequence[MultiplexCondition], payload: NDArray[np.uint8], lengths: NDArray[np.uint8]
) -> Bool | None:
    """Return in which frames all multiplexers have the values of a signal; None without multiplexers."""
    if not switches:
        return None
    by_name = {signal.name: signal for signal in message.signals}
    sent = np.ones(lengths.size, dtype=bool)
    for switch in switches:
        signal = by_name.get(switch.signal)
        # without its multiplexer, or in frames that end before it, a signal is never sent
        if signal is None or signal.bytes > payload.shape[1]:
            return np.zeros(lengths.size, dtype=bool)
        values = to_numbers(extract_raw(payload, signal), signal)
        spans = [(values >= low) & (values <= high) for low, high in switch.spans]
        sent &= np.any(spans, axis=0) & (lengths >= signal.bytes)
    return sent


def _condition(switches: Sequence[MultiplexCondition]) -> str:
    """Return the values of multiplexers as part of a group's name."""
    texts = [
        f"{switch.signal} = {', '.join(str(low) if low == high else f'{low} to {high}' for low, high in switch.spans)}"
        for switch in switches
    ]
    return f" ({' and '.join(texts)})" if texts else ""


def _column(
    channel: BusChannel,
    payload: NDArray[np.uint8],
    lengths: NDArray[np.uint8],
    is_j1939: bool,
    texts: dict[str, str],
) -> Column:
    """Return the values of a signal, NaN in frames that are too short for it or hold a text, which `texts` notes."""
    signal = channel.signal
    if signal.bytes > payload.shape[1]:
        values = np.full(lengths.size, np.nan)
    else:
        raw = extract_raw(payload, signal)
        values = to_physical(raw, signal, is_j1939)
        if missing_texts(signal) and (counts := without_texts(to_numbers(raw, signal), values, signal)):
            texts[channel.name] = f"{sum(counts.values())} of {values.size}: {join_names(list(counts), _MAX_TEXTS)}"
        if lengths.size and lengths.min() < signal.bytes:
            values[lengths < signal.bytes] = np.nan
    # an unscaled integer is a gear or a state: between two frames it stays, it does not rise
    held = signal.kind != "f" and not signal.is_scaled
    return Column(channel.name, signal.unit, channel.name, values, held=held, description=_description(signal))


def _description(signal: BusSignal) -> str:
    """Return the comment, and the names of values, as physical values."""
    pairs = [f"{value * signal.factor + signal.offset:g} = {text}" for value, text in signal.texts[:_MAX_TEXTS]]
    texts = ", ".join(pairs) + (", ..." if len(signal.texts) > _MAX_TEXTS else "")
    return ": ".join(part for part in (signal.comment, texts) if part)
