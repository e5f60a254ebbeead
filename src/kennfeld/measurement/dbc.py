"""Reader of CAN databases (DBC): messages, the layout of their signals, multiplexing and texts of values.

Statements begin at the start of a line. A statement that cannot be understood is skipped with a warning, since the
messages that a project reads may be intact. Statements about network nodes, receivers and tools are not needed.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.foreign import identify_foreign
from kennfeld.measurement.bus_messages import BusDatabase, BusMessage, BusSignal, MultiplexCondition, bits_of
from kennfeld.measurement.unit_text import plain_unit

_EXTENDED = 1 << 31  # of an identifier in the file
_MOST_STANDARD, _MOST_EXTENDED = 0x7FF, 0x1FFFFFFF  # identifiers of frames
_UNASSIGNED = 0xC0000000  # identifier of the message that collects signals without one
_MOST_BITS = 64
_MOST_BYTES = 1785  # of a message; of J1939 in several packets
_MAX_SIZE = 200_000_000  # bytes of a file
_MOST_LINES = 1000  # of a statement
_MAX_FINDINGS = 20
_HEAD = 20_000  # bytes
# atomic and possessive, so that a head full of comments is searched only once
_MATRIX_FORMATS = (
    (re.compile(rb"\A(?:<\?xml[^>]*>)?\s*(?:<!--(?>.*?-->)\s*+)*+<AUTOSAR[\s>]", re.DOTALL), "arxml"),
    (re.compile(rb"\A(?:<\?xml[^>]*>)?\s*(?:<!--(?>.*?-->)\s*+)*+<(?:\w+:)?NetworkDefinition[\s>]", re.DOTALL), "kcd"),
    (re.compile(rb"\AFormatVersion\s*=", re.IGNORECASE), "sym"),
)
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_TEXT = r'"((?:[^"\\]|\\.)*)"'
# BO_ identifier name: bytes sender
_MESSAGE = re.compile(r"BO_\s+(\d{1,10})\s+(\S+?)\s*:\s*(\d{1,6})\b")
# SG_ name multiplexer : start|length@order sign (factor,offset) [min|max] "unit" receivers; order 0 is Motorola's
_SIGNAL = re.compile(
    r"SG_\s+(\S+?)\s*(?:\s(M|m\d{1,10}M?|m)\s*)?:\s*(\d{1,6})\s*\|\s*(\d{1,6})\s*@\s*([01])\s*([-+])\s*"
    rf"\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\)(?:\s*\[[^\]]*\])?\s*(?:{_TEXT})?"
)
_COMMENT = re.compile(rf"CM_\s+SG_\s+(\d{{1,10}})\s+(\S+)\s+{_TEXT}", re.DOTALL)
_VALUES = re.compile(r"VAL_\s+(\d{1,10})\s+(\S+)\s+(.*)", re.DOTALL)
_PAIR = re.compile(rf"(-?\d{{1,20}})\s+{_TEXT}", re.DOTALL)
_VALUE_TYPE = re.compile(r"SIG_VALTYPE_\s+(\d{1,10})\s+(\S+?)(?:\s*:\s*|\s+)([0-3])\b")
_SWITCH = re.compile(r"SG_MUL_VAL_\s+(\d{1,10})\s+(\S+)\s+(\S+)\s+([\d\s,-]+)")
_SPAN = re.compile(r"(\d{1,20})\s*-\s*(\d{1,20})")
_CHOICES = re.compile(rf"BA_DEF_\s+(?:BO_\s+)?{_TEXT}\s+ENUM\s+(.*)", re.DOTALL)
_DEFAULT = re.compile(rf"BA_DEF_DEF_\s+{_TEXT}\s+(.*?)\s*;", re.DOTALL)
_OF_MESSAGE = re.compile(rf"BA_\s+{_TEXT}\s+BO_\s+(\d{{1,10}})\s+(.*?)\s*;", re.DOTALL)
_OF_SIGNAL = re.compile(rf"BA_\s+{_TEXT}\s+SG_\s+(\d{{1,10}})\s+(\S+)\s+{_TEXT}\s*;", re.DOTALL)
# a value without quotes does not begin with a capital, as BO_, SG_ and BU_ of other attributes do
_OF_FILE = re.compile(rf'BA_\s+{_TEXT}\s+("[^"]*"|[^\sA-Z][^\s;]*)\s*;', re.DOTALL)
_KEYWORD = re.compile(r"\s*([A-Z]{2,}_(?:[A-Z]+_)*)(?=[\s:])")
_LONG_SIGNAL, _LONG_MESSAGE = "SystemSignalLongSymbol", "SystemMessageLongSymbol"  # names of more than 32 characters
_FORMAT, _PROTOCOL = "VFrameFormat", "ProtocolType"  # attributes
_J1939_FORMAT, _J1939 = "J1939PG", "J1939"


@dataclass
class _MessageLines:
    """A message while its statements are read."""

    message: BusMessage
    signals: dict[str, BusSignal] = field(default_factory=dict)
    marks: dict[str, str] = field(default_factory=dict)  # `M`, `m3` or `m3M` of each multiplexed signal
    # the ranges of each multiplexed signal by multiplexer, which may be spread over several statements
    switches: dict[str, dict[str, tuple[tuple[int, int], ...]]] = field(default_factory=dict)
    long_name: str = ""
    long_names: dict[str, str] = field(default_factory=dict)  # of its signals


@dataclass
class _Statements:
    """The content of the statements; messages by their identifier in the file."""

    file: str
    messages: dict[int, _MessageLines] = field(default_factory=dict)
    choices: dict[str, list[str]] = field(default_factory=dict)
    defaults: dict[str, str] = field(default_factory=dict)
    formats: dict[int, str] = field(default_factory=dict)
    protocol: str = ""
    current: _MessageLines | None = None
    findings: list[Finding] = field(default_factory=list)

    def warn(self, line: int, message: str, remedy: str = "") -> None:
        self.findings.append(Finding(Location(self.file, line), message, remedy, severity="warning"))


def read_database(path: Path) -> BusDatabase:
    """Read a DBC file.

    Raises:
        InputError: the file cannot be read, or describes no message.
    """
    location = Location(path.name)
    with convert_errors(path, "cannot be read"):
        if path.stat().st_size > _MAX_SIZE:
            raise InputError.of(location, "this is too large for a CAN database (DBC)", "Is it the right file?")
        content = path.read_bytes()
    return parse_content(path.name, content)


def parse_content(file: str, content: bytes) -> BusDatabase:
    """Return the database in a file: DBC, or an exchange format that another package reads."""
    foreign = identify_foreign(content)
    if foreign is not None:
        raise InputError.of(Location(file), f"this is {foreign.description}", foreign.remedy)
    kind = matrix_format(content)
    if not kind:
        return parse_database(file, decode(content))
    from kennfeld.measurement.matrix_databases import to_dbc

    texts, problems = to_dbc(file, content, kind)
    if not texts:
        raise InputError.of(Location(file), "describes no message of a bus", "Is it the right file?")
    databases = [parse_database(file, text) for text in texts]
    # from the last to the first, so that of equal identifiers the first message remains
    messages = {(m.identifier, m.extended): m for database in reversed(databases) for m in reversed(database.messages)}
    findings = [replace(f, location=Location(file)) for database in databases for f in database.findings]
    if problems:
        message = f"{count_noun(len(problems), 'part')} of the database could not be read ({problems[0]})"
        remedy = "Compare its signals, or convert it to DBC with the tool that wrote it."
        findings.append(Finding(Location(file), message, remedy, severity="warning"))
    return BusDatabase(file, tuple(messages.values()), tuple(findings))


def matrix_format(content: bytes) -> str:
    """Return the format of a database that is not DBC: `arxml`, `kcd` or `sym`; empty for others.

    >>> matrix_format(b'FormatVersion=6.0 // Do not edit this line!')
    'sym'
    """
    start = content[:_HEAD].removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((kind for mark, kind in _MATRIX_FORMATS if mark.search(start)), "")


def decode(content: bytes) -> str:
    """Return the text of a file: UTF-8, else that of Windows."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def parse_database(file: str, text: str) -> BusDatabase:
    r"""Return the database that a text describes; `file` is its name in messages.

    >>> text = 'BO_ 500 Engine: 8 ECU\n SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" ECU\n'
    >>> database = parse_database("engine.dbc", text)
    >>> database.messages[0].signals[0].factor
    0.25
    """
    statements = _Statements(file)
    for line, keyword, statement in _split(statements, text):
        _READERS[keyword](statements, line, statement)
    if not statements.messages:
        remedy = "Name a DBC file with statements BO_ and SG_; other databases can be converted to DBC."
        raise InputError.of(Location(file), "describes no message of a bus", remedy)
    messages = tuple(_message(statements, identifier) for identifier in statements.messages)
    return BusDatabase(file, messages, (*_limited(file, statements.findings), *_overlaps(file, messages)))


def _limited(file: str, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    more = len(findings) - _MAX_FINDINGS
    if more <= 0:
        return tuple(findings)
    rest = Finding(Location(file), f"{more} more problems of the database", severity="warning")
    return (*findings[:_MAX_FINDINGS], rest)


def _split(statements: _Statements, text: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, keyword and text of the statements that are needed; texts in quotes may contain line ends."""
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        first, match = at, _KEYWORD.match(lines[at])
        at += 1
        keyword = match[1] if match else ""
        if keyword not in _READERS:
            continue
        if keyword not in ("BO_", "SG_"):
            at = _end(lines, first)
            if at == first:
                statements.warn(first + 1, f"the text of {keyword} does not end; it is skipped", "Add a quote and ;.")
                at += 1
                continue
        yield first + 1, keyword, "\n".join(lines[first:at]).strip()


def _end(lines: Sequence[str], first: int) -> int:
    """Return the line after a statement; the first line itself if a text in quotes does not end."""
    odd = False
    for at in range(first, min(first + _MOST_LINES, len(lines))):
        line = lines[at]
        if at > first and not odd and _KEYWORD.match(line):
            return at  # without a semicolon
        # each quote opens or closes a text, unless a backslash precedes it
        odd ^= (line.count('"') - line.count('\\"')) % 2 == 1
        if not odd and line.rstrip().endswith(";"):
            return at + 1
    return first if odd else min(first + _MOST_LINES, len(lines))


def _read_message(statements: _Statements, line: int, text: str) -> None:
    statements.current = None
    match = _MESSAGE.match(text)
    if match is None:
        statements.warn(line, f"{text[:60]!r} is not a message; it is skipped with its signals")
        return
    number, name, size = int(match[1]), match[2], int(match[3])
    if number == _UNASSIGNED:
        return
    extended, identifier = bool(number & _EXTENDED), number & ~_EXTENDED
    if not extended and _MOST_STANDARD < identifier <= _MOST_EXTENDED:
        extended = True
        message = f"message {name} has an identifier of more than 11 bits, {number}, and is taken as an extended one"
        statements.warn(line, message, f"Write {number | _EXTENDED} (with bit 31) if that is right.")
    if identifier > (_MOST_EXTENDED if extended else _MOST_STANDARD) or number >= 1 << 32:
        statements.warn(line, f"message {name} has an identifier {number} that no frame can have; it is skipped")
    elif number in statements.messages:
        other = statements.messages[number].message
        message = f"message {name} has the identifier of {other.name} (line {other.line}); it is skipped"
        statements.warn(line, message, "Remove one of them.")
    else:
        size = min(size, _MOST_BYTES)
        statements.current = _MessageLines(BusMessage(name, identifier, extended, size, line=line))
        statements.messages[number] = statements.current


def _read_signal(statements: _Statements, line: int, text: str) -> None:
    lines = statements.current
    if lines is None:
        return
    match, where = _SIGNAL.match(text), f"of message {lines.message.name}"
    if match is None or not all(math.isfinite(float(number)) for number in match.group(7, 8)):
        statements.warn(line, f"{text[:60]!r} is not a signal {where}; it is skipped")
        return
    name, mark, start, length, order, sign, factor, offset, unit = match.groups()
    signal = BusSignal(
        name,
        int(start),
        int(length),
        big_endian=order == "0",
        kind="i" if sign == "-" else "u",
        factor=float(factor),
        offset=float(offset),
        unit=plain_unit(unit or ""),
    )
    if not 0 < signal.length <= _MOST_BITS:
        message = f"signal {name} {where} has {signal.length} bits; it is skipped"
        statements.warn(line, message, f"Signals have 1 to {_MOST_BITS} bits.")
    elif signal.bytes > max(lines.message.size, 8):
        message = f"signal {name} {where} lies outside its {lines.message.size} bytes; it is skipped"
        statements.warn(line, message, "Correct its start and length.")
    elif name in lines.signals:
        statements.warn(line, f"duplicate signal {name} {where}; it is skipped", "Rename or remove one of them.")
    else:
        lines.signals[name] = signal
        if mark and mark != "m":  # without a number only SG_MUL_VAL_ tells what the signal switches
            lines.marks[name] = mark


def _signal_of(statements: _Statements, number: str, name: str) -> tuple[_MessageLines, BusSignal] | None:
    lines = statements.messages.get(int(number))
    signal = None if lines is None else lines.signals.get(name)
    return None if lines is None or signal is None else (lines, signal)


def _read_comment(statements: _Statements, line: int, text: str) -> None:
    match = _COMMENT.match(text)
    if match and (target := _signal_of(statements, match[1], match[2])):
        lines, signal = target
        lines.signals[signal.name] = replace(signal, comment=" ".join(_unquoted(match[3]).split())[:200])


def _read_values(statements: _Statements, line: int, text: str) -> None:
    match = _VALUES.match(text)
    if match and (target := _signal_of(statements, match[1], match[2])):
        lines, signal = target
        texts = tuple((int(number), _unquoted(name)) for number, name in _PAIR.findall(match[3]))
        lines.signals[signal.name] = replace(signal, texts=tuple(sorted(texts)))


def _read_value_type(statements: _Statements, line: int, text: str) -> None:
    match = _VALUE_TYPE.match(text)
    # 1 is a float of 32 bits, 2 a double; the others are integers, as they are by default
    if match and match[3] in "12" and (target := _signal_of(statements, match[1], match[2])):
        lines, signal = target
        bits = 32 if match[3] == "1" else 64
        if signal.length != bits:
            message = f"signal {signal.name} of message {lines.message.name} is a floating-point number of {bits} bits"
            statements.warn(line, f"{message}, but has {signal.length}; it is skipped", "Correct its length.")
            del lines.signals[signal.name]
        else:
            lines.signals[signal.name] = replace(signal, kind="f")


def _read_switch(statements: _Statements, line: int, text: str) -> None:
    match = _SWITCH.match(text)
    if match and (target := _signal_of(statements, match[1], match[2])):
        lines, signal = target
        spans = tuple((int(low), int(high)) for low, high in _SPAN.findall(match[4]))
        by_multiplexer = lines.switches.setdefault(signal.name, {})
        by_multiplexer[match[3]] = tuple(dict.fromkeys((*by_multiplexer.get(match[3], ()), *spans)))


def _read_choices(statements: _Statements, line: int, text: str) -> None:
    if match := _CHOICES.match(text):
        statements.choices[match[1]] = re.findall(_TEXT, match[2])


def _read_default(statements: _Statements, line: int, text: str) -> None:
    if match := _DEFAULT.match(text):
        statements.defaults[match[1]] = match[2].strip('"')


def _read_attribute(statements: _Statements, line: int, text: str) -> None:
    if (match := _OF_MESSAGE.match(text)) and match[1] == _FORMAT:
        statements.formats[int(match[2])] = match[3].strip('"')
    elif match and match[1] == _LONG_MESSAGE and int(match[2]) in statements.messages:
        statements.messages[int(match[2])].long_name = match[3].strip('"')
    elif (match := _OF_SIGNAL.match(text)) and match[1] == _LONG_SIGNAL:
        if target := _signal_of(statements, match[2], match[3]):
            target[0].long_names[match[3]] = match[4]
    elif (match := _OF_FILE.match(text)) and match[1] == _PROTOCOL:
        statements.protocol = match[2].strip('"')


_READERS: Mapping[str, Callable[[_Statements, int, str], None]] = {
    "BO_": _read_message,
    "SG_": _read_signal,
    "CM_": _read_comment,
    "VAL_": _read_values,
    "SIG_VALTYPE_": _read_value_type,
    "SG_MUL_VAL_": _read_switch,
    "BA_DEF_": _read_choices,
    "BA_DEF_DEF_": _read_default,
    "BA_": _read_attribute,
}


def _unquoted(text: str) -> str:
    return text.replace('\\"', '"')


def _message(statements: _Statements, number: int) -> BusMessage:
    """Return a message with its signals in the order of the file."""
    lines = statements.messages[number]
    signals = _with_long_names(lines, _with_switches(statements, lines))
    name = lines.long_name or lines.message.name
    return replace(lines.message, name=name, is_j1939=_is_j1939(statements, number), signals=tuple(signals))


def _with_long_names(lines: _MessageLines, signals: Sequence[BusSignal]) -> list[BusSignal]:
    """Return signals under their long names, if these are unique; multiplexers are named in the same way."""
    names = {signal.name: lines.long_names.get(signal.name) or signal.name for signal in signals}
    if len(set(names.values())) < len(names):
        return list(signals)
    renamed = []
    for signal in signals:
        # a condition names its multiplexer, which may have a long name itself
        switches = tuple(switch._replace(signal=names.get(switch.signal, switch.signal)) for switch in signal.switches)
        short = signal.name if names[signal.name] != signal.name else ""
        renamed.append(replace(signal, name=names[signal.name], switches=switches, short_name=short))
    return renamed


def _is_j1939(statements: _Statements, number: int) -> bool:
    """Return whether a message is one of J1939: by its own format, else by the protocol of the database."""
    frame_format = statements.formats.get(number, statements.defaults.get(_FORMAT, ""))
    choices = statements.choices.get(_FORMAT, [])
    # an attribute that is an enumeration is stored as the number of its choice
    if frame_format.isdecimal() and int(frame_format) < len(choices):
        frame_format = choices[int(frame_format)]
    protocol = statements.protocol or statements.defaults.get(_PROTOCOL, "")
    by_protocol = protocol == _J1939 and number not in statements.formats
    return statements.messages[number].message.extended and (by_protocol or frame_format == _J1939_FORMAT)


def _with_switches(statements: _Statements, lines: _MessageLines) -> list[BusSignal]:
    """Return the signals of a message with the conditions of those that are multiplexed."""
    # `m3` means the one multiplexer `M`; which of several is meant, SG_MUL_VAL_ states
    plain = next((name for name, mark in lines.marks.items() if mark == "M" and name in lines.signals), "")
    own: dict[str, list[MultiplexCondition]] = {}
    for name in lines.signals:
        mark = lines.marks.get(name, "")
        if lines.switches.get(name):  # whatever its mark is
            own[name] = list(map(MultiplexCondition._make, lines.switches[name].items()))
        elif mark.startswith("m"):
            value = int(mark[1:].rstrip("M"))
            own[name] = [MultiplexCondition(plain, ((value, value),))] if plain else []
    signals = []
    for name, signal in lines.signals.items():
        switches = _chain(name, own)
        if name in own and (not switches or any(switch.signal not in lines.signals for switch in switches)):
            message = f"signal {name} of message {lines.message.name} depends on a multiplexer that is missing"
            statements.warn(lines.message.line, f"{message}; it is skipped", "Add the multiplexer (M).")
            continue
        signals.append(replace(signal, switches=switches))
    return signals


def _chain(name: str, own: Mapping[str, Sequence[MultiplexCondition]]) -> tuple[MultiplexCondition, ...]:
    """Return the conditions of a signal and of the multiplexers that it depends on; none if they form a cycle."""
    chain: dict[MultiplexCondition, None] = {}
    multiplexers: dict[str, list[str]] = {}
    names = [name]
    while names:
        here = names.pop()
        # two multiplexers may depend on the same one
        if here in multiplexers:
            continue
        switches = own.get(here, ())
        chain |= dict.fromkeys(switches)
        multiplexers[here] = [switch.signal for switch in switches]
        names += multiplexers[here]
    try:
        TopologicalSorter(multiplexers).prepare()
    except CycleError:
        return ()
    return tuple(chain)


def _overlaps(file: str, messages: Sequence[BusMessage]) -> list[Finding]:
    """Return a remark on signals that share bits, unless they are multiplexed."""
    pairs = [pair for message in messages for pair in _overlapping(message)]
    if not pairs:
        return []
    message = f"{count_noun(len(pairs), 'signal')} share bits with others of their message: {join_names(pairs, 3)}"
    return [Finding(Location(file), message, severity="remark")]


def _overlapping(message: BusMessage) -> Iterator[str]:
    taken = 0
    bits = [(bits_of(signal), signal.name) for signal in message.signals if not signal.switches]
    for mask, name in bits:
        if taken & mask:
            other = next(other for own, other in bits if own & mask)
            yield f"{message.name}.{name} and {other}"
        taken |= mask
